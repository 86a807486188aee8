"""Readings of test machines become stress and strain: signs, corrections only if asked for, and what is refused."""

import numpy as np
import pytest
from sppm_crushing.numerics.compression import Specimen, measures
from sppm_crushing.stages.read_compression import ReadCompression

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext

SIZE = (Length(45.0), Length(4.5, "cm"), Length(45.0, "mm"))
STRAIN = np.arange(3001) / 5000
STRESS = np.interp(STRAIN, [0, 0.03, 0.05, 0.1, 0.25, 0.5, 0.6], [0, 3.0, 2.5, 2.0, 2.0, 2.2, 4.0])


@pytest.fixture
def write(tmp_path):
    def write(force, way, head="Force (N),Displacement (mm)", name="test.csv", row="{:.6f},{:.6f}\n", decimal="."):
        text = "".join(row.format(f, d).replace(".", decimal) for f, d in zip(force, way, strict=True))
        path = tmp_path / name
        path.write_text(f"{head}\n{text}", encoding="utf-8")
        return path

    return write


def curve_of(path, context=None, **options):
    made = ReadCompression(path=path, **{"size": SIZE} | options).run(context or PlainContext())
    made.check()
    return made


def numbers(strain, stress):
    return {m.name: m.value for m in measures(strain, stress, Specimen("MPa", 2025.0, 45.0, 0.4))}


def test_stress_is_force_over_area_and_strain_displacement_over_height(write):
    context = PlainContext()
    curve = curve_of(write(STRESS * 2025, STRAIN * 45), context, mass=36.45)
    assert curve.stress == pytest.approx(STRESS, abs=1e-9)
    assert curve.strain == pytest.approx(STRAIN, abs=1e-7)
    assert (curve.area, curve.height) == pytest.approx((2025, 45))
    assert curve.density == pytest.approx(0.4)
    assert (curve.origin, curve.unit, curve.name) == ("measured", "MPa", "test")
    assert curve.notes[-1] == "no correction"
    assert not context.warnings
    slab = curve_of(write(STRESS * 600, STRAIN * 50), size=(Length(30.0), Length(20.0), Length(50.0)))
    assert slab.stress == pytest.approx(STRESS, abs=1e-8)
    assert slab.strain == pytest.approx(STRAIN, abs=1e-7)
    round_one = curve_of(write(STRESS * 2025, STRAIN * 45), area=1000.0, specimen="SPPM-1")
    assert round_one.stress == pytest.approx(STRESS * 2.025)
    assert round_one.name == "SPPM-1"


MANGLED = {
    "negative": (lambda f, d: (-f, -d), "Force (N),Displacement (mm)", {}),
    "inches and pounds": (lambda f, d: (f / 4.4482216, d / 25.4), "Load (lbf),Extension (in)", {}),
    "kilonewtons and centimeters": (lambda f, d: (f / 1000, d / 10), "Force (kN),Travel (cm)", {}),
    "compliance": (lambda f, d: (f, d + f / 20_000), "Force (N),Displacement (mm)", {"compliance": 0.05}),
    "preload": (
        lambda f, d: (np.append(np.zeros(90), f + 0.01), np.append(np.linspace(0, 1, 90), d + 1)),
        "Force (N),Displacement (mm)",
        {"preload": 0.005},
    ),
    "toe": (
        # the first 1 % strain of the straight rise becomes a parabola that joins it, .45 mm later
        lambda f, d: (np.append(np.linspace(0, 1, 91)[:-1] ** 2 * 2025, f[50:]), np.append(np.arange(90) / 100,
                      d[50:] + 0.45)),
        "Force (N),Displacement (mm)",
        {"toe": True},
    ),
    "toe, inches and compliance": (
        lambda f, d: (f / 4.4482216, (d + 0.9 + f / 20_000) / 25.4),
        "Load (lbf),Extension (in)",
        {"toe": True, "compliance": 0.05},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MANGLED)
def test_a_mangled_test_has_the_same_measures(write, name):
    mangle, head, options = MANGLED[name]
    curve = curve_of(write(*mangle(STRESS * 2025, STRAIN * 45), head=head, row="{:.9f},{:.9f}\n"), **options)
    found, known = numbers(curve.strain, curve.stress), numbers(STRAIN, STRESS)
    for measure, value in known.items():
        if value is not None:
            assert found[measure] == pytest.approx(value, rel=5e-3), measure


def test_a_blank_run_takes_the_machine_off(write):
    machine = lambda f: 0.3 * (f / 9000) ** 0.7  # noqa: E731
    force = np.linspace(0, 9000, 400)
    blank = write(
        force, machine(force), name="blank.csv", head="Kraft (N);Weg (mm)", row="{:.6f};{:.6f}\n", decimal=","
    )
    path = write(STRESS * 2025, STRAIN * 45 + machine(STRESS * 2025))
    curve = curve_of(path, compliance=blank)
    assert curve.strain == pytest.approx(STRAIN, abs=1e-4)
    assert "blank.csv" in curve.notes[-1]
    with pytest.raises(InputError, match="ends at 2000 N, and the test goes to 8100 N"):
        curve_of(path, compliance=write([0, 2000, 1000], [0, 0.1, 0.05], name="blank.csv"))


def test_unloading_is_kept_if_asked_for(write):
    there, back = np.arange(1500) / 5000, 0.3 - np.arange(150) / 5000
    strain = np.concatenate([there, back, back[::-1], 0.3 + there])
    stress = np.concatenate([there * 10, 3 - 40 * (0.3 - back), 3 - 40 * (0.3 - back[::-1]), np.full(1500, 3.0)])
    path = write(stress * 2025, strain * 45)
    with pytest.raises(InputError, match=r"goes back at a strain of 0\.3, and on again"):
        curve_of(path)
    assert len(curve_of(path, unload="keep").strain) == 3300
    with pytest.raises(InputError, match="goes back"):
        curve_of(path, strain=0.4)
    before = curve_of(path, strain=0.29)
    assert before.strain.max() == pytest.approx(0.29, abs=3e-4)
    assert "left out" in before.notes[-1]


def test_the_way_back_at_the_end_is_left_out(write):
    strain = np.concatenate([STRAIN, STRAIN[::-1]])
    curve = curve_of(write(np.append(STRESS, 0 * STRESS) * 2025, strain * 45))
    assert len(curve.strain) == len(STRAIN)
    assert "3001 readings behind a strain of 0.6 left out" in curve.notes[-1]


def test_stress_and_strain_need_no_size(write):
    path = write(STRESS * 1000, STRAIN * 100, head="Spannung (kPa);Stauchung (%)", row="{:.6f};{:.6f}\n")
    curve = curve_of(path, size=None)
    assert curve.stress == pytest.approx(STRESS)
    assert curve.strain == pytest.approx(STRAIN)
    assert (curve.area, curve.height) == (None, None)
    with pytest.raises(ConfigError, match=r"area of the specimen of test\.csv is not known"):
        curve_of(path, size=None, preload=5.0)


def test_a_zero_far_away_is_told(write):
    context = PlainContext()
    curve_of(write(STRESS * 2025, STRAIN * 45 + 5), context)
    assert "begins at a strain of 0.111" in str(context.warnings)


@pytest.mark.parametrize(
    ("force", "way", "options", "said"),
    [
        (np.full(50, 3.0), np.arange(50), {}, "the force is 3 in all 50 readings"),
        (np.arange(50), np.full(50, 2.0), {}, "the displacement is 2 in all 50 readings"),
        (np.arange(50), np.arange(50), {"size": None}, "the area of the specimen"),
        (np.arange(50), np.arange(50), {"size": None, "area": 3.0}, "the height of the specimen"),
        (np.arange(50), np.arange(50), {"preload": 100.0}, "before the preload of 100 N"),
        (np.arange(50), np.arange(50), {"strain": 0.01}, "1 readings are left up to a strain of 0.01"),
        (np.full(50, 3.0) + (np.arange(50) == 0), np.arange(50), {"toe": True}, "the stress does not rise"),
        (np.arange(50), np.arange(50), {"columns": ("Force (N)", "State")}, "'State' is no column"),
        (np.arange(50), np.arange(50), {"columns": ("1", "Force (N)")}, "names column 'Force .N.' twice"),
    ],
)
def test_what_is_no_test_of_compression_is_refused(write, force, way, options, said):
    with pytest.raises((InputError, ConfigError), match=said):
        curve_of(write(force, way), **options)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"columns": ("Force",)}, "`columns` names 1; it takes two"),
        ({"units": ("N", "mm", "s")}, "`units` names 3"),
        ({"units": ("mm", "N")}, "'mm' is no unit of force"),
    ],
)
def test_options_that_contradict_each_other(options, said):
    with pytest.raises(ConfigError, match=said):
        ReadCompression(path="a.csv", **options).check_options()
