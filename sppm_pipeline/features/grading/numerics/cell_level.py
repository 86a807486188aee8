"""A level that is smooth over cells of any shape: one unknown a cell, blended by Wendland's functions.

Each cell has a weight that falls from its middle to zero at `SUPPORT` cells from there, measured in the frame of the
cell, and the weights at a place are divided by their sum (Shepard). The weight is Wendland's C2 function ``(1 - q)^4
(4 q + 1)`` (Wendland 1995). A blend at the middles of a fine lattice is the control of a quadratic spline, which is
what is used in the end: it is once continuously differentiable and cheap to evaluate on rows of samples.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sppm_pipeline.features.grading.numerics.local_level import LevelFit, newton_steps
from sppm_pipeline.services.arrays import F32, F64, I32, I64, Bools
from sppm_pipeline.services.jit.compiled import jit

if TYPE_CHECKING:
    from scipy.sparse import csr_array

SUPPORT = 1.6
"""Reach of a cell's weight, in its own size. A heuristic: the corners of a cube are 0.87 away and its neighbors 1, so
that weights of 0.8 would leave gaps, and of 3.2 would blur the level over six cells."""

_CELLS_AT_A_TIME = 2000


class ControlLattice(NamedTuple):
    """Control points of the spline: middles of small cells of an edge, mm, the first of which begins at `origin`."""

    shape: tuple[int, int, int]
    edge: float
    origin: F64


def blending(lattice: ControlLattice, centers: F64, frames: F64) -> csr_array:
    """Weights of the cells at each control point, (points, cells); rows add up to one.

    `frames` (m, 3, 3) are the derivatives at the centers, in mm: column a is the cell's axis a. Points out of reach of
    all cells get the value of the nearest one.
    """
    from scipy.sparse import csr_array
    from scipy.spatial import cKDTree

    inverse = np.ascontiguousarray(np.linalg.inv(frames))
    # the box around the ellipsoid in which a weight is positive
    reach = SUPPORT * np.linalg.norm(frames, axis=2)
    place = (centers - lattice.origin) / lattice.edge - 0.5
    low = np.clip(np.ceil(place - reach / lattice.edge), 0, lattice.shape).astype(np.int64)
    high = np.clip(np.floor(place + reach / lattice.edge) + 1, 0, lattice.shape).astype(np.int64)
    most = int(np.maximum(high - low, 0).prod(axis=1).sum())
    point, cell, weight = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    count = _weights(
        low, high, np.array(lattice.shape), lattice.edge, lattice.origin, centers, inverse, point, cell, weight
    )
    size = (int(np.prod(lattice.shape)), len(centers))
    made = csr_array((weight[:count], (point[:count], cell[:count])), shape=size)
    total = np.asarray(made.sum(axis=1)).ravel()
    bare = np.flatnonzero(total <= 0)
    made = csr_array(made.multiply((1 / np.where(total > 0, total, 1.0))[:, None]))
    if len(bare):
        where = np.stack(np.unravel_index(bare, lattice.shape), axis=1)
        _, nearest = cKDTree(centers).query((where + 0.5) * lattice.edge + lattice.origin)
        made = csr_array(made + csr_array((np.ones(len(bare)), (bare, nearest)), shape=size))
    return made


@jit
def _weights(
    low: I64, high: I64, shape: I64, edge: float, origin: F64, centers: F64, inverse: F64, point: I64, cell: I64,
    weight: F64,
) -> int:  # fmt: skip
    count = 0
    for c in range(len(centers)):
        for i in range(low[c, 0], high[c, 0]):
            for j in range(low[c, 1], high[c, 1]):
                for k in range(low[c, 2], high[c, 2]):
                    x = origin[0] + (i + 0.5) * edge - centers[c, 0]
                    y = origin[1] + (j + 0.5) * edge - centers[c, 1]
                    z = origin[2] + (k + 0.5) * edge - centers[c, 2]
                    squared = 0.0
                    for a in range(3):
                        along = inverse[c, a, 0] * x + inverse[c, a, 1] * y + inverse[c, a, 2] * z
                        squared += along * along
                    q = np.sqrt(squared) / SUPPORT
                    if q < 1.0:
                        point[count] = (i * shape[1] + j) * shape[2] + k
                        cell[count] = c
                        weight[count] = (1.0 - q) ** 4 * (4.0 * q + 1.0)
                        count += 1
    return count


def means_over_cells(
    lattice: ControlLattice, blend: csr_array, inner: Callable[[int, int], tuple[F64, F64]]
) -> csr_array:
    """Matrix from the cells' values to the means of the spline over each cell, (m, m); `inner` gives for the cells
    from a first one to before a last one points (cells, k, 3) mm and the volume that each stands for, (cells, k).
    """
    from scipy.sparse import csr_array, vstack

    shape, rows = np.array(lattice.shape), []
    for first in range(0, blend.shape[1], _CELLS_AT_A_TIME):
        points, volume = inner(first, min(first + _CELLS_AT_A_TIME, blend.shape[1]))
        place = ((points - lattice.origin) / lattice.edge).reshape(-1, 3)
        own = np.clip(np.floor(place).astype(np.int64), 0, shape - 1)
        t = np.clip(place - own, 0.0, 1.0)
        along = np.stack([(1 - t) ** 2 / 2, 0.5 + t - t**2, t**2 / 2], -1)  # as in `level_spline`
        share = (volume / volume.sum(axis=1, keepdims=True)).ravel()
        cell = np.repeat(np.arange(len(points)), points.shape[1])
        # 27 control points around each place carry its value
        mean = csr_array((len(points), blend.shape[0]))
        for step in np.ndindex(3, 3, 3):
            node = np.clip(own + np.array(step) - 1, 0, shape - 1)
            weight = share * along[:, 0, step[0]] * along[:, 1, step[1]] * along[:, 2, step[2]]
            number = np.ravel_multi_index(tuple(node.T), lattice.shape)
            mean = mean + csr_array((weight, (cell, number)), shape=mean.shape)
        rows.append(csr_array(mean @ blend))
    return csr_array(vstack(rows))


def fit_cells(
    measure: Callable[[F64], tuple[F64, F64]],
    means: csr_array,
    known: Bools,
    targets: F64,
    start: F64,
    bounds: tuple[float, float],
    tolerance: float,
    steps: int,
) -> LevelFit:
    """`newton_steps` on cells of any shape (m,): `means` is the matrix by `means_over_cells`."""
    from scipy.sparse import csc_array, eye_array
    from scipy.sparse.linalg import spsolve

    # cells without an equation take the mean of those around them
    around = means.copy()
    around.setdiag(0.0)
    around = around.multiply((1 / np.maximum(np.asarray(around.sum(axis=1)).ravel(), 1e-300))[:, None])
    one = eye_array(len(known))
    smooth = one - around

    def move(wanted: F64, held: Bools) -> F64:
        # rows: a target change of the mean, the mean of the neighbors, or no change
        parts = [(means, known & ~held), (smooth, ~known & ~held), (one, held)]
        rows = sum(matrix.multiply(own[:, None].astype(float)) for matrix, own in parts)
        return np.asarray(spsolve(csc_array(rows), wanted))

    return newton_steps(measure, move, known, targets, start, bounds, tolerance, steps)


class CellSamples(NamedTuple):
    """Samples in cells: places (n, 3) counted in small cells of the control lattice from its low corner, cells, values
    to compare with the level, and the volume that each stands for.
    """

    place: F32
    cell: I32
    value: F32
    volume: F32


BYTES_OF_A_SAMPLE = 24


def porosities_and_slopes(samples: list[CellSamples], control: F64, cells: int, half_width: float) -> tuple[F64, F64]:
    """Share of each cell at or above the level, and its change with it by samples within `half_width` of the level."""
    totals = np.zeros((3, cells))
    padded = np.pad(control, 1, mode="edge")
    for some in samples:
        _compare(*some, padded, half_width, totals)
    of = np.maximum(totals[0], 1e-300)
    return totals[1] / of, totals[2] / of / (2 * half_width)


@jit
def _compare(place: F32, cell: I32, value: F32, volume: F32, padded: F64, half_width: float, totals: F64) -> None:
    """Sums by cell of the volume, of that at or above the level, and of that near it."""
    own = np.empty(3, np.int64)
    w = np.empty((3, 3))
    for n in range(len(cell)):
        for axis in range(3):
            t = np.float64(place[n, axis])
            own[axis] = min(max(int(np.floor(t)), 0), padded.shape[axis] - 3)
            t = min(max(t - own[axis], 0.0), 1.0)
            w[axis, 0], w[axis, 1], w[axis, 2] = 0.5 * (1 - t) ** 2, 0.5 + t - t * t, 0.5 * t * t
        level = 0.0
        for i in range(3):
            for j in range(3):
                row = padded[own[0] + i, own[1] + j]
                k = own[2]
                level += w[0, i] * w[1, j] * (w[2, 0] * row[k] + w[2, 1] * row[k + 1] + w[2, 2] * row[k + 2])
        excess = value[n] - level
        totals[0, cell[n]] += volume[n]
        # void is where the value is at or above the level; samples near it estimate the slope
        if excess >= 0:
            totals[1, cell[n]] += volume[n]
        if abs(excess) < half_width:
            totals[2, cell[n]] += volume[n]
