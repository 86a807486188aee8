"""Charts: statistics by known numbers, drawings by where the colors are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError
from sppm_pipeline.render.charts import chart, nice_ticks
from sppm_pipeline.render.series import Boxes, Line, Points, box_statistics

GREEN = (0, 160, 0)


def painted(picture, color=GREEN):
    return abs(picture.astype(int) - color).max(axis=2) < 40


def test_box_statistics_by_hand():
    found = box_statistics([1, 2, 3, 4, 5, 6, 7, 8, 30])
    assert found[:5] == (1.0, 3.0, 5.0, 7.0, 8.0)
    assert found.outliers.tolist() == [30.0]
    assert box_statistics([4.0])[:5] == (4.0,) * 5
    with pytest.raises(ValueError, match="at least one"):
        box_statistics([])


@given(low=st.floats(-1e6, 1e6), span=st.floats(1e-3, 1e6))
@settings(deadline=None, derandomize=True)
def test_ticks_are_few_inside_and_evenly_spaced(low, span):
    ticks = nice_ticks(low, low + span)
    assert 2 <= len(ticks) <= 9
    slack = 1e-6 * span
    assert ticks[0] >= low - slack
    assert ticks[-1] <= low + span + slack
    steps = np.diff(ticks)
    assert np.allclose(steps, steps[0], rtol=1e-6)


def test_ticks_are_round():
    assert nice_ticks(0.0, 1.0) == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    assert nice_ticks(17.0, 123.0) == pytest.approx([20, 40, 60, 80, 100, 120])
    assert nice_ticks(0.02, 3000.0, log=True) == pytest.approx([0.1, 1, 10, 100, 1000])
    assert nice_ticks(20.0, 600.0, log=True) == pytest.approx([20, 50, 100, 200, 500])
    assert len(nice_ticks(1e-20, 1e20, log=True)) <= 8


def test_points_are_where_the_axes_say():
    found = []
    for x, y in ((0.2, 0.3), (0.8, 0.3), (0.2, 0.9)):
        picture = chart([Points([x], [y], color=GREEN)], x_range=(0, 1), y_range=(0, 1), size=(600, 400))
        rows, columns = np.nonzero(painted(picture))
        found.append((columns.mean(), rows.mean()))
    (x0, y0), (x1, y1), (x2, y2) = found
    assert y1 == pytest.approx(y0, abs=0.3)
    assert x2 == pytest.approx(x0, abs=0.3)
    # Three fifths of each axis.
    assert x1 - x0 == pytest.approx(0.6 * (x1 - x0) / 0.6)
    assert 0.6 * 500 < x1 - x0 < 0.6 * 600
    assert 0.6 * 300 < y0 - y2 < 0.6 * 400


def test_equal_ratios_are_equal_distances_on_a_log_axis():
    columns = []
    for x in (1.0, 10.0, 100.0):
        picture = chart([Points([x], [1.0], color=GREEN)], x_range=(0.5, 200), y_range=(0, 2), x_log=True)
        columns.append(np.nonzero(painted(picture))[1].mean())
    assert columns[2] - columns[1] == pytest.approx(columns[1] - columns[0], abs=0.5)


def test_lines_are_clipped_and_interrupted():
    full = chart([Line([0, 1], [0.5, 0.5], color=GREEN)], x_range=(0, 1), y_range=(0, 1))
    beyond = chart([Line([-5, 6], [0.5, 0.5], color=GREEN)], x_range=(0, 1), y_range=(0, 1))
    assert painted(beyond).sum() == pytest.approx(painted(full).sum(), rel=0.02)
    gap = chart([Line([0, 0.4, np.nan, 0.6, 1], [0.5] * 5, color=GREEN)], x_range=(0, 1), y_range=(0, 1))
    assert painted(gap).sum() == pytest.approx(0.8 * painted(full).sum(), rel=0.03)
    dashed = chart([Line([0, 1], [0.5, 0.5], color=GREEN, dashed=True)], x_range=(0, 1), y_range=(0, 1))
    assert painted(dashed).sum() == pytest.approx(painted(full).sum() / 1.7, rel=0.06)


def test_boxes_reach_from_quartile_to_quartile():
    values = np.linspace(0.0, 8.0, 101)
    picture = chart([Boxes([1.0], [values], color=GREEN)], x_range=(0, 2), y_range=(-1, 9), size=(600, 500))
    rows = np.nonzero(painted(picture).sum(axis=1) > 20)[0]
    point = chart([Points([1.0, 1.0], [2.0, 6.0], color=GREEN)], x_range=(0, 2), y_range=(-1, 9), size=(600, 500))
    marks = np.nonzero(painted(point))[0]
    upper, lower = marks[marks < marks.mean()].mean(), marks[marks > marks.mean()].mean()
    # Rows with wide strokes: whisker ends, quartiles, median.
    assert abs(rows - upper).min() <= 1.5
    assert abs(rows - lower).min() <= 1.5
    assert abs(rows - (upper + lower) / 2).min() <= 1.5


def test_series_get_different_colors_and_a_legend():
    x = np.arange(5.0)
    bare, named = (chart([Line(x, x, a), Line(x, 4 - x, b)]) for a, b in (("", ""), ("one", "two")))
    assert (bare != named).any()
    assert len(np.unique(named.reshape(-1, 3), axis=0)) > 20


def test_labels_take_room():
    plain, labeled = (
        chart([Points([0.5], [0.5], color=GREEN)], x_range=(0, 1), y_range=(0, 1), x_label=a, y_label=a, title=a)
        for a in ("", "porosity")
    )
    assert np.nonzero(painted(labeled))[1].mean() > np.nonzero(painted(plain))[1].mean() + 5


def test_same_series_same_bytes():
    series = [Boxes([1, 2], [[1, 2, 3], [2, 3, 9]], "boxes"), Line([1, 2], [2, 3], "line")]
    first, second = (chart(series, title="Twice", size=(300, 200)) for _ in range(2))
    assert first.tobytes() == second.tobytes()
    assert first.shape == (200, 300, 3)
    assert first.dtype == np.uint8


def test_charts_of_nothing_and_of_one_value():
    assert chart([]).shape == (640, 960, 3)
    assert painted(chart([Points([3.0], [3.0], color=GREEN)])).any()
    assert not painted(chart([Points([-1.0], [2.0], color=GREEN)], x_log=True)).any()


def test_wrong_arguments():
    with pytest.raises(DesignError, match="range of the x axis"):
        chart([], x_range=(1, 0))
    with pytest.raises(DesignError, match="range of the y axis"):
        chart([], y_range=(0, 1), y_log=True)
    with pytest.raises(DesignError, match="100 x 100"):
        chart([], size=(100, 100))
    with pytest.raises(ValueError, match="equally long"):
        chart([Line([1, 2], [1])])
    with pytest.raises(ValueError, match="boxes"):
        chart([Boxes([1, 2], [[1]])])
