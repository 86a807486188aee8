"""Dart throwing into many boxes of one size: interiors of thousands of cells, or thousands of faces, in a few calls.

Each box has a stream of its own and gets the pores that `throw` would give it, whatever the number of threads. A box
whose count is not reached is left to `throw`, which says how many pores fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.active_voxels import fill_active_voxels, throw_darts
from sppm_pipeline.method.sampling.cell_list import CellList, add_point, empty_cell_list
from sppm_pipeline.method.sampling.darts import NAIVE_BUDGET, NAIVE_SHARE, obstacles_around, throw, wanted_pores
from sppm_pipeline.services.arrays import F64, I64, U64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.threads import ordered_map

_PORE, _OBSTACLE = 0, -1
_EPS = 1e-9
FEW = 64
"""Patterns below which they are thrown one by one: the kernel for many of them has to be loaded first. Only speed
depends on it."""
_RUN = 64
"""Boxes of one call: enough that the call costs nothing, few enough that all threads have work."""


class Surrounding(NamedTuple):
    """Pores around each box: some pieces of a list, each moved by whole cells.

    Attributes
    ----------
    points : (n, 3) float64
        Pores, piece after piece.
    first : (pieces + 1,) int64
        Where each piece begins.
    piece : (r,) int64
        Pieces around the boxes, box after box.
    shift : (r, 3) int64
        Cells by which they are moved.
    rows : (boxes + 1,) int64
        Where those of each box begin.
    """

    points: F64
    first: I64
    piece: I64
    shift: I64
    rows: I64


def nothing_around(boxes: int) -> Surrounding:
    """No pores around any of so many boxes."""
    none = np.zeros(0, np.int64)
    return Surrounding(np.zeros((0, 3)), np.zeros(1, np.int64), none, none.reshape(0, 3), np.zeros(boxes + 1, np.int64))


def throw_many(
    streams: U64,
    count: int | None,
    spacing: float,
    lower: F64,
    upper: F64,
    *,
    around: Surrounding,
    obstacles: F64 | None,
    obstacle_images: bool = False,
    share: float | None = None,
    attempts: int = 20,
    threads: int = 1,
) -> Iterator[tuple[F64, I64]]:
    """Throw pores into many boxes that do not repeat; arguments and errors as in `throw`, for all boxes.

    `streams` (boxes,) are the numbers that `throw` draws from its generator. Each box keeps the spacing from pores of
    its own, `around`, listed completely, and from common `obstacles` (k, 3), which may repeat by `obstacle_images`.
    Yields the pores (n, 3) of the next boxes, box after box, in the order of throwing, and their numbers (q,): -1 for a
    box that is left to `throw`.
    """
    low, side, wraps = np.array(lower), upper - lower, (False,) * 3
    wanted, rows, capacity = wanted_pores(count, share, spacing, side, wraps)
    everywhere = obstacles_around(obstacles, low, side, spacing, wraps, obstacle_images)
    naive, all_that_fit = int(min(wanted, NAIVE_SHARE * capacity)), share == 1.0

    if wanted == 0:
        return iter([(np.empty((0, 3)), np.zeros(len(streams), np.int64))])
    sizes = np.concatenate([[0], np.cumsum(np.diff(around.first)[around.piece])])
    most = int(np.diff(sizes[around.rows]).max(initial=0))
    # in one array, as thousands of small ones would leave the memory in shreds; what is not written takes none
    room = np.empty((rows * len(streams), 3))

    def thrown(box: int) -> tuple[F64, I64]:
        own = streams[box : box + _RUN].copy()
        cells = empty_cell_list(rows + len(everywhere) + most, spacing, low, low + side, wraps)
        centers, counts = room[rows * box : rows * (box + len(own))], np.empty(len(own), np.int64)
        used = _throw(
            cells, own, box, low, side, wanted, naive, all_that_fit, attempts, everywhere, around, centers, counts
        )
        return centers[:used], counts

    runs = range(0, len(streams), _RUN)
    return ordered_map(thrown, runs, min(threads, max(len(runs), 1)))


@jit
def _throw(
    cells: CellList,
    streams: U64,
    box: int,
    lower: F64,
    side: F64,
    wanted: int,
    naive: int,
    all_that_fit: bool,
    attempts: int,
    everywhere: F64,
    around: Surrounding,
    centers: F64,
    counts: I64,
) -> int:
    """Throw into the boxes from `box` on; returns the number of rows of `centers` that were written."""
    used = 0
    nz, ny, nx = cells.first.shape
    for own in range(len(streams)):
        stream = streams[own : own + 1]
        best = 0
        counts[own] = -1
        for _ in range(attempts):
            cells.used[0] = 0
            for k in range(nz):
                for j in range(ny):
                    for i in range(nx):
                        cells.first[k, j, i] = -1
            for row in range(everywhere.shape[0]):
                add_point(cells, everywhere[row, 0], everywhere[row, 1], everywhere[row, 2], _OBSTACLE, 0)
            for row in range(around.rows[box + own], around.rows[box + own + 1]):
                _add_near(cells, around, row, lower, side)
            start = cells.used[0]
            placed = throw_darts(cells, stream, lower, side, naive, NAIVE_BUDGET * naive + 1000, _PORE, 0)
            if placed < wanted:
                placed += fill_active_voxels(cells, stream, lower, side, wanted - placed, _PORE, 0)
            if placed == wanted or all_that_fit:
                counts[own] = placed
                for row in range(placed):
                    for axis in range(3):
                        centers[used, axis] = cells.points[start + row, axis]
                    used += 1
                break
            best = max(best, placed)
            # as in `throw`: the count is out of reach
            if wanted - best > 1.5 * math.sqrt(wanted):
                break
    return used


@jit
def _add_near(cells: CellList, around: Surrounding, row: int, lower: F64, side: F64) -> None:
    """Add those pores of a piece that matter to the box."""
    shift = around.shift[row]
    for p in range(around.first[around.piece[row]], around.first[around.piece[row] + 1]):
        x, y, z = around.points[p, 0] + shift[0], around.points[p, 1] + shift[1], around.points[p, 2] + shift[2]
        near = True
        for axis, value in ((0, x), (1, y), (2, z)):
            near &= lower[axis] - cells.reach - _EPS <= value <= lower[axis] + side[axis] + cells.reach + _EPS
        if near:
            add_point(cells, x, y, z, _OBSTACLE, 0)


def patterns_apart(
    streams: U64, wanted: I64, spacing: float, lower: F64, upper: F64, *, obstacles: F64 | None = None, threads: int = 1
) -> list[F64]:
    """Face patterns, (wanted, 3) each, that need not look at each other, each as `throw` makes it.

    `streams` (n,) are the numbers that `throw` draws; `obstacles` (k, 3) repeat in every cell. Raises DesignError when
    a pattern holds fewer pores than its `wanted` (n,).
    """
    around = np.zeros((0, 3)) if obstacles is None else obstacles

    def thrown(one: int) -> F64:
        return throw(streams[one : one + 1].copy(), int(wanted[one]), spacing, lower, upper, obstacles=around)

    if len(streams) < FEW:
        return [thrown(one) for one in range(len(streams))]
    patterns, full = [np.zeros((0, 3))] * len(streams), []
    for count in dict.fromkeys(wanted.tolist()):
        alike = np.flatnonzero(wanted == count)
        made = throw_many(
            streams[alike], count, spacing, lower, upper,
            around=nothing_around(len(alike)), obstacles=around, obstacle_images=True, threads=threads,
        )  # fmt: skip
        done = 0
        for centers, counts in made:
            which = alike[done : done + len(counts)]
            full += which[counts < 0].tolist()
            done += len(counts)
            for one, start in zip(which[counts > 0].tolist(), range(0, len(centers), max(count, 1)), strict=True):
                patterns[one] = centers[start : start + count]
    for one in sorted(full):
        patterns[one] = thrown(one)  # which raises with the number that fits
    return patterns


def faces_apart(
    streams: Sequence[U64],
    wanted: I64,
    spacing: float,
    border: float,
    *,
    obstacles: F64 | None = None,
    threads: int = 1,
) -> list[list[F64]]:
    """`patterns_apart` of each axis, by axis and color, so far from the border that perpendicular faces do not matter.

    `streams` are those of each axis, `wanted` (3, colors or more) the pores of each pattern. Raises DesignError if the
    border leaves no face.
    """
    if border >= 0.5:
        raise DesignError(
            f"this many face patterns keep {border:.4g} cell sizes from the border, which leaves no face",
            hint="choose a smaller spacing",
        )
    patterns = []
    for axis, own in enumerate(streams):
        low, high = np.full(3, border), np.full(3, 1.0 - border)
        low[axis] = high[axis] = 0.0
        made = patterns_apart(own, wanted[axis, : len(own)], spacing, low, high, obstacles=obstacles, threads=threads)
        patterns.append(made)
    return patterns
