"""Sheets of pictures and of layers."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.render.sheets import contact_sheet, font, layer_sheet, printable, text_width

RED = np.full((30, 40, 3), (200, 10, 10), np.uint8)
BLUE = np.full((20, 30, 3), (10, 10, 200), np.uint8)


def test_pictures_stand_in_rows_and_small_ones_in_the_middle():
    sheet = contact_sheet([RED, BLUE, RED], columns=2, gap=10)
    assert sheet.shape == (10 + 2 * 40, 10 + 2 * 50, 3)
    assert np.array_equal(sheet[10:40, 10:50], RED)
    assert np.array_equal(sheet[15:35, 65:95], BLUE)
    assert np.array_equal(sheet[50:80, 10:50], RED)
    untouched = sheet.copy()
    untouched[10:40, 10:50] = untouched[15:35, 65:95] = untouched[50:80, 10:50] = 255
    assert (untouched == 255).all()


def test_labels_are_beneath_their_pictures():
    bare = contact_sheet([RED, RED], ["", "n = 7"], columns=2, gap=10, text_size=16)
    dark = (bare.max(axis=2) < 200) & (bare != RED[0, 0]).any(axis=2)
    rows, columns = np.nonzero(dark)
    assert rows.min() >= 40
    assert columns.min() >= 60
    assert columns.max() < 100


def test_long_labels_shrink():
    sheet = contact_sheet([RED, RED], ["a label much wider than its picture", ""], columns=2, gap=10)
    dark = (sheet.max(axis=2) < 200) & (sheet != RED[0, 0]).any(axis=2)
    assert np.nonzero(dark)[1].min() >= 0
    assert np.nonzero(dark)[1].max() < 100


@pytest.mark.parametrize("width", [37, 100, 320])
def test_layers_of_pixels_that_are_not_square_keep_their_shape(width):
    """A disk is a disk, averaged down or enlarged."""
    x, y = (np.arange(50) + 0.5) * 0.2 - 5, (np.arange(100) + 0.5) * 0.1 - 5
    disk = np.hypot(x, y[:, None]) < 5
    picture = layer_sheet([disk], width=width, pixel=(0.2, 0.1), solid=(0, 0, 0), void=(255, 255, 255))[20:-20, 20:-20]
    assert picture.shape[0] == picture.shape[1] == {37: 37, 100: 100, 320: 300}[width]
    assert (picture[..., 0] / 255).mean() == pytest.approx(1 - disk.mean(), abs=1e-3)
    assert np.array_equal(layer_sheet([disk], width=width), layer_sheet([disk], width=width, pixel=(3.0, 3.0)))


def test_title_is_above():
    assert contact_sheet([RED], title="Title").shape[0] > contact_sheet([RED]).shape[0]


def test_sheets_are_about_square_without_a_number_of_columns():
    height, width, _ = contact_sheet([RED] * 12).shape
    assert 0.5 < height / width < 2.0


def test_layers_are_colored_and_enlarged_by_whole_factors():
    layer = np.zeros((3, 5), bool)
    layer[0, 1] = True
    sheet = layer_sheet([layer], width=52, solid=(1, 2, 3), void=(250, 251, 252))
    picture = sheet[20:-20, 20:-20]
    assert picture.shape == (30, 50, 3)
    assert (picture[:10, 10:20] == (1, 2, 3)).all()
    assert (picture == (1, 2, 3)).all(axis=2).sum() == 100
    assert (picture[10:] == (250, 251, 252)).all()


def test_large_layers_are_averaged_down():
    layer = np.zeros((400, 800), np.uint8)
    layer[:, ::2] = 255
    sheet = layer_sheet([layer], width=100, solid=(0, 0, 0), void=(200, 200, 200))
    assert sheet[20:-20, 20:-20].shape == (50, 100, 3)
    assert abs(sheet[20:-20, 20:-20].astype(int) - 100).max() <= 1


def test_what_the_font_lacks_is_spelt_out():
    missing = bytes(font(30).getmask("\uffff"))
    for letter in "αβγδεθκλμµνξρσφω−–—×²³≤≥≈…":
        spelt = printable(letter)
        assert all(bytes(font(30).getmask(part)) != missing for part in spelt), letter
    assert printable("porosity 0.5 °") == "porosity 0.5 °"


def test_text_width_grows_with_size():
    assert 1.8 < text_width("porosity", 60) / text_width("porosity", 30) < 2.2


def test_wrong_arguments():
    with pytest.raises(DesignError, match="no picture"):
        contact_sheet([])
    with pytest.raises(DesignError, match="columns"):
        contact_sheet([RED], columns=0)
    with pytest.raises(DesignError, match="wide"):
        layer_sheet([np.ones((2, 2), bool)], width=0)
    with pytest.raises(ValueError, match="labels"):
        contact_sheet([RED], ["a", "b"])
    with pytest.raises(ValueError, match="pictures"):
        contact_sheet([RED[..., 0]])
    with pytest.raises(ValueError, match="layers"):
        layer_sheet([RED])
