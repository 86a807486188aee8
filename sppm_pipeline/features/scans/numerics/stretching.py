"""The stretch and the turn that a fabric tensor shows, and cells that are stretched and turned in a box."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from sppm_pipeline.services.arrays import F32, F64


def stretch_of(lengths: F64, axes: F64) -> tuple[F64, F64]:
    """Stretches along x, y, z, of the product 1, and the angles about x, then y, then z of the turn after it, degrees.

    An isotropic structure that is stretched and turned so has mean intercept `lengths` (3,) along `axes`, one a row:
    what a line meets stays the same when both are stretched. Of all ways to number the axes the one that turns least.
    Stretches are NaN where a length is not finite.
    """
    from scipy.spatial.transform import Rotation

    order = max(permutations(range(3)), key=lambda p: float(np.abs(axes[list(p)].diagonal()).sum()))
    rotation = axes[list(order)].T * np.where(axes[list(order)].diagonal() < 0, -1.0, 1.0)
    if np.linalg.det(rotation) < 0:
        rotation[:, np.abs(rotation.diagonal()).argmin()] *= -1
    with np.errstate(invalid="ignore"):  # no direction of an ellipsoid that is open
        found = lengths[list(order)] / np.cbrt(lengths.prod())
    return found, np.asarray(Rotation.from_matrix(rotation).as_euler("xyz", degrees=True))


def matrix_of(stretch: tuple[float, float, float], turn: tuple[float, float, float] | None) -> F64:
    """The linear map (3, 3) of `warp.affine`."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", turn or (0, 0, 0), degrees=True).as_matrix() * np.array(stretch))


def stretched(values: F32, finer: int, matrix: F64, shape: tuple[int, int, int]) -> F32:
    """Cells that repeat, mapped about their middle, at the voxels of a box (nx, ny, nz); linear between their samples.

    `values` (mx, my, mz) are samples at the centers of voxels, `finer` of them along the edge of a voxel of the box.
    """
    from scipy.ndimage import map_coordinates

    x, y, z = (finer * (np.arange(m) + (1 - m) / 2) for m in shape)
    a, b, c = np.linalg.inv(matrix).T[:, :, None, None]
    middle = (np.array(values.shape)[:, None, None] - 1) / 2
    out = np.empty(shape, np.float32, order="F")
    for k in range(shape[2]):  # the coordinates of a layer at a time
        at = a * x[:, None] + b * y + c * z[k] + middle
        out[:, :, k] = map_coordinates(values, at, order=1, mode="grid-wrap", output=np.float32)
    return out
