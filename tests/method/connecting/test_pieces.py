"""Many small pieces in one call: the same graphs as one by one, and what can't be finished is left."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.method.connecting import pieces as many
from sppm_pipeline.method.connecting.greedy import clamped_degrees, greedy_subgraph
from sppm_pipeline.method.connecting.pieces import greedy_pieces, nearest_in_interiors, piece_degrees


def in_pieces(clouds, seed=0):
    """Points in an order of their own, the order by piece, and where each piece begins."""
    owner = np.repeat(np.arange(len(clouds)), [len(c) for c in clouds])
    mixed = np.random.default_rng(seed).permutation(len(owner))
    points = np.concatenate(clouds)[mixed]
    return points, np.argsort(owner[mixed], kind="stable"), np.searchsorted(np.sort(owner), np.arange(len(clouds) + 1))


def joined(clouds, degree, k, threads=1):
    """The edges of each piece in its own numbering, None for one that was left."""
    points, order, first = in_pieces(clouds)
    sizes = np.diff(first)
    own = np.flatnonzero(sizes > 1)
    degrees = piece_degrees(sizes, len(clouds), degree)
    place = np.empty(len(points), np.int64)
    place[order] = np.arange(len(points)) - np.repeat(first[:-1], sizes)
    found = {}
    for names, edges, counts in greedy_pieces(points, order, first, own, degrees[own], k=k, threads=threads):
        ends = np.cumsum(np.maximum(counts, 0))
        for piece, stop, count in zip(names, ends, counts, strict=True):
            found[int(piece)] = None if count < 0 else place[edges[stop - count : stop]]
    return found, [points[order[first[p] : first[p + 1]]] for p in range(len(clouds))]


def slowly(points, degree, k):
    edges, shifts = greedy_subgraph(points, *degree, period=np.zeros(3), k=k, loops=False, clearance=None)
    assert not shifts.any()
    return edges


@pytest.mark.parametrize(("degree", "k"), [((3, 5), 10), ((1, 3), 4), ((3, 4), 3)])
def test_graphs_are_those_of_one_by_one(degree, k):
    rng = np.random.default_rng(5)
    clouds = [rng.random((n, 3)) for n in [0, 1, 2, 3, 4, 5, 6, 7, 20, 33, 61, *rng.integers(5, 40, 30)]]
    clouds += [rng.random((n, 3)) * [1, 1, 0] for n in (9, 24)]
    found, own = joined(clouds, degree, k)
    finished = 0
    for piece, points in enumerate(own):
        if len(points) < 2:
            assert piece not in found
        elif found[piece] is not None:
            finished += 1
            assert np.array_equal(found[piece], slowly(points, degree, k)), f"piece of {len(points)} pores"
    assert finished > 25


def test_equal_lengths_are_taken_in_the_same_order():
    places = np.argwhere(np.ones((3, 3, 3))) / 3
    found, own = joined([places, places[:18], places[::2]], (2, 5), 10)
    for piece in range(3):
        assert np.array_equal(found[piece], slowly(own[piece], (2, 5), 10))


def test_what_falls_apart_or_has_no_graph_is_left():
    rng = np.random.default_rng(1)
    far = np.concatenate([0.1 * rng.random((12, 3)), 0.9 + 0.1 * rng.random((12, 3))])
    found, _ = joined([far, rng.random((3, 3)), rng.random((5, 3)), rng.random((many.LARGEST + 1, 3))], (3, 3), 3)
    assert found == {0: None, 1: None, 2: None, 3: None}
    assert joined([rng.random((24, 3))], (3, 5), 10)[0][0] is not None


def test_threads_and_runs_change_nothing(monkeypatch):
    rng = np.random.default_rng(2)
    clouds = [rng.random((n, 3)) for n in rng.integers(2, 30, 40)]
    one, _ = joined(clouds, (3, 5), 10)
    monkeypatch.setattr(many, "_RUN", 7)
    three, _ = joined(clouds, (3, 5), 10, threads=3)
    assert one.keys() == three.keys()
    assert all((one[p] is None and three[p] is None) or np.array_equal(one[p], three[p]) for p in one)


def test_degrees_of_pieces():
    sizes = np.array([8, 2, many.LARGEST + 1, 8, 3, 2, 1, 7])
    degrees = piece_degrees(sizes, 3, (3, 3))
    assert degrees.tolist()[:3] == [[3, 3], [0, 0], [0, 0]]
    for n, bounds in zip(sizes[3:], degrees[3:], strict=True):
        assert tuple(bounds) == ((0, 0) if n == 1 else clamped_degrees(int(n), 3, 3)[:2])


def test_sorting_is_stable_whatever_the_lengths():
    rng = np.random.default_rng(3)
    for length in (
        rng.random(300), np.ones(50), rng.integers(0, 4, 200) / 4.0, np.array([0.3]), np.r_[1e9, rng.random(40)],
        np.sort(rng.random(100))[::-1].copy(),
    ):  # fmt: skip
        assert np.array_equal(many._stable_order(length), np.argsort(length, kind="stable"))


def test_nearest_pores_of_interiors():
    rng = np.random.default_rng(4)
    clouds = [rng.random((30, 3)), np.zeros((0, 3)), rng.random((1, 3))] + [rng.random((6, 3)) for _ in range(2)]
    clouds[0] = np.concatenate([clouds[0], clouds[0]])  # equally near: the first is taken
    points, order, first = in_pieces(clouds)
    rows = np.array([(t, axis, side, k) for t in range(3) for axis in range(3) for side in (0, 1) for k in (0, 1)])
    edges, shifts = nearest_in_interiors(points, order, first, rows, 3 + rows[:, 3])
    at = 0
    for t, axis, side, k in rows.tolist():
        inside, outside = order[first[t] : first[t + 1]], order[first[3 + k] : first[4 + k]]
        for face in outside if len(inside) else ():
            place = points[face] + side * np.eye(3)[axis]
            nearest = inside[np.argmin(((place - points[inside]) ** 2).sum(1))]
            assert edges[at].tolist() == [nearest, face]
            assert shifts[at].tolist() == (side * np.eye(3)[axis]).tolist()
            at += 1
    assert at == len(edges) == 2 * 12 * 6
