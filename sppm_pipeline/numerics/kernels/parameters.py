"""Conversions between physical radii and kernel parameters, and how far a kernel reaches (paper, section 2.3).

An isolated pore kernel has the value C, the level, on a sphere of the pore radius; an isolated tunnel has it on a
tube of the tunnel radius. Radii and parameters of one call share one unit of length.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.numerics.kernels.kernels import Kernels

#: Kernel values below this share of their maximum are dropped: 2 voxels in 100 000 change sides, against 2 in
#: 100 at a cut-off of 1e-2.
DEFAULT_CUTOFF = 1e-5


def _log_of_level(level: float) -> float:
    """ln(1 / level), after a check of the level."""
    if not 0.0 < level < 1.0:
        raise DesignError(
            f"the level is {level!r}, but a level between 0 and 1 (both excluded) is needed",
            hint="a single pore has the value 1 in its center and falls to 0; the paper uses the level 0.25",
        )
    return math.log(1.0 / level)


def _positive(value: float, name: str, unit: str) -> float:
    if not (value > 0.0 and math.isfinite(value)):
        raise DesignError(f"the {name} is {value!r}, but a positive, finite number is needed", hint=f"unit: {unit}")
    return float(value)


def omega_from_radius(radius: float, level: float) -> float:
    """Pore size parameter omega of a pore radius: ``ln(1 / level) / radius^2``.

    Parameters
    ----------
    radius : float
        Radius of an isolated pore; positive.
    level : float
        The level C of the surface, 0 < C < 1.

    Returns
    -------
    float
        omega, 1 / length^2.

    Raises
    ------
    DesignError
        If the radius or the level lies outside its range.
    """
    return _log_of_level(level) / _positive(radius, "pore radius", "length") ** 2


def pore_radius(omega: float, level: float) -> float:
    """Radius of an isolated pore: ``sqrt(ln(1 / level) / omega)``, the inverse of `omega_from_radius`.

    Raises
    ------
    DesignError
        If omega or the level lies outside its range.
    """
    return math.sqrt(_log_of_level(level) / _positive(omega, "pore size parameter omega", "1 / length^2"))


def mu_from_radius(radius: float, level: float, squared: bool = False) -> float:
    """Tunnel size parameter mu of a tunnel radius: ``ln(1 / level) / radius``, or ``/ radius^2`` if squared.

    Parameters
    ----------
    radius : float
        Radius of an isolated tunnel; positive.
    level : float
        The level C of the surface, 0 < C < 1.
    squared : bool
        Whether the kernel takes the squared distance.

    Returns
    -------
    float
        mu, 1 / length, or 1 / length^2 if squared.

    Raises
    ------
    DesignError
        If the radius or the level lies outside its range.
    """
    radius = _positive(radius, "tunnel radius", "length")
    return _log_of_level(level) / (radius * radius if squared else radius)


def tunnel_radius(mu: float, level: float, squared: bool = False) -> float:
    """Radius of an isolated tunnel, the inverse of `mu_from_radius`.

    Raises
    ------
    DesignError
        If mu or the level lies outside its range.
    """
    ratio = _log_of_level(level) / _positive(mu, "tunnel size parameter mu", "1 / length, squared: 1 / length^2")
    return math.sqrt(ratio) if squared else ratio


def omega_in_cell_units(omega: float, edge: float) -> float:
    """omega for lengths counted in cell edges: ``omega * edge^2``.

    Raises
    ------
    DesignError
        If omega or the edge is not positive.
    """
    return _positive(omega, "pore size parameter omega", "1 / length^2") * _positive(edge, "cell edge", "length") ** 2


def mu_in_cell_units(mu: float, edge: float, squared: bool = False) -> float:
    """mu for lengths counted in cell edges: ``mu * edge``, or ``mu * edge^2`` if squared.

    Raises
    ------
    DesignError
        If mu or the edge is not positive.
    """
    edge = _positive(edge, "cell edge", "length")
    mu = _positive(mu, "tunnel size parameter mu", "1 / length, squared: 1 / length^2")
    return mu * (edge * edge if squared else edge)


def check_cutoff(cutoff: float) -> float:
    """The cut-off, after a check that it lies in [1e-12, 0.5].

    Below 1e-12 nothing is gained (the sums are kept in float32) and the compiled exponential leaves its range.

    Raises
    ------
    ValueError
        If the cut-off lies outside.
    """
    if not 1e-12 <= cutoff <= 0.5:
        raise ValueError(f"the cut-off is {cutoff!r}, but it must lie between 1e-12 and 0.5")
    return float(cutoff)


def pore_reach(omega: NDArray[np.float64] | float, cutoff: float = DEFAULT_CUTOFF) -> NDArray[np.float64]:
    """Distance at which a pore kernel falls to the cut-off: ``sqrt(ln(1 / cutoff) / omega)``, shape of omega."""
    return np.sqrt(math.log(1.0 / check_cutoff(cutoff)) / np.asarray(omega, dtype=np.float64))


def tunnel_reach(
    mu: NDArray[np.float64] | float, cutoff: float = DEFAULT_CUTOFF, squared: bool = False
) -> NDArray[np.float64]:
    """Distance at which a tunnel kernel falls to the cut-off: ``ln(1 / cutoff) / mu`` (squared: its root)."""
    ratio = math.log(1.0 / check_cutoff(cutoff)) / np.asarray(mu, dtype=np.float64)
    return np.sqrt(ratio) if squared else ratio


def reach_boxes(
    kernels: Kernels, cutoff: float = DEFAULT_CUTOFF
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Axis-parallel boxes outside of which the kernels lie below the cut-off.

    Returns
    -------
    pore_lower, pore_upper : (n, 3) float64
        Corners of the boxes of the pores.
    tunnel_lower, tunnel_upper : (m, 3) float64
        Corners of the boxes of the tunnels.
    """
    pores = pore_reach(kernels.omega, cutoff)[:, None]
    tunnels = tunnel_reach(kernels.mu, cutoff, kernels.squared)[:, None]
    return (
        kernels.centers - pores,
        kernels.centers + pores,
        np.minimum(kernels.starts, kernels.ends) - tunnels,
        np.maximum(kernels.starts, kernels.ends) + tunnels,
    )
