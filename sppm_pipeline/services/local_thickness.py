"""Local thickness of a phase, from exact squared Euclidean distances between voxels, on a torus or in a box."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F32, I32, I64, U8
from sppm_pipeline.services.jit.compiled import jit

UNREACHED = np.int32(2**30)
"""Stands for no voxel of the other phase at all."""


def squared_distance(phase: U8, periodic: tuple[bool, bool, bool] = (True, True, True)) -> I32:
    """Squared distance of each voxel of a phase (nz, ny, nx) to the nearest voxel outside, in voxels, center to center.

    `periodic` says along x, y, z whether opposite sides are neighbors; otherwise nothing is known to lie beyond a side.
    0 outside the phase; `UNREACHED` everywhere if there is no outside.
    """
    squared = np.where(phase != 0, UNREACHED, np.int32(0))
    # along one axis after the other, the nearest in a plane follows from the nearest in its rows
    for axis, wraps in ((2, periodic[0]), (1, periodic[1]), (0, periodic[2])):
        lines = np.ascontiguousarray(np.moveaxis(squared, axis, 2))
        _along_rows(lines, wraps)
        squared = np.ascontiguousarray(np.moveaxis(lines, 2, axis))
    return squared


@jit
def _along_rows(lines: I32, wraps: bool) -> None:
    """One pass of Saito and Toriwaki (1994): each sample searches outward until nothing nearer can come."""
    nz, ny, n = lines.shape
    best = np.empty(n, np.int32)
    for k in range(nz):
        for j in range(ny):
            row = lines[k, j]
            for i in range(n):
                nearest = row[i]
                step = 1
                while step < n and step * step < nearest:
                    for side in (-step, step):
                        at = i + side
                        if wraps:
                            if at < 0:
                                at += n
                            elif at >= n:
                                at -= n
                        elif at < 0 or at >= n:
                            continue
                        candidate = row[at] + step * step
                        nearest = min(nearest, candidate)
                    step += 1
                best[i] = nearest
            for i in range(n):
                row[i] = best[i]


class LimitSizes(NamedTuple):
    """Volume-weighted distribution of local thickness in the limit of fine grids.

    Attributes
    ----------
    mean, deviation : float
    low, high : float
        At 5 and 95 % of the volume.
    thinnest : float
        At 1 %. The smallest value of all is a corner of the grid, whatever its resolution.
    """

    mean: float
    deviation: float
    low: float
    high: float
    thinnest: float


def limit_sizes(fine: F32, coarse: F32, spacings: tuple[float, float]) -> LimitSizes:
    """Sizes in the limit of fine grids, from the local thickness on two grids.

    Balls on voxel centers are too small by 0.4 (walls) to 1.1 (struts, pores) voxels on average, a multiple of the
    spacing. So the line through the means of both grids gives the mean at spacing 0, and the distribution of the fine
    grid is moved there as a whole.

    Parameters
    ----------
    fine, coarse : array
        Local thickness in voxels, 0 outside the phase, which both hold. Several cells may be joined.
    spacings : (fine, coarse)
        Edges of their voxels, the fine one smaller; the result has their unit.
    """
    small, large = spacings
    sizes = np.sort(fine[fine > 0].astype(np.float64)) * small
    mean = float(sizes.mean())
    shift = (mean - float(coarse[coarse > 0].mean(dtype=np.float64)) * large) * small / (large - small)
    low, high, thinnest = (float(sizes[min(len(sizes) - 1, int(q * len(sizes)))] + shift) for q in (0.05, 0.95, 0.01))
    # struts of one or two voxels may be extrapolated to nothing
    return LimitSizes(mean + shift, float(sizes.std()), max(low, 0.0), high, max(thinnest, 0.0))


class SizeDistribution(NamedTuple):
    """Volume-weighted distribution of local thickness."""

    mean: float
    deviation: float
    smallest: float
    largest: float
    quantiles: tuple[float, float, float]  # at 10, 50 and 90 % of the volume


def local_thickness(phase: U8, periodic: tuple[bool, bool, bool] = (True, True, True)) -> F32:
    """Diameter of the largest ball inside the phase (nz, ny, nx) that covers each voxel, in voxels; 0 outside of it.

    Balls have their centers at voxel centers and reach to half way between the last voxel of the phase and the first
    one outside; so a plate of w voxels has the thickness w where w is odd, w - 1 where it is even. If there is no
    outside, it is the shortest side of the image everywhere. Hildebrand and Rüegsegger 1997, "A new method for the
    model-independent assessment of thickness".
    """
    squared = squared_distance(phase, periodic)
    if squared.size and squared.max() >= UNREACHED:
        return np.full(phase.shape, min(phase.shape), np.float32)
    return painted_balls(squared, periodic)


def painted_balls(squared: I32, periodic: tuple[bool, bool, bool]) -> F32:
    """Diameter of the largest ball that covers each voxel, of balls with squared radii at all voxels; 0 for none."""
    centers = np.flatnonzero(_ridge(squared, np.array(periodic[::-1], np.uint8)))
    # the largest balls first, equal ones in the order of their voxels: each voxel is painted once
    order = np.argsort(-squared.reshape(-1)[centers], kind="stable")
    painted = np.zeros(squared.shape, np.float32)
    _paint(squared, centers[order], np.array(periodic[::-1], np.uint8), painted)
    return painted


def size_distribution(thickness: F32, spacing: float) -> SizeDistribution | None:
    """Moments and quantiles of a local thickness in voxels, times the spacing; None if the phase (above 0) is empty."""
    sizes = np.sort(thickness[thickness > 0].astype(np.float64)) * spacing
    if not len(sizes):
        return None
    low, middle, high = (float(sizes[min(len(sizes) - 1, int(share * len(sizes)))]) for share in (0.1, 0.5, 0.9))
    return SizeDistribution(
        float(sizes.mean()), float(sizes.std()), float(sizes[0]), float(sizes[-1]), (low, middle, high)
    )


@jit
def _ridge(squared: I32, wraps: U8) -> U8:
    """1 at voxels whose ball is not inside that of a neighbor: only those can be the largest somewhere."""
    nz, ny, nx = squared.shape
    ridge = np.zeros((nz, ny, nx), np.uint8)
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                own = squared[k, j, i]
                if own == 0:
                    continue
                inner = 0 < k < nz - 1 and 0 < j < ny - 1 and 0 < i < nx - 1
                covered = False
                for step in range(27):
                    dk, dj, di = step // 9 - 1, step // 3 % 3 - 1, step % 3 - 1
                    z, y, x = k + dk, j + dj, i + di
                    if not inner:
                        if (not wraps[0] and not 0 <= z < nz) or (not wraps[1] and not 0 <= y < ny):
                            continue
                        if not wraps[2] and not 0 <= x < nx:
                            continue
                        z, y, x = z % nz, y % ny, x % nx
                    apart = dk * dk + dj * dj + di * di
                    # sqrt(other) >= sqrt(own) + sqrt(apart), in integers
                    rest = squared[z, y, x] - own - apart
                    if apart > 0 and rest > 0 and np.int64(rest) * rest >= 4 * np.int64(own) * apart:
                        covered = True
                        break
                if not covered:
                    ridge[k, j, i] = 1
    return ridge


@jit
def _paint(squared: I32, centers: I64, wraps: U8, painted: F32) -> None:
    """Give each voxel the diameter of the first ball that covers it.

    Balls hold nothing but the phase. Each voxel knows of a number of voxels from it on in its row that are painted, so
    that what larger balls cover is not visited again.
    """
    nz, ny, nx = squared.shape
    done = np.zeros((nz, ny, nx), np.uint16)
    ends = np.empty((2, 2), np.int64)
    for center in centers:
        k, j, i = center // (ny * nx), center // nx % ny, center % nx
        reach = squared[k, j, i]
        diameter = np.float32(2.0 * np.sqrt(np.float64(reach)) - 1.0)
        radius = int(np.sqrt(np.float64(reach)))
        for dk in range(-min(radius, nz - 1), min(radius, nz - 1) + 1):
            z = k + dk
            if wraps[0]:
                z %= nz
            elif z < 0 or z >= nz:
                continue
            for dj in range(-min(radius, ny - 1), min(radius, ny - 1) + 1):
                left = reach - dk * dk - dj * dj
                if left <= 0:
                    continue
                y = j + dj
                if wraps[1]:
                    y %= ny
                elif y < 0 or y >= ny:
                    continue
                half = int(np.sqrt(np.float64(left - 1)))  # strictly inside: the voxel at the radius is outside
                low, high = i - half, i + half + 1
                # what leaves a row comes in at its other end
                ends[0, 0], ends[0, 1] = max(low, 0), min(high, nx)
                ends[1, 0], ends[1, 1] = 0, 0
                if wraps[2] and low < 0:
                    ends[1, 0], ends[1, 1] = max(low + nx, ends[0, 1]), nx
                elif wraps[2] and high > nx:
                    ends[1, 1] = min(high - nx, low)
                for part in range(2):
                    x, stop = ends[part, 0], ends[part, 1]
                    while x < stop:
                        known = np.int64(done[z, y, x])
                        if known == 0:
                            painted[z, y, x] = diameter
                        done[z, y, x] = min(max(known, stop - x), 65535)
                        x += max(known, 1)
