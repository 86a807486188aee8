"""Stealthy hyperuniform points: moved until no wave longer than a limit sees them (collective coordinates).

The sum of S(k) over all waves up to a radius K in reciprocal space is minimized from independent points. It is a sum of
squares, so a minimum of zero is a proof: every S(k) vanishes (Uche, Stillinger and Torquato 2004, "Constraints on
collective density variables"). A soft repulsion may be added that vanishes beyond a distance; as both terms are at
least zero, a sum of zero proves both promises (Zhang, Stillinger and Torquato 2017 study such ground states).

M waves, k and -k counted once, are 2 M real conditions on 3 (n - 1) coordinates that matter. The share
``chi = M / (3 (n - 1))`` is called stealthiness; at 1/2 there are as many conditions as coordinates, and beyond, the
points would crystallize.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.structure_factor import (
    Waves,
    add_density,
    collective_density,
    longest_waves,
    plane_waves,
)
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import inline_jit, jit

TOLERANCE = 1e-12
"""Structure factor that counts as none: some thousand roundings of a sum of a hundred pores."""

_STEPS, _STARTS = 5000, 30
_STUCK = 1e-5
"""Slope along the step over energy, below which a minimum above zero is near; on the way to zero it is about 2."""
_MEMORY = 20
# added to spacing and walls, so that they are kept although `TOLERANCE` leaves a trace of the soft repulsion
_MARGIN = 3e-6


class Surroundings(NamedTuple):
    """Box that points are moved in, and the points that do not move."""

    lower: F64  # (3,) corners of the box that points are kept in; not looked at in a periodic cell
    upper: F64
    periodic: bool  # the box is the whole cell
    fixed: F64  # (m, 3) points on the faces, seen by the waves, once for the whole cell
    weight: F64  # (m,) share of the cells that they stand in
    obstacles: F64  # (k, 3) points that the spacing is kept from, images included


FREE = Surroundings(np.zeros(3), np.ones(3), True, np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
"""An empty periodic cell."""


def stealthy_waves(count: int, stealth: float) -> Waves:
    """The waves that `count` points are hidden from: the longest, in whole shells, at most ``3 (count - 1) stealth``.

    Raises DesignError if that is less than the first shell.
    """
    waves = longest_waves(int(stealth * 3 * max(count - 1, 0)))
    if not waves.number:
        raise DesignError(
            f"{count} pores with a stealth of {stealth:g} are hidden from no wave at all",
            hint=f"at least {int(np.ceil(1 / stealth)) + 1} pores are needed",
        )
    return waves


def throw_stealthy(
    rng: np.random.Generator, count: int, waves: Waves, spacing: float = 0.0, around: Surroundings = FREE
) -> F64:
    """`count` points, (count, 3) in cell sizes, that are hidden from `waves` and keep a spacing, 0 for none.

    Descends from independent points drawn by `rng`; in a periodic cell the result lies in [0, 1). Raises DesignError if
    no start leads to such points.
    """
    seen = count + float(around.weight.sum())
    sheet = max((float(around.weight[around.fixed[:, a] == 0].sum()) for a in range(3)), default=0.0)
    straight = int(waves.radius)
    # the bound is that of the Fejer kernel
    if sheet * (straight + 1) > seen:
        # points whose first K waves across a plane vanish have at most 1 / (K + 1) of their number in that plane
        raise DesignError(
            f"{sheet:.4g} of {seen:.4g} pores lie on one face: {straight} waves across it can't be silenced",
            hint="give a smaller `stealth`, or a smaller share of the pores to the faces",
        )
    landscape = _Landscape(count, waves, spacing * (1 + _MARGIN), around, seen)
    for _ in range(_STARTS):
        # independent points: the minimum that is found then has no trace of another order
        start = around.lower + rng.random((count, 3)) * (around.upper - around.lower)
        points, loudest = _descended(landscape, start)
        if loudest <= TOLERANCE:
            return points % 1.0 % 1.0 if around.periodic else points  # -1e-17 % 1.0 is 1.0
    apart = f", {spacing:.4g} apart" if spacing else ""
    raise DesignError(
        f"{count} pores{apart}, can't be hidden from {2 * waves.number} waves: after the last of {_STARTS} starts a "
        f"structure factor or overlap of {loudest:.2g} is left, allowed is {TOLERANCE:g}",
        hint="give a smaller `stealth`" + (" or a smaller `spacing`" if spacing else "") + ", or another seed",
    )


class _Landscape:
    """The energy of points: sum of S(k), overlaps of the soft spheres, and depths beyond the walls of the box."""

    def __init__(self, count: int, waves: Waves, spacing: float, around: Surroundings, seen: float) -> None:
        self._waves, self._spacing, self._around, self._seen = waves, spacing, around, seen
        self._waves_of = np.empty((2, count, 3, 2 * waves.reach + 1))
        self._weight = np.ones(count)
        self._lower, self._upper = around.lower + _MARGIN, around.upper - _MARGIN
        self._background = collective_density(around.fixed, waves, around.weight)
        self.longest_step = 0.2 * count ** (-1 / 3)

    def __call__(self, points: F64) -> tuple[float, F64, float]:
        """Energy, its gradient, and the largest of its terms."""
        waves, around = self._waves, self._around
        real, imag = self._waves_of
        plane_waves(points, waves.reach, real, imag)
        density = self._background.copy()
        add_density(real, imag, self._weight, waves.columns, waves.reach, density)
        factor = (density**2).sum(0) / self._seen
        gradient = np.zeros_like(points)
        _add_gradient(real, imag, waves.columns, waves.reach, density, 4 * np.pi / self._seen, gradient)
        energy, largest = float(factor.sum()), float(factor.max())
        if self._spacing > 0:
            overlaps = np.zeros(2)
            _repel(points, around.obstacles, around.periodic, self._spacing, overlaps, gradient)
            energy, largest = energy + overlaps[0], max(largest, overlaps[1])
        if not around.periodic:
            depth = np.maximum(self._lower - points, 0) - np.maximum(points - self._upper, 0)
            energy, largest = energy + float((depth**2).sum()), max(largest, float((depth**2).max()))
            gradient -= 2 * depth
        return energy, gradient, largest


@inline_jit
def _add_gradient(real: F64, imag: F64, columns: I64, reach: int, density: F64, scale: float, gradient: F64) -> None:
    """Add the derivative of ``sum |density|^2`` by each point, times `scale` / 4 pi, to `gradient` (n, 3)."""
    for j in range(len(real)):
        gx = gy = gz = 0.0
        for c in range(len(columns)):
            a, b = columns[c, 0] + reach, columns[c, 1] + reach
            xy = real[j, 0, a] * real[j, 1, b] - imag[j, 0, a] * imag[j, 1, b]
            xy_imag = real[j, 0, a] * imag[j, 1, b] + imag[j, 0, a] * real[j, 1, b]
            first, size, before = columns[c, 2], columns[c, 3] - columns[c, 2] + 1, columns[c, 4]
            low = first + reach
            z, z_imag = real[j, 2, low : low + size], imag[j, 2, low : low + size]
            sums, sums_imag = density[0, before : before + size], density[1, before : before + size]
            level = slope = 0.0
            for k in range(size):
                turned = sums[k] * (xy * z_imag[k] + xy_imag * z[k]) - sums_imag[k] * (xy * z[k] - xy_imag * z_imag[k])
                level += turned
                slope += turned * (first + k)
            gx += level * columns[c, 0]
            gy += level * columns[c, 1]
            gz += slope
        gradient[j, 0] -= scale * gx
        gradient[j, 1] -= scale * gy
        gradient[j, 2] -= scale * gz


@jit
def _repel(points: F64, obstacles: F64, periodic: bool, spacing: float, overlaps: F64, gradient: F64) -> None:
    """Soft spheres, (1 - d / spacing)^2 for each pair nearer than the spacing: sum and largest, and the gradient."""
    gap = np.empty(3)
    count = len(points)
    for i in range(count):
        for j in range(i + len(obstacles)):
            squared = 0.0
            for axis in range(3):
                other = points[j, axis] if j < i else obstacles[j - i, axis]
                gap[axis] = points[i, axis] - other
                if periodic:
                    gap[axis] -= np.rint(gap[axis])
                squared += gap[axis] * gap[axis]
            if squared >= spacing * spacing:
                continue
            distance = max(np.sqrt(squared), 1e-12 * spacing)
            overlap = 1.0 - distance / spacing
            overlaps[0] += overlap * overlap
            overlaps[1] = max(overlaps[1], overlap * overlap)
            force = 2.0 * overlap / (spacing * distance)
            for axis in range(3):
                gradient[i, axis] -= force * gap[axis]
                if j < i:
                    gradient[j, axis] += force * gap[axis]


def _descended(landscape: _Landscape, points: F64) -> tuple[F64, float]:
    """Down to a minimum by limited-memory BFGS (Nocedal 1980); the points and the largest term left.

    Written out because sums must not depend on the number of threads, as those of BLAS do.
    """
    energy, gradient, largest = landscape(points)
    moves: list[tuple[F64, F64, float]] = []
    for _ in range(_STEPS):
        if largest <= TOLERANCE:
            break
        direction = -_bfgs_direction(gradient, moves)
        slope = _dot(direction, gradient)
        if slope >= 0:
            moves.clear()
            direction, slope = -gradient, -_dot(gradient, gradient)
        if moves and slope > -_STUCK * energy:
            break
        longest = landscape.longest_step / max(float(np.abs(direction).max()), 1e-300)
        step = min(1.0, longest) if moves else longest
        while True:
            trial = points + step * direction
            after = landscape(trial)
            if after[0] <= energy + 1e-4 * step * slope:
                break
            step /= 2
            if step < 1e-12:  # the energy is at its rounding
                return points, largest
        moved, bent = trial - points, after[1] - gradient
        curvature = _dot(moved, bent)
        # only pairs of positive curvature keep the inverse Hessian positive definite
        if curvature > 1e-12 * _dot(moved, moved):
            moves.append((moved, bent, curvature))
            del moves[:-_MEMORY]
        points, (energy, gradient, largest) = trial, after
    return points, largest


def _bfgs_direction(gradient: F64, moves: list[tuple[F64, F64, float]]) -> F64:
    """The gradient times the inverse Hessian that the last moves suggest (two-loop recursion)."""
    result = gradient.copy()
    weights = []
    for moved, bent, curvature in reversed(moves):
        weights.append(_dot(moved, result) / curvature)
        result -= weights[-1] * bent
    if moves:
        _, bent, curvature = moves[-1]
        result *= curvature / _dot(bent, bent)
    for (moved, bent, curvature), weight in zip(moves, reversed(weights), strict=True):
        result += (weight - _dot(bent, result) / curvature) * moved
    return result


def _dot(a: F64, b: F64) -> float:
    """Without BLAS, whose sums depend on the number of threads."""
    return float((a * b).sum())
