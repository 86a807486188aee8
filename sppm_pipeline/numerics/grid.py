"""The regular grid on which fields are sampled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


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

    def axis(self, axis: int) -> NDArray[np.float64]:
        """Coordinates of the samples along one axis, (shape[axis],)."""
        return self.origin[axis] + self.spacing[axis] * np.arange(self.shape[axis], dtype=np.float64)

    def layers(self, start: int, stop: int) -> Grid:
        """The part of the grid with z-layers start <= k < stop."""
        x, y, z = self.origin
        return Grid((x, y, z + start * self.spacing[2]), self.spacing, (self.shape[0], self.shape[1], stop - start))


def cell_centers(n: int, cells: tuple[int, int, int] = (1, 1, 1)) -> Grid:
    """Voxel centers of `cells` unit cells with n voxels along each cell edge."""
    h = 1.0 / n
    return Grid((h / 2,) * 3, (h,) * 3, (n * cells[0], n * cells[1], n * cells[2]))


def cell_nodes(n: int, cells: tuple[int, int, int] = (1, 1, 1)) -> Grid:
    """Voxel corners of `cells` unit cells with n voxels along each cell edge; both ends are included."""
    h = 1.0 / n
    return Grid((0.0,) * 3, (h,) * 3, (n * cells[0] + 1, n * cells[1] + 1, n * cells[2] + 1))
