"""Periodic images: which axes repeat, where an edge ends, how long it is, and its one canonical form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


def as_points(points: ArrayLike) -> NDArray[np.float64]:
    """The points as a C-contiguous (n, 3) float64 array.

    Raises
    ------
    ValueError
        If the shape is not (n, 3) or a coordinate is not finite.
    """
    array = np.ascontiguousarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"points must have the shape (n, 3), not {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError("points must be finite")
    return array


def periodic_axes(periodic: bool | Sequence[bool]) -> NDArray[np.bool_]:
    """Which of x, y, z repeat with period 1: one flag for all, or three."""
    axes = np.asarray(periodic, dtype=np.bool_)
    if axes.shape not in ((), (3,)):
        raise ValueError("periodic must be one flag or three")
    return np.ascontiguousarray(np.broadcast_to(axes, 3))


def images_per_pair(periodic: bool | Sequence[bool]) -> int:
    """How many tunnels two pores may always share.

    No tunnel is longer than the cell along a periodic axis, which leaves two images of a pore along each such axis.
    """
    return int(2 ** int(periodic_axes(periodic).sum()))


def wrapped(points: NDArray[np.float64], axes: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points moved into the cell along the periodic axes, and the whole cells (n, 3) that were taken off."""
    cells = np.where(axes, np.floor(points), 0.0)
    return points - cells, cells.astype(np.int64)


def canonical_edges(edges: NDArray[np.int64], shifts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each edge with i < j, sorted by (i, j, shift), without duplicates.

    Turning an edge round changes the sign of its shift: i -> j + s is the same tunnel as j -> i - s.
    """
    turned = edges[:, 0] > edges[:, 1]
    rows = np.empty((len(edges), 5), dtype=np.int64)
    rows[:, :2] = np.where(turned[:, None], edges[:, ::-1], edges)
    rows[:, 2:] = np.where(turned[:, None], -shifts, shifts)
    rows = rows[np.lexsort(rows.T[::-1])]
    fresh = np.ones(len(rows), dtype=np.bool_)
    fresh[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    rows = rows[fresh]
    return np.ascontiguousarray(rows[:, :2]), np.ascontiguousarray(rows[:, 2:])


def segments(
    points: NDArray[np.float64], edges: NDArray[np.int64], shifts: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Start ``points[i]`` and end ``points[j] + shift`` of every edge, each (m, 3)."""
    return points[edges[:, 0]], points[edges[:, 1]] + shifts


def edge_lengths(
    points: NDArray[np.float64], edges: NDArray[np.int64], shifts: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Length of every tunnel, (m,)."""
    starts, ends = segments(points, edges, shifts)
    steps = ends - starts
    lengths: NDArray[np.float64] = np.sqrt(steps[:, 0] ** 2 + steps[:, 1] ** 2 + steps[:, 2] ** 2)
    return lengths
