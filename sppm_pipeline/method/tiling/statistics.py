"""Statistics of a tiling: broken rules, alike neighbors, scores, and the entropy that a rule leaves.

Nothing here is shared with the tilers, so that it is an independent test of each.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.method.tiling.lattice import Faces, check_count, checked_mask, face_presence
from sppm_pipeline.services.arrays import I64, Bools

#: Weight of a neighbor that is another tile, by the number of axes along which it is shifted (Rule 2 of the paper).
_WEIGHTS = {1: 3, 2: 2, 3: 1}


def face_violations(
    interior: ArrayLike, faces: Faces, tile_faces: ArrayLike | None = None, *, periodic: bool = False
) -> I64:
    """Count faces across x, y, z, (3,), that don't fit the cells; with `tile_faces` broken adjacencies of Rule 1, too.

    A face is broken if it lies at a cell and has no color, has a color and lies at no cell, shows another color than a
    tile beside it (once for each such tile), or differs from the face at the opposite end of a periodic assembly.
    `tile_faces`, where `interior` numbers tiles whose faces are fixed, are (n, 3) colors across x, y, z if opposite
    faces are equal, else (n, 6): low x, high x, low y, high y, low z, high z.
    """
    cells = np.asarray(interior)
    broken = np.zeros(3, np.int64)
    for axis, there in enumerate(face_presence(cells >= 0, periodic)):
        broken[axis] = np.count_nonzero((faces[axis] >= 0) != there)
        planes = np.moveaxis(faces[axis], axis, 0)
        if periodic:
            broken[axis] += np.count_nonzero(planes[0] != planes[-1])
        if tile_faces is not None:
            colors = np.asarray(tile_faces, np.int64)
            colors = np.repeat(colors, 2, axis=1) if colors.shape[1] == 3 else colors
            along = np.moveaxis(cells, axis, 0)
            filled = along >= 0
            broken[axis] += np.count_nonzero(colors[along[filled], 2 * axis] != planes[:-1][filled])
            broken[axis] += np.count_nonzero(colors[along[filled], 2 * axis + 1] != planes[1:][filled])
    return broken


def _neighbors(cells: I64, periodic: bool) -> Iterator[tuple[int, tuple[slice, ...], I64, I64]]:
    """For each of the 26 directions: the axes it shifts along, where such a neighbor may be, cells and neighbors."""
    for step in itertools.product((-1, 0, 1), repeat=3):
        if any(step):
            there = tuple(
                slice(None) if periodic else slice(max(0, -d), n - max(0, d))
                for d, n in zip(step, cells.shape, strict=True)
            )
            yield sum(map(abs, step)), there, cells[there], np.roll(cells, [-d for d in step], (0, 1, 2))[there]


def alike_neighbors(interior: ArrayLike, *, periodic: bool = False) -> tuple[I64, I64]:
    """Count pairs of neighbors across faces, edges and corners, (3,), that have the same interior, and all pairs.

    In a periodic assembly a cell may be its own neighbor.
    """
    alike, pairs = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for axes, _, here, other in _neighbors(np.asarray(interior, np.int64), periodic):
        both = (here >= 0) & (other >= 0)
        pairs[axes - 1] += np.count_nonzero(both)
        alike[axes - 1] += np.count_nonzero(both & (here == other))
    # both cells of a pair have met each other
    return alike // 2, pairs // 2


def rule2_scores(tiles: ArrayLike, *, periodic: bool = False) -> tuple[I64, I64]:
    """Score of each cell by Rule 2 of the paper among all of its neighbors, and its maximum, both (nx, ny, nz).

    A neighbor that is another tile adds 3 across a face, 2 across an edge, 1 across a corner; in the maximum every
    neighbor is another one. Both are 0 where there is no cell (-1).
    """
    cells = np.asarray(tiles, np.int64)
    score, largest = np.zeros(cells.shape, np.int64), np.zeros(cells.shape, np.int64)
    for axes, there, here, other in _neighbors(cells, periodic):
        both = (here >= 0) & (other >= 0)
        largest[there] += _WEIGHTS[axes] * both
        # eq. 6: a neighbor counts if it is another tile
        score[there] += _WEIGHTS[axes] * (both & (here != other))
    return score, largest


def entropy_per_cell(mask: ArrayLike, kind: str, colors: int, interiors: int = 1, *, periodic: bool = False) -> float:
    """Bits of choice per cell: the binary logarithm of the number of layouts that a rule allows, over the cells.

    * ``wang``: the paper's tile set under Rule 1. Every unbroken row of cells along an axis has one color, so a full
    box has ``c^(ny nz + nz nx + nx ny)`` layouts, ``3^(3 N^2)`` for N^3 cells and three colors: the exponent grows with
    the surface, and the entropy of a cell falls to zero as 1 / N. Rule 2 chooses among these layouts.

    * ``free``: every lattice face has a color of its own. Tends to ``3 log2(c) + log2(K)`` for large boxes.

    * ``corner``: every lattice corner has one. Tends to ``log2(c) + log2(K)``.

    `colors` is c, `interiors` the number K that a cell may have for given colors. 0 without cells; DesignError if
    either number is below 1, ValueError for another kind.
    """
    check_count("colors", colors)
    check_count("interiors", interiors)
    cells = checked_mask(mask)
    if kind == "wang":
        # Rule 1 leaves one free color for each unbroken row
        colored = sum(_runs(np.moveaxis(cells, axis, 0), periodic) for axis in range(3))
    elif kind == "free":
        faces = face_presence(cells, periodic)
        planes = (range(n + (not periodic)) for n in cells.shape)
        colored = sum(int(np.take(faces[axis], plane, axis).sum()) for axis, plane in enumerate(planes))
    elif kind == "corner":
        corners = np.zeros([n + 1 for n in cells.shape], np.bool_)
        for step in itertools.product((0, 1), repeat=3):
            corners[tuple(slice(d, n + d) for d, n in zip(step, cells.shape, strict=True))] |= cells
        if periodic:
            for axis in range(3):
                # the last plane of corners is the first one
                ends = np.take(corners, [0], axis) | np.take(corners, [-1], axis)
                corners = np.concatenate([ends, np.take(corners, range(1, cells.shape[axis]), axis)], axis)
        colored = int(corners.sum())
    else:
        raise ValueError(f"unknown kind {kind!r} of tile set, known are wang, free, corner")
    count = int(cells.sum())
    return (colored * math.log2(colors) + count * math.log2(interiors)) / count if count else 0.0


def _runs(cells: Bools, periodic: bool) -> int:
    """Number of unbroken rows of cells along the first axis, around the end, too, if periodic."""
    before = np.roll(cells, 1, axis=0)
    if not periodic:
        before[0] = False
    # a row of a periodic box that has no gap has no start either
    starts = int((cells & ~before).sum())
    return starts + (int(cells.all(axis=0).sum()) if periodic else 0)
