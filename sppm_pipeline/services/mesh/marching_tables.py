"""The case tables of marching cubes, derived from the geometry of the cube.

Corner ``x + 2 y + 4 z`` of the unit cube (x, y, z in {0, 1}) is bit ``x + 2 y + 4 z`` of a case; a set bit is a solid
corner. The edges along x are numbered 0-3 by ``y + 2 z``, those along y 4-7 by ``x + 2 z``, those along z 8-11 by
``x + 2 y``.

How a case is built: on each face of the cube, seen from outside, the surface runs from every edge where the walk
around the face enters the solid to the edge where it next leaves the solid. An ambiguous face (solid on one diagonal,
void on the other) therefore always separates the solid corners; the rule sees nothing but the four signs of the face,
so that two neighboring cubes always agree and the surface has no hole. The segments of the six faces close up to
loops, and each loop is cut into triangles without a diagonal that lies in a face of the cube: such a diagonal could be
drawn by the neighbor as well, and that edge would then belong to four triangles.
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, U8

# Corners of each face, counter-clockwise for a viewer outside the cube.
_FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))


class CaseTables(NamedTuple):
    """Triangles of every case; they turn counter-clockwise for a viewer in the void."""

    counts: U8  # (256,) triangles
    triangles: U8  # (256, 3 * maximum): edges of the cube, three a triangle, padded with zeros


def _edge(a: int, b: int) -> int:
    """Number of the edge between two corners."""
    low, axis = min(a, b), (a ^ b).bit_length() - 1
    x, y, z = low & 1, low >> 1 & 1, low >> 2
    return 4 * axis + (y + 2 * z, x + 2 * z, x + 2 * y)[axis]


_FACE_EDGES = tuple(tuple(_edge(face[i - 1], face[i]) for i in range(4)) for face in _FACES)
_FACES_OF_EDGE = tuple(frozenset(f for f, edges in enumerate(_FACE_EDGES) if edge in edges) for edge in range(12))


def _middle(edge: int) -> tuple[int, int, int]:
    """Twice the coordinates of the middle of an edge."""
    axis, number = divmod(edge, 4)
    first, second = 2 * (number & 1), 2 * (number >> 1)
    return ((1, first, second), (first, 1, second), (first, second, 1))[axis]


def _diagonal_cost(a: int, b: int) -> float:
    """Squared length of a diagonal between the middles of two edges; infinite where it would lie in a face."""
    if _FACES_OF_EDGE[a] & _FACES_OF_EDGE[b]:
        return float("inf")
    return sum((p - q) ** 2 for p, q in zip(_middle(a), _middle(b), strict=True))


_COST = tuple(tuple(_diagonal_cost(a, b) for b in range(12)) for a in range(12))


def _loops(case: int) -> list[list[int]]:
    """The closed polygons of a case as lists of edges, in the order of their smallest edge."""
    following: dict[int, int] = {}
    for face, edges in zip(_FACES, _FACE_EDGES, strict=True):
        solid = [case >> corner & 1 for corner in face]
        entries = [i for i in range(4) if solid[i] and not solid[i - 1]]
        for i in entries:
            leave = i + 1
            while solid[leave % 4]:
                leave += 1
            following[edges[i]] = edges[leave % 4]
    loops = []
    for start in range(12):
        if start in following:
            loop = [start]
            while (edge := following.pop(loop[-1])) != start:
                loop.append(edge)
            loops.append(loop)
    return loops


def _triangulated(loop: list[int]) -> list[int]:
    """Triangles of a loop with the shortest sum of squared diagonals, none of which lies in a face (ties: first found).

    Dynamic programming over the chords of the polygon.
    """
    n = len(loop)
    best: dict[tuple[int, int], tuple[float, list[int]]] = {(i, i + 1): (0.0, []) for i in range(n - 1)}
    # from short chords to long ones, as a long one is split into two shorter
    for width in range(2, n):
        for i in range(n - width):
            j = i + width
            own = 0.0 if width == n - 1 else _COST[loop[i]][loop[j]]
            cost, k = min((best[i, k][0] + best[k, j][0], k) for k in range(i + 1, j))
            best[i, j] = (own + cost, [*best[i, k][1], loop[i], loop[k], loop[j], *best[k, j][1]])
    cost, triangles = best[0, n - 1]
    if cost == float("inf"):
        raise ValueError("every triangulation of the loop has a diagonal in a face")
    return triangles


@cache
def case_tables() -> CaseTables:
    """The tables of all 256 cases, computed on the first call (some milliseconds)."""
    rows = [[edge for loop in _loops(case) for edge in _triangulated(loop)] for case in range(256)]
    triangles = np.zeros((256, max(len(row) for row in rows)), np.uint8)
    for case, row in enumerate(rows):
        triangles[case, : len(row)] = row
    counts = np.array([len(row) // 3 for row in rows], np.uint8)
    counts.flags.writeable = triangles.flags.writeable = False
    return CaseTables(counts, triangles)


@cache
def separations() -> F64:
    """Planes that keep the polygons of a cube apart, (256 cases, 6 faces, 3 planes, 4).

    Where the surface passes through a cube in several polygons, and through one of its faces once, a point (x, y, z) of
    that face, in the unit cube, may become a corner of its polygon if ``a x + b y + c z <= d`` for all planes
    (a, b, c, d): there is one against each of the other polygons, which lie on its far side wherever their vertices
    are on their edges. All numbers are 0 where there is nothing to keep apart.
    """
    planes = np.zeros((256, 6, 3, 4))
    for case in range(256):
        loops = _loops(case)
        for own in loops if len(loops) > 1 else ():
            against = [_plane_between(own, other) for other in loops if other is not own]
            for face, edges in enumerate(_FACE_EDGES):
                passed = [loop for loop in loops if len(set(loop) & set(edges)) > 1]
                if passed == [own] and len(set(own) & set(edges)) == 2:
                    planes[case, face, : len(against)] = against
    planes.flags.writeable = False
    return planes


def _plane_between(own: list[int], other: list[int]) -> F64:
    """A plane ``a x + b y + c z = d`` with all points of some edges of the cube below, and all of others above it.

    Edges may end in the plane, as vertices are never at their ends. Of all planes whose normals consist of -1, 0 and 1
    the one farthest from both, the first one of equals.
    """
    normals, lows, middles, highs = _along_normals()
    low, high = highs[:, own].max(axis=1), lows[:, other].min(axis=1)
    clear = middles[:, other].min(axis=1) - middles[:, own].max(axis=1)
    between = (high >= low) & (clear > 0)
    if not between.any():
        raise ValueError(f"no plane lies between the polygons {own} and {other}")
    # the gap decides, and where edges end in the plane, how far their middles are
    best = int(np.argmax(np.where(between, (high - low + clear / 8) / np.linalg.norm(normals, axis=1), -1.0)))
    return np.array([*normals[best], (low[best] + high[best]) / 2])


@cache
def _along_normals() -> tuple[F64, ...]:
    """Normals (26, 3), and how far along them the 12 edges of the cube begin, have their middles, and end."""
    normals = np.array([n for n in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(n)])
    middles = np.array([_middle(edge) for edge in range(12)]) / 2
    half = np.repeat(np.eye(3) / 2, 4, axis=0)
    along = [normals @ (middles + side * half).T for side in (-1, 0, 1)]
    return normals, np.minimum(along[0], along[2]), along[1], np.maximum(along[0], along[2])
