"""The structure factor of periodic points, and points that have none at long waves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import DesignError


def wave_vectors(count: int, share: float) -> NDArray[np.float64]:
    """The longest waves that fit the periodic unit cube, in complete shells of equal wave length.

    Parameters
    ----------
    count : int
        Number of points.
    share : float
        How many of the ``3 (count - 1)`` degrees of freedom the waves may bind; chi in the literature.

    Returns
    -------
    (m, 3) float64
        Integer numbers of waves along x, y, z; of each pair k and -k one, in order of falling wave length.
    """
    allowed = int(share * 3 * (count - 1))
    reach = int(np.ceil((allowed / 2) ** (1 / 3))) + 2
    k = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    k = k[len(k) // 2 + 1 :]  # the middle row is zero; the rows before it are the negatives of those after it
    length2 = (k**2).sum(1)
    order = np.argsort(length2, kind="stable")
    whole_shells = np.searchsorted(length2[order], length2[order[allowed]])
    return k[order[:whole_shells]].astype(np.float64)


def _phases(points: NDArray[np.float64], waves: NDArray[np.float64]) -> NDArray[np.complex128]:
    # no matrix product: what BLAS returns depends on the number of threads
    angle = sum(points[:, None, a] * waves[None, :, a] for a in range(3))
    return np.exp(2j * np.pi * np.asarray(angle))


def structure_factor(points: NDArray[np.float64], waves: NDArray[np.float64]) -> NDArray[np.float64]:
    """S(k) = |sum_j exp(2 pi i k r_j)|^2 / n, about 1 for independent points; (m,) for points (n, 3), waves (m, 3)."""
    density = _phases(points, waves).sum(0)
    return np.asarray(np.abs(density) ** 2 / len(points), np.float64)


def stealthy(
    points: NDArray[np.float64], waves: NDArray[np.float64], *, tolerance: float, steps: int
) -> NDArray[np.float64]:
    """Move periodic points until S(k) is at most `tolerance` at all `waves`.

    Goes down the slope of the sum of S(k) (collective coordinates: Uche, Stillinger and Torquato 2004) with the step
    lengths of Barzilai and Borwein 1988.

    Parameters
    ----------
    points : (n, 3) float64
        Where to start, cell sizes.
    waves : (m, 3) float64
    tolerance : float
    steps : int
        When to give up.

    Returns
    -------
    (n, 3) float64
        In [0, 1).

    Raises
    ------
    DesignError
        If the steps are used up.
    """
    n = len(points)
    longest = 0.2 * n ** (-1 / 3)
    moved = np.zeros_like(points)
    last_slope = np.zeros_like(points)
    for _ in range(steps):
        phases = _phases(points, waves)
        density = phases.sum(0)
        if float((np.abs(density) ** 2).max()) <= tolerance * n:
            return points % 1.0 % 1.0  # -1e-17 % 1.0 is 1.0
        slope = -4 * np.pi / n * np.einsum("nm,md->nd", (density.conj() * phases).imag, waves)
        bend = float((moved * (slope - last_slope)).sum())
        steepest = float(np.abs(slope).max())
        step = float((moved**2).sum()) / abs(bend) if bend else longest / steepest
        moved = -min(step, longest / steepest) * slope
        last_slope = slope
        points = points + moved
    raise DesignError(
        f"after {steps} steps the largest structure factor is {float((np.abs(density) ** 2).max()) / n:.2g}, "
        f"the target is {tolerance:g}",
        hint="bind fewer degrees of freedom with a smaller `stealth`, or give another seed",
    )
