"""Layers that are decided at sample points: those of a field, which is mesh-free slicing, and those of a mesh."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.data.printer import Printer
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.fields.slice_stack import Slab, SliceStack
from sppm_pipeline.fields.spool import Spool
from sppm_pipeline.numerics.grid import Grid

if TYPE_CHECKING:
    from sppm_pipeline.numerics.domain.inside import Method

SLAB_PIXELS = 2**22
"""Samples decided at a time; a slab holds at least one layer."""

VOTED_PIXELS = 2**25
"""The same for a vote of rays, which looks at all triangles for every slab."""


class _Kept:
    """What has been found out once: the layers without islands, and what was said of them."""

    layers: Spool | None = None
    islands: dict[str, Any]
    told: dict[str, Any]


@dataclass(frozen=True, eq=False, kw_only=True)
class SampledSlices(SliceStack):
    """Base of layers decided at the mid-height of each, at the middle of the pixels or of their parts.

    A subclass says where it is solid. Islands are removed in a pass ahead of the delivering one; the layers are kept
    in between, and from then on for whoever else reads them, so that nothing is evaluated twice.

    Attributes
    ----------
    grid : Grid
        Pixel centers of all layers, in the unit of the source.
    pitch : tuple of 3 floats
        Pixel pitch along x and y, layer height, mm.
    lower : tuple of 3 floats
        World position of the low corner of the stack, mm.
    islands : {"remove", "keep"}
    subsamples : int
        For gray layers: each pixel is sampled on k x k points, and its value is the solid fraction.
    sublayers : int
        For gray layers: so many heights of each layer are sampled.
    machine : Printer or None
        The printer that the layers are cut for.
    """

    grid: Grid
    pitch: tuple[float, float, float]
    lower: tuple[float, float, float]
    islands: str
    subsamples: int = 1
    sublayers: int = 1
    machine: Printer | None = None
    _kept: _Kept = field(default_factory=_Kept, init=False, compare=False, repr=False)

    @property
    def printer(self) -> Printer | None:
        return self.machine

    @property
    def pixel_mm(self) -> tuple[float, float]:
        return self.pitch[:2]

    @property
    def layer_mm(self) -> float:
        return self.pitch[2]

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.grid.shape

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.lower

    @property
    def gray(self) -> bool:
        return self.subsamples > 1 or self.sublayers > 1

    @property
    def samples(self) -> Grid:
        """The points where solid is decided, in the unit of the source."""
        return self.grid.subsampled(self.subsamples, self.sublayers)

    @property
    def unit_mm(self) -> float:
        """Millimeters of the unit of the source."""
        return 1.0

    @abstractmethod
    def decided(self, threads: int, told: dict[str, Any]) -> Iterator[Slab]:
        """Slabs of 1 where solid and 0 elsewhere at all samples, bottom first; findings of its own go to `told`.

        A slab begins with the first sheet of samples of a layer, and ends with the last one of a layer.
        """

    def spans(self, most: int) -> Iterator[tuple[int, int]]:
        """First sheet of samples and the one after the last of slabs of at most so many samples, or of one layer."""
        nx, ny, nz = self.samples.shape
        step = max(1, most // (nx * ny * self.sublayers)) * self.sublayers
        return ((start, min(start + step, nz)) for start in range(0, nz, step))

    def read(self, threads: int) -> Generator[Slab, None, dict[str, Any]]:
        count = 0
        islands: dict[str, Any] = {}
        told: dict[str, Any] = {}
        for start, solid in self._cleaned(threads, islands, told):
            count += int(np.count_nonzero(solid))
            if self.gray:
                from sppm_pipeline.numerics.domain.occupancy import gray_by_coverage

                factor, m = (self.subsamples, self.subsamples), self.sublayers
                sheets = range(0, len(solid), m)
                yield start // m, np.stack([gray_by_coverage(solid[k : k + m], factor) for k in sheets])
            else:
                np.multiply(solid, np.uint8(255), out=solid)
                yield start, solid
        _, (hx, hy, hz), (nx, ny, nz) = self.samples
        volume = {
            "solid_voxels": count,
            "solid_share_of_box": count / (nx * ny * nz),
            "solid_volume_mm3": count * hx * hy * hz * self.unit_mm**3,
        }
        return islands | volume | told

    def _cleaned(self, threads: int, found: dict[str, Any], told: dict[str, Any]) -> Iterator[Slab]:
        """The solid, without islands if they are to be removed; what was removed is added to `found`."""
        if self.islands == "keep":
            yield from self.decided(threads, told)
            return
        if self._kept.layers is not None:
            found |= self._kept.islands
            told |= self._kept.told
            kept = self._kept.layers
            yield from (kept.slab(number) for number in range(len(kept)))
            return
        from sppm_pipeline.numerics.connectivity.streaming import IslandFilter

        nx, ny, _ = self.samples.shape
        spool = Spool()
        islands = IslandFilter(ny, nx)
        for start, solid in self.decided(threads, told):
            islands.observe(solid)
            spool.append(start, solid)
        statistics = islands.finish("largest")
        found["components"] = statistics.components
        found["removed_share"] = statistics.removed_share
        found["spans"] = list(statistics.spans)
        if not spool.whole:
            for start, solid in self.decided(threads, told):
                yield start, islands.clear(solid)
            return
        for number in range(len(spool)):
            start, solid = spool.slab(number)
            spool.replace(number, islands.clear(solid, out=solid))
            yield start, solid
        self._kept.islands, self._kept.told = dict(found), dict(told)
        self._kept.layers = spool


@dataclass(frozen=True, eq=False, kw_only=True)
class FieldSlices(SampledSlices):
    """Sections of a field; its unit is the cell size.

    Attributes
    ----------
    source : ScalarField
        Has a physical size.
    """

    source: ScalarField

    @property
    def unit_mm(self) -> float:
        return self.source.physical_edge()

    def decided(self, threads: int, told: dict[str, Any]) -> Iterator[Slab]:
        for start, stop in self.spans(SLAB_PIXELS):
            yield start, self.source.solid_zyx(self.samples, start, stop, threads)


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshSlices(SampledSlices):
    """Sections of a mesh, in mm; shells that overlap are united.

    Attributes
    ----------
    source : SurfaceMesh
        Wound outwards.
    method : {"scanline", "winding", "vote"}
        Method of the inside test.
    """

    source: SurfaceMesh
    method: Method = "scanline"

    def decided(self, threads: int, told: dict[str, Any]) -> Iterator[Slab]:
        from sppm_pipeline.numerics.domain.inside import inside_layers, prepare_inside

        scan = prepare_inside(self.source.vertices, self.source.faces, self.samples, self.method)
        count = undecided = 0
        for start, stop in self.spans(VOTED_PIXELS if self.method == "vote" else SLAB_PIXELS):
            found = inside_layers(scan, start, stop)
            count += int(np.count_nonzero(found.mask))
            undecided += found.undecided
            yield start, found.mask
        if self.method != "scanline":
            told["undecided_share"] = undecided / max(1, count)
