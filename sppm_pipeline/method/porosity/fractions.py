"""Solid fractions of voxels, from samples of a smooth field."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F32
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import inline_jit, jit

_LAYERS = 16
"""Layers of voxels sampled in one go, to bound memory."""


EMPTY, FULL = 0.25, 0.75
"""Solid fractions below which a voxel counts as void, and above which as solid. On 13 cells at 64 voxels
the extrapolated error is 0.73 %, rms; 1.1 % with 0.35 and 0.65, and 1.5 % in proportion to the fraction (0 and 1)."""


def stiff_share(fraction: NDArray[Any]) -> NDArray[Any]:
    """Share of the solid's stiffness that a voxel has, by its solid fraction: 0 to 1/4, 1 from 3/4 on, linear between.

    The rule is symmetric, ``f(s) + f(1 - s) = 1``: a flat surface stays where it is in the mean, wherever it cuts the
    voxels, so that errors are of second order in the voxel, and two materials may change places.
    """
    share: NDArray[Any] = np.clip((fraction - fraction.dtype.type(EMPTY)) / fraction.dtype.type(FULL - EMPTY), 0, 1)
    return share


MIN_SHARE = 1e-6
"""Shares below are 0: they carry nothing, and single precision has no inverse of the least."""


def power_share(fraction: NDArray[Any], power: float, ratio: float = 0.0) -> NDArray[Any]:
    """Share of the solid's stiffness that a voxel has: its solid fraction to a power if the void has no stiffness.

    With a filling, `ratio` times as stiff as the solid, voxels have the power mean of both, with the exponent
    ``1 / power``. So both may change places, and the share turns into the fraction as they become alike.
    """
    if ratio > 1:
        return np.asarray(1 - power_share(1 - fraction, power, 1 / ratio))
    if ratio > 0.99:  # where the share is the fraction to a thousandth, and rounding errors are not
        return fraction
    root = ratio ** (1 / power)
    mean = (root + (1 - root) * fraction) ** power
    share = np.asarray(np.clip((mean - ratio) / (1 - ratio), 0, 1), fraction.dtype)
    share[share < MIN_SHARE] = 0
    return share


@inline_jit
def _cube(value: float) -> float:
    return value * value * value if value > 0.0 else 0.0


@inline_jit
def below_plane(value: float, a: float, b: float, c: float) -> float:
    """Fraction of a unit cube in which ``value + (a, b, c) · x`` is negative, x being measured from its center.

    Exact for a plane: inclusion and exclusion of the corners that the plane cuts off.
    """
    a, b, c = abs(a), abs(b), abs(c)
    reach = 0.5 * (a + b + c)
    if value >= reach:
        return 0.0
    if value <= -reach:
        return 1.0
    # the formula divides by each slope
    least = 1e-3 * reach
    a, b, c = max(a, least), max(b, least), max(c, least)
    up = 0.5 * (a + b + c) - value
    # volume of a tetrahedron cut by the plane, less those that stick out of the cube, by inclusion and exclusion
    total = _cube(up) - _cube(up - a) - _cube(up - b) - _cube(up - c)
    total += _cube(up - a - b) + _cube(up - a - c) + _cube(up - b - c) - _cube(up - a - b - c)
    return min(1.0, max(0.0, total / (6.0 * a * b * c)))


@jit
def _add_fractions(samples: F32, k: Any, shift: float, out: F32) -> None:
    """Mean fraction of the k^3 parts of each voxel; `samples` has one part more on each side, `shift` is in parts."""
    nz, ny, nx = out.shape
    share = 1.0 / (k * k * k)
    for z in range(1, nz * k + 1):
        for y in range(1, ny * k + 1):
            for x in range(1, nx * k + 1):
                value = np.float64(samples[z, y, x])
                left, right = np.float64(samples[z, y, x - 1]), np.float64(samples[z, y, x + 1])
                front, back = np.float64(samples[z, y - 1, x]), np.float64(samples[z, y + 1, x])
                low, high = np.float64(samples[z - 1, y, x]), np.float64(samples[z + 1, y, x])
                # the mean over the part, to second order value + Laplacian / 24: with the
                # sample alone, curved walls would all be displaced to one side
                mean = 0.75 * value + (left + right + front + back + low + high) / 24.0
                slopes = 0.5 * (right - left), 0.5 * (back - front), 0.5 * (high - low)
                if shift != 0.0:
                    mean += shift * math.sqrt(slopes[0] ** 2 + slopes[1] ** 2 + slopes[2] ** 2)
                inside = below_plane(mean, slopes[0], slopes[1], slopes[2])
                out[(z - 1) // k, (y - 1) // k, (x - 1) // k] += np.float32(share * inside)


def solid_fractions(
    sample_layers: Callable[[Grid, int, int], F32],
    shape: tuple[int, int, int],
    resolution: float | tuple[float, float, float],
    parts: int = 2,
    *,
    shift: float = 0.0,
) -> F32:
    """Fraction of each voxel in which a periodic field is negative, (nz, ny, nx) float32.

    Each voxel is cut into ``parts^3``; in each part the field is taken for a plane, with its mean and slope from the
    samples at the center and its six neighbors. That is exact for flat walls and of second order for curved ones;
    with two parts the fraction of a voxel on a sphere with a radius of four voxels is right within 0.02, the volume
    within 0.1 %.

    Parameters
    ----------
    sample_layers : callable
        Values of the field at the layers start <= k < stop of a grid, (stop - start, ny, nx).
    shape : (nx, ny, nz)
        Voxels.
    resolution : float or 3 floats
        Voxels along a unit of the field's coordinates; along x, y and z.
    parts : int
        Along a voxel edge.
    shift : float
        By how many voxels the walls are moved into the solid, everywhere the same.
    """
    nx, ny, nz = shape
    per_unit = resolution if isinstance(resolution, tuple) else (resolution,) * 3
    hx, hy, hz = (1.0 / (n * parts) for n in per_unit)
    # one part more on each side for the slopes
    grid = Grid((-hx / 2, -hy / 2, -hz / 2), (hx, hy, hz), (nx * parts + 2, ny * parts + 2, nz * parts + 2))
    out = np.zeros((nz, ny, nx), np.float32)
    for start in range(0, nz, _LAYERS):
        stop = min(nz, start + _LAYERS)
        samples = sample_layers(grid, start * parts, stop * parts + 2)
        _add_fractions(
            np.ascontiguousarray(samples, np.float32), np.int64(parts), float(shift * parts), out[start:stop]
        )
    return np.clip(out, 0, 1)
