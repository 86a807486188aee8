"""The surface of the intersection of two solids, each exact to its own field.

The intersection of two fields is their maximum, and marching cubes finds its topology. But the maximum mixes, at the
two ends of a grid edge, values of fields of different size, so its interpolated zero lies where neither field has one.
Here every vertex is put where, going from the solid end, the first of the two fields reaches its zero. With a third
solid, united with the first one beforehand, that is where the last of the two has its zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.surface.marching_cubes import EDGE_MARGIN


def on_both_fields(
    vertices: NDArray[np.float64],
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    grid: Grid,
    start: int = 0,
    third: NDArray[np.float32] | None = None,
) -> NDArray[np.float64]:
    """Move the vertices of the surface of ``max(first, second) = 0`` along their grid edges.

    With a third field, of that of ``max(min(first, third), second) = 0``.

    Parameters
    ----------
    vertices : (n, 3) float64
        As marching cubes gives them, each inside a grid edge; others, on caps at the border, stay.
    first, second, third : (planes, ny, nx) float32
        Fields, negative inside their solids; their sizes need not have anything to do with each other.
    grid : Grid
        Where the fields were sampled.
    start : int
        The plane of the grid that comes first in the fields; vertices beyond their planes stay.

    Returns
    -------
    (n, 3) float64
    """
    moved = np.array(vertices, np.float64)
    _move(
        moved,
        np.ascontiguousarray(first, np.float32),
        np.ascontiguousarray(second, np.float32),
        np.ascontiguousarray(np.empty((0, 0, 0)) if third is None else third, np.float32),
        np.array(grid.origin),
        np.array(grid.spacing),
        np.array([0, 0, start]),
    )
    return moved


@jit
def _leaves(solid: float, void: float) -> float:
    """Where, as a fraction of the way, a field leaves its solid: -1 if it never is in it, 2 if it does not leave."""
    if not solid < 0.0:
        return -1.0
    if void < 0.0:
        return 2.0
    return solid / (solid - void)


@jit
def _move(
    vertices: NDArray[np.float64],
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    third: NDArray[np.float32],
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    start: NDArray[np.int64],
) -> None:
    node, beyond = np.empty(3, np.int64), np.empty(3, np.int64)
    for v in range(vertices.shape[0]):
        axis, inside, known = 0, 0, True
        for a in range(3):
            place = (vertices[v, a] - origin[a]) / spacing[a]
            whole = np.floor(place + 0.5)
            # vertices keep EDGE_MARGIN from the ends of their edge; the bevels of caps lie at half of it
            if abs(place - whole) > 0.75 * EDGE_MARGIN:
                axis = a
                inside += 1
                whole = np.floor(place)
            node[a] = np.int64(whole) - start[a]
            beyond[a] = node[a]
        beyond[axis] += 1
        for a in range(3):
            known &= node[a] >= 0 and beyond[a] < first.shape[2 - a]
        if inside != 1 or not known:
            continue
        k, j, i = node[2], node[1], node[0]
        kk, jj, ii = beyond[2], beyond[1], beyond[0]
        f0, f1 = np.float64(first[k, j, i]), np.float64(first[kk, jj, ii])
        s0, s1 = np.float64(second[k, j, i]), np.float64(second[kk, jj, ii])
        t0, t1 = 0.0, 0.0
        if third.size > 0:
            t0, t1 = np.float64(third[k, j, i]), np.float64(third[kk, jj, ii])
        if s0 < 0.0 and (f0 < 0.0 or t0 < 0.0):
            share = min(max(_leaves(f0, f1), _leaves(t0, t1)), _leaves(s0, s1))
        else:
            share = 1.0 - min(max(_leaves(f1, f0), _leaves(t1, t0)), _leaves(s1, s0))
        share = min(max(share, EDGE_MARGIN), 1.0 - EDGE_MARGIN)
        vertices[v, axis] = origin[axis] + (node[axis] + start[axis] + share) * spacing[axis]
