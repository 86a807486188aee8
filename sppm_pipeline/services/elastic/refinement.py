"""Voxels that a surface cuts, and the limit of fine grids that they allow to extrapolate."""

from __future__ import annotations

import math
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

POWERS = (2.0, 2.0, 1.5, 1.0)
"""Powers of the solid fraction that voxels at the surface have as their stiffness: on the finest grid, then on one half
as fine. Several powers tell on one grid what it makes of voxels at the surface."""

_FINEST, _LINEAR = 1.53, -0.32
"""Weights of the finest grid and of the power 1: the only numbers that were fitted to the moduli of the first 20 cells
of benchmarks/partial_voxels.py, at 32, 48 and 64 voxels. The other two follow, as errors of first order must vanish."""

_CHANGE = 0.1
"""Part of the term of second order that the error bar takes over. Without it bars of some cells are too short."""

_THIN = 0.06
"""Relative error of a member one voxel thick beside it; half as much for one twice as thick."""

_MIN_THICKNESS = 1.5
"""Voxels across walls below which there is a warning, whatever the error bar."""

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


def doubt(error: float, what: str, thickness: float, resolution: int = 0) -> str:
    """A warning of an error bar too long to rely on, relative, of walls and struts so many voxels thick; else empty.

    The bar falls by the power 1.5 of the voxel, about; given the present `resolution`, the text names that of 3 %.
    """
    if error <= _RELIABLE and thickness >= _MIN_THICKNESS:
        return ""
    needed = math.ceil(resolution * max(1.0, error / 0.03) ** (1 / _REST_POWER))
    return (
        f"the error bar is {error:.0%} of the {what}, as walls and struts are {thickness:.2g} voxels thick in the "
        f"mean: raise `resolution`{f' to about {needed} for 3 %' if needed > resolution else ''}"
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
    rest = rest_of(thickness, contrast)
    return _bounded(value, fine, value - fine, values[-1] - fine, rest)


def power_weights(spacing: float) -> tuple[F64, F64]:
    """Weights of the stiffnesses of `POWERS` in the limit of fine grids, and in the term of second order.

    With the power p a flat wall loses ``1/2 - 1/(p + 1)`` voxels on each side: 1/6 for 2, 1/10 for 1.5, nothing for 1.
    The weights of the limit add up to 1, those of the change to 0, and with both of them these losses cancel. `spacing`
    is that of the coarser grid over that of the finest.
    """
    rest = 1 - _FINEST - _LINEAR
    square = -2.5 * _FINEST / spacing - 1.5 * rest
    limit = np.array([_FINEST, square, rest - square, _LINEAR])
    return limit, np.array([1.0, 1.5 - 2.5 / spacing, 2.5 / spacing - 2.5, 0.0])


def limit_of_powers(spacing: float, values: list[F64], thickness: float, contrast: float = 1.0) -> Limit:
    """Extrapolate the stiffnesses (6, 6) by `POWERS` to infinitely fine grids; parameters as of `limit_of_grids`.

    The error bar is a tenth of the term of second order, and ``0.06 / t`` of the stiffness.
    """
    limit, change = (np.tensordot(weights, np.asarray(values), 1) for weights in power_weights(spacing))
    return _bounded(limit, values[0], _CHANGE * change, values[2] - values[0], _THIN * contrast / thickness)


def _bounded(value: F64, fine: F64, change: F64, fallback: F64, rest: float) -> Limit:
    """The limit with its bar, or the finest grid with that of `fallback` if no material has that limit."""
    # a direction without a load path on the finest grid has none, whatever passes on coarser ones
    unloaded = np.diag(fine) == 0
    value[unloaded] = 0
    value[:, unloaded] = 0
    if np.linalg.eigvalsh(value)[0] < -_INDEFINITE * np.abs(value).max():
        return Limit(fine, np.abs(fallback) + rest * np.abs(fine), False)
    change[unloaded] = 0
    change[:, unloaded] = 0
    return Limit(value, np.abs(change) + rest * np.abs(value), True)
