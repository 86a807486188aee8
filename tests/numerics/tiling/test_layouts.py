"""Number of layouts, counted where counting is possible."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.numerics.tiling.layouts import entropy_per_cell, layout_count_log
from sppm_pipeline.numerics.tiling.rule_check import rule1_violations
from sppm_pipeline.numerics.tiling.wang import tile_colors


@pytest.mark.parametrize("cells", [(2, 1, 1), (2, 2, 1), (3, 1, 1)])
@pytest.mark.parametrize("periodic", [False, True])
def test_opposite_equal_counts_what_rule_1_allows(cells, periodic):
    table = tile_colors(2)
    count = sum(
        not rule1_violations(np.array(tiles).reshape(cells), table, periodic=periodic).any()
        for tiles in itertools.product(range(8), repeat=math.prod(cells))
    )
    assert round(math.exp(layout_count_log(cells, "opposite_equal", 2, periodic=periodic))) == count


def test_paper_set():
    n = 7
    assert layout_count_log((n, n, n), "opposite_equal", 3) == pytest.approx(3 * n * n * math.log(3))


@pytest.mark.parametrize(
    ("rule", "periodic", "colors"),
    [("free_faces", False, 36), ("free_faces", True, 24), ("corners", False, 27), ("corners", True, 8)],
)
def test_free_rules_count_faces_and_corners(rule, periodic, colors):
    found = layout_count_log((2, 2, 2), rule, 5, 7, periodic=periodic)
    assert found == pytest.approx(colors * math.log(5) + 8 * math.log(7))


def test_entropy_of_large_boxes():
    box = (200, 200, 200)
    assert entropy_per_cell(box, "opposite_equal", 3) == pytest.approx(3 * math.log2(3) / 200)
    assert entropy_per_cell(box, "free_faces", 4, 8, periodic=True) == pytest.approx(9.0)
    assert entropy_per_cell(box, "corners", 4, 8, periodic=True) == pytest.approx(5.0)


def test_wrong_arguments():
    with pytest.raises(ValueError, match="unknown rule"):
        layout_count_log((2, 2, 2), "hexagons", 2)
    with pytest.raises(DesignError, match="colors is 0"):
        layout_count_log((2, 2, 2), "corners", 0)
