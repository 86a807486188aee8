"""The level that gives a wished porosity: a quantile of the field.

Porosity is the share of samples where the kernel sum G reaches the level C, so the C that gives a porosity is an order
statistic of G. Changing C changes the radii of pores and tunnels a little; `radius_scale` says by how much.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError


class LevelFit(NamedTuple):
    """A level and what it gives.

    Attributes
    ----------
    level : float
        C; representable in the type of the samples.
    porosity : float
        Share of the samples with G >= C, counted. Differs from the wish by at most half a sample, unless many samples
        share one value.
    """

    level: float
    porosity: float


def level_for_porosity(samples: NDArray[np.float32] | NDArray[np.float64], target: float) -> LevelFit:
    """The level at which a wished share of the samples is void (G >= C).

    Parameters
    ----------
    samples : array of any shape, float32 or float64
        The kernel sum G (not G - C) at points of equal weight, such as the voxel centers of a periodic cell.
    target : float
        Wished porosity, between 0 and 1, both excluded.

    Returns
    -------
    LevelFit
        The level lies halfway between two neighboring sample values, so that rounding does not flip a voxel.

    Raises
    ------
    DesignError
        If the target is not in (0, 1), or if no positive level reaches it (the rest of the samples is beyond the reach
        of every kernel).
    ValueError
        If there are no samples, or one is not finite.
    """
    found = cut_for_porosity(samples, target)
    if found.level <= 0.0:
        reach = np.count_nonzero(samples > 0) / samples.size
        raise DesignError(
            f"a porosity of {target:g} would need a level of {found.level:g}; positive levels reach up to {reach:.4g}",
            hint="add pores, make them larger, or lower the cut-off of the kernels",
        )
    return found


def cut_for_porosity(samples: NDArray[np.float32] | NDArray[np.float64], target: float) -> LevelFit:
    """The value, of any sign, at which to cut any field for a wished share of void; see `level_for_porosity`."""
    if not 0.0 < target < 1.0:
        raise DesignError(f"a porosity of {target} can't be reached by a level", hint="give a value between 0 and 1")
    flat: NDArray[Any] = np.array(samples, copy=True).ravel()
    if flat.size == 0 or not np.isfinite(flat).all():
        raise ValueError("the samples of a field are finite, and there is at least one")
    solid = flat.size - max(1, min(flat.size - 1, round(target * flat.size))) if flat.size > 1 else 0
    if solid == 0:
        low = high = flat.min()
    else:
        flat.partition((solid - 1, solid))
        low, high = flat[solid - 1], flat[solid]
    level = low + (high - low) / 2
    if level <= low:  # neighboring numbers, or equal ones
        level = high
    return LevelFit(float(level), np.count_nonzero(flat >= level) / flat.size)


def radius_scale(level: float, nominal: float, power: int = 2) -> float:
    """By what factor a lone kernel's radius changes when the level does.

    A kernel exp(-omega r^2) meets the level C at r = sqrt(ln(1/C) / omega), a tunnel exp(-mu r) at ln(1/C) / mu. Near a
    porosity of one half, one point of porosity costs about 1 % of the pore radius.

    Parameters
    ----------
    level : float
        The new level, positive.
    nominal : float
        The level for which the radius was meant, in (0, 1).
    power : {1, 2}
        Power of the distance in the exponent: 2 for pores and squared tunnels, 1 for tunnels as the paper prints them.

    Returns
    -------
    float
        New radius over nominal radius; 0 from level 1 on, where a lone kernel makes no void.

    Raises
    ------
    ValueError
        If an argument is out of its range.
    """
    if not level > 0.0 or not 0.0 < nominal < 1.0 or power not in (1, 2):
        raise ValueError(f"no radius for level {level}, nominal level {nominal}, power {power}")
    ratio = max(0.0, math.log(1.0 / level)) / math.log(1.0 / nominal)
    return math.sqrt(ratio) if power == 2 else ratio
