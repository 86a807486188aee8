"""Samples of periodic fields: each point of a period is computed once, so that its images are equal to the last bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.grid import Grid


def sample_one_period(
    grid: Grid, cells: tuple[int, int, int], start: int, stop: int, sample: Callable[[Grid, int, int], NDArray[Any]]
) -> NDArray[Any]:
    """Layers start <= k < stop of a grid that may be larger than the period of the field.

    Along axes where the period is no whole number of samples nothing can be shared, and all samples are computed.

    Parameters
    ----------
    grid : Grid
    cells : tuple of 3 ints
        The period, cell edges.
    start, stop : int
    sample : function of grid, start, stop
        Computes layers of a grid, (layers, ny, nx).
    """
    counts = []
    for axis in range(3):
        n = round(cells[axis] / grid.spacing[axis])
        whole = abs(n * grid.spacing[axis] - cells[axis]) < 1e-9 * cells[axis]
        counts.append(min(n, grid.shape[axis]) if whole else grid.shape[axis])
    nx, ny, nz = counts
    if (nx, ny, nz) == grid.shape:
        return sample(grid, start, stop)
    once = Grid(grid.origin, grid.spacing, (nx, ny, nz))
    place = np.arange(start, stop) % nz
    if stop - start >= nz:
        layers = sample(once, 0, nz)[place]
    elif start < stop and place[0] > place[-1]:
        layers = np.concatenate([sample(once, int(place[0]), nz), sample(once, 0, int(place[-1]) + 1)])
    else:
        layers = sample(once, start % nz, start % nz + stop - start)
    if (nx, ny) == grid.shape[:2]:
        return layers
    return np.ascontiguousarray(layers[:, np.arange(grid.shape[1]) % ny][:, :, np.arange(grid.shape[0]) % nx])
