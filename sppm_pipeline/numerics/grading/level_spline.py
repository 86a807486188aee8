"""A quadratic tensor spline over a lattice of cells, with one control point in the middle of each.

Inside a cell, at t from 0 to 1 along an axis, the control points before, in and after it have the weights
``(1 - t)^2 / 2``, ``1/2 + t - t^2`` and ``t^2 / 2``: the uniform B-spline of degree two, whose value and slope are
continuous. Beyond the first and the last cell the outermost control point is repeated, so that the spline ends with
slope zero and goes on as a constant. Its mean over a cell is ``(1/6, 2/3, 1/6)`` of the three control points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class _Along(NamedTuple):
    """Positions along one axis: the first and last cell that they lie in, and for each its cell and three weights."""

    cell: NDArray[np.int64]
    weights: NDArray[np.float64]


def _along(positions: NDArray[np.float64], cells: int) -> _Along:
    cell = np.clip(np.floor(positions).astype(np.int64), 0, cells - 1)
    t = np.clip(positions - cell, 0.0, 1.0)
    return _Along(cell, np.stack([(1 - t) ** 2 / 2, 0.5 + t - t**2, t**2 / 2], -1))


def _contracted(values: NDArray[np.float64], along: _Along) -> NDArray[np.float64]:
    """Control points along the first axis of `values` to positions along the last one of the result."""
    padded = np.concatenate([values[:1], values, values[-1:]])
    taken = [padded[along.cell + k] * along.weights[:, k].reshape(-1, *[1] * (values.ndim - 1)) for k in range(3)]
    return np.moveaxis(taken[0] + taken[1] + taken[2], 0, -1)


def spline_values(
    control: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The spline at the points of three axes.

    Parameters
    ----------
    control : (nx, ny, nz) float64
        Control points, one for each cell.
    x, y, z : (k,), (m,), (n,) float64
        Positions along the axes, cell sizes.

    Returns
    -------
    (n, m, k) float64
        Indexed z, y, x.
    """
    along = (_along(p, n) for p, n in zip((x, y, z), control.shape, strict=True))
    values = control
    for axis in along:
        values = _contracted(values, axis)
    return values.transpose(2, 1, 0)


class LayerSpline:
    """The spline on the rows of single layers, as what samples a field layer by layer asks for it.

    A value depends on its position alone: it is the same sum of three numbers whatever is asked for beside it.

    Parameters
    ----------
    control : (nx, ny, nz) float64
    x, y : (k,), (m,) float64
        Positions of the samples of every layer, cell sizes.
    """

    def __init__(self, control: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
        self._control, self._y = control, _along(y, control.shape[1])
        across = _along(x, control.shape[0])
        self._weights = across.weights.T.astype(np.float32)
        ends = np.concatenate([[0], np.flatnonzero(np.diff(across.cell)) + 1, [len(x)]])
        self._runs = [
            (slice(a, b), int(across.cell[a])) for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)
        ]

    def layer(self, z: float) -> NDArray[np.float32]:
        """The spline in the layer at height `z`, (m, k) float32, indexed y, x."""
        at = _along(np.array([z]), self._control.shape[2])
        plane = _contracted(self._control.transpose(2, 0, 1), at)[..., 0]
        rows = _contracted(plane.T, self._y).T.astype(np.float32)
        rows = np.concatenate([rows[:, :1], rows, rows[:, -1:]], 1)
        out = np.empty((len(rows), self._weights.shape[1]), np.float32)
        for run, cell in self._runs:
            np.multiply(rows[:, cell, None], self._weights[0, run], out=out[:, run])
            for k in (1, 2):
                out[:, run] += rows[:, cell + k, None] * self._weights[k, run]
        return out


def control_of_means(means: NDArray[np.float64]) -> NDArray[np.float64]:
    """The control points whose spline has the given means over the cells, (nx, ny, nz): a banded solve for each axis.

    Along each axis means are ``(1/6, 2/3, 1/6)`` of the control points, ``(5/6, 1/6)`` at the ends.
    """
    from scipy.linalg import solve_banded

    values = means
    for axis in range(3):
        n = means.shape[axis]
        if n > 1:
            bands = np.full((3, n), 1 / 6)
            bands[1] = 2 / 3
            bands[1, [0, -1]] += 1 / 6
            lines = np.moveaxis(values, axis, 0)
            solved = solve_banded((1, 1), bands, lines.reshape(n, -1), check_finite=False)
            values = np.moveaxis(solved.reshape(lines.shape), 0, axis)
    return values


def extended(values: NDArray[np.float64], known: NDArray[np.bool_], sweeps: int = 200) -> NDArray[np.float64]:
    """`values` where they are known, elsewhere a smooth continuation: the mean of the neighbors, as far as it spreads.

    Where nothing is known within `sweeps` cells the mean of all known values is taken.
    """
    if known.all() or not known.any():
        return np.where(known, values, 0.0)
    found = np.where(known, values, values[known].mean())
    for _ in range(min(sweeps, 2 * sum(found.shape))):
        padded = np.pad(found, 1, mode="edge")
        around = sum(np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1] for axis in range(3) for step in (-1, 1))
        found = np.where(known, values, around / 6)
    return found
