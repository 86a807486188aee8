"""The faces of tetrahedra: neighbors, boundary, components."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import I32, I64, U64, jit

BOUNDARY, NON_MANIFOLD = -1, -2

FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)], np.int64)
"""Corners of the face opposite of each corner, counterclockwise for a viewer outside."""

_LONG = 64
"""Lists of faces longer than this are not left to the insertion sort."""


def face_neighbors(tets: NDArray[np.integer]) -> I32:
    """Tetrahedron behind the face opposite of each corner (m, 4); further nodes than four are ignored.

    `BOUNDARY` if there is none, `NON_MANIFOLD` if three or more tetrahedra share the face.
    """
    corners = _corners(tets)
    n = int(corners.max()) + 1 if corners.size else 0
    keys, faces, starts = _face_keys(corners, n)
    for node in np.flatnonzero(np.diff(starts) > _LONG):
        part = slice(starts[node], starts[node + 1])
        order = np.argsort(keys[part], kind="stable")
        keys[part], faces[part] = keys[part][order], faces[part][order]
    neighbors = np.full((len(corners), 4), BOUNDARY, np.int32)
    _match(keys, faces, starts, neighbors.reshape(-1))
    return neighbors


def boundary_triangles(tets: NDArray[np.integer], neighbors: I32) -> I32:
    """The faces with no tetrahedron behind them, (k, 3) int32, their normals pointing outward."""
    cell, corner = np.nonzero(neighbors == BOUNDARY)
    return np.ascontiguousarray(_corners(tets)[cell[:, None], FACES[corner]])


def components(neighbors: I32) -> tuple[int, I32]:
    """Connected components of a mesh, cells that share faces: their number, and that of each cell (m,) in order."""
    count, labels = _components(np.ascontiguousarray(neighbors, np.int32))
    return int(count), labels


def _corners(tets: NDArray[np.integer]) -> I32:
    corners = np.ascontiguousarray(tets[:, :4], np.int32)
    if corners.size and corners.min() < 0:
        raise ValueError("nodes are numbered from 0")
    return corners


@jit
def _face_keys(tets: I32, n: int) -> tuple[U64, I64, I64]:
    """For each face, by its smallest node, the other two in one number, and 4 m + i for face i of tetrahedron m.

    Those of node a begin at starts[a]; in each list the keys ascend, unless it is long.
    """
    starts = np.zeros(n + 1, np.int64)
    for m in range(tets.shape[0]):
        for i in range(4):
            starts[min(tets[m, (i + 1) % 4], tets[m, (i + 2) % 4], tets[m, (i + 3) % 4]) + 1] += 1
    for node in range(n):
        starts[node + 1] += starts[node]
    ends = starts.copy()
    keys = np.empty(4 * tets.shape[0], np.uint64)
    faces = np.empty(4 * tets.shape[0], np.int64)
    for m in range(tets.shape[0]):
        for i in range(4):
            a, b, c = int(tets[m, (i + 1) % 4]), int(tets[m, (i + 2) % 4]), int(tets[m, (i + 3) % 4])
            low, high = int(min(a, b, c)), int(max(a, b, c))
            p = ends[low]
            # the middle one of three nodes is their sum less the others
            keys[p] = np.uint64((a + b + c - low - high) * n + high)
            faces[p] = 4 * m + i
            ends[low] += 1
    for node in range(n):
        if starts[node + 1] - starts[node] > _LONG:
            continue
        for p in range(starts[node] + 1, starts[node + 1]):
            key, face = keys[p], faces[p]
            q = p
            while q > starts[node] and keys[q - 1] > key:
                keys[q], faces[q] = keys[q - 1], faces[q - 1]
                q -= 1
            keys[q], faces[q] = key, face
    return keys, faces, starts


@jit
def _match(keys: U64, faces: I64, starts: I64, neighbors: I32) -> None:
    for a in range(starts.size - 1):
        p = starts[a]
        while p < starts[a + 1]:
            q = p + 1
            while q < starts[a + 1] and keys[q] == keys[p]:
                q += 1
            if q - p == 2:
                neighbors[faces[p]], neighbors[faces[p + 1]] = faces[p + 1] // 4, faces[p] // 4
            elif q - p > 2:
                for r in range(p, q):
                    neighbors[faces[r]] = NON_MANIFOLD
            p = q


@jit
def _components(neighbors: I32) -> tuple[int, I32]:
    labels = np.full(neighbors.shape[0], -1, np.int32)
    waiting = np.empty(neighbors.shape[0], np.int32)
    count = 0
    for m in range(neighbors.shape[0]):
        if labels[m] >= 0:
            continue
        labels[m] = count
        waiting[0] = m
        n = 1
        while n > 0:
            n -= 1
            t = waiting[n]
            for i in range(4):
                s = neighbors[t, i]
                if s >= 0 and labels[s] < 0:
                    labels[s] = count
                    waiting[n] = s
                    n += 1
        count += 1
    return count, labels
