"""Distances between pores, measured."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


def nearest_distances(points: ArrayLike, periodic: Sequence[bool] = (True, True, True)) -> NDArray[np.float64]:
    """Distance of each point to its nearest neighbor, (n,) in cell sizes; infinite for a single point without images.

    Periodic axes have period 1; a point's own images, at distance 1, are neighbors, too.
    """
    from scipy.spatial import cKDTree

    wraps = np.asarray(periodic, np.bool_)
    folded = np.array(points, np.float64).reshape(-1, 3)
    folded = np.where(wraps, folded - np.floor(folded), folded)
    folded[wraps & (folded >= 1.0)] = 0.0  # just below a whole cell the difference rounds to 1
    own_image = 1.0 if wraps.any() else math.inf
    if len(folded) < 2:
        return np.full(len(folded), own_image)
    distances, _ = cKDTree(folded, boxsize=np.where(wraps, 1.0, 0.0)).query(folded, k=2)
    nearest: NDArray[np.float64] = np.minimum(distances[:, 1], own_image)
    return nearest


def min_spacing(points: ArrayLike, periodic: Sequence[bool] = (True, True, True)) -> float:
    """Smallest distance of two points, cell sizes; infinite when there is no pair. See `nearest_distances`."""
    distances = nearest_distances(points, periodic)
    return float(distances.min()) if len(distances) else math.inf
