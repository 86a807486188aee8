"""A part: a field cut by a domain, with an optional solid skin."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.numerics.grid import Grid

if TYPE_CHECKING:
    from sppm_pipeline.numerics.domain.inside import Method

DISTANCE_SAMPLES = 2**22
"""Samples whose distance from the domain is found at a time."""

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
        """`grid`, given in cell edges, in world millimeters."""
        edge = self.physical_edge()
        x, y, z = (o + edge * g for o, g in zip(self.origin_mm, grid.origin, strict=True))
        hx, hy, hz = (edge * h for h in grid.spacing)
        return Grid((x, y, z), (hx, hy, hz), grid.shape)

    def sample(self, grid: Grid, threads: int = 1) -> NDArray[np.float32]:
        """The larger of the microstructure's field and the distance from the domain in cell edges.

        Who extracts a surface takes both apart, as their sizes have nothing to do with each other.
        """
        return self.sample_layers(grid, 0, grid.shape[2], threads)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        inner, outer = self.sample_apart(grid, threads, start, stop)
        return np.maximum(inner, outer, out=inner)

    def sample_apart(
        self, grid: Grid, threads: int = 1, start: int = 0, stop: int | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The microstructure's field, made solid inside the skin, and the distance from the domain in cell edges.

        The distance is cut off one spacing from the surface of the domain; with a skin, as much farther as that is
        thick. Layers start <= k < stop of the grid, all of them unless given.
        """
        inner, skin, outer = self.sample_fields(grid, threads, start, stop)
        if skin is not None:
            # farther in, the microstructure decides alone; a distance cut off would lie between
            deep = outer <= np.float32(-0.999 * (self.skin_mm / self.physical_edge() + max(grid.spacing)))
            np.minimum(inner, skin, out=inner, where=~deep)
        return inner, outer

    def sample_fields(
        self, grid: Grid, threads: int = 1, start: int = 0, stop: int | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None, NDArray[np.float32]]:
        """The fields of the microstructure, of the skin (None without one) and of the domain; see `sample_apart`.

        Solid is where the domain's field is negative and one of the other two as well. Those of the domain and of the
        skin are distances in cell edges; that of the microstructure is steeper or flatter.
        """
        stop = grid.shape[2] if stop is None else stop
        inner = self.field.sample_layers(grid, start, stop, threads)
        outer = self._distance(grid, start, stop)
        edge = np.float32(self.physical_edge())
        outer /= edge
        return inner, -np.float32(self.skin_mm) / edge - outer if self.skin_mm else None, outer

    def _distance(self, grid: Grid, start: int, stop: int) -> NDArray[np.float32]:
        """Signed distance from the domain for layers of `grid`, mm.

        It is computed in blocks that belong to the grid, whichever layers are asked for: where the skin is thick, the
        distance in a block depends a little on where the block ends. The last block is kept.
        """
        from sppm_pipeline.numerics.domain.signed_distance import distance_layers, reach_bare_borders

        kept, world = self._prepared, self.in_mm(grid)
        reach = max(world.spacing) + self.skin_mm
        nx, ny, nz = grid.shape
        block = max(1, DISTANCE_SAMPLES // (nx * ny), 4 * math.ceil(self.skin_mm / world.spacing[2]))
        out = np.empty((stop - start, ny, nx), np.float32)
        for number in range(start // block, -(-stop // block)):
            first, last = number * block, min(nz, (number + 1) * block)
            if kept.get("distance_of") != (grid, number):
                if "triangles" not in kept:
                    kept["triangles"] = self.domain.vertices[self.domain.faces]
                distance = distance_layers(kept["triangles"], world, first, last, reach)
                halo = 0 if self.method == "scanline" else math.ceil(reach / world.spacing[2])
                low, high = max(0, first - halo), min(nz, last + halo)
                around = self._inside(grid, low, high)
                if halo:
                    reach_bare_borders(distance, around, first - low, world.spacing)
                inside = around[first - low : last - low].view(bool)
                np.negative(distance, out=distance, where=inside)
                kept["distance_of"], kept["distance"] = (grid, number), distance
            low, high = max(start, first), min(stop, last)
            out[low - start : high - start] = kept["distance"][low - first : high - first]
        return out

    def solid(self, grid: Grid, threads: int = 1) -> NDArray[np.uint8]:
        return self.solid_layers(grid, 0, grid.shape[2], threads)

    def solid_layers(
        self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: NDArray[np.int32] | None = None
    ) -> NDArray[np.uint8]:
        from sppm_pipeline.numerics.domain.occupancy import row_spans

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
