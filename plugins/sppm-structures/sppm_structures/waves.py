"""Sums of cosine waves with integer wave vectors: smooth random functions that repeat with the cell.

``f(p) = sum_i a_i cos(2 pi k_i . p + phase_i)`` is summed axis by axis: all waves that share (kx, ky) first along z,
then those that share kx along y, then along x. So a sample costs as many terms as there are different kx, about 10 for
a thousand waves. Every sum runs in the order of the waves, whatever the grid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Waves(NamedTuple):
    """Waves sorted by wave vector, kx first.

    `vectors` (n, 3) are periods along the edges of the cell; of a vector and its opposite, which make the same wave,
    one. `real`, `imaginary` (n,) are ``a cos(phase)`` and ``a sin(phase)``.
    """

    vectors: NDArray[np.int64]
    real: NDArray[np.float64]
    imaginary: NDArray[np.float64]


def waves_of(vectors: NDArray[np.int64], phases: NDArray[np.float64], amplitudes: NDArray[np.float64] | float) -> Waves:
    """Sort waves for `sum_of_waves`; vectors (n, 3), phases (n,) in radians."""
    order = np.lexsort(np.asarray(vectors).T[::-1])
    amplitudes = np.broadcast_to(np.asarray(amplitudes, np.float64), len(vectors))[order]
    return Waves(
        np.ascontiguousarray(vectors[order], np.int64),
        amplitudes * np.cos(phases[order]),
        amplitudes * np.sin(phases[order]),
    )


def half_space(vectors: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of every wave vector and its opposite the one that points up, or right, or ahead; without zero."""
    x, y, z = vectors.T
    kept: NDArray[np.int64] = vectors[(x > 0) | ((x == 0) & (y > 0)) | ((x == 0) & (y == 0) & (z > 0))]
    return kept


def sum_of_waves(
    waves: Waves, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The sum at the points of three axes of nx, ny, nz positions, cell sizes: (nx, ny, nz), x contiguous in memory."""
    from sppm_structures.wave_kernels import add_waves

    values = np.zeros((z.size, y.size, x.size))
    add_waves(waves.vectors, waves.real, waves.imaginary, x.reshape(-1), y.reshape(-1), z.reshape(-1), values)
    return values.T
