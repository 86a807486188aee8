"""Hyperuniform points without cells: descent on a pair potential whose Fourier transform covers the long waves.

The energy of points with the pair potential v is a sum of v^(k) S(k) over all waves. The potential here has the
transform ``(1 - (k / K)^2)^2`` up to the wave number K and none beyond, so that its descent lowers the structure factor
of all waves longer than 2 pi / K and of no others, as the collective coordinates of `stealthy` do (Uche, Stillinger and
Torquato 2004). Multiplied by a positive definite function of finite support (Wendland 1995), it reaches a few distances
of points only, and no wave gets a negative weight.

It depends on distances alone: unlike cells that are silenced one by one, no place of a lattice differs from another.
All points move at once, each by the sum over its neighbors in a fixed order, so that the number of threads changes
nothing.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.threads import ordered_map

REACH = 4.0
"""Support of the potential, mean distances of points. With half of it three times as much of S(k) is left at long waves
(measured after 60 steps); with twice of it each step takes eight times as long."""

STEPS, MOMENTUM = 24, 0.7
"""Steps of the descent, and the part of a step that the next one repeats. After 24, S(k) is 0.004 at 2/3 K, where darts
have 0.3. With 60 it is 0.002, but points are evened out at waves beyond K as well, as in a glass: S(k) is 0.3 there
instead of 0.9."""

LONGEST_STEP = 0.1
"""Mean distances of points that one may move in a step: near points, which repel most, would jump past each other."""

APART_STEPS = 500
"""Steps in which points that are left too close are moved apart; up to 60 % of the packing limit none are needed."""

_ENTRIES = 4096  # of a table over the squared distance; the force is then exact to 1e-5
_MARGIN = 1e-3  # soft spheres are so much larger than the spacing, as they lose their force where they touch


class _Potential(NamedTuple):
    """Energy of a pair, and force over distance, at equal steps of the squared distance from 0 to ``reach^2``."""

    energy: F64
    force: F64
    reach: float


def even_out(
    points: F64,
    moves: Bools,
    room: Bools,
    periodic: bool,
    density: float,
    stealth: float,
    spacing: float,
    threads: int = 1,
) -> tuple[F64, float]:
    """Move the points that may (`moves`) until their structure factor is small at long waves.

    Points (n, 3) are in cell sizes from the low corner of the lattice, keep the spacing, and stay in the blocks `room`
    (nx, ny, nz); `density` is their number per block. `stealth` is the number of waves up to K over that of
    coordinates, `stealthy` calls it chi. The result does not depend on the threads.

    Returns the points in the order given, from 0 to the period in a lattice that repeats, and the mean of S(k) weighted
    by the transform of the potential: that of a lattice that repeats, as others lack neighbors at their rim, and NaN if
    nothing moves. Raises DesignError if points can't be moved as far apart as the spacing.
    """
    if not moves.any():
        return points, math.nan
    mean = density ** (-1 / 3)
    # 4/3 pi K^3 / (2 pi)^3 waves for a unit volume, k and -k counted once, are `stealth` of 3 density coordinates
    wave = 2 * np.pi * (9 * stealth * density / (2 * np.pi)) ** (1 / 3)
    potential, integral = _long_waves(wave, REACH * mean)
    soft = _soft_spheres(spacing * (1 + _MARGIN), potential.reach)
    both = _Potential(potential.energy, potential.force + soft.force, potential.reach)
    grid = _Grid(room, periodic, threads)
    rate, longest, velocity = wave**-2, LONGEST_STEP * mean, np.zeros_like(points)
    for _ in range(STEPS):
        _, force = grid.sums(points, both)
        velocity = MOMENTUM * velocity + rate * force
        points = grid.moved(points, _shortened(velocity, longest), moves)
    period = np.array(room.shape, float) if periodic else None
    spheres = _soft_spheres(spacing * (1 + _MARGIN), spacing * (1 + _MARGIN))
    for _ in range(APART_STEPS):
        nearest = cKDTree(points, boxsize=period).query(points, k=2)[0][:, 1]
        if nearest.min() >= spacing:
            break
        _, force = grid.sums(points, spheres)
        points = grid.moved(points, _shortened(spacing**2 / 4 * force, longest), moves)
    else:
        raise DesignError(
            f"pores with a spacing of {spacing:.6g} cell sizes can't be evened out: two stay {nearest.min():.6g} apart",
            hint="give fewer pores or a smaller `spacing`",
        )
    energy, _ = grid.sums(points, potential)
    # the sum of v^(k) S(k) over the waves is v(0) + 2 E / n less the wave without length; here v(0) is 1
    return points, 1 + float(energy[moves].mean()) - density * integral


def _shortened(step: F64, longest: float) -> F64:
    length = np.sqrt((step**2).sum(1, keepdims=True))
    shortened: F64 = step * np.minimum(1.0, longest / np.maximum(length, 1e-300))
    return shortened


def _long_waves(wave: float, reach: float) -> tuple[_Potential, float]:
    """The potential of all waves up to a wave number, 1 at distance 0, and its integral over space."""
    # Gauss's rule: the transform is a polynomial times sin(k r) / (k r), of at most a few periods
    k, weight = np.polynomial.legendre.leggauss(96)
    k, weight = (k + 1) / 2 * wave, weight * wave / 2
    weight = weight * k**2 * (1 - (k / wave) ** 2) ** 2
    squared = np.linspace(0, reach**2, _ENTRIES)
    distance = np.sqrt(squared)
    energy = (np.sinc(np.outer(distance, k) / np.pi) * weight).sum(1) / weight.sum()
    part = distance / reach
    # Wendland's function is positive definite in space: the transform of the product is that of both, convolved
    energy *= (1 - part) ** 4 * (4 * part + 1)
    integral = float(np.trapezoid(4 * np.pi * squared * energy, distance))
    return _Potential(energy, -2 * np.gradient(energy, squared, edge_order=2), reach), integral


def _soft_spheres(diameter: float, reach: float) -> _Potential:
    """``(1 - r / diameter)^2`` of pairs nearer than the diameter."""
    distance = np.sqrt(np.linspace(0, reach**2, _ENTRIES))
    overlap = np.maximum(1 - distance / diameter, 0)
    return _Potential(overlap**2, 2 * overlap / (diameter * np.maximum(distance, 1e-3 * diameter)), reach)


class _Grid:
    """Sums over pairs of points of a lattice, and moves within it."""

    def __init__(self, room: Bools, periodic: bool, threads: int) -> None:
        self._room, self._periodic, self._threads = room, periodic, threads
        self._shape = np.array(room.shape)

    def sums(self, points: F64, potential: _Potential) -> tuple[F64, F64]:
        """For each point the energy of all its pairs, (n,), and the force on it, (n, 3)."""
        # buckets of half the reach or more, and not many more of them than points
        parts = max(1, min(int(2 / potential.reach), int(2 * (len(points) / self._room.size) ** (1 / 3))))
        buckets = self._shape * parts
        at = np.minimum((points * parts).astype(np.int64), buckets - 1)
        bucket = (at[:, 0] * buckets[1] + at[:, 1]) * buckets[2] + at[:, 2]
        # the order of a sum is that of buckets and of the points given, whatever the threads
        order = np.argsort(bucket, kind="stable")
        first = np.concatenate([[0], np.cumsum(np.bincount(bucket, minlength=int(buckets.prod())))])
        energy, force = np.empty(len(points)), np.empty((len(points), 3))
        sorted_points = points[order]

        def add(some: tuple[int, int]) -> None:
            _pair_sums(
                sorted_points, first, buckets, float(parts), self._periodic, *potential, order, *some, energy, force
            )

        ends = np.linspace(0, len(points), min(4 * self._threads, 64) + 1).astype(int).tolist()
        for _ in ordered_map(add, itertools.pairwise(ends), self._threads):
            pass
        return energy, force

    def moved(self, points: F64, step: F64, moves: Bools) -> F64:
        """Points after a step, those that would leave the room where they were."""
        target = points + step
        if self._periodic:
            target = target % self._shape % self._shape  # -1e-17 % 1.0 is 1.0
            return np.where(moves[:, None], target, points)
        block = np.floor(target).astype(np.int64)
        inside = moves & ((block >= 0) & (block < self._shape)).all(1)
        inside[inside] = self._room[tuple(block[inside].T)]
        return np.where(inside[:, None], target, points)


@jit
def _pair_sums(
    points: F64,
    first: I64,
    buckets: I64,
    parts: float,
    periodic: bool,
    energies: F64,
    forces: F64,
    reach: float,
    order: I64,
    start: int,
    stop: int,
    energy: F64,
    force: F64,
) -> None:
    """Sums for the points ``start`` to ``stop`` of those sorted by bucket, to the places given by `order`."""
    around = int(np.ceil(reach * parts))
    squared_reach = reach * reach
    entries = (energies.shape[0] - 1) / squared_reach
    for i in range(start, stop):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        bx = min(int(x * parts), buckets[0] - 1)
        by = min(int(y * parts), buckets[1] - 1)
        bz = min(int(z * parts), buckets[2] - 1)
        fx = fy = fz = total = 0.0
        # in a lattice that repeats the search may pass its end, also several times: those are the images
        for p in range(bx - around, bx + around + 1):
            if not periodic and (p < 0 or p >= buckets[0]):
                continue
            turn_x = p // buckets[0]
            for q in range(by - around, by + around + 1):
                if not periodic and (q < 0 or q >= buckets[1]):
                    continue
                turn_y = q // buckets[1]
                row = ((p - turn_x * buckets[0]) * buckets[1] + q - turn_y * buckets[1]) * buckets[2]
                for r in range(bz - around, bz + around + 1):
                    if not periodic and (r < 0 or r >= buckets[2]):
                        continue
                    turn_z = r // buckets[2]
                    bucket = row + r - turn_z * buckets[2]
                    sx = x - turn_x * buckets[0] / parts
                    sy = y - turn_y * buckets[1] / parts
                    sz = z - turn_z * buckets[2] / parts
                    for j in range(first[bucket], first[bucket + 1]):
                        dx, dy, dz = sx - points[j, 0], sy - points[j, 1], sz - points[j, 2]
                        squared = dx * dx + dy * dy + dz * dz
                        if squared >= squared_reach or squared == 0.0:
                            continue
                        place = squared * entries
                        k = min(int(place), energies.shape[0] - 2)
                        part = place - k
                        scale = forces[k] + part * (forces[k + 1] - forces[k])
                        fx += scale * dx
                        fy += scale * dy
                        fz += scale * dz
                        total += energies[k] + part * (energies[k + 1] - energies[k])
        energy[order[i]] = total
        force[order[i], 0], force[order[i], 1], force[order[i], 2] = fx, fy, fz


def near_the_rim(points: F64, room: Bools, width: float) -> Bools:
    """Which points have a block that is not there within about `width`, at most a block."""
    padded = np.pad(room, 1)
    found = np.zeros(len(points), np.bool_)
    for direction in np.ndindex(3, 3, 3):
        block = np.floor(points + min(width, 1.0) * (np.array(direction) - 1.0)).astype(np.int64) + 1
        found |= ~padded[tuple(block.T)]
    return found
