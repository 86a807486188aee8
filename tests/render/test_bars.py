"""Panels of bars: lengths, signs, gaps, marks."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.render.bars import Panel, bar_panels

BAR, MARKED = (122, 152, 190), (206, 96, 62)
NAMES = ["one", "two", "three", "four"]


def lengths(picture, color=BAR):
    """Pixels of a color in each row of bars; an edge that was averaged with its surroundings does not count."""
    hit = (np.abs(picture.astype(int) - color) <= 2).all(axis=2).sum(axis=1)
    starts = np.flatnonzero(np.diff(np.concatenate([[0], (hit > 0).astype(int)])) == 1)
    return [int(hit[start + 2]) for start in starts]


def test_bars_are_as_long_as_their_values():
    found = lengths(bar_panels(NAMES, [Panel("a", [4.0, 2.0, 1.0, 3.0])], bar_length=200))
    assert found == pytest.approx([200, 100, 50, 150], abs=2)


def test_bars_of_both_signs_share_a_scale():
    picture = bar_panels(NAMES[:2], [Panel("a", [-1.0, 3.0])], bar_length=200)
    assert lengths(picture) == pytest.approx([50, 150], abs=2)
    columns = [np.flatnonzero((picture[row] == BAR).all(axis=1)) for row in range(picture.shape[0])]
    ends = [(c.min(), c.max()) for c in columns if c.size]
    assert ends[0][1] <= ends[-1][0] + 2  # one to the left of zero, the other to the right


def test_each_panel_has_its_own_scale_and_place():
    alone = bar_panels(NAMES, [Panel("a", [4, 2, 1, 3])])
    both = bar_panels(NAMES, [Panel("a", [4, 2, 1, 3]), Panel("b", [4e6, 2e6, 1e6, 3e6])])
    assert both.shape[0] == alone.shape[0]
    assert both.shape[1] > alone.shape[1]
    assert lengths(both) == pytest.approx(2 * np.array(lengths(alone)), abs=3)


def test_what_is_not_there_is_no_bar_but_a_dash():
    picture = bar_panels(NAMES, [Panel("a", [np.nan, 2.0, np.inf, 1.0])], bar_length=200)
    assert lengths(picture) == pytest.approx([200, 100], abs=2)
    empty = bar_panels(NAMES, [Panel("a", [np.nan] * 4)])
    assert lengths(empty) == []
    assert lengths(bar_panels(NAMES, [Panel("a", [0.0] * 4)])) == []


def test_marked_rows_have_another_color():
    picture = bar_panels(NAMES, [Panel("a", [4.0, 2.0, 1.0, 3.0])], bar_length=200, marked=[1])
    assert len(lengths(picture)) == 3
    assert lengths(picture, MARKED)[-1] == pytest.approx(100, abs=2)


def test_a_title_takes_room_and_fits():
    bare, titled = (bar_panels(["x"], [Panel("a", [1.0])], title=title) for title in ("", "a title " * 12))
    assert titled.shape[0] > bare.shape[0]
    assert (titled[:, [0, -1]] >= 240).all()  # nothing runs out at the sides


def test_equal_input_gives_equal_pixels():
    first, second = (bar_panels(NAMES, [Panel("a", [1, 2, 3, 4])], title="t") for _ in range(2))
    assert np.array_equal(first, second)
    assert first.dtype == np.uint8


def test_errors():
    with pytest.raises(DesignError, match="0 rows"):
        bar_panels([], [Panel("a", [])])
    with pytest.raises(DesignError, match="0 measures"):
        bar_panels(NAMES, [])
    with pytest.raises(DesignError, match="can't be drawn"):
        bar_panels(NAMES, [Panel("a", [1, 2, 3, 4])], bar_length=0)
    with pytest.raises(ValueError, match="4 rows"):
        bar_panels(NAMES, [Panel("a", [1, 2])])
