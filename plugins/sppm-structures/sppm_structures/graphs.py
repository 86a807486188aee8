"""Graphs of struts in the periodic unit cell."""

from __future__ import annotations

from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import InputError

_SAME = 1e-9
"""Positions nearer than this, in cell sizes, are one node."""


class StrutGraph(NamedTuple):
    """Struts of one cell; those of the neighbors follow by repetition.

    Starts (m, 3) lie in [0, 1)^3, cell sizes, ends (m, 3) may lie in a neighboring cell. Radii (m,) at the ends are
    over the mean, 1 for cylinders.
    """

    starts: NDArray[np.float64]
    ends: NDArray[np.float64]
    start_radii: NDArray[np.float64]
    end_radii: NDArray[np.float64]


def strut_graph(
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    start_radii: NDArray[np.float64] | None = None,
    end_radii: NDArray[np.float64] | None = None,
) -> StrutGraph:
    """Struts with copies left out: one strut stays of those that periodicity makes the same.

    `InputError` if there are none, one has no length or is longer than two cells, or a position is not finite.
    """
    starts, ends = np.asarray(starts, np.float64).reshape(-1, 3), np.asarray(ends, np.float64).reshape(-1, 3)
    ones = np.ones(len(starts))
    radii = (ones if start_radii is None else start_radii, ones if end_radii is None else end_radii)
    if not len(starts):
        raise InputError("a strut lattice needs at least one strut")
    if not (np.isfinite(starts).all() and np.isfinite(ends).all()):
        raise InputError("the positions of nodes must be finite")
    lengths = np.linalg.norm(ends - starts, axis=1)
    if lengths.min() < 1e-6 or lengths.max() > 2:
        bad = int(np.argmin(lengths)) if lengths.min() < 1e-6 else int(np.argmax(lengths))
        raise InputError(f"strut {bad} is {lengths[bad]:g} cell sizes long; allowed are 1e-6 to 2")
    found: dict[tuple[int, ...], tuple[float, ...]] = {}
    for a, b, ra, rb in zip(starts, ends, *radii, strict=True):
        ways = []
        for first, second, r1, r2 in ((a, b, ra, rb), (b, a, rb, ra)):
            moved = np.floor(first + _SAME)
            ways.append((*(first - moved), *(second - moved), r1, r2))
        keyed = [(tuple(int(v) for v in np.round(np.array(way) / (10 * _SAME))), way) for way in ways]
        key, way = min(keyed)
        found.setdefault(key, way)
    rows = np.array([found[key] for key in sorted(found)])
    return StrutGraph(rows[:, :3], rows[:, 3:6], rows[:, 6], rows[:, 7])


def images(graph: StrutGraph, reach: float) -> StrutGraph:
    """The struts of the cell and of its neighbors that come nearer than `reach` to it."""
    parts: list[list[NDArray[np.float64]]] = [[], [], [], []]
    low, high = np.minimum(graph.starts, graph.ends), np.maximum(graph.starts, graph.ends)
    span = int(np.ceil(2 + reach))
    for shift in product(range(-span, span + 1), repeat=3):
        near = ((low + shift <= 1 + reach) & (high + shift >= -reach)).all(axis=1)
        for part, values in zip(
            parts, (graph.starts + shift, graph.ends + shift, graph.start_radii, graph.end_radii), strict=True
        ):
            part.append(values[near])
    return StrutGraph(*(np.concatenate(part) for part in parts))


def _neighbors(points: NDArray[np.float64], distance: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Struts between all periodic points at some distance."""
    starts, ends = [], []
    for a in points:
        for b in points:
            for shift in product((-1, 0, 1), repeat=3):
                if abs(np.linalg.norm(b + shift - a) - distance) < 1e-6:
                    starts.append(a)
                    ends.append(b + shift)
    return np.array(starts), np.array(ends)


def _face_centered() -> NDArray[np.float64]:
    return np.array([[0, 0, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]])


def _simple_cubic() -> StrutGraph:
    return strut_graph(*_neighbors(np.zeros((1, 3)), 1.0))


def _body_centered() -> StrutGraph:
    corners = np.array(list(product((0.0, 1.0), repeat=3)))
    return strut_graph(np.full_like(corners, 0.5), corners)


def _corners_to_faces() -> StrutGraph:
    """Face diagonals only: what is usually called the FCC lattice of struts."""
    starts, ends = [], []
    for center in _face_centered()[1:]:
        for shift in product((0.0, 1.0), repeat=3):
            if abs(np.linalg.norm(np.array(shift) - center) - 0.5**0.5) < 1e-9:
                starts.append(center)
                ends.append(shift)
    return strut_graph(np.array(starts), np.array(ends))


def _octet() -> StrutGraph:
    return strut_graph(*_neighbors(_face_centered(), 0.5**0.5))


def _kelvin() -> StrutGraph:
    points = {tuple(p) for quarter in (0.25, 0.75) for p in permutations((0.0, quarter, 0.5))}
    return strut_graph(*_neighbors(np.array(sorted(points)), 0.125**0.5))


def _diamond() -> StrutGraph:
    points = np.concatenate([_face_centered(), _face_centered() + 0.25])
    return strut_graph(*_neighbors(points, 0.1875**0.5))


def _re_entrant() -> StrutGraph:
    """Cuboctahedra whose square faces, on the faces of the cell, are pyramids dented in by a quarter of the cell.

    The middles of the cell's edges are joined to the dents. Pulled along one axis, the dents open and push the others
    apart: Poisson's ratio is negative along the axes.
    """
    starts, ends = [], []
    for axis in range(3):
        for side, dent in ((0.0, 0.25), (1.0, 0.75)):
            apex = np.full(3, 0.5)
            apex[axis] = dent
            for across in set(range(3)) - {axis}:
                for end in (0.0, 1.0):
                    middle = np.full(3, 0.5)
                    middle[axis], middle[across] = side, end
                    starts.append(apex)
                    ends.append(middle)
    return strut_graph(np.array(starts), np.array(ends))


LATTICES = {
    "simple_cubic": _simple_cubic,
    "bcc": _body_centered,
    "fcc": _corners_to_faces,
    "octet": _octet,
    "kelvin": _kelvin,
    "diamond": _diamond,
    "re_entrant": _re_entrant,
}
"""Name -> function that makes the graph."""
