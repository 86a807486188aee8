"""Find what gives a target porosity: the level as a quantile of the field, or any other argument by a search.

Porosity is the fraction of samples where the kernel sum G reaches the level C, so the C that gives a porosity is an
order statistic of G. The search is meant for the gap d between faces and interior (paper, section 2.3), where each
evaluation draws and measures a whole microstructure. Porosity falls with d only on the branch d >= l; below it is not
monotone, so the caller's interval has to start at l.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import F32, F64


class LevelFit(NamedTuple):
    """A level and the porosity it gives."""

    level: float  # C; representable in the type of the samples
    porosity: float  # share of the samples with G >= C; off by at most half a sample, unless many are equal


def level_for_porosity(samples: F32 | F64, target: float) -> LevelFit:
    """Level at which a fraction of samples of the kernel sum G (not G - C), of equal weight, is void (G >= C).

    It lies halfway between two neighboring sample values, so that rounding does not flip a voxel. A DesignError says
    that no positive level reaches the target, as the rest of the samples is beyond the reach of every kernel.
    """
    found = cut_for_porosity(samples, target)
    if found.level <= 0.0:
        reach = np.count_nonzero(samples > 0) / samples.size
        raise DesignError(
            f"a porosity of {target:g} would need a level of {found.level:g}; positive levels reach up to {reach:.4g}",
            hint="add pores, make them larger, or lower the cut-off of the kernels",
        )
    return found


def cut_for_porosity(samples: F32 | F64, target: float) -> LevelFit:
    """The value, of any sign, at which to cut any field for a requested fraction of void; see `level_for_porosity`."""
    if not 0.0 < target < 1.0:
        raise DesignError(f"a porosity of {target} can't be reached by a level", hint="give a value between 0 and 1")
    flat: NDArray[Any] = np.array(samples, copy=True).ravel("K")
    if flat.size == 0 or not np.isfinite(flat).all():
        raise ValueError("the samples of a field are finite, and there is at least one")
    solid = flat.size - max(1, min(flat.size - 1, round(target * flat.size))) if flat.size > 1 else 0
    if solid == 0:
        low = high = flat.min()
    else:
        # a selection, not a sort: linear in the number of samples
        flat.partition((solid - 1, solid))
        low, high = flat[solid - 1], flat[solid]
    level = low + (high - low) / 2
    if level <= low:  # neighboring numbers, or equal ones
        level = high
    return LevelFit(float(level), np.count_nonzero(flat >= level) / flat.size)


class SearchResult(NamedTuple):
    """The best argument found by `search_monotone`."""

    x: float
    value: float
    met: bool  # the value is within the tolerance of the target
    bracketed: bool  # the values at the ends of the interval lie on both sides of the target, or on it
    evaluations: int


def search_monotone(
    function: Callable[[float], float],
    low: float,
    high: float,
    target: float,
    tolerance: float,
    max_evaluations: int = 20,
) -> SearchResult:
    """Find x in [low, high] with |function(x) - target| <= tolerance, for a repeatable function.

    Regula falsi with the Illinois weights, guarded by bisection whenever two steps did not halve the bracket. So a
    smooth function takes a handful of evaluations, and a staircase (a porosity counted in voxels) no more than three
    times those of bisection. A function that is not monotone costs the guarantee, not the result: the best x that was
    met is returned. If the target is not bracketed, that is the better end, after two evaluations.
    """
    x_a, x_b = low, high
    excess_a = function(x_a) - target
    best_x, best_excess = x_a, excess_a
    if abs(excess_a) <= tolerance:
        return SearchResult(x_a, target + excess_a, True, True, 1)
    excess_b = function(x_b) - target
    evaluations = 2
    if abs(excess_b) < abs(best_excess):
        best_x, best_excess = x_b, excess_b
    bracketed = excess_a * excess_b <= 0
    # the weights are what the secant sees: an end that stays twice counts half, so that the other end moves as well
    weight_a, weight_b = excess_a, excess_b
    stayed = 0
    widths = [math.inf, math.inf]  # of the bracket, one and two steps ago
    # Illinois: the secant of the weights; a bracket that two steps have not halved is bisected
    while bracketed and abs(best_excess) > tolerance and evaluations < max_evaluations:
        x = x_a + (x_b - x_a) * weight_a / (weight_a - weight_b)
        if x_b - x_a > widths[1] / 2 or not x_a < x < x_b:
            x = x_a + (x_b - x_a) / 2
            if not x_a < x < x_b:
                break  # the ends are neighboring numbers
        widths = [x_b - x_a, widths[0]]
        excess = function(x) - target
        evaluations += 1
        if abs(excess) < abs(best_excess):
            best_x, best_excess = x, excess
        if (excess < 0) == (excess_a < 0):
            x_a, excess_a, weight_a = x, excess, excess
            weight_b = weight_b / 2 if stayed == 1 else excess_b
            stayed = 1
        else:
            x_b, excess_b, weight_b = x, excess, excess
            weight_a = weight_a / 2 if stayed == -1 else excess_a
            stayed = -1
    return SearchResult(best_x, target + best_excess, abs(best_excess) <= tolerance, bracketed, evaluations)
