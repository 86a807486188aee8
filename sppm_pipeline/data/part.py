"""A part: a field cut by a domain, with an optional solid skin."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.field import ScalarField
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.numerics.grid import Grid

__all__ = ["Part"]


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
    """

    field: ScalarField
    domain: SurfaceMesh
    skin_mm: float = 0.0
    islands: str = "remove"
    _prepared: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.field.cells

    @property
    def periodic(self) -> bool:
        return False

    @property
    def edge_mm(self) -> float | None:
        return self.field.edge_mm

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.field.origin_mm

    def in_mm(self, grid: Grid) -> Grid:
        """`grid`, given in cell edges, in world millimetres."""
        edge = self.physical_edge()
        x, y, z = (o + edge * g for o, g in zip(self.origin_mm, grid.origin, strict=True))
        hx, hy, hz = (edge * h for h in grid.spacing)
        return Grid((x, y, z), (hx, hy, hz), grid.shape)

    def sample(self, grid: Grid, threads: int = 1) -> NDArray[np.float32]:
        """The larger of the microstructure's field and the signed distance from the domain, in cell edges."""
        inner, outer = self.sample_apart(grid, threads)
        return np.maximum(inner, outer, out=inner)

    def sample_apart(self, grid: Grid, threads: int = 1) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The microstructure's field, made solid inside the skin, and the domain's distance in cell edges."""
        from sppm_pipeline.numerics.domain.signed_distance import signed_distance

        values = self.field.sample(grid, threads)
        world = self.in_mm(grid)
        reach = max(world.spacing) + self.skin_mm
        distance = signed_distance(self.domain.vertices, self.domain.faces, world, reach)
        edge = np.float32(self.physical_edge())
        if self.skin_mm:
            # inside the skin the field does not matter: solid where the surface is nearer than the skin is thick
            np.minimum(values, (-np.float32(self.skin_mm) - distance) / edge, out=values)
        distance /= edge
        return values, distance

    def solid(self, grid: Grid, threads: int = 1) -> NDArray[np.uint8]:
        return self.solid_layers(grid, 0, grid.shape[2], threads)

    def solid_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.uint8]:
        from sppm_pipeline.numerics.domain.scanline import scan_layers

        solid = self.field.solid_layers(grid, start, stop, threads)
        scan = self._scan(grid)
        if not self.skin_mm:
            solid &= scan_layers(scan, start, stop).mask
            return solid
        from sppm_pipeline.numerics.domain.skin import halo_layers, skin_layers

        spacing = self.in_mm(grid).spacing
        halo = halo_layers(self.skin_mm, spacing[2])
        first, last = max(0, start - halo), min(grid.shape[2], stop + halo)
        inside = scan_layers(scan, first, last).mask
        solid &= inside[start - first : stop - first]
        solid |= skin_layers(inside, spacing, self.skin_mm, start - first, last - stop)
        return solid

    def _scan(self, grid: Grid) -> Any:
        """The domain made ready for scanning the layers of `grid`; kept, as slabs of one grid follow each other."""
        from sppm_pipeline.numerics.domain.scanline import prepare_scan

        if self._prepared.get("grid") != grid:
            self._prepared["scan"] = prepare_scan(self.domain.vertices, self.domain.faces, self.in_mm(grid))
            self._prepared["grid"] = grid
        return self._prepared["scan"]

    def summary(self) -> dict[str, Any]:
        """The domain's and the lattice's size."""
        return {
            "domain": self.domain.summary(),
            "skin_mm": self.skin_mm,
            "islands": self.islands,
            "cells": list(self.cells),
        }
