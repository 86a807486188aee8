"""Sheets of pictures and of layers."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.pictures.camera import Camera, framed
from sppm_pipeline.services.pictures.sheets import (
    AXES,
    annotated,
    bar_length,
    contact_sheet,
    font,
    layer_sheet,
    printable,
    text_width,
)

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


def frame_of(camera, length=40.0, size=(600, 400)):
    """A camera pointed at a cube of some length."""
    return framed(camera, length * np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float), size)


@pytest.mark.parametrize(("unit", "length"), [(1.0, 40.0), (4.0, 40.0), (0.25, 3.7), (None, 2.0)])
def test_the_scale_bar_is_as_long_as_it_says(unit, length):
    frame = frame_of(Camera(-90, 0), length)
    blank = np.full((400, 600, 3), 255, np.uint8)
    picture = annotated(blank, frame, unit)[380:396, 300:]
    row = max(picture, key=lambda line: (line < 128).all(1).sum())
    drawn = int((row < 128).all(1).sum())
    said = bar_length(frame.scale / (unit or 1.0), 600)
    assert drawn == pytest.approx(said * frame.scale / (unit or 1.0), abs=1)
    assert 120 >= drawn > 120 / 2.5 - 1  # a fifth of the width, or as near to it as 1, 2, 5 come
    assert f"{said:g}".strip("0.")[0] in "125"


@pytest.mark.parametrize("camera", [Camera(), Camera(20, -40), Camera(-90, 0)])
def test_axes_point_where_they_do(camera):
    frame = frame_of(camera)
    picture = annotated(np.zeros((900, 1200, 3), np.uint8), frame, 1.0)[:, :300].astype(int)
    axes = np.array(AXES)
    near = np.abs(picture[:, :, None] - axes).max(3) < 40
    # all arms begin in the middle of a patch of 3.2 arms of 49.5 pixels
    middle = np.array([12 + 79, 900 - 9 - 79])
    for axis in range(3):
        along = np.array([frame.axes[0, axis], -frame.axes[1, axis]])
        if np.hypot(*along) < 0.3:
            continue
        rows, columns = np.nonzero(near[:, :, axis])
        places = np.stack([columns, rows], 1) + 0.5 - middle
        farthest = places[np.argmax(places @ along)]
        assert farthest @ along > 0.9 * 49.5 * (along @ along)
        mean = places[(places @ along > 9) & (places @ along < 36 * np.hypot(*along))].mean(0)
        assert mean @ along / np.hypot(*mean) / np.hypot(*along) > 0.97


def test_sheets_may_be_transparent():
    tile = np.full((4, 5, 4), 200, np.uint8)
    sheet = contact_sheet([tile, tile], gap=3)
    assert sheet.shape[2] == 4
    assert (sheet[..., 3] == 200).sum() == 2 * 4 * 5
    assert (sheet[..., 3] == 0).sum() == sheet[..., 3].size - 2 * 4 * 5
    with pytest.raises(ValueError, match=r"\(h, w, 3\) or all \(h, w, 4\)"):
        contact_sheet([tile, tile[..., :3]])
