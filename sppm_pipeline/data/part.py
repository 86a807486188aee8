"""A part: a field cut by a domain, with an optional solid skin."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.field import ScalarField
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.numerics.grid import Grid

if TYPE_CHECKING:
    from sppm_pipeline.numerics.domain.inside import Method

__all__ = ["Part"]

VOTED_LAYERS = 64
"""Layers that are decided together where rays along all axes vote."""


@dataclass(frozen=True, eq=False)
class Part(ScalarField):
    """The intersection of a microstructure with a domain, evaluated where somebody samples it (paper, section 2.4).

    Attributes
    ----------
    field : ScalarField
        The microstructure; has a physical size.
    domain : SurfaceMesh
        The part to fill, mm.
    skin_mm : float
        Thickness of the solid skin inside the domain's surface; 0 for none.
    islands : {"remove", "keep"}
        Whether solid that is not connected to the largest component is left out where the part is sliced or meshed.
    inside : {"scanline", "winding", "vote"} or None
        How it is told what lies in the domain; None for the first if the domain bounds a solid, else the second.
    """

    field: ScalarField
    domain: SurfaceMesh
    skin_mm: float = 0.0
    islands: str = "remove"
    inside: Method | None = None
    _prepared: dict[str, Any] = dataclasses.field(default_factory=dict, compare=False, repr=False)

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.field.cells

    @property
    def periodic(self) -> bool:
        return False

    @property
    def finest_radius(self) -> float | None:
        return self.field.finest_radius

    @property
    def edge_mm(self) -> float | None:
        return self.field.edge_mm

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.field.origin_mm

    @property
    def method(self) -> Method:
        """How it is told what lies in the domain."""
        from sppm_pipeline.numerics.domain.inside import way_for

        return self.inside or way_for(self.domain.bounds_solid)

    def in_mm(self, grid: Grid) -> Grid:
        """`grid`, given in cell edges, in world millimetres."""
        edge = self.physical_edge()
        x, y, z = (o + edge * g for o, g in zip(self.origin_mm, grid.origin, strict=True))
        hx, hy, hz = (edge * h for h in grid.spacing)
        return Grid((x, y, z), (hx, hy, hz), grid.shape)

    def sample(self, grid: Grid, threads: int = 1) -> NDArray[np.float32]:
        """The larger of the microstructure's field and the distance from the domain in cell edges.

        Who extracts a surface takes both apart, as their sizes have nothing to do with each other.
        """
        inner, outer = self.sample_apart(grid, threads)
        return np.maximum(inner, outer, out=inner)

    def sample_apart(self, grid: Grid, threads: int = 1) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The microstructure's field, made solid inside the skin, and the distance from the domain in cell edges.

        The distance is cut off one spacing from the surface of the domain.
        """
        from sppm_pipeline.numerics.domain.signed_distance import signed_distance

        values = self.field.sample(grid, threads)
        world, edge = self.in_mm(grid), np.float32(self.physical_edge())
        reach = max(world.spacing) + self.skin_mm
        outer = signed_distance(self.domain.vertices, self.domain.faces, world, reach, self.method)
        outer /= edge
        if self.skin_mm:
            # inside the skin the field does not matter: solid where the surface is nearer than the skin is thick
            np.minimum(values, -np.float32(self.skin_mm) / edge - outer, out=values)
        return values, outer

    def solid(self, grid: Grid, threads: int = 1) -> NDArray[np.uint8]:
        return self.solid_layers(grid, 0, grid.shape[2], threads)

    def solid_layers(
        self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: NDArray[np.int32] | None = None
    ) -> NDArray[np.uint8]:
        from sppm_pipeline.numerics.domain.spans import row_spans

        if not self.skin_mm:
            inside = self._inside(grid, start, stop)
            inside &= self.field.solid_layers(grid, start, stop, threads, row_spans(inside))
            return inside
        from sppm_pipeline.numerics.domain.skin import halo_layers, skin_layers

        spacing = self.in_mm(grid).spacing
        halo = halo_layers(self.skin_mm, spacing[2])
        first, last = max(0, start - halo), min(grid.shape[2], stop + halo)
        around = self._inside(grid, first, last)
        inside = around[start - first : stop - first]
        solid = self.field.solid_layers(grid, start, stop, threads, row_spans(inside))
        solid &= inside
        solid |= skin_layers(around, spacing, self.skin_mm, start - first, last - stop)
        return solid

    def _inside(self, grid: Grid, start: int, stop: int) -> NDArray[np.uint8]:
        """Which voxels of some layers of `grid` lie in the domain; what the whole grid needs is kept between slabs."""
        from sppm_pipeline.numerics.domain.inside import inside_layers, prepare_inside

        kept = self._prepared
        if kept.get("grid") != grid:
            kept["grid"], kept["block"] = grid, None
            kept["scan"] = prepare_inside(self.domain.vertices, self.domain.faces, self.in_mm(grid), self.method)
        if self.method != "vote":
            return inside_layers(kept["scan"], start, stop).mask
        # a vote costs as much for one layer as for many, so layers are asked for in thick blocks
        if kept["block"] is None or not kept["block"][0] <= start <= stop <= kept["block"][1]:
            last = min(grid.shape[2], max(stop, start + VOTED_LAYERS))
            kept["block"] = (start, last, inside_layers(kept["scan"], start, last).mask)
        first, _, block = kept["block"]
        return block[start - first : stop - first].copy()  # type: ignore[no-any-return]

    def summary(self) -> dict[str, Any]:
        """The domain's and the lattice's size."""
        return {
            "domain": self.domain.summary(),
            "skin_mm": self.skin_mm,
            "islands": self.islands,
            "inside": self.method,
            "cells": list(self.cells),
        }
