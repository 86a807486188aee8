"""Expected porosity, pore surface and kernel overlap of a random porous cell, from counts and radii alone.

Pores and tunnels are taken as independent balls and tubes (the Boolean model of stochastic geometry: Chiu, Stoyan,
Kendall, Mecke, "Stochastic Geometry and its Applications", ch. 3): with specific volume V and surface S of all grains,
the void fraction is ``1 - exp(-V)`` and the surface ``S exp(-V)``. Against configurations of the paper the surface is
right within a fifth.
"""

from __future__ import annotations

import math

WIDENING = 1.75
"""A sum of kernels is wider than the union of its parts. V of the sum over V of its parts, measured: 66 pores and 158
tunnels of the paper's size give 0.69 and 0.40."""


def tunnel_length(pores: float) -> float:
    """Mean length of tunnels in cell sizes: somewhat below the mean distance of neighbors, ``n^(-1/3)``."""
    length: float = 0.85 * max(pores, 1.0) ** (-1 / 3)
    return length


def expected_structure(
    pores: float, tunnels: float, pore_radius: float, tunnel_radius: float, porosity: float | None = None
) -> tuple[float, float]:
    """Porosity of a cell and area of its pores, for counts in a cell and radii in cell sizes.

    If `porosity` is given, it is reached by the level, which scales all radii alike.
    """
    length = tunnel_length(pores)
    volume = pores * 4 / 3 * math.pi * pore_radius**3 + tunnels * math.pi * tunnel_radius**2 * length
    if volume <= 0:
        return 0.0, 0.0
    if porosity is None:
        porosity = 1 - math.exp(-WIDENING * volume)
    scale = (-math.log(max(1 - porosity, 1e-9)) / volume) ** (1 / 3)
    area = pores * 4 * math.pi * (pore_radius * scale) ** 2 + tunnels * 2 * math.pi * tunnel_radius * scale * length
    return porosity, (1 - porosity) * area


def kernels_at_a_point(pores: float, tunnels: float, pore_reach: float, tunnel_reach: float) -> float:
    """Mean number of kernels above the cut-off at a point: the volume within their reach (cell sizes), over the cell's.

    Tunnels reach as far around their ends as around their axes.
    """
    ball = 4 / 3 * math.pi
    tube = math.pi * tunnel_reach**2 * tunnel_length(pores) + ball * tunnel_reach**3
    total: float = pores * ball * pore_reach**3 + tunnels * tube
    return total


def expected_walls(length: float, half: float, radius: float, tunnels: float) -> tuple[float, float]:
    """Porosity of a cell of pierced walls and area of their sides, for lengths in cell sizes.

    Voronoi cells of pores with the mean distance `length` have ``2.9 / length`` of faces per volume (random pores:
    Okabe et al., "Spatial Tessellations", ch. 5); tunnels open some.
    """
    pierced = min(0.9, tunnels * math.pi * radius**2 * length / 2.9)
    area = 2.9 / length * (1 - pierced)
    return math.exp(-2 * half * area), 2 * area * math.exp(-2 * half * area)
