"""Dart throwing: pores with a smallest spacing, in a box or in a plane, periodic or not (paper, section 2.1).

A pore is thrown uniformly; if it lies too near one that was thrown before, it is discarded and thrown again. Up to 75 %
of the capacity this is done as it is said. From there on, and whenever plain darts find no room, the active-voxel
sampler goes on: it draws from the same distribution, and it knows when no free spot is left. So a count that can't be
reached is an answer, not an endless loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.active_voxels import fill_active_voxels, throw_darts
from sppm_pipeline.method.sampling.capacity import box_capacity, check_capacity
from sppm_pipeline.method.sampling.cell_list import add_points, empty_cell_list, new_stream
from sppm_pipeline.services.arrays import F64, U64

# Fraction of the capacity up to which plain darts are cheaper than keeping a list of voxels (some 20 darts a pore).
NAIVE_SHARE = 0.75
# Darts a pore after which plain darts are given up even below that fraction: obstacles have taken the space.
NAIVE_BUDGET = 60
# The voxel list of more points than this takes gigabytes, and no cell needs them.
_MAX_POINTS = 5_000_000
_PORE, _OBSTACLE = 0, -1


def throw(
    rng: np.random.Generator | U64,
    count: int | None,
    spacing: float,
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    periodic: Sequence[bool] = (False, False, False),
    obstacles: ArrayLike | None = None,
    obstacle_images: bool = True,
    share: float | None = None,
    attempts: int = 20,
) -> F64:
    """Throw pores that keep `spacing` from each other and from the obstacles.

    Parameters
    ----------
    rng : numpy.random.Generator or (1,) uint64
        Source of randomness, from which one 64-bit number is drawn; or that number, in an array that is written to.
    count : int or None
        Exact number of pores; None to fill up to `share`.
    spacing : float
        Smallest distance of two pores, cell sizes. 0 throws independent points.
    lower, upper : (3,)
        Corners of the box of centers, cell sizes. Equal coordinates along an axis give points in a plane (or line).
    periodic : 3 bools
        Axes along which everything, obstacles included, repeats with period 1; the box is at most 1 long there.
    obstacles : (k, 3), optional
        Points to keep `spacing` from. They need not keep it among themselves.
    obstacle_images : bool
        Whether the obstacles repeat with period 1 along the axes that are not periodic, too: True for mirrored face
        pores listed once, False when the list is complete as it stands (opposite faces of different colors).
    share : float, optional
        With ``count=None``: the packing share in (0, 1]. Below 1 the count is the share of the capacity of the empty
        box, rounded down; 1 fills until no free spot is left.
    attempts : int
        How often the box is thrown again when it was full before the count was reached.

    Returns
    -------
    (count, 3) float64
        Positions in order of throwing, cell sizes.

    Raises
    ------
    DesignError
        When the count is above the capacity, or was reached in none of the attempts; the best count is named.
    """
    low = np.ascontiguousarray(lower, dtype=np.float64)
    side = np.asarray(upper, dtype=np.float64) - low
    wraps = tuple(bool(flag) for flag in periodic)
    if low.shape != (3,) or side.shape != (3,) or len(wraps) != 3:
        raise ValueError("lower, upper and periodic have three entries each")
    if not np.all(np.isfinite(side)) or np.any(side < 0.0) or np.any(side[np.array(wraps)] > 1.0):
        raise ValueError(f"a box needs 0 <= upper - lower (<= 1 along periodic axes), got {side.tolist()}")
    if (count is None) == (share is None):
        raise ValueError("give either a count or a share")
    wanted, rows, capacity = wanted_pores(count, share, spacing, side, wraps)
    if wanted == 0:
        return np.empty((0, 3))
    around = obstacles_around(obstacles, low, side, spacing, wraps, obstacle_images)

    stream = new_stream(rng) if isinstance(rng, np.random.Generator) else rng
    # plain darts first: each pore costs a few at this packing, and no list of voxels has to be made
    naive = int(min(wanted, NAIVE_SHARE * capacity))
    best = throws = 0
    while throws < max(1, attempts):
        throws += 1
        cells = empty_cell_list(rows + len(around), spacing, low, low + side, wraps)
        add_points(cells, around, _OBSTACLE, 0)
        placed = int(throw_darts(cells, stream, low, side, naive, NAIVE_BUDGET * naive + 1000, _PORE, 0))
        if placed < wanted:
            placed += int(fill_active_voxels(cells, stream, low, side, wanted - placed, _PORE, 0))
        # a filled box is full when no voxel is left, whatever the count
        if placed == wanted or share == 1.0:
            return cells.points[len(around) : len(around) + placed].copy()
        best = max(best, placed)
        # The saturated count varies by 0.3 sqrt(n): five times that is out of reach for any number of attempts.
        if wanted - best > 1.5 * math.sqrt(wanted):
            break
    dimension = max(1, int(np.count_nonzero(side)))
    near = spacing * (max(best, 1) / wanted) ** (1.0 / dimension)
    raise DesignError(
        f"only {best} of {wanted} pores fit with a spacing of {spacing:.6g} ({wanted / capacity:.0%} of the capacity "
        f"of the empty box, {throws} throws, each until no free spot was left)",
        hint=f"ask for at most {best} pores, or for a spacing of about {0.98 * near:.4g} (cell sizes)",
    )


def wanted_pores(
    count: int | None, share: float | None, spacing: float, side: F64, wraps: Sequence[bool]
) -> tuple[int, int, float]:
    """Number of pores to throw, the number of rows that certainly holds them, and the capacity of the box.

    Raises DesignError if the spacing or the share is out of range, or the count above the capacity.
    """
    if not 0.0 <= spacing < math.inf:
        raise DesignError(f"the pore spacing must be a number >= 0, got {spacing}")
    capacity = box_capacity(side.tolist(), spacing, wraps)
    # No packing of equal balls is denser than pi / sqrt(18), which bounds any set of centers with this spacing.
    bound = math.inf if spacing == 0.0 else 1 + math.sqrt(2.0) * math.prod((side / spacing + 1.0).tolist())
    if count is not None:
        if count < 0:
            raise DesignError(f"the number of pores must be >= 0, got {count}")
        check_capacity(count, spacing, side.tolist(), periodic=wraps)
        wanted, rows = count, float(count)
    else:
        assert share is not None
        if not 0.0 < share <= 1.0:
            raise DesignError(f"the packing share must lie in (0, 1], got {share}")
        if spacing == 0.0:
            raise DesignError("a packing share needs a spacing above 0", hint="give the number of pores instead")
        check_capacity(1, spacing, side.tolist(), periodic=wraps)
        rows = bound if share == 1.0 else max(1.0, math.floor(share * capacity))
        wanted = int(rows) if rows <= _MAX_POINTS else 0
    if rows > _MAX_POINTS:
        raise DesignError(
            f"a spacing of {spacing:.6g} asks for up to {rows:.3g} pores; at most {_MAX_POINTS} are thrown at once",
            hint="choose a larger spacing or fewer pores",
        )
    return wanted, int(rows), capacity


def obstacles_around(
    obstacles: ArrayLike | None, lower: F64, side: F64, spacing: float, wraps: Sequence[bool], images: bool
) -> F64:
    """Obstacles (m, 3) that can matter to the box: folded along periodic axes, repeated along others where asked."""
    if obstacles is None:
        return np.empty((0, 3))
    points = np.array(obstacles, dtype=np.float64).reshape(-1, 3)
    for axis in range(3):
        start, stop = lower[axis] - spacing, lower[axis] + side[axis] + spacing
        if wraps[axis]:
            points[:, axis] -= np.floor(points[:, axis] - lower[axis])
            continue
        if images:
            points[:, axis] -= np.floor(points[:, axis] - start)
            shifts = np.zeros((math.floor(stop - start) + 1, 1, 3))
            shifts[:, 0, axis] = np.arange(len(shifts))
            points = (points[None] + shifts).reshape(-1, 3)
        points = points[(points[:, axis] >= start - 1e-9) & (points[:, axis] <= stop + 1e-9)]
    return np.ascontiguousarray(points)
