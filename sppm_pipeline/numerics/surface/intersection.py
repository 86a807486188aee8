"""The surface of the intersection of two solids, each exact to its own field.

The intersection of two fields is their maximum, and marching cubes finds its topology. But the maximum mixes, at the
two ends of a grid edge, values of fields of different size, so its interpolated zero lies where neither field has one.
Here every vertex is put where, going from the solid end, the first of the two fields reaches its zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.surface.marching_cubes import EDGE_MARGIN

__all__ = ["on_both_fields"]


def on_both_fields(
    vertices: NDArray[np.float64], first: NDArray[np.float32], second: NDArray[np.float32], grid: Grid
) -> NDArray[np.float64]:
    """Move the vertices of the surface of ``max(first, second) = 0`` along their grid edges.

    Parameters
    ----------
    vertices : (n, 3) float64
        As marching cubes gives them, each inside a grid edge; others, on caps at the border, stay.
    first, second : (nz, ny, nx) float32
        Fields, negative inside their solids; their sizes need not have anything to do with each other.
    grid : Grid
        Where the fields were sampled.

    Returns
    -------
    (n, 3) float64
    """
    place = (vertices - grid.origin) / grid.spacing
    whole = np.round(place)
    # vertices keep EDGE_MARGIN from the ends of their edge; the bevels of caps lie at half of it
    inside = np.abs(place - whole) > 0.75 * EDGE_MARGIN
    last = np.array(grid.shape) - 1
    on_edge = (inside.sum(1) == 1) & ((place > 0) & (place < last) | ~inside).all(1)
    on_edge &= ((whole >= 0) & (whole <= last)).all(1)
    axis = np.argmax(inside, 1)[on_edge]
    rows = np.arange(len(axis))
    low = whole[on_edge].astype(np.int64)
    low[rows, axis] = np.floor(place[on_edge][rows, axis]).astype(np.int64)
    high = low.copy()
    high[rows, axis] += 1
    share = np.full(len(axis), 1.0)
    solid_is_low = _at(first, low) < 0
    solid_is_low &= _at(second, low) < 0
    for field in (first, second):
        a, b = _at(field, low), _at(field, high)
        solid, void = np.where(solid_is_low, a, b), np.where(solid_is_low, b, a)
        crosses = (void >= 0) & (solid < 0)
        share[crosses] = np.minimum(share[crosses], solid[crosses] / (solid[crosses] - void[crosses]))
    share = np.clip(np.where(solid_is_low, share, 1 - share), EDGE_MARGIN, 1 - EDGE_MARGIN)
    moved = vertices.copy()
    rows_moved = np.flatnonzero(on_edge)
    moved[rows_moved, axis] = np.array(grid.origin)[axis] + (low[rows, axis] + share) * np.array(grid.spacing)[axis]
    return moved


def _at(field: NDArray[np.float32], index: NDArray[np.int64]) -> NDArray[np.float64]:
    return field[index[:, 2], index[:, 1], index[:, 0]].astype(np.float64)
