"""Darts into many boxes: each gets the pores that it would get alone."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling import many
from sppm_pipeline.method.sampling.darts import throw
from sppm_pipeline.method.sampling.many import Surrounding, nothing_around, patterns_apart, throw_many

LOW, HIGH = np.full(3, 0.1), np.full(3, 0.9)


def surroundings(boxes, seed=0):
    """Three pieces around each box, moved by whole cells or not; box 0 has nothing around."""
    rng = np.random.default_rng(seed)
    sizes = rng.integers(0, 9, 12)
    first = np.concatenate([[0], np.cumsum(sizes)])
    rows = np.concatenate([[0, 0], 3 * np.arange(1, boxes)])
    piece = rng.integers(0, 12, rows[-1])
    shift = np.eye(3, dtype=np.int64)[rng.integers(0, 3, rows[-1])] * rng.integers(0, 2, (rows[-1], 1))
    return Surrounding(rng.random((first[-1], 3)), first, piece, shift, rows)


def around_box(around, box):
    parts = [
        around.points[around.first[around.piece[row]] : around.first[around.piece[row] + 1]] + around.shift[row]
        for row in range(around.rows[box], around.rows[box + 1])
    ]
    return np.concatenate([np.zeros((0, 3)), *parts])


def by_box(made):
    """The pores of each box, None for one that was left."""
    found = []
    for centers, counts in made:
        ends = np.cumsum(np.maximum(counts, 0))
        found += [None if n < 0 else centers[stop - n : stop] for n, stop in zip(counts, ends, strict=True)]
    return found


@pytest.mark.parametrize(("count", "share"), [(22, None), (30, None), (None, 0.5), (None, 1.0), (0, None)])
def test_boxes_get_the_pores_they_get_alone(count, share, monkeypatch):
    monkeypatch.setattr(many, "_RUN", 5)
    streams = np.random.default_rng(1).integers(0, 2**64, 17, dtype=np.uint64)
    around, everywhere = surroundings(17), np.random.default_rng(9).random((4, 3)) * [1, 1, 0]
    for threads in (1, 3):
        found = by_box(
            throw_many(
                streams, count, 0.2, LOW, HIGH, around=around, obstacles=everywhere, share=share, threads=threads
            )
        )
        assert len(found) == 17
        for box, pores in enumerate(found):
            near = np.concatenate([everywhere, around_box(around, box)])
            arguments = (streams[box : box + 1].copy(), count, 0.2, LOW, HIGH)
            alone = throw(*arguments, obstacles=near, obstacle_images=False, share=share)
            assert pores is not None
            assert np.array_equal(pores, alone)


def test_a_box_that_is_too_full_is_left():
    points = np.ascontiguousarray(np.argwhere(np.ones((5, 5, 5))) / 4)
    around = Surrounding(points, np.array([0, 125]), np.array([0]), np.zeros((1, 3), np.int64), np.array([0, 0, 1, 1]))
    streams = np.arange(3, dtype=np.uint64)
    found = by_box(throw_many(streams, 25, 0.22, LOW, HIGH, around=around, obstacles=None))
    assert [pores is None for pores in found] == [False, True, False]
    with pytest.raises(DesignError, match="of 25 pores fit"):
        throw(streams[1:2].copy(), 25, 0.22, LOW, HIGH, obstacles=points, obstacle_images=False)


def test_more_than_any_box_holds():
    with pytest.raises(DesignError, match="do not fit"):
        throw_many(np.zeros(3, np.uint64), 500, 0.2, LOW, HIGH, around=nothing_around(3), obstacles=None)
    with pytest.raises(DesignError, match="spacing must be"):
        throw_many(np.zeros(3, np.uint64), 5, np.nan, LOW, HIGH, around=nothing_around(3), obstacles=None)


def test_patterns_are_those_of_one_by_one(monkeypatch):
    low, high = np.array([0.0, 0.12, 0.12]), np.array([0.0, 0.88, 0.88])
    streams = np.random.default_rng(3).integers(0, 2**64, 30, dtype=np.uint64)
    wanted = np.where(np.arange(30) % 3 == 0, 7, 6)
    wanted[4] = 0
    sites = np.array([[0.0, 0, 0], [0, 0, 0.4], [0, 0.55, 0]])
    slow = patterns_apart(streams, wanted, 0.16, low, high, obstacles=sites)
    monkeypatch.setattr(many, "FEW", 0)
    fast = patterns_apart(streams, wanted, 0.16, low, high, obstacles=sites, threads=2)
    assert [len(pattern) for pattern in fast] == wanted.tolist()
    assert all(np.array_equal(a, b) for a, b in zip(slow, fast, strict=True))


def test_the_first_full_pattern_tells_how_many_fit(monkeypatch):
    low, high = np.array([0.0, 0.2, 0.2]), np.array([0.0, 0.8, 0.8])
    obstacles = np.argwhere(np.ones((1, 4, 4))) * [0, 0.25, 0.25]
    arguments = (np.arange(5, dtype=np.uint64), np.full(5, 9), 0.16, low, high)
    messages = []
    for few in (64, 0):
        monkeypatch.setattr(many, "FEW", few)
        with pytest.raises(DesignError) as error:
            patterns_apart(*arguments, obstacles=obstacles)
        messages.append(str(error.value))
    assert messages[0] == messages[1]
