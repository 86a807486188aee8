"""The statistics of a porous cell: its surface, and how many kernels are felt at a point.

Pores and tunnels are taken as independent balls and tubes (the Boolean model of stochastic geometry: Chiu, Stoyan,
Kendall, Mecke, "Stochastic Geometry and its Applications", ch. 3): with specific volume V and surface S of all grains,
the void share is ``1 - exp(-V)`` and the surface ``S exp(-V)``. A sum of Gaussians is wider than the union of its
parts; `WIDENED` accounts for it. Against configurations of the paper the surface is right within a fifth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

WIDENED = 1.75
"""V of the sum over V of its parts: 66 pores and 158 tunnels of the paper's size give 0.69 and 0.40."""

REACH_PORE = 11.5
"""ln(1 / cut-off) of the kernels."""


class Structure(NamedTuple):
    """Porosity, and area of the surface in cell edges^2 for each cell."""

    porosity: float
    surface: float


def tunnel_length(pores: float) -> float:
    """Mean length of tunnels between neighbors, cell edges."""
    length: float = 0.85 * max(pores, 1.0) ** (-1 / 3)
    return length


def structure_of(
    pores: float, tunnels: float, pore_radius: float, tunnel_radius: float, *, porosity: float | None = None
) -> Structure:
    """Porosity and surface of a cell.

    Parameters
    ----------
    pores, tunnels : float
        In one cell.
    pore_radius, tunnel_radius : float
        Cell edges.
    porosity : float, optional
        The one that is reached by the level, which scales all radii; that of the radii if omitted.
    """
    length = tunnel_length(pores)
    volume = pores * 4 / 3 * math.pi * pore_radius**3 + tunnels * math.pi * tunnel_radius**2 * length
    if volume <= 0:
        return Structure(0.0, 0.0)
    if porosity is None:
        porosity = 1 - math.exp(-WIDENED * volume)
    scale = (-math.log(max(1 - porosity, 1e-9)) / volume) ** (1 / 3)
    area = pores * 4 * math.pi * (pore_radius * scale) ** 2 + tunnels * 2 * math.pi * tunnel_radius * scale * length
    return Structure(porosity, (1 - porosity) * area)


def kernels_at_a_point(pores: float, tunnels: float, omega: float, mu: float, squared: bool) -> float:
    """How many kernels lie above the cut-off at a point, on average; `omega` and `mu` in cell edges."""
    pore = math.sqrt(REACH_PORE / omega)
    tunnel = math.sqrt(REACH_PORE / mu) if squared else REACH_PORE / mu
    ball = 4 / 3 * math.pi
    total: float = pores * ball * pore**3 + tunnels * (math.pi * tunnel**2 * tunnel_length(pores) + ball * tunnel**3)
    return total
