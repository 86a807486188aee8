"""The regular grid on which fields are sampled, and samples of periodic fields."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.services.arrays import F64

VOXEL_FACES = (
    ((-1, 0, 0), (0, 4, 6, 2)),
    ((1, 0, 0), (1, 3, 7, 5)),
    ((0, -1, 0), (0, 1, 5, 4)),
    ((0, 1, 0), (2, 6, 7, 3)),
    ((0, 0, -1), (0, 2, 3, 1)),
    ((0, 0, 1), (4, 5, 7, 6)),
)
"""Neighbor beyond each face of a voxel, and its corners counterclockwise from outside, numbered i + 2 j + 4 k."""


class Grid(NamedTuple):
    """Sample points ``origin + (i, j, k) * spacing`` for 0 <= (i, j, k) < shape.

    Attributes
    ----------
    origin : tuple of 3 floats
        Position of the first sample (x, y, z).
    spacing : tuple of 3 floats
        Distance between neighboring samples along x, y, z; positive.
    shape : tuple of 3 ints
        Number of samples along x, y, z.
    """

    origin: tuple[float, float, float]
    spacing: tuple[float, float, float]
    shape: tuple[int, int, int]

    def axis(self, axis: int) -> F64:
        """Coordinates of the samples along one axis, (shape[axis],)."""
        return self.origin[axis] + self.spacing[axis] * np.arange(self.shape[axis], dtype=np.float64)

    def layers(self, start: int, stop: int) -> Grid:
        """The part of the grid with z-layers start <= k < stop."""
        x, y, z = self.origin
        return Grid((x, y, z + start * self.spacing[2]), self.spacing, (self.shape[0], self.shape[1], stop - start))

    def subsampled(self, k: int, m: int = 1) -> Grid:
        """k x k x m points in place of each one: the middles of the equal parts of the voxel around it."""
        if (k, m) == (1, 1):
            return self
        (x, y, z), (hx, hy, hz), (nx, ny, nz) = self
        z += 0.0 if m == 1 else hz / (2 * m) - hz / 2
        return Grid(
            (x - hx / 2 + hx / (2 * k), y - hy / 2 + hy / (2 * k), z),
            (hx / k, hy / k, hz / m),
            (nx * k, ny * k, nz * m),
        )


def covering_voxels(
    lower: ArrayLike, upper: ArrayLike, spacing: ArrayLike
) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    """The voxels of an endless lattice that cover a box: indices of the first, and their number along each axis.

    Voxel (i, j, k) reaches from ``(i, j, k) * spacing`` to ``(i + 1, j + 1, k + 1) * spacing``. A millionth of a voxel
    is rounding and no part of the box; there is at least one voxel.
    """
    first = np.floor(np.divide(lower, spacing) + 1e-6).astype(np.int64)
    last = np.ceil(np.divide(upper, spacing) - 1e-6).astype(np.int64)
    i, j, k = first.tolist()
    nx, ny, nz = np.maximum(1, last - first).tolist()
    return (i, j, k), (nx, ny, nz)


def cell_centers(n: int, cells: tuple[int, int, int] = (1, 1, 1)) -> Grid:
    """Voxel centers of `cells` unit cells with n voxels along each cell edge."""
    h = 1.0 / n
    return Grid((h / 2,) * 3, (h,) * 3, (n * cells[0], n * cells[1], n * cells[2]))


def cell_nodes(n: int, cells: tuple[int, int, int] = (1, 1, 1)) -> Grid:
    """Voxel corners of `cells` unit cells with n voxels along each cell edge; both ends are included."""
    h = 1.0 / n
    return Grid((0.0,) * 3, (h,) * 3, (n * cells[0] + 1, n * cells[1] + 1, n * cells[2] + 1))


def sample_one_period(
    grid: Grid, cells: tuple[int, int, int], start: int, stop: int, sample: Callable[[Grid, int, int], NDArray[Any]]
) -> NDArray[Any]:
    """Layers start <= k < stop, (layers, ny, nx), of a grid that may be larger than the field's period of some `cells`.

    `sample` computes layers of a grid. Each point of a period is computed once, so that its images are equal to the
    last bit. Along axes where the period is not an integer number of samples nothing can be shared, and all are
    computed.
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
