"""The sum of all kernels without any cut-off, in float64, and how far the fast sum can be from it.

The reference that every faster way is held against.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.method.kernels.kernels import Kernels
from sppm_pipeline.method.kernels.profiles import DEFAULT_CUTOFF, PORE_PROFILE, TUNNEL_PROFILES
from sppm_pipeline.services.metric import matrices

# Points times kernels of one chunk: 2^20 pairs keep the temporary arrays near 50 MB.
_PAIRS = 1 << 20


def exact_sum(kernels: Kernels, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of all kernels at points (k, 3) in their unit, float64 (k,) (paper, eq. 1-3).

    A tunnel of length zero is a point.
    """
    points = np.asarray(points, dtype=np.float64)
    if kernels.pore_metric is not None and kernels.tunnel_metric is not None:
        return _stretched_sum(kernels, points)
    field = np.zeros(len(points))
    step = max(1, _PAIRS // max(1, len(kernels.centers), len(kernels.starts)))
    along, inverse = _directions(kernels)
    for first in range(0, len(points), step):
        chunk = points[first : first + step, None, :]
        from_center = chunk - kernels.centers
        total = np.exp(-kernels.omega * np.einsum("ijk,ijk->ij", from_center, from_center)).sum(axis=1)
        from_start = chunk - kernels.starts
        # the nearest point of each axis, its ends included
        share = np.clip(np.einsum("ijk,jk->ij", from_start, along) * inverse, 0.0, 1.0)
        nearest = from_start - share[..., None] * along
        squared = np.einsum("ijk,ijk->ij", nearest, nearest)
        field[first : first + step] = total + TUNNEL_PROFILES[kernels.profile].value(kernels.mu, squared).sum(axis=1)
    return field


def _stretched_sum(kernels: Kernels, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """`exact_sum` of kernels with metrics, one by one: each is a plain one of the points ``M^(1/2) x``."""
    total = np.zeros(len(points))
    assert kernels.pore_metric is not None
    assert kernels.tunnel_metric is not None
    for number, metric in enumerate(matrices(np.concatenate([kernels.pore_metric, kernels.tunnel_metric]))):
        values, vectors = np.linalg.eigh(metric)
        # the symmetric root: |M^(1/2) x| is the length of x in the metric M
        root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
        pores = slice(number, number + 1) if number < len(kernels.omega) else slice(0)
        tunnels = slice(0) if number < len(kernels.omega) else slice(number - len(kernels.omega), None)
        one = kernels.taken(pores, tunnels)._replace(pore_metric=None, tunnel_metric=None)
        one = one._replace(centers=one.centers @ root, starts=one.starts[:1] @ root, ends=one.ends[:1] @ root)
        total += exact_sum(one._replace(mu=one.mu[:1]), points @ root)
    return total


def _directions(kernels: Kernels) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Vectors (m, 3) along the tunnels and their inverse squared lengths, 0 for a tunnel of length zero."""
    along = kernels.ends - kernels.starts
    squared_length = np.einsum("ij,ij->i", along, along)
    return along, np.divide(1.0, squared_length, out=np.zeros_like(squared_length), where=squared_length > 0.0)


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

    Raises
    ------
    ValueError
        If the kernels have metrics: the bound is one of round kernels.
    """
    if kernels.pore_metric is not None:
        raise ValueError("the cut-off of stretched kernels has no bound here")
    lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    size = (upper - lower) / blocks
    # no point of a block lies further from its center
    half = float(np.linalg.norm(size)) / 2.0
    index = np.stack(np.meshgrid(*[np.arange(blocks)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    centers = lower + (index + 0.5) * size

    profile = TUNNEL_PROFILES[kernels.profile]
    pores = PORE_PROFILE.reach(kernels.omega, cutoff)
    tunnels = profile.reach(kernels.mu, cutoff)
    along, inverse = _directions(kernels)
    # Relative rounding of one kernel: a few units in the last place of coordinates up to length + reach, as exponents.
    exponent = math.log2(1.0 / cutoff)
    pore_rounding = 1e-6 + 1e-6 * exponent
    # An exponent r^power at r <= reach changes by power r^(power - 1) for a change of r.
    reach = profile.scaled_reach(cutoff)
    span = profile.scale(kernels.mu) * np.linalg.norm(along, axis=1) + reach
    tunnel_rounding = 1e-6 + 1e-6 * span * max(1, profile.power / 2) * reach ** (profile.power - 1)

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
        peak = profile.value(kernels.mu, nearest * nearest)
        lost += _lost(peak, distance + half > tunnels, cutoff)
        rounded += (tunnel_rounding * peak).sum(axis=1)
        total += peak.sum(axis=1)
        count += (distance - half < tunnels).sum(axis=1)
        # each addition in float32 rounds by half a unit in the last place of the sum
        rounded += total * count * 2.0**-24
        worst = max(worst, float((lost + rounded).max(initial=0.0)))
    return worst


def _lost(peak: NDArray[np.float64], partly: NDArray[np.bool_], cutoff: float) -> NDArray[np.float64]:
    """Maximum that the kernels lose in each block; the border of the reach is itself rounded."""
    lost: NDArray[np.float64] = np.where(partly, np.minimum(peak, 1.001 * cutoff), 0.0).sum(axis=1)
    return lost
