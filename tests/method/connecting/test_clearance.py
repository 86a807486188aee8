from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.connecting.clearance import close_pairs, segment_distance


def distance_by_optimum(a, b, c, d) -> float:
    """Least of the four end-to-segment distances and, where it lies inside both, the line-to-line distance."""

    def to_segment(p, q, r):
        length = ((r - q) ** 2).sum()
        t = min(max((p - q) @ (r - q) / length, 0), 1) if length else 0
        return np.linalg.norm(p - q - t * (r - q))

    found = [to_segment(a, c, d), to_segment(b, c, d), to_segment(c, a, b), to_segment(d, a, b)]
    (s, t), *_ = np.linalg.lstsq(np.stack([b - a, c - d], axis=1), c - a, rcond=None)
    if 0 <= s <= 1 and 0 <= t <= 1:
        found.append(np.linalg.norm(a + s * (b - a) - c - t * (d - c)))
    return min(found)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), kind=st.sampled_from(["any", "grid", "parallel", "point"]))
def test_segment_distance_matches_the_obvious_way(seed, kind):
    rng = np.random.default_rng(seed)
    a, b, c, d = rng.random((4, 3)) if kind != "grid" else rng.integers(0, 3, (4, 3)).astype(float)
    if kind == "parallel":
        d = c + rng.uniform(-1, 1) * (b - a)
    if kind == "point":
        b = a.copy()
    moved = rng.integers(-1, 2, 3).astype(float)
    assert segment_distance(a, b, c, d, moved) == pytest.approx(
        distance_by_optimum(a, b, c + moved, d + moved), abs=1e-9
    )


def close_by_enumeration(points, edges, shifts, clearance, periodic):
    found = {}
    reach = [range(-4, 5) if axis else (0,) for axis in periodic]
    for e, f in itertools.combinations_with_replacement(range(len(edges)), 2):
        here = {(edges[e, 0], (0, 0, 0)), (edges[e, 1], tuple(shifts[e]))}
        least = np.inf
        for moved in itertools.product(*reach):
            there = {(edges[f, 0], moved), (edges[f, 1], tuple(shifts[f] + moved))}
            if not here & there:
                a, b = points[edges[e, 0]], points[edges[e, 1]] + shifts[e]
                c, d = points[edges[f, 0]] + moved, points[edges[f, 1]] + shifts[f] + moved
                least = min(least, distance_by_optimum(a, b, c, d))
        if least < clearance:
            found[e, f] = least
    return found


@settings(max_examples=12, deadline=None, derandomize=True)
@given(seed=st.integers(0, 100), periodic=st.sampled_from([(False,) * 3, (True, False, False), (True, True, False)]))
def test_close_pairs_match_enumeration(seed, periodic):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 1.5, (6, 3))
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [0, 5]])
    shifts = np.where(periodic, -np.rint(points[edges[:, 1]] - points[edges[:, 0]]), 0).astype(np.int64)
    clearance = rng.uniform(0.05, 0.9)
    pairs, distances = close_pairs(points, edges, shifts, clearance, periodic=periodic)
    wanted = close_by_enumeration(points, edges, shifts, clearance, periodic)
    assert [tuple(pair) for pair in pairs.tolist()] == sorted(wanted)
    assert distances == pytest.approx([wanted[pair] for pair in sorted(wanted)], abs=1e-9)


def test_more_pairs_than_room_are_all_found():
    # 40 parallel needles in a bundle: every pair is close
    rng = np.random.default_rng(0)
    foot = np.concatenate([0.01 * rng.random((40, 2)), np.zeros((40, 1))], axis=1)
    points = np.concatenate([foot, foot + np.array([0, 0, 0.5])])
    edges = np.stack([np.arange(40), np.arange(40) + 40], axis=1)
    pairs, _ = close_pairs(points, edges, np.zeros((40, 3), np.int64), 0.1)
    assert len(pairs) == 40 * 39 // 2


def test_a_tunnel_comes_close_to_its_own_image_only_if_the_clearance_is_nearly_the_cell():
    points = np.array([[0.1, 0.5, 0.5], [0.9, 0.5, 0.5]])
    edges, shifts = np.array([[0, 1]]), np.zeros((1, 3), np.int64)
    assert not len(close_pairs(points, edges, shifts, 0.19, periodic=True)[0])
    pairs, distances = close_pairs(points, edges, shifts, 0.21, periodic=True)
    assert pairs.tolist() == [[0, 0]]
    assert distances == pytest.approx([0.2])
