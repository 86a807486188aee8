"""Porosity in a moving window, from shares of void in small blocks."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

BLOCKS = 8
"""Blocks along a cell edge."""

WINDOW = 0.5
"""Standard deviation of the Gaussian window, cell sizes."""

_TRUNCATE = 3.0


def block_counts(
    void: NDArray[np.bool_], inside: NDArray[np.bool_] | None, size: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Voxels that are void and inside, and all that are inside, in blocks of `size` along each axis.

    Masks are (nz, ny, nx), multiples of `size`; `inside` is None for all.
    """
    nz, ny, nx = (n // size for n in void.shape)

    def summed(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
        blocks = mask.reshape(nz, size, ny, size, nx, size)
        found: NDArray[np.int64] = blocks.sum((1, 3, 5), dtype=np.int64)
        return found

    if inside is None:
        return summed(void), np.full((nz, ny, nx), size**3, np.int64)
    return summed(void & inside), summed(inside)


def smoothed_means(
    values: NDArray[np.floating], weights: NDArray[np.floating], *, mode: Literal["constant", "wrap"] = "constant"
) -> NDArray[np.float64]:
    """Weighted means of block values (nx, ny, nz), `BLOCKS` along a cell edge, in a Gaussian window around each block;
    NaN where nothing has a weight. Beyond the ends there is nothing ("constant"), or the blocks repeat ("wrap").
    """
    from scipy.ndimage import gaussian_filter

    sigma = WINDOW * BLOCKS
    weight = gaussian_filter(np.asarray(weights, np.float64), sigma, mode=mode, truncate=_TRUNCATE)
    total = gaussian_filter(np.asarray(values * weights, np.float64), sigma, mode=mode, truncate=_TRUNCATE)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weights > 0, total / weight, np.nan)
