"""A part: a field cut by a domain, with an optional solid skin."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from sppm_pipeline.method.fields.scalar_field import ScalarField, WrappedField
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.capsules import depths_in_capsules, fill_capsules
from sppm_pipeline.method.part.domain_sampler import DomainSampler
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.services.arrays import F32, F64, I32, U8, U64, Bools
from sppm_pipeline.services.grid import Grid

if TYPE_CHECKING:
    from sppm_pipeline.method.part.border import Border, BorderSampler
    from sppm_pipeline.method.part.crossings import Crossings
    from sppm_pipeline.method.part.inside import Method
    from sppm_pipeline.nouns.length import Length
    from sppm_pipeline.nouns.size import Size

COARSE_VOXELS = 2**20
"""Voxels of the grid on which a part is measured as a whole, in some tenths of a second. A heuristic: twice as many
take twice as long and show void that is 20 % narrower."""

COARSE_ALONG = 48
"""Voxels along the longest side of a part whose skin would allow for larger ones."""


@dataclass(frozen=True, eq=False)
class Part(WrappedField):
    """The intersection of a microstructure with a domain, evaluated where it is sampled (paper, section 2.4).

    Attributes
    ----------
    base : ScalarField
        The microstructure; has a physical size.
    domain : SurfaceMesh
        The part to fill, mm.
    skin_mm : float
        Thickness of the solid skin inside the domain's surface; 0 for none.
    skin_faces : (n,) int32 or None
        The triangles of the domain that have the skin: what is within its thickness of one of them. None for all.
    solid_mm : float
        Distance within which the part is solid near the triangles `solid_faces`; 0 for none.
    solid_faces : (n,) int32
        The triangles of the domain that keep solid around them, whatever has the skin.
    islands : {"auto", "remove", "keep"}
        Whether solid that is not connected to the largest component is left out where the part is sliced or meshed;
        "auto" as `connectivity.removal` limits it.
    inside : {"scanline", "winding", "vote"} or None
        Method of the inside test of the domain; None for the first if the domain bounds a solid, else the second.
    drains : tuple of tuples of 7 floats
        Capsules (both ends of a segment, radius), mm, that are void in skin and microstructure alike.
    fills : (n, 7) float64
        Capsules that are solid as far as they lie in the domain; drains win over them.
    border : Border or None
        How the solid ends at the surface of the domain; None if it is cut there. All else is done before.
    """

    domain: SurfaceMesh
    skin_mm: float = 0.0
    islands: str = "auto"
    inside: Method | None = None
    drains: tuple[tuple[float, ...], ...] = ()
    skin_faces: I32 | None = None
    fills: F64 = field(default_factory=lambda: np.zeros((0, 7)))
    border: Border | None = None
    solid_mm: float = 0.0
    solid_faces: I32 = field(default_factory=lambda: np.zeros(0, np.int32))

    def __post_init__(self) -> None:
        object.__setattr__(self, "fills", frozen(np.asarray(self.fills, np.float64)))
        object.__setattr__(self, "solid_faces", frozen(np.asarray(self.solid_faces, np.int32)))
        if self.skin_faces is not None:
            object.__setattr__(self, "skin_faces", frozen(np.asarray(self.skin_faces, np.int32)))

    @property
    def periodic(self) -> bool:
        return False

    @property
    def method(self) -> Method:
        """Method of the inside test of the domain."""
        from sppm_pipeline.method.part.inside import way_for

        # rays are exact, but leak where a mesh is open
        return self.inside or way_for(self.domain.bounds_solid)

    def check(self) -> None:
        """Drains are capsules with a radius."""
        super().check()
        for drain in self.drains:
            if len(drain) != 7 or not all(math.isfinite(number) for number in drain) or drain[6] <= 0:
                raise ValueError(f"a drain is two ends (x, y, z) and a positive radius, 7 numbers in mm, not {drain}")
        for chosen in (self.skin_faces, self.solid_faces):
            if chosen is not None and len(chosen) and not 0 <= chosen.min() <= chosen.max() < len(self.domain.faces):
                raise ValueError("the skin is on a triangle that the domain does not have")
        if self.fills.shape[1:] != (7,) or not np.isfinite(self.fills).all() or not (self.fills[:, 6] > 0).all():
            raise ValueError("fills are rows of two ends (x, y, z) and a positive radius, 7 numbers in mm")

    @property
    def has_skin(self) -> bool:
        """Whether there is solid besides the microstructure: a skin, or what is kept solid near some triangles."""
        return self.skin_mm > 0 or self.solid_mm > 0

    @property
    def inner_level(self) -> float | None:
        """Level C if the microstructure's field, as it is handed out here, is a sum of kernels less C; else None."""
        return None if self.border else self.base.sum_level

    def in_mm(self, grid: Grid) -> Grid:
        """`grid`, given in cell sizes, in world millimeters."""
        edge = self.physical_edge()
        x, y, z = (o + edge * g for o, g in zip(self.origin_mm, grid.origin, strict=True))
        hx, hy, hz = (edge * h for h in grid.spacing)
        return Grid((x, y, z), (hx, hy, hz), grid.shape)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        """The larger of the microstructure's field and the distance from the domain in cell sizes.

        Who extracts a surface takes both apart, as their sizes have nothing to do with each other.
        """
        inner, outer = self.apart_zyx(grid, threads, start, stop)
        return np.maximum(inner, outer, out=outer).T

    def apart_zyx(self, grid: Grid, threads: int = 1, start: int = 0, stop: int | None = None) -> tuple[F32, F32]:
        """The microstructure's field, made solid inside the skin, and the distance from the domain in cell sizes.

        Both for kernels, (stop - start, ny, nx).
        The distance is cut off one spacing from the surface of the domain; with a skin, as much farther as that is
        thick. Layers start <= k < stop of the grid, all of them unless given.
        """
        inner, skin, outer = self.fields_zyx(grid, threads, start, stop)
        if skin is not None:
            # farther in, the microstructure decides alone; a distance cut off would lie between
            slack = 0.001 * max(self.skin_mm, self.solid_mm) / self.physical_edge()
            deep = skin >= np.float32(0.999 * max(grid.spacing) - slack)
            np.minimum(inner, skin, out=inner, where=~deep)
        return inner, outer

    def fields_zyx(
        self, grid: Grid, threads: int = 1, start: int = 0, stop: int | None = None
    ) -> tuple[F32, F32 | None, F32]:
        """The fields of the microstructure, of the skin (None without one) and of the domain; see `apart_zyx`.

        Solid is where the domain's field is negative and one of the other two as well. Those of the domain and of the
        skin are distances in cell sizes; that of the microstructure is steeper or flatter. With a border the first is
        about the distance of the whole solid, and that of the domain is -1 everywhere.
        """
        stop = grid.shape[2] if stop is None else stop
        if self.border is not None:
            field = self._drained(self._bordered().sample(grid, start, stop, threads), grid, start, stop)
            return field, None, np.full_like(field, -1)
        inner = self.base.sample_zyx(grid, start, stop, threads)
        outer = self._in_domain(grid).distance(start, stop)
        edge = np.float32(self.physical_edge())
        outer /= edge
        skin = None
        if self.skin_mm:
            away = -outer if self.skin_faces is None else self._in_domain(grid).skin_distance(start, stop) / edge
            skin = away - np.float32(self.skin_mm) / edge
        if self.solid_mm:
            near = self._near_faces(grid).skin_distance(start, stop) / edge - np.float32(self.solid_mm) / edge
            skin = near if skin is None else np.minimum(skin, near, out=skin)
        return self._filled_and_drained_field(inner, skin, grid, start, stop), skin, outer

    def within_zyx(self, grid: Grid, threads: int, start: int, stop: int) -> tuple[F32, F32 | None, Bools]:
        """The fields of the microstructure and of the skin as in `fields_zyx`, and which samples the domain holds."""
        inside = self._in_domain(grid).inside(start, stop).view(np.bool_)
        if self.has_skin or self.border:
            return *self.fields_zyx(grid, threads, start, stop)[:2], inside
        inner = self.base.sample_zyx(grid, start, stop, threads)
        return self._filled_and_drained_field(inner, None, grid, start, stop), None, inside

    def _filled_and_drained_field(self, inner: F32, skin: F32 | None, grid: Grid, start: int, stop: int) -> F32:
        """The microstructure's field with fills in it and drains taken out, of the skin's as well, which is changed."""
        if not (len(self.fills) or len(self.drains)):
            return inner
        inner = inner.copy()  # what a field hands out may be its own
        world, edge = self.in_mm(grid), np.float32(self.physical_edge())
        layers, margin = world.layers(start, stop), 2 * max(world.spacing)
        fill_capsules(layers, self.fills, margin, edge, inner)
        if skin is not None:
            self._drained(skin, grid, start, stop)
        return self._drained(inner, grid, start, stop)

    def _drained(self, field: F32, grid: Grid, start: int, stop: int) -> F32:
        """A field without what drains take away from the border, which may have thickened what is beside them."""
        world, edge = self.in_mm(grid), np.float32(self.physical_edge())
        for window, depth in depths_in_capsules(world.layers(start, stop), self.drains, 2 * max(world.spacing)):
            np.maximum(field[window], depth / edge, out=field[window])
        return field

    def cut_zyx(
        self, grid: Grid, threads: int, start: int, stop: int, wanted: I32 | None = None
    ) -> tuple[F32, F32 | None, F32, Crossings]:
        """`fields_zyx`, and where grid edges that begin in these layers pierce the triangles of the domain.

        Of the domain's field only the sign counts where these are known: without a skin and drains, a closed domain is
        -1 inside and 1 outside. Nodes on its surface are outside, whatever way their place is rounded, so that faces
        are flat. `wanted` as for `solid_layers`.
        """
        from sppm_pipeline.method.part.crossings import NO_CROSSINGS, on_surface

        if self.border is not None:  # the domain is rounded, too
            return *self.fields_zyx(grid, threads, start, stop), NO_CROSSINGS
        domain = self._in_domain(grid)
        crossings = domain.crossings(start, stop)
        if self.has_skin or self.drains or self.method != "scanline":
            # only a closed mesh without skin and drains is known by its triangles alone
            return *self.fields_zyx(grid, threads, start, stop), crossings
        inside = domain.inside(start, stop).view(np.bool_)
        # a node on the surface is outside whichever way it is rounded, or flat faces would be ragged
        inside &= ~on_surface(crossings, grid, start, stop)
        outer = np.where(inside, np.float32(-1), np.float32(1))
        if wanted is None:
            inner = self.base.sample_zyx(grid, start, stop, threads)
        else:
            inner = self.base.sample_wanted(grid, start, stop, threads, wanted)
        return self._filled_and_drained_field(inner, None, grid, start, stop), None, outer, crossings

    def solid_layers(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> U8:
        return self._solid_inside_skin(grid, start, stop, threads)[0].T

    def _solid_inside_skin(self, grid: Grid, start: int, stop: int, threads: int) -> tuple[U8, U8, U8 | None]:
        """The solid, the domain, and the skin before drains (None without one), (stop - start, ny, nx) uint8."""
        from sppm_pipeline.method.assembly.occupancy import row_spans

        if self.border is not None:
            _, inside, skin = (
                self._plain()._solid_inside_skin(grid, start, stop, threads)
                if self.has_skin
                else (None, self._in_domain(grid).inside(start, stop), None)
            )
            field = self._bordered().sample(grid, start, stop, threads, row_spans(inside))
            return (self._drained(field, grid, start, stop) < 0).view(np.uint8), inside, skin
        skin = None
        if not self.skin_mm or self.skin_faces is not None:
            domain = self._in_domain(grid)
            inside = domain.inside(start, stop)
            if self.skin_mm:
                skin = np.zeros_like(inside)
                domain.add_skin(start, inside, skin)
        else:
            from sppm_pipeline.method.part.skin import halo_layers, skin_layers

            # how far a layer lies below the surface depends on the layers around it
            spacing = self.in_mm(grid).spacing
            halo = halo_layers(self.skin_mm, spacing[2])
            first, last = max(0, start - halo), min(grid.shape[2], stop + halo)
            around = self._in_domain(grid).inside(first, last)
            inside = around[start - first : stop - first]
            skin = skin_layers(around, spacing, self.skin_mm, start - first, last - stop)
        if self.solid_mm:
            skin = np.zeros_like(inside) if skin is None else skin
            self._near_faces(grid).add_skin(start, inside, skin)
        solid = self.base.solid_zyx(grid, start, stop, threads, row_spans(inside))
        solid &= inside
        if skin is not None:
            solid |= skin
        return self._filled_and_drained(solid, inside, grid, start, stop), inside, skin

    @property
    def _decided_by_bytes(self) -> bool:
        """True if skin, border, fills or drains make it necessary to look at a byte for each sample."""
        return bool(self.has_skin or self.drains or len(self.fills) or self.border)

    def samples_by_rows(self, grid: Grid) -> bool:
        return self.method == "scanline" and not self._decided_by_bytes and self.base.samples_by_rows(grid)

    def solid_bits(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> U64:
        return self.counted_bits(grid, start, stop, threads)[0]

    def counted_bits(self, grid: Grid, start: int, stop: int, threads: int = 1) -> tuple[U64, dict[str, int]]:
        """`solid_bits`, and how many samples lie in the domain and in its skin, as ``domain`` and ``skin``."""
        from sppm_pipeline.services.bit_rows import count, pack

        if self._decided_by_bytes:
            solid, inside, skin = self._solid_inside_skin(grid, start, stop, threads)
            of_skin = 0 if skin is None else int(np.count_nonzero(skin & solid))  # drains win over the skin
            return pack(solid), {"domain": int(np.count_nonzero(inside)), "skin": of_skin}
        from sppm_pipeline.method.assembly.occupancy import row_spans_of_bits

        held = self._in_domain(grid).inside_bits(start, stop)
        bits = self.base.solid_bits(grid, start, stop, threads, row_spans_of_bits(held))
        bits &= held
        return bits, {"domain": count(held), "skin": 0}

    def _filled_and_drained(self, solid: U8, inside: U8, grid: Grid, start: int, stop: int) -> U8:
        """The layers with what fills add in the domain, and without what drains take away."""
        layers = self.in_mm(grid).layers(start, stop)
        for window, depth in depths_in_capsules(layers, self.fills):
            solid[window] |= inside[window] & (depth > 0)
        for window, depth in depths_in_capsules(layers, self.drains):
            solid[window][depth > 0] = 0
        return solid

    def coarse_pitch(self) -> float:
        """Edge of the voxels, mm, of which there are about `COARSE_VOXELS` in the box of the part."""
        extent = np.asarray(self.domain.upper - self.domain.lower)
        # a skin needs more than a voxel to be closed
        fine = self.skin_mm / 1.5 or math.inf
        return float(max(min(fine, extent.max() / COARSE_ALONG), math.cbrt(extent.prod() / COARSE_VOXELS)))

    def coarse_solid(self, threads: int = 1, pitch: float | None = None) -> tuple[U8, Grid]:
        """The part on cubes of a pitch, mm, (nz, ny, nx) uint8, and their centers in mm; a margin is void.

        The pitch is `coarse_pitch` if omitted. A skin thinner than it is taken as thick, so that it stays closed.
        """
        lower, extent = np.asarray(self.domain.lower), np.asarray(self.domain.upper - self.domain.lower)
        pitch = self.coarse_pitch() if pitch is None else pitch
        nx, ny, nz = (int(n) + 2 for n in np.ceil(extent / pitch))
        edge = self.physical_edge()
        x, y, z = ((lower - pitch / 2 - self.origin_mm) / edge).tolist()
        grid = Grid((x, y, z), (pitch / edge,) * 3, (nx, ny, nz))
        # a skin thinner than a voxel would leak, and sealed void would look open
        thick = replace(self, skin_mm=max(self.skin_mm, 1.01 * pitch)) if self.skin_mm else self
        thick = thick if thick.border is None else thick._plain()  # voxels are coarser than what a border changes
        return thick.solid_zyx(grid, 0, nz, threads), self.in_mm(grid)

    def inside_zyx(self, grid: Grid, start: int, stop: int) -> U8:
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
        return self._kept(_SAMPLERS, grid, self.skin_mm, self.skin_faces)

    def _near_faces(self, grid: Grid) -> DomainSampler:
        """The sampler whose skin is what is kept solid near faces."""
        return self._kept(_NEAR_FACES, grid, self.solid_mm, self.solid_faces)

    def _kept(
        self, samplers: WeakKeyDictionary[Part, DomainSampler], grid: Grid, thick: float, faces: I32 | None
    ) -> DomainSampler:
        """The last sampler if it is of this grid, else another; weak keys free it with its part."""
        sampler = samplers.get(self)
        if sampler is None or sampler.of != grid:
            sampler = samplers[self] = DomainSampler(self.domain, grid, self.in_mm(grid), thick, self.method, faces)
        return sampler

    def _plain(self) -> Part:
        """The part whose solid ends at the surface as it is cut."""
        return replace(self, border=None)

    def _bordered(self) -> BorderSampler:
        """The sampler of the solid with its border."""
        from sppm_pipeline.method.part.border import BorderSampler

        assert self.border is not None
        sampler = _BORDERS.get(self)
        if sampler is None:
            sampler = _BORDERS[self] = BorderSampler(self._plain(), self.border)
        return sampler

    def summary(self) -> dict[str, Any]:
        """The domain's and the lattice's size."""
        return {
            "domain": self.domain.summary(),
            "skin_mm": self.skin_mm,
            **({} if self.skin_faces is None else {"skin_triangles": len(self.skin_faces)}),
            **({"solid_mm": self.solid_mm, "solid_triangles": len(self.solid_faces)} if self.solid_mm else {}),
            "drains": len(self.drains),
            "fills": len(self.fills),
            "islands": self.islands,
            "inside": self.method,
            "cells": list(self.cells),
        }


def islands_for(field: ScalarField, islands: str) -> str:
    """The option `islands` of a stage that meshes a field; "auto" yields to that of a part."""
    return field.islands if islands == "auto" and isinstance(field, Part) else islands


def node_grid(field: ScalarField, per_cell: int) -> Grid:
    """The nodes, `per_cell` to a cell edge, on which the surface of a field is found; in cell sizes.

    They fill the box of a cell or tiling with both of its ends, and reach one node beyond the domain of a part.
    """
    h = 1.0 / per_cell
    low, high = np.zeros(3, np.int64), np.array(field.cells) * per_cell
    if isinstance(field, Part):
        edge = field.physical_edge()
        low = np.floor((field.domain.lower - field.origin_mm) / edge * per_cell).astype(np.int64) - 1
        high = np.ceil((field.domain.upper - field.origin_mm) / edge * per_cell).astype(np.int64) + 1
    nx, ny, nz = (int(v) for v in high - low + 1)
    x, y, z = (float(v) * h for v in low)
    return Grid((x, y, z), (h, h, h), (nx, ny, nz))


def coarse_size(part: Size, pitch: Length | None = None) -> Size:
    """Expected work of `Part.coarse_solid`, as for a part without a thin skin, which wants finer voxels."""
    body = part.body
    extent = [body.scale * side for side in body.box]
    own = max(max(extent) / COARSE_ALONG, math.cbrt(math.prod(extent) / COARSE_VOXELS))
    return replace(part.grid(body.scale / (own if pitch is None else pitch.mm())), nodes=part.nodes)


_SAMPLERS: WeakKeyDictionary[Part, DomainSampler] = WeakKeyDictionary()
_NEAR_FACES: WeakKeyDictionary[Part, DomainSampler] = WeakKeyDictionary()
_BORDERS: WeakKeyDictionary[Part, BorderSampler] = WeakKeyDictionary()
