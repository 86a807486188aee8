"""Lengths and cells."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.nouns.length import CELL_UNIT, UNITS_IN_MM, Cell, Length, parse_length, voxel_mm


@pytest.mark.parametrize(
    ("text", "mm"),
    [(7.5, 7.5), ("7.5 mm", 7.5), ("50um", 0.05), ("50 µm", 0.05), (" 1e-1 cm ", 1.0), ("2 in", 50.8), ("-.5 m", -500)],
)
def test_lengths_are_read(text, mm):
    assert parse_length(text).mm() == pytest.approx(mm)


@pytest.mark.parametrize("text", ["", "mm", "7.5 furlong", "1 2", "nan", "inf", True, None, [1], float("inf"), "1e999"])
def test_others_are_refused(text):
    with pytest.raises(ValueError, match=r"length|unit"):
        parse_length(text)


@given(st.floats(1e-6, 1e6), st.sampled_from([None, CELL_UNIT, *UNITS_IN_MM]))
def test_what_is_printed_reads_the_same(value, unit):
    length = Length(float(f"{value:g}"), unit)
    assert parse_length(str(length)) == length


def test_fractions():
    assert Cell(7.5, True).fraction(Length(0.75, "cm")) == 1.0
    with pytest.raises(ConfigError, match="physical"):
        Cell(2.0).fraction(Length(1, "mm"))
    with pytest.raises(ConfigError, match="in cell sizes"):
        Length(0.5, CELL_UNIT).mm()


@pytest.mark.parametrize("cell", [Cell(), Cell(6.0, True), Cell(0.5, True)])
def test_lengths_without_a_unit_are_in_cell_sizes(cell):
    assert cell.fraction(Length(0.11)) == cell.fraction(Length(0.11, CELL_UNIT)) == 0.11
    assert cell.fraction(Length(0.0)) == 0.0


def test_lengths_that_may_be_meant_in_the_unit_of_the_edge_need_theirs():
    with pytest.raises(ConfigError, match=r"0\.8 has no unit and counts in cell sizes, of 7\.5 mm") as caught:
        Cell(7.5, True).fraction(Length(0.8))
    assert "`0.8 mm`" in caught.value.hint
    with pytest.raises(ConfigError, match="`edge: 2`") as caught:
        Cell(2.0).fraction(Length(0.3))
    assert "`0.15 cell`" in caught.value.hint
    assert Cell(7.5, True).fraction(Length(0.8, CELL_UNIT)) == 0.8
    assert Cell(2.0).fraction(Length(0.3, CELL_UNIT)) == 0.3


def test_units_are_those_of_the_international_system():
    """1 in is 25.4 mm exactly (international yard and pound agreement, 1959)."""
    expected = {"um": 0.001, "mm": 1, "cm": 10, "m": 1000, "in": 25.4}
    assert {unit: parse_length(f"1 {unit}").mm() for unit in expected} == expected
    assert set(UNITS_IN_MM) == {*expected, "µm"}
    assert UNITS_IN_MM["µm"] == UNITS_IN_MM["um"]


def test_pixels_and_layers():
    mm, um = Length(0.05, "mm"), Length(24.0, "um")
    assert voxel_mm(mm, None) == (0.05, 0.05, 0.05)
    assert voxel_mm((mm, mm), um) == pytest.approx((0.05, 0.05, 0.024))
    assert voxel_mm((mm, um), Length(0.1)) == pytest.approx((0.05, 0.024, 0.1))
    assert voxel_mm((Length(0.1), Length(0.2)), mm) == (0.1, 0.2, 0.05)
    assert voxel_mm((Length(50.0, "um"), mm), None) == pytest.approx((0.05, 0.05, 0.05))
    for pixel in ((mm, Length(0.05)), (Length(0.05), mm)):
        with pytest.raises(ConfigError, match="one has a unit"):
            voxel_mm(pixel, mm)
    with pytest.raises(ConfigError, match="needs a `layer`"):
        voxel_mm((mm, um), None)


def test_a_cell_says_its_unit():
    assert Cell(7.5, True).summary() == {"edge": 7.5, "unit": "mm"}
    assert Cell(2.0).summary() == {"edge": 2.0, "unit": "cell size"}
