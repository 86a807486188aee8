"""A part: a field cut by a domain, with an optional solid skin."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.fields.domain_sampler import DomainSampler
from sppm_pipeline.fields.wrapped import WrappedField
from sppm_pipeline.numerics.domain.capsules import depths_in_capsules
from sppm_pipeline.numerics.grid import Grid

if TYPE_CHECKING:
    from sppm_pipeline.numerics.domain.crossings import Crossings
    from sppm_pipeline.numerics.domain.inside import Method

COARSE_VOXELS = 2**20
"""Voxels of the grid on which a part is looked at as a whole: a choice, for some tenths of a second."""

COARSE_ALONG = 48
"""Voxels along the longest side of a part whose skin would allow for larger ones."""


@dataclass(frozen=True, eq=False)
class Part(WrappedField):
    """The intersection of a microstructure with a domain, evaluated where somebody samples it (paper, section 2.4).

    Attributes
    ----------
    base : ScalarField
        The microstructure; has a physical size.
    domain : SurfaceMesh
        The part to fill, mm.
    skin_mm : float
        Thickness of the solid skin inside the domain's surface; 0 for none.
    islands : {"remove", "keep"}
        Whether solid that is not connected to the largest component is left out where the part is sliced or meshed.
    inside : {"scanline", "winding", "vote"} or None
        Method of the inside test of the domain; None for the first if the domain bounds a solid, else the second.
    drains : tuple of tuples of 7 floats
        Capsules (both ends of a segment, radius), mm, that are void in skin and microstructure alike.
    """

    domain: SurfaceMesh
    skin_mm: float = 0.0
    islands: str = "remove"
    inside: Method | None = None
    drains: tuple[tuple[float, ...], ...] = ()

    @property
    def periodic(self) -> bool:
        return False

    @property
    def method(self) -> Method:
        """Method of the inside test of the domain."""
        from sppm_pipeline.numerics.domain.inside import way_for

        return self.inside or way_for(self.domain.bounds_solid)

    def check(self) -> None:
        """Drains are capsules with a radius."""
        super().check()
        for drain in self.drains:
            if len(drain) != 7 or not all(math.isfinite(number) for number in drain) or drain[6] <= 0:
                raise ValueError(f"a drain is two ends (x, y, z) and a positive radius, 7 numbers in mm, not {drain}")

    def in_mm(self, grid: Grid) -> Grid:
        """`grid`, given in cell sizes, in world millimeters."""
        edge = self.physical_edge()
        x, y, z = (o + edge * g for o, g in zip(self.origin_mm, grid.origin, strict=True))
        hx, hy, hz = (edge * h for h in grid.spacing)
        return Grid((x, y, z), (hx, hy, hz), grid.shape)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        """The larger of the microstructure's field and the distance from the domain in cell sizes.

        Who extracts a surface takes both apart, as their sizes have nothing to do with each other.
        """
        inner, outer = self.apart_zyx(grid, threads, start, stop)
        return np.maximum(inner, outer, out=inner).T

    def apart_zyx(
        self, grid: Grid, threads: int = 1, start: int = 0, stop: int | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The microstructure's field, made solid inside the skin, and the distance from the domain in cell sizes.

        Both for kernels, (stop - start, ny, nx).
        The distance is cut off one spacing from the surface of the domain; with a skin, as much farther as that is
        thick. Layers start <= k < stop of the grid, all of them unless given.
        """
        inner, skin, outer = self.fields_zyx(grid, threads, start, stop)
        if skin is not None:
            # farther in, the microstructure decides alone; a distance cut off would lie between
            deep = outer <= np.float32(-0.999 * (self.skin_mm / self.physical_edge() + max(grid.spacing)))
            np.minimum(inner, skin, out=inner, where=~deep)
        return inner, outer

    def fields_zyx(
        self, grid: Grid, threads: int = 1, start: int = 0, stop: int | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None, NDArray[np.float32]]:
        """The fields of the microstructure, of the skin (None without one) and of the domain; see `apart_zyx`.

        Solid is where the domain's field is negative and one of the other two as well. Those of the domain and of the
        skin are distances in cell sizes; that of the microstructure is steeper or flatter.
        """
        stop = grid.shape[2] if stop is None else stop
        inner = self.base.sample_zyx(grid, start, stop, threads)
        outer = self._in_domain(grid).distance(start, stop)
        edge = np.float32(self.physical_edge())
        outer /= edge
        skin = -np.float32(self.skin_mm) / edge - outer if self.skin_mm else None
        world = self.in_mm(grid)
        for window, depth in depths_in_capsules(world.layers(start, stop), self.drains, 2 * max(world.spacing)):
            for field in (inner, skin):
                if field is not None:
                    np.maximum(field[window], depth / edge, out=field[window])
        return inner, skin, outer

    def cut_zyx(
        self, grid: Grid, threads: int, start: int, stop: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None, NDArray[np.float32], Crossings]:
        """`fields_zyx`, and where grid edges that begin in these layers pierce the triangles of the domain.

        Of the domain's field only the sign counts where these are known: without a skin and drains, a closed domain is
        -1 inside and 1 outside. Nodes on its surface are outside, whatever way their place is rounded, so that faces
        are flat.
        """
        from sppm_pipeline.numerics.domain.crossings import on_surface

        domain = self._in_domain(grid)
        crossings = domain.crossings(start, stop)
        if self.skin_mm or self.drains or self.method != "scanline":
            return *self.fields_zyx(grid, threads, start, stop), crossings
        inside = domain.inside(start, stop).view(np.bool_)
        inside &= ~on_surface(crossings, grid, start, stop)
        outer = np.where(inside, np.float32(-1), np.float32(1))
        return self.base.sample_zyx(grid, start, stop, threads), None, outer, crossings

    def solid_layers(
        self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: NDArray[np.int32] | None = None
    ) -> NDArray[np.uint8]:
        from sppm_pipeline.numerics.domain.occupancy import row_spans

        if not self.skin_mm:
            inside = self._in_domain(grid).inside(start, stop)
            inside &= self.base.solid_zyx(grid, start, stop, threads, row_spans(inside))
            return self._drained(inside, grid, start, stop).T
        from sppm_pipeline.numerics.domain.skin import halo_layers, skin_layers

        spacing = self.in_mm(grid).spacing
        halo = halo_layers(self.skin_mm, spacing[2])
        first, last = max(0, start - halo), min(grid.shape[2], stop + halo)
        around = self._in_domain(grid).inside(first, last)
        inside = around[start - first : stop - first]
        solid = self.base.solid_zyx(grid, start, stop, threads, row_spans(inside))
        solid &= inside
        solid |= skin_layers(around, spacing, self.skin_mm, start - first, last - stop)
        return self._drained(solid, grid, start, stop).T

    def _drained(self, solid: NDArray[np.uint8], grid: Grid, start: int, stop: int) -> NDArray[np.uint8]:
        """The layers without what the drains take away."""
        for window, depth in depths_in_capsules(self.in_mm(grid).layers(start, stop), self.drains):
            solid[window][depth > 0] = 0
        return solid

    def coarse_solid(self, threads: int = 1) -> tuple[NDArray[np.uint8], Grid]:
        """The part on about `COARSE_VOXELS` cubes, (nz, ny, nx) uint8, and their centers in mm; a margin is void.

        A skin thinner than the voxels is taken as thick as these, so that it stays closed.
        """
        lower, extent = np.asarray(self.domain.lower), np.asarray(self.domain.upper - self.domain.lower)
        fine = self.skin_mm / 1.5 or math.inf
        pitch = float(max(min(fine, extent.max() / COARSE_ALONG), math.cbrt(extent.prod() / COARSE_VOXELS)))
        nx, ny, nz = (int(n) + 2 for n in np.ceil(extent / pitch))
        edge = self.physical_edge()
        x, y, z = ((lower - pitch / 2 - self.origin_mm) / edge).tolist()
        grid = Grid((x, y, z), (pitch / edge,) * 3, (nx, ny, nz))
        thick = replace(self, skin_mm=max(self.skin_mm, 1.01 * pitch)) if self.skin_mm else self
        return thick.solid_zyx(grid, 0, nz, threads), self.in_mm(grid)

    def inside_zyx(self, grid: Grid, start: int, stop: int) -> NDArray[np.uint8]:
        """Which samples of a grid lie in the domain, skin included, (stop - start, ny, nx) uint8."""
        return self._in_domain(grid).inside(start, stop)

    def skin_gap(self, voxel_mm: tuple[float, float, float]) -> str | None:
        """Warning for voxels larger than the skin is thick, which leave it open; None for smaller ones."""
        largest = max(voxel_mm)
        if not 0 < self.skin_mm < largest * (1 - 1e-6):
            return None
        which = "layers" if voxel_mm[2] == largest else "pixels"
        return (
            f"the skin of {self.skin_mm:g} mm is thinner than {which} of {largest:g} mm, which leaves it open across "
            f"them; make it thicker, or the {which} finer"
        )

    def _in_domain(self, grid: Grid) -> DomainSampler:
        """The sampler of the domain on a grid; the last one is kept, as slab after slab asks for the same grid."""
        sampler = _SAMPLERS.get(self)
        if sampler is None or sampler.of != grid:
            sampler = _SAMPLERS[self] = DomainSampler(self.domain, grid, self.in_mm(grid), self.skin_mm, self.method)
        return sampler

    def summary(self) -> dict[str, Any]:
        """The domain's and the lattice's size."""
        return {
            "domain": self.domain.summary(),
            "skin_mm": self.skin_mm,
            "drains": len(self.drains),
            "islands": self.islands,
            "inside": self.method,
            "cells": list(self.cells),
        }


_SAMPLERS: WeakKeyDictionary[Part, DomainSampler] = WeakKeyDictionary()
