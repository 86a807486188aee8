"""How far the fast sum can be from the exact one."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.kernels.kernels import Kernels
from sppm_pipeline.numerics.kernels.parameters import DEFAULT_CUTOFF, pore_reach, tunnel_reach

# Pairs of block and kernel of one chunk.
_PAIRS = 1 << 20


def cutoff_bound(
    kernels: Kernels, lower: ArrayLike, upper: ArrayLike, cutoff: float = DEFAULT_CUTOFF, blocks: int = 8
) -> float:
    """Bound of |fast sum - exact sum| at every point of a box, for `add_kernels` with this cut-off.

    The box is cut into ``blocks^3`` blocks. In a block, a kernel that reaches all of it loses nothing; another one
    loses at most the cut-off, and at most its largest value in the block. To these losses the rounding of float32 is
    added: of the coordinates of the samples, which are scaled by the kernel, and of the sum. The bound holds for the
    worst point and the worst rounding; the mean error is 10 to 100 times smaller.

    Parameters
    ----------
    kernels : Kernels
        The kernels of the exact sum. For a periodic cell, hand over its images for a cut-off of 1e-12.
    lower, upper : (3,) array_like
        Corners of the box, in the unit of the kernels.
    cutoff : float
        Cut-off of the fast sum.
    blocks : int
        Blocks along an edge of the box: more are slower and give a smaller bound.

    Returns
    -------
    float
        The bound.
    """
    lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    size = (upper - lower) / blocks
    half = float(np.linalg.norm(size)) / 2.0
    index = np.stack(np.meshgrid(*[np.arange(blocks)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    centers = lower + (index + 0.5) * size

    pores = pore_reach(kernels.omega, cutoff)
    tunnels = tunnel_reach(kernels.mu, cutoff, kernels.squared)
    along = kernels.ends - kernels.starts
    length2 = np.einsum("ij,ij->i", along, along)
    inverse = np.divide(1.0, length2, out=np.zeros_like(length2), where=length2 > 0.0)
    # Relative rounding of one kernel: a few units in the last place of coordinates up to length + reach, as exponents.
    exponent = math.log2(1.0 / cutoff)
    pore_rounding = 1e-6 + 1e-6 * exponent
    scale = np.sqrt(kernels.mu * math.log2(math.e)) if kernels.squared else kernels.mu * math.log2(math.e)
    span = scale * np.sqrt(length2) + (math.sqrt(exponent) if kernels.squared else exponent)
    tunnel_rounding = 1e-6 + 1e-6 * (span * math.sqrt(exponent) if kernels.squared else span)

    worst = 0.0
    step = max(1, _PAIRS // max(1, len(pores) + len(tunnels)))
    for first in range(0, len(centers), step):
        chunk = centers[first : first + step, None, :]
        distance = np.linalg.norm(chunk - kernels.centers, axis=2)
        peak = np.exp(-kernels.omega * np.maximum(distance - half, 0.0) ** 2)
        lost = _lost(peak, distance + half > pores, cutoff)
        rounded = (pore_rounding * peak).sum(axis=1)
        total, count = peak.sum(axis=1), (distance - half < pores).sum(axis=1)
        share = np.clip(np.einsum("ijk,jk->ij", chunk - kernels.starts, along) * inverse, 0.0, 1.0)
        distance = np.linalg.norm(chunk - kernels.starts - share[..., None] * along, axis=2)
        nearest = np.maximum(distance - half, 0.0)
        peak = np.exp(-kernels.mu * (nearest * nearest if kernels.squared else nearest))
        lost += _lost(peak, distance + half > tunnels, cutoff)
        rounded += (tunnel_rounding * peak).sum(axis=1)
        total += peak.sum(axis=1)
        count += (distance - half < tunnels).sum(axis=1)
        rounded += total * count * 2.0**-24
        worst = max(worst, float((lost + rounded).max(initial=0.0)))
    return worst


def _lost(peak: NDArray[np.float64], partly: NDArray[np.bool_], cutoff: float) -> NDArray[np.float64]:
    """Most that the kernels lose in each block; the border of the reach is itself rounded."""
    lost: NDArray[np.float64] = np.where(partly, np.minimum(peak, 1.001 * cutoff), 0.0).sum(axis=1)
    return lost
