"""Voxels that a surface cuts, and the limit of fine grids that they allow to extrapolate."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64

_REST = 0.25
"""Relative error of a member one voxel thick that extrapolation may leave. The least that covers the 40 cases of
benchmarks/partial_voxels.py is 0.241; half of it misses three of them, twice only widens the bars."""

_REST_POWER = 1.5
"""Power of the voxel by which that error falls. Less than 2, as stress is singular at sharp edges; with 2, bars of
smooth sheets many voxels thick are too short."""

_RELIABLE = 0.15
"""Relative error bar above which there is a warning (heuristic): walls of two voxels have 0.13."""

_INDEFINITE = 1e-4
"""Negative eigenvalues of an extrapolated stiffness, over its norm, that are the solver's error."""


def mean_thickness(fraction: NDArray[Any]) -> float:
    """Mean thickness of walls and struts in voxels, ``2 V / S``; infinite without a surface.

    A plane of area A cuts 1.5 A voxels of unit edge, the mean of ``|nx| + |ny| + |nz|`` over all directions.
    """
    cut = int(np.count_nonzero((fraction > 0) & (fraction < 1)))
    solid = float(fraction.sum(dtype=np.float64))
    # of what is left over, void or a second material, walls may be the thinner ones
    return 3 * min(solid, fraction.size - solid) / cut if cut else float("inf")


class Limit(NamedTuple):
    """An extrapolated stiffness, and the error bar of each entry, both (6, 6)."""

    value: F64
    error: F64
    extrapolated: bool  # False if the grids are too coarse to extrapolate; then the value is that of the finest


def second_order(spacings: list[float], values: list[F64]) -> F64:
    """The limit at spacing 0 of the parabola ``a + b h^2`` through the values of all grids, by least squares."""
    squares = np.square(np.asarray(spacings, np.float64) / max(spacings))
    weights = np.linalg.pinv(np.stack([np.ones_like(squares), squares], axis=1))[0]
    return np.asarray(np.tensordot(weights, np.asarray(values, np.float64), 1), np.float64)


def rest_of(thickness: float, contrast: float = 1.0) -> float:
    """Relative error that extrapolation may leave, where walls and struts have this mean thickness in voxels."""
    return float(_REST * contrast / thickness**_REST_POWER)


def doubt(error: float, what: str, thickness: float) -> str:
    """A warning of an error bar too long to rely on, relative, of walls and struts so many voxels thick; else empty."""
    if error <= _RELIABLE:
        return ""
    return (
        f"the error bar is {error:.0%} of the {what}, as walls and struts are {thickness:.2g} voxels thick in the "
        "mean: raise `resolution`"
    )


def limit_of_compliance(spacings: list[float], values: list[float], thickness: float) -> tuple[float, float]:
    """The limit of a compliance on fine grids, and its relative error bar, from those of two grids, the finest first.

    The reciprocals, which are stiffnesses, are extrapolated as in `limit_of_grids`. Those of bricks fall on finer
    grids; where they rise, or nothing would be left, the grids are too coarse, and the value is that of the finest.
    """
    fine, coarse = (1 / value for value in values)
    limit = float(second_order(spacings, [np.asarray(fine), np.asarray(coarse)]))
    if coarse < fine or limit <= 0:
        return values[0], 3 * abs(coarse - fine) / fine + rest_of(thickness)
    return 1 / limit, abs(limit - fine) / limit + rest_of(thickness)


def limit_of_grids(spacings: list[float], values: list[F64], thickness: float, contrast: float = 1.0) -> Limit:
    """Extrapolate the stiffness (6, 6) of two or more grids to infinitely fine ones, the finest first.

    `thickness` is that of `mean_thickness`, on the finest grid. What is not of second order is left over by the
    extrapolation, whose change may also vanish by accident; so ``0.25 / t^1.5`` of the stiffness is added to that
    change. `contrast` is one less the ratio of both stiffnesses; 1 for void.
    """
    fine, value = values[0], second_order(spacings, values)
    # a direction without a load path on the finest grid has none, whatever passes on coarser ones
    unloaded = np.diag(fine) == 0
    value[unloaded] = 0
    value[:, unloaded] = 0
    rest = rest_of(thickness, contrast)
    if np.linalg.eigvalsh(value)[0] < -_INDEFINITE * np.abs(value).max():
        return Limit(fine, np.abs(values[-1] - fine) + rest * np.abs(fine), False)
    return Limit(value, np.abs(value - fine) + rest * np.abs(value), True)
