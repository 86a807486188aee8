"""Numbers of vertices and triangles that marching cubes will make, and their box, from the runs of the solid.

Exact, as both depend on the signs of the samples alone; so a file can begin with the counts before there is a mesh.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.connectivity.runs import Runs
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_tables import case_tables
from sppm_pipeline.services.mesh.sign_words import ONE, lowest, mixed_cells, ones, plane_crossings, shifted_word
from sppm_pipeline.services.threads import in_bands

_ALL, _LAST = np.uint64(0xFFFFFFFFFFFFFFFF), np.int64(63)


class Counts(NamedTuple):
    """Counts of a mesh to come."""

    vertices: int
    faces: int
    low: NDArray[np.int64]  # (3,), first node of the solid along x, y, z; of no meaning without triangles
    high: NDArray[np.int64]  # (3,), the last one


def count_mesh(runs: Runs, keep: NDArray[np.bool_], capped: bool, threads: int = 1) -> Counts:
    """Count the vertices and triangles that `capped_marching_cubes_slabs` makes of a solid.

    Runs that `keep`, (n,) bool, marks are solid. If `capped`, the surface is closed at the outermost nodes of each
    axis; else it ends there.
    """
    nz, ny, nx = runs.shape
    # a cap is what marching cubes makes of a border of void
    pad = int(capped)
    size, table = np.array([nz, ny, nx], np.int64), case_tables().counts
    found: list[tuple[int, int]] = []

    def count(start: int, stop: int) -> None:
        found.append(_count(runs.rows, runs.bounds, keep, size, pad, start, stop, table))

    in_bands(count, nz + 2 * pad, threads)
    box = np.empty((2, 3), np.int64)
    _find_box(runs.rows, runs.bounds, keep, size, box)
    return Counts(sum(vertices for vertices, _ in found), sum(faces for _, faces in found), box[0], box[1])


@jit
def _fill_plane(
    rows: NDArray[np.int64], bounds: NDArray[np.int32], keep: NDArray[np.bool_], size: NDArray[np.int64], pad: int,
    plane: int, words: NDArray[np.uint64],
) -> None:  # fmt: skip
    """The signs of a plane, which is void if it lies outside of the solid's."""
    words[:] = np.uint64(0)
    if plane < pad or plane >= size[0] + pad:
        return
    row = (plane - pad) * size[1]
    for y in range(size[1]):
        for r in range(rows[row + y], rows[row + y + 1]):
            if not keep[r]:
                continue
            first, last = np.int64(bounds[2 * r]) + pad, np.int64(bounds[2 * r + 1]) + pad - 1
            head, tail = _ALL << np.uint64(first & _LAST), _ALL >> np.uint64(_LAST - (last & _LAST))
            w, end = first >> 6, last >> 6
            if w == end:
                words[y + pad, w] |= head & tail
                continue
            words[y + pad, w] |= head
            for between in range(w + 1, end):
                words[y + pad, between] = _ALL
            words[y + pad, end] |= tail


@jit
def _count(
    rows: NDArray[np.int64], bounds: NDArray[np.int32], keep: NDArray[np.bool_], size: NDArray[np.int64], pad: int,
    start: int, stop: int, table: NDArray[np.uint8],
) -> tuple[int, int]:  # fmt: skip
    """Vertices and triangles of the planes start <= p < stop, and between each of them and the plane before it."""
    ny, nx = size[1] + 2 * pad, size[2] + 2 * pad
    low, high = np.empty((ny, (nx + 63) // 64), np.uint64), np.empty((ny, (nx + 63) // 64), np.uint64)
    vertices, faces = int(np.int64(0)), int(np.int64(0))
    if start > 0:
        _fill_plane(rows, bounds, keep, size, pad, start - 1, high)
    for p in range(start, stop):
        low, high = high, low
        _fill_plane(rows, bounds, keep, size, pad, p, high)
        vertices += plane_crossings(high, nx)
        if p == 0:
            continue
        for j in range(ny):
            for w in range(low.shape[1]):
                vertices += ones(low[j, w] ^ high[j, w])
                bits = mixed_cells(low, high, j, w, nx) if j + 1 < ny else np.uint64(0)
                if bits == 0:
                    continue
                s0, s1, s2, s3 = low[j, w], low[j + 1, w], high[j, w], high[j + 1, w]
                n0, n1 = shifted_word(low, j, w), shifted_word(low, j + 1, w)
                n2, n3 = shifted_word(high, j, w), shifted_word(high, j + 1, w)
                while bits != 0:
                    k = np.uint64(lowest(bits))
                    bits &= bits - ONE
                    case = (s0 >> k) & ONE | ((n0 >> k) & ONE) << np.uint64(1)
                    case |= ((s1 >> k) & ONE) << np.uint64(2) | ((n1 >> k) & ONE) << np.uint64(3)
                    case |= ((s2 >> k) & ONE) << np.uint64(4) | ((n2 >> k) & ONE) << np.uint64(5)
                    case |= ((s3 >> k) & ONE) << np.uint64(6) | ((n3 >> k) & ONE) << np.uint64(7)
                    faces += int(table[case])
    return vertices, faces


@jit
def _find_box(
    rows: NDArray[np.int64],
    bounds: NDArray[np.int32],
    keep: NDArray[np.bool_],
    size: NDArray[np.int64],
    box: NDArray[np.int64],
) -> None:
    box[0, 0], box[0, 1], box[0, 2] = size[2], size[1], size[0]
    box[1] = -1
    for row in range(size[0] * size[1]):
        for r in range(rows[row], rows[row + 1]):
            if keep[r]:
                z, y = row // size[1], row % size[1]
                box[0, 0] = min(box[0, 0], np.int64(bounds[2 * r]))
                box[1, 0] = max(box[1, 0], np.int64(bounds[2 * r + 1]) - 1)
                box[0, 1], box[1, 1] = min(box[0, 1], y), max(box[1, 1], y)
                box[0, 2], box[1, 2] = min(box[0, 2], z), max(box[1, 2], z)
