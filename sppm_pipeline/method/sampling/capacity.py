"""Packing capacity: the mean count at which random sequential addition with a given spacing is saturated.

Balls of diameter l thrown at random fill 0.3841 of space, discs 0.5470 of the plane, rods 0.7476 of the line (the
jamming limits of random sequential addition; Torquato, Uche and Stillinger 2006; Renyi 1958), which makes 0.7336,
0.6966 and 0.7476 centers per l^d. A box that is not periodic holds more centers than its volume says, because no
centers outside press on those inside: each edge counts as longer by 0.64 l. Against measured saturation the formulas
are within 5 % for boxes of 1.5 spacings and more (within 1 % from 4 on); a torus needs 2.5 spacings, below which the
count jumps.

The packing share of a design is count / capacity.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import F64

# centers per l^d at the jamming limits above: 0.7476, 0.5470 / (pi / 4), 0.3841 / (pi / 6)
_JAMMED = {0: 1.0, 1: 0.7476, 2: 0.6966, 3: 0.7336}
# by how much of the spacing an edge counts as longer, fitted to measured saturation
_EDGE = 0.64


def _region_capacity(sides: Sequence[float], spacing: float, periodic: Sequence[bool]) -> float:
    """Capacity of a box of one to three axes; at least 1, since a single pore always fits."""
    if spacing <= 0.0:
        return math.inf
    if spacing > 1.0 and any(periodic):
        return 0.0  # a pore would be nearer than the spacing to its own image
    factors = [
        (min(side + _EDGE * spacing, 1.0) if wraps else side + _EDGE * spacing) / spacing
        for side, wraps in zip(sides, periodic, strict=True)
    ]
    best = 1.0
    # A box much thinner than the spacing holds what its face holds: take the best over all faces and edges.
    for used in itertools.product((False, True), repeat=len(factors)):
        chosen = [factor for factor, use, side in zip(factors, used, sides, strict=True) if use and side > 0.0]
        best = max(best, _JAMMED[len(chosen)] * math.prod(chosen))
    return best


def _as_flags(periodic: bool | Sequence[bool], dimension: int) -> tuple[bool, ...]:
    flags = (periodic,) * dimension if isinstance(periodic, bool) else tuple(bool(flag) for flag in periodic)
    if len(flags) != dimension:
        raise ValueError(f"{dimension} periodic flags are needed, got {len(flags)}")
    return flags


def box_capacity(side: float | Sequence[float], spacing: float, periodic: bool | Sequence[bool] = False) -> float:
    """Mean number of pores of a saturated box, 0.7336 prod((a_i + 0.64 l) / l), for the spacing l of centers.

    The edges a_i, in cell sizes, are those of the box of the centers; zero edges make it a plane or a line. Periodic
    axes have the factor min(a_i + 0.64 l, 1) / l. At least 1, 0 where a pore would be too near its own image, and
    infinite if l is 0.
    """
    sides = (float(side),) * 3 if isinstance(side, int | float) else tuple(float(a) for a in side)
    return _region_capacity(sides, spacing, _as_flags(periodic, 3))


def face_capacity(spacing: float, colors: int = 1, margin: float | None = None) -> float:
    """Mean number of pores of one face pattern when the mirrored patterns of all three axes are saturated together.

    A fit, 0.6966 ((1 - e l) / l)^2, to measured saturation of patterns thrown in turn (`mirrored_faces`): within 6 %
    for spacings l up to 1/3 cell sizes. The loss e grows from 0.46 (one color, no margin) to 0.60, 0.62, 0.66 (2, 3, 8
    colors, margin l/2), because the faces around a cell edge press on each other; past a margin of 0.71 l they no
    longer do. The margin from the border is 0 for one color and l/2 otherwise if omitted.
    """
    # the fit of the docstring: linear to l/2, to 0.71 l, and beyond, where the side is 1 - 2 margin + 0.66 l
    ratio = (0.0 if colors == 1 else 0.5) if margin is None else margin / spacing
    at_half = 0.70 - 0.17 * math.pow(colors, -0.7)  # loss at a margin of l/2
    if ratio <= 0.5:
        loss = 0.46 + (at_half - 0.46) * ratio / 0.5
    elif ratio <= 0.71:
        loss = at_half + (0.76 - at_half) * (ratio - 0.5) / 0.21
    else:
        loss = 2.0 * ratio - 0.66
    width = max(0.0, (1.0 - loss * spacing) / spacing)
    return _JAMMED[2] * width * width


def largest_spacing(count: int, sides: Sequence[float], *, periodic: bool | Sequence[bool] = False) -> float:
    """The spacing at which `count` pores are 100 % of the capacity of a box.

    Parameters
    ----------
    count : int
        Number of pores; positive.
    sides : 1 to 3 floats
        Edges of the box, cell sizes; their number (less the zero ones) is the dimension.
    periodic : bool or one bool an axis
        Axes of period 1.

    Returns
    -------
    float
        Spacing in cell sizes, to a relative 1e-12; never above 1 along a periodic axis, infinite for a single pore.
    """
    if count < 1:
        raise ValueError(f"count must be positive, got {count}")
    flags = _as_flags(periodic, len(sides))
    if count == 1:
        return 1.0 if any(flags) else math.inf
    low, high = 0.0, 1.0 if any(flags) else 2.0 * max(sides) + 1e-300
    # bisection: the capacity is no smooth function of the spacing, but falls with it
    for _ in range(200):
        middle = (low + high) / 2
        if _region_capacity(sides, middle, flags) >= count:
            low = middle
        else:
            high = middle
        if high - low <= 1e-12 * high:
            break
    return low


def check_capacity(
    count: int, spacing: float, sides: Sequence[float], *, periodic: bool | Sequence[bool] = False, what: str = "box"
) -> float:
    """Refuse a count above 100 % of the capacity (rounded up, since the capacity is a mean); return the packing share.

    Raises DesignError, which names the count, the capacity of the `what`, and the largest spacing at which the count
    fits.
    """
    flags = _as_flags(periodic, len(sides))
    capacity = _region_capacity(sides, spacing, flags)
    if count > capacity and count > math.ceil(capacity):
        if capacity == 0.0:
            reason = "a pore would lie closer than that to its own periodic image"
        else:
            reason = f"it holds about {capacity:.1f} at this spacing"
        raise DesignError(
            f"{count} pores with a spacing of {spacing:.6g} do not fit into the {what}: {reason}",
            hint=f"ask for fewer pores, or for a spacing below {largest_spacing(count, sides, periodic=flags):.4g} "
            "(cell sizes), at which this count is 100 % of the capacity",
        )
    return count / capacity if count else 0.0


def nearest_distances(points: ArrayLike, periodic: Sequence[bool] = (True, True, True)) -> F64:
    """Distance of each point to its nearest neighbor, (n,) in cell sizes; infinite for a single point without images.

    Periodic axes have period 1; a point's own images, at distance 1, are neighbors, too.
    """
    from scipy.spatial import cKDTree

    wraps = np.asarray(periodic, np.bool_)
    folded = np.array(points, np.float64).reshape(-1, 3)
    folded = np.where(wraps, folded - np.floor(folded), folded)
    folded[wraps & (folded >= 1.0)] = 0.0  # just below a whole cell the difference rounds to 1
    own_image = 1.0 if wraps.any() else math.inf
    if len(folded) < 2:
        return np.full(len(folded), own_image)
    distances, _ = cKDTree(folded, boxsize=np.where(wraps, 1.0, 0.0)).query(folded, k=2)
    nearest: F64 = np.minimum(distances[:, 1], own_image)
    return nearest


def min_spacing(points: ArrayLike, periodic: Sequence[bool] = (True, True, True)) -> float:
    """Smallest distance of two points, cell sizes; infinite when there is no pair. See `nearest_distances`."""
    distances = nearest_distances(points, periodic)
    return float(distances.min()) if len(distances) else math.inf
