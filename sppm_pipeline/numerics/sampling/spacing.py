"""Distances between pores, measured: nearest neighbors, smallest spacing, pair correlation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.compiled import jit


@jit
def _image_distance2(points: NDArray[np.float64], i: int, j: int, period: NDArray[np.float64]) -> float:
    total = 0.0
    for axis in range(3):
        gap = abs(points[i, axis] - points[j, axis])
        gap = min(gap, abs(period[axis] - gap))
        total += gap * gap
    return total


@jit
def _nearest(points: NDArray[np.float64], period: NDArray[np.float64], start: float) -> NDArray[np.float64]:
    """Squared distance of each point to its nearest neighbor; `points` (n, 3) sorted along the first column."""
    n = points.shape[0]
    nearest = np.empty(n)
    wraps = period[0] == 1.0
    for i in range(n):
        best = start
        for direction in (1, -1):
            j, turn = i, 0.0
            for _ in range(n - 1):
                j += direction
                if j == n or j == -1:
                    if not wraps:
                        break
                    j -= direction * n
                    turn = 1.0
                ahead = (points[j, 0] - points[i, 0]) * direction + turn
                if ahead * ahead >= best:
                    break
                best = min(best, _image_distance2(points, i, j, period))
        nearest[i] = best
    return nearest


@jit
def _pair_histogram(points: NDArray[np.float64], period: NDArray[np.float64], reach: float, bins: int) -> NDArray:
    counts = np.zeros(bins, dtype=np.int64)
    n = points.shape[0]
    for i in range(n):
        for j in range(i):
            distance = np.sqrt(_image_distance2(points, i, j, period))
            if distance < reach:
                counts[min(bins - 1, int(distance / reach * bins))] += 1
    return counts


def _folded(points: ArrayLike, wraps: Sequence[bool]) -> NDArray[np.float64]:
    folded = np.array(points, dtype=np.float64).reshape(-1, 3)
    for axis in range(3):
        if wraps[axis]:
            folded[:, axis] -= np.floor(folded[:, axis])
    return folded


def nearest_distances(points: ArrayLike, periodic: Sequence[bool] = (True, True, True)) -> NDArray[np.float64]:
    """Distance of each point to its nearest neighbor, images included.

    Parameters
    ----------
    points : (n, 3)
        Positions, cell edges.
    periodic : 3 bools
        Axes of period 1; a point's own images, at distance 1, are neighbors, too.

    Returns
    -------
    (n,) float64
        Distances in cell edges, in the order of `points`; infinite for a lone point without images.
    """
    folded = _folded(points, periodic)
    if len(folded) == 0:
        return np.empty(0)
    period = np.where(np.asarray(periodic, dtype=np.bool_), 1.0, np.inf)
    # Neighbors are sought along the axis on which the points are spread widest, outwards until they are too far.
    first = int(np.argmax(np.ptp(folded, axis=0)))
    axes = [first, (first + 1) % 3, (first + 2) % 3]
    order = np.argsort(folded[:, first], kind="stable")
    sorted_points = np.ascontiguousarray(folded[order][:, axes])
    distances = np.empty(len(folded))
    distances[order] = np.sqrt(_nearest(sorted_points, period[axes], float(period.min()) ** 2))
    return distances


def min_spacing(points: ArrayLike, periodic: Sequence[bool] = (True, True, True)) -> float:
    """Smallest distance of two points, cell edges; infinite when there is no pair. See `nearest_distances`."""
    distances = nearest_distances(points, periodic)
    return float(distances.min()) if len(distances) else math.inf


def pair_correlation(
    points: ArrayLike, *, bins: int = 50, reach: float = 0.5
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radially averaged pair correlation g(r) of points in the periodic unit cube; 1 everywhere for random points.

    Parameters
    ----------
    points : (n, 3)
        Positions, cell edges; at least two.
    bins : int
        Number of shells.
    reach : float
        Largest radius, cell edges; at most 1/2, beyond which images enter twice.

    Returns
    -------
    radii : (bins,) float64
        Middle of each shell, cell edges.
    correlation : (bins,) float64
        Pairs found in the shell over pairs expected of independent points.
    """
    folded = _folded(points, (True, True, True))
    if len(folded) < 2 or bins < 1 or not 0.0 < reach <= 0.5:
        raise ValueError("pair_correlation needs two points, one bin and 0 < reach <= 0.5")
    counts = _pair_histogram(folded, np.ones(3), float(reach), int(bins))
    edges = np.linspace(0.0, reach, bins + 1)
    shells = 4.0 / 3.0 * math.pi * np.diff(edges**3)
    pairs = len(folded) * (len(folded) - 1) / 2
    return (edges[1:] + edges[:-1]) / 2, counts / (pairs * shells)
