"""Void that opens nowhere: what is large enough for a drain, and what is small enough to be filled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.connectivity.components import find_components, paint_runs

AMBIENT = 1
"""Label of all void that reaches the border of the grid."""


class Traps(NamedTuple):
    """Void that opens nowhere, the largest component first."""

    labels: NDArray[np.int32]  # (nz, ny, nx): 0 in solid, `AMBIENT`, and 2, 3, ... in the traps
    sizes: NDArray[np.int64]  # (n,), voxels of each trap


def find_traps(solid: NDArray[np.uint8]) -> Traps:
    """Components of the void (nz, ny, nx) that do not meet the border of the grid, across faces."""
    found = find_components(solid, (False, False, False), 6, zeros=True)
    closed = ~found.faces.any(1)
    number = np.where(closed, 1 + np.cumsum(closed), AMBIENT).astype(np.int32)
    labels = np.zeros(solid.shape, np.int32)
    paint_runs(found.runs.rows, found.runs.bounds, number[found.of_run], labels)
    return Traps(labels, found.sizes[closed])


class SmallVoids(NamedTuple):
    """Void that opens nowhere and is small enough to be filled."""

    sizes: NDArray[np.int64]  # (n,), voxels of each, the largest first
    places: NDArray[np.int32]  # (n, 3), the first voxel of each, z, y, x
    runs: NDArray[np.int32]  # (m, 4), z, y, first x and last x of their runs
    left: NDArray[np.int64]  # (k,), voxels of the closed voids that are larger, the largest first


def find_small_voids(solid: NDArray[np.uint8], largest: float) -> SmallVoids:
    """Components of the void (nz, ny, nx) of up to `largest` voxels that do not meet the border, across faces."""
    found = find_components(solid, (False, False, False), 6, zeros=True)
    closed = ~found.faces.any(1)
    small = closed & (found.sizes <= largest)
    chosen = np.flatnonzero(small[found.of_run])
    z, y = np.divmod(np.searchsorted(found.runs.rows, chosen, "right") - 1, solid.shape[1])
    bounds = found.runs.bounds.reshape(-1, 2)[chosen]
    runs = np.stack([z, y, bounds[:, 0], bounds[:, 1] - 1], 1).astype(np.int32)
    _, first = np.unique(found.of_run[chosen], return_index=True)
    return SmallVoids(found.sizes[small], runs[first, :3], runs, found.sizes[closed & ~small])
