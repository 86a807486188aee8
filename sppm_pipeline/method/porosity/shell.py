"""Samples near the zero level of a sampled field."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_LAYERS = 16
"""Layers of samples whose distances are found at once, to bound memory."""


def crossings(values: NDArray[np.float32], periodic: bool) -> NDArray[np.float64]:
    """Points where lines between neighboring samples meet the zero level, (n, 3), x, y, z in steps of the grid.

    NaN counts as positive; beside a value that is not finite the level is taken to lie half way between samples. If
    periodic, opposite sides are neighbors.
    """
    found = []
    solid = values < 0
    for axis in range(3):
        meets = solid != np.roll(solid, -1, axis)
        if not periodic:
            np.moveaxis(meets, axis, 0)[-1] = False
        places = np.argwhere(meets)
        beyond = places.copy()
        beyond[:, axis] = (beyond[:, axis] + 1) % values.shape[axis]
        here, there = (values[tuple(at.T)].astype(np.float64) for at in (places, beyond))
        points = places.astype(np.float64)
        with np.errstate(invalid="ignore"):  # NaN and infinity
            share = here / (here - there)
        points[:, axis] += np.where(np.isfinite(here) & np.isfinite(there), share, 0.5)
        found.append(points[:, ::-1])
    return np.concatenate(found)


def in_shell(values: NDArray[np.float32], thickness: float, periodic: bool, threads: int = 1) -> NDArray[np.bool_]:
    """Negative samples within a distance (in steps of the grid) of the zero level, (nz, ny, nx) bool.

    Distances are those to the nearest point where the level meets a line of the grid, a little too long between
    such points: at a distance of d voxels by less than about 1 / (4 d) of a voxel, as half the diagonal of a voxel's
    face is the way to the next one.
    """
    from scipy.spatial import cKDTree

    within = np.zeros(values.shape, bool)
    points = crossings(values, periodic)
    if not len(points):
        return within
    box: Any = np.array(values.shape[::-1]) if periodic else None
    tree = cKDTree(points % box if periodic else points, boxsize=box)
    for start in range(0, len(values), _LAYERS):
        solid = np.argwhere(values[start : start + _LAYERS] < 0)
        solid[:, 0] += start
        distance, _ = tree.query(solid[:, ::-1], distance_upper_bound=thickness * (1 + 1e-6) + 1e-6, workers=threads)
        within[tuple(solid[np.isfinite(distance)].T)] = True
    return within
