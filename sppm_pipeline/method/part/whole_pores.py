"""Pores that a part holds as a whole: those that its surface would cut, or leave a thin wall at, are left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.kernels.kernels import kernel_reaches
from sppm_pipeline.services.arrays import F64, Bools
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.mesh.winding_number import dipoles, winding_numbers
from sppm_pipeline.services.nearest import surface_distances

SHARE = 0.25
"""Of the level: a pore or tunnel ends where it has this much, for others add to it. With 1 the walls of a knot are
broken through at a hundred places, with 0.5 at ten, with 0.25 nowhere."""

ALONG = 8
"""Pieces of a tunnel, at whose ends its distance from the surface is found. Between two of them, a distance s apart,
it may be less by s/2 at most, and is by s^2/8R near a surface of the radius R."""


def with_whole_pores(field: ScalarField, triangles: F64, wall: float) -> tuple[Tiling, Bools]:
    """A field without the pores and tunnels that come nearer than a wall to a surface, or lie outside of it.

    Parameters
    ----------
    field : ScalarField
        A tiling of scattered pores.
    triangles : (m, 3, 3) float64
        The surface, wound outwards, mm.
    wall : float
        Least distance of a pore or tunnel from the surface, mm; it ends where it has `SHARE` of the level.

    Returns
    -------
    Tiling, (n,) bool
        The field, and which of its pores have stayed.

    Raises
    ------
    ConfigError
        If the field has no pores of its own at each place.
    DesignError
        If no pore stays.
    """
    if not isinstance(field, Tiling) or field.tileset.kind != "scattered" or not field.additive:
        raise ConfigError(
            "`border: closed` leaves out pores one by one, and this structure repeats, or has none",
            hint="lay it by `tile.scattered` with pores and tunnels, or give `border: round`",
        )
    micro, edge = field.tileset.micro, field.physical_edge()
    graph, arrays = micro.graph, field.arrays
    tree = box_tree(triangles)
    number = np.argwhere(arrays.interior >= 0)  # interiors count in this order
    corner = np.asarray(field.origin) + edge * (number - arrays.halo)[graph.pores.piece]
    of_pores, of_tunnels = (edge * reach for reach in kernel_reaches(micro.pieces.kernels, SHARE * micro.level))
    centers = corner + edge * graph.pores.centers
    stays = surface_distances(tree, centers) >= of_pores + wall
    stays[stays] = winding_numbers(dipoles(tree), centers[stays]) > 0.5
    if not stays.any():
        raise DesignError(
            f"the part holds no pore with a wall of {wall:g} mm around it",
            hint="give smaller cells, or `thinnest` smaller",
        )
    leads = stays[graph.edges].all(1)
    chosen, order = np.flatnonzero(leads), micro.tunnel_order
    start, end = (edge * ends[:, None] for ends in graph.segments(chosen))
    places = corner[graph.edges[chosen, 0]][:, None] + start + np.linspace(0, 1, ALONG + 1)[:, None] * (end - start)
    radius = np.empty(len(leads))
    radius[order] = of_tunnels
    nearest = surface_distances(tree, places.reshape(-1, 3)).reshape(-1, ALONG + 1).min(1, initial=np.inf)
    leads[chosen] = nearest >= radius[chosen] + wall
    return replace(field, tileset=replace(field.tileset, micro=micro.only(stays, leads))), stays
