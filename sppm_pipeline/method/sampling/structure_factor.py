"""The structure factor S(k) of periodic points: how much of them a plane wave sees.

A wave is written by its integer numbers of periods (kx, ky, kz) along the edges of the periodic unit cube. Independent
points have S(k) of 1 on average, crystals have 0 but for Bragg peaks, and stealthy hyperuniform points have 0 for all
waves longer than some length (Torquato 2018, "Hyperuniform states of matter").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import inline_jit


class Waves(NamedTuple):
    """All waves up to a radius in reciprocal space but the constant one, and of each pair k and -k only one."""

    # (c, 5) runs of waves that differ in kz only: kx, ky, first and last kz, waves before the run
    columns: I64
    number: int  # M, the number of waves
    reach: int  # largest kx, ky or kz
    radius: float  # K, the longest wave vector, periods over the edge of the cell

    def vectors(self) -> I64:
        """The wave vectors in the order of the columns, (number, 3)."""
        return np.array([(kx, ky, kz) for kx, ky, low, high, _ in self.columns for kz in range(low, high + 1)])


def longest_waves(most: int) -> Waves:
    """The longest waves, in complete shells of equal length and not more than `most` of them.

    A column of the result is not empty and without gaps because all waves of a ball are taken.
    """
    reach = int(np.ceil((most / 2) ** (1 / 3))) + 2  # a ball of this radius holds far more than 2 most waves
    k = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    k = k[len(k) // 2 + 1 :]  # the middle row is zero; the rows before it are the negatives of those after it
    squared = (k**2).sum(1)
    bound = int(np.sort(squared)[most]) - 1  # the shell of the first wave too many is left out as a whole
    k = k[squared <= bound]
    columns, before = [], 0
    for kx, ky in np.unique(k[:, :2], axis=0):
        kz = k[(k[:, 0] == kx) & (k[:, 1] == ky), 2]
        columns.append((kx, ky, kz.min(), kz.max(), before))
        before += len(kz)
    largest = int((k**2).sum(1).max()) if len(k) else 0
    return Waves(
        np.array(columns, np.int64).reshape(-1, 5), len(k), int(np.abs(k).max()) if len(k) else 0, largest**0.5
    )


@inline_jit
def plane_waves(points: F64, reach: int, real: F64, imag: F64) -> None:
    """``exp(2 pi i k x)`` by point, axis and k from -reach to reach: `real` and `imag`, (n, 3, 2 reach + 1)."""
    for j in range(len(points)):
        for axis in range(3):
            angle = 2.0 * np.pi * points[j, axis]
            cosine, sine = np.cos(angle), np.sin(angle)
            x, y = 1.0, 0.0
            real[j, axis, reach], imag[j, axis, reach] = x, y
            for k in range(1, reach + 1):
                x, y = x * cosine - y * sine, x * sine + y * cosine
                real[j, axis, reach + k], imag[j, axis, reach + k] = x, y
                real[j, axis, reach - k], imag[j, axis, reach - k] = x, -y


@inline_jit
def add_density(real: F64, imag: F64, weight: F64, columns: I64, reach: int, total: F64) -> None:
    """Add ``sum_j weight_j exp(2 pi i k r_j)`` to `total` (2, number), real and imaginary parts.

    `real` and `imag` are those of `plane_waves`.
    """
    for j in range(len(real)):
        for c in range(len(columns)):
            a, b = columns[c, 0] + reach, columns[c, 1] + reach
            xy = weight[j] * (real[j, 0, a] * real[j, 1, b] - imag[j, 0, a] * imag[j, 1, b])
            xy_imag = weight[j] * (real[j, 0, a] * imag[j, 1, b] + imag[j, 0, a] * real[j, 1, b])
            low, size = columns[c, 2] + reach, columns[c, 3] - columns[c, 2] + 1
            z, z_imag = real[j, 2, low : low + size], imag[j, 2, low : low + size]
            sums = total[0, columns[c, 4] : columns[c, 4] + size]
            sums_imag = total[1, columns[c, 4] : columns[c, 4] + size]
            for k in range(size):
                sums[k] += xy * z[k] - xy_imag * z_imag[k]
                sums_imag[k] += xy * z_imag[k] + xy_imag * z[k]


def collective_density(points: ArrayLike, waves: Waves, weight: ArrayLike | None = None) -> F64:
    """The Fourier sums of points with weights (1 if omitted) at `waves`: real and imaginary parts, (2, number)."""
    centers = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
    shares = np.ones(len(centers)) if weight is None else np.ascontiguousarray(weight, np.float64)
    real, imag = (np.empty((len(centers), 3, 2 * waves.reach + 1)) for _ in range(2))
    plane_waves(centers, waves.reach, real, imag)
    total = np.zeros((2, waves.number))
    add_density(real, imag, shares, waves.columns, waves.reach, total)
    return total


def structure_factor(points: ArrayLike, waves: Waves, weight: ArrayLike | None = None) -> F64:
    """``S(k) = |sum_j exp(2 pi i k r_j)|^2 / n`` at `waves`, (number,); with weights, n is their sum."""
    centers = np.asarray(points, np.float64).reshape(-1, 3)
    total = collective_density(centers, waves, weight)
    return np.asarray((total**2).sum(0) / (len(centers) if weight is None else np.sum(weight)), np.float64)
