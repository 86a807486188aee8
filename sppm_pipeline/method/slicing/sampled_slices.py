"""Layers that are decided at sample points: those of a field, which is mesh-free slicing, and those of a mesh."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.nouns.printer import Printer
from sppm_pipeline.method.slicing.slice_stack import Slab, Slabs, SliceStack
from sppm_pipeline.method.slicing.spool import Spool
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.threads import computed_ahead, ordered_map

if TYPE_CHECKING:
    from sppm_pipeline.method.connectivity.verdicts import IslandStatistics
    from sppm_pipeline.method.part.inside import Method
    from sppm_pipeline.method.slicing.slab_passes import Survey

SLAB_PIXELS = 2**22
"""Samples decided at a time; a slab holds at least one layer."""

VOTED_PIXELS = 2**25
"""The same for a vote of rays, which looks at all triangles for every slab."""


BitSlab = tuple[int, NDArray[np.uint64]]
"""Index of the first sheet of samples, and the sheets as bits, see `numerics.bit_rows`."""


class _Kept:
    """What has been found out once: the layers without islands, or what workers have kept, and what was said."""

    layers: Spool | None = None
    survey: Survey | None = None
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

    def prepared(self) -> Any:
        """What `decided` needs for any sheet, made once for all who ask for some of them."""
        return None

    @abstractmethod
    def decided(
        self, threads: int, counts: dict[str, int], start: int = 0, stop: int | None = None, prepared: Any = None
    ) -> Iterator[BitSlab]:
        """Slabs of bits, set where solid, of all samples, bottom first; what it counts is added to `counts`.

        A slab begins with the first sheet of samples of a layer, and ends with the last one of a layer. Only the sheets
        start <= k < stop are decided, and are what they are among all.
        """

    def told(self, counts: dict[str, int]) -> dict[str, Any]:
        """Findings of its own, from what `decided` has counted."""
        return {}

    @property
    def height(self) -> int:
        """Sheets of samples that are decided at a time: some, or those of one layer."""
        nx, ny, _ = self.samples.shape
        return max(1, self._at_once() // (nx * ny * self.sublayers)) * self.sublayers

    def _at_once(self) -> int:
        return SLAB_PIXELS

    def spans(self, start: int = 0, stop: int | None = None) -> Iterator[tuple[int, int]]:
        """First sheet of samples and the one after the last of slabs of some samples, or of one layer."""
        last = self.samples.shape[2] if stop is None else stop
        return ((first, min(first + self.height, last)) for first in range(start, last, self.height))

    def read(self, threads: int) -> Generator[Slab, None, dict[str, Any]]:
        sheets = self._read_bits(threads)
        while True:
            try:
                start, solid = next(sheets)
            except StopIteration as end:
                return dict(end.value)
            yield start // self.sublayers, self.shaded(solid)

    def bit_slabs(self, threads: int = 1) -> Slabs:
        """`slabs` as bits, index of the first sheet of samples and sheets: an eighth of the bytes, and less work.

        Nobody may change them.
        """
        return Slabs(self._watched(self._read_bits(threads)))

    def _read_bits(self, threads: int) -> Generator[BitSlab, None, dict[str, Any]]:
        from sppm_pipeline.services.bit_rows import count

        voxels = 0
        islands: dict[str, Any] = {}
        told: dict[str, Any] = {}
        for start, solid in self._cleaned(threads, islands, told):
            voxels += count(solid)
            yield start, solid
        return self.findings(islands, voxels, told)

    def shaded(self, bits: NDArray[np.uint64]) -> NDArray[np.uint8]:
        """Layers as they are delivered from sheets of samples."""
        from sppm_pipeline.services.bit_rows import unpack

        if not self.gray:
            return unpack(bits, self.samples.shape[0], 255)
        from sppm_pipeline.method.assembly.occupancy import gray_by_coverage

        solid = unpack(bits, self.samples.shape[0])
        factor, m = (self.subsamples, self.subsamples), self.sublayers
        return np.stack([gray_by_coverage(solid[k : k + m], factor) for k in range(0, len(solid), m)])

    def findings(self, islands: dict[str, Any], count: int, told: dict[str, Any]) -> dict[str, Any]:
        """What was found out while the layers were read; `count` is that of solid samples."""
        _, (hx, hy, hz), (nx, ny, nz) = self.samples
        volume = {
            "solid_voxels": count,
            "solid_share_of_box": count / (nx * ny * nz),
            "solid_volume_mm3": count * hx * hy * hz * self.unit_mm**3,
        }
        return islands | volume | told

    @property
    def is_kept(self) -> bool:
        """Whether its layers lie ready in this process, without islands, so that there is nothing left to evaluate."""
        return self._kept.layers is not None

    @property
    def survey(self) -> Survey | None:
        """What workers have found out in a first pass, if they have made one."""
        return self._kept.survey

    def keep(self, survey: Survey) -> None:
        """Know what workers have found out in a first pass."""
        self._kept.survey, self._kept.islands, self._kept.told = survey, survey.islands, survey.told

    def _cleaned(self, threads: int, found: dict[str, Any], told: dict[str, Any]) -> Iterator[BitSlab]:
        """The solid, without islands if they are to be removed; what was removed is added to `found`."""
        counts: dict[str, int] = {}
        if self.islands == "keep":
            yield from self.decided(threads, counts)
            told |= self.told(counts)
            return
        kept = self._kept
        if kept.layers is not None or kept.survey is not None:
            found |= kept.islands
            told |= kept.told
            if kept.layers is not None:
                yield from (kept.layers.slab(number) for number in range(len(kept.layers)))
            elif kept.survey is not None:
                yield from kept.survey.cleared(self, threads)
            return
        from sppm_pipeline.method.connectivity.streaming import IslandFilter

        nx, ny, _ = self.samples.shape
        spool = Spool()
        islands = IslandFilter(ny, nx)
        for start, solid in self.decided(threads, counts):
            islands.observe_bits(solid)
            spool.append(start, solid)
        found |= said_of(islands.finish("largest"))
        told |= self.told(counts)
        if not spool.whole:
            for start, solid in self.decided(threads, {}):
                islands.clear_bits(solid)
                yield start, solid
            return
        for number in range(len(spool)):
            start, solid = spool.slab(number)
            islands.clear_bits(solid)
            spool.replace(number, solid)
            yield start, solid
        kept.islands, kept.told = dict(found), dict(told)
        kept.layers = spool


def said_of(statistics: IslandStatistics) -> dict[str, Any]:
    """What findings say of islands."""
    return {
        "components": statistics.components,
        "removed_share": statistics.removed_share,
        "spans": list(statistics.spans),
    }


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

    def decided(
        self, threads: int, counts: dict[str, int], start: int = 0, stop: int | None = None, prepared: Any = None
    ) -> Iterator[BitSlab]:
        apart = threads > 1 and self.source.slabs_in_threads(self.samples)

        def slab(span: tuple[int, int]) -> BitSlab:
            return span[0], self.source.solid_bits(self.samples, *span, 1 if apart else threads)

        spans = self.spans(start, stop)
        if apart:
            yield from ordered_map(slab, spans, threads, ahead=threads - 1)
        else:  # whoever takes a slab looks for islands in it, by one thread
            yield from computed_ahead(map(slab, spans), threads)


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

    def _at_once(self) -> int:
        return VOTED_PIXELS if self.method == "vote" else SLAB_PIXELS

    def prepared(self) -> Any:
        from sppm_pipeline.method.part.inside import prepare_inside

        return prepare_inside(self.source.vertices, self.source.faces, self.samples, self.method)

    def decided(
        self, threads: int, counts: dict[str, int], start: int = 0, stop: int | None = None, prepared: Any = None
    ) -> Iterator[BitSlab]:
        from sppm_pipeline.method.part.inside import inside_layers
        from sppm_pipeline.method.part.ray_crossings import Scan
        from sppm_pipeline.method.part.scanline import scan_bits
        from sppm_pipeline.services.bit_rows import pack

        scan = self.prepared() if prepared is None else prepared
        for first, last in self.spans(start, stop):
            if isinstance(scan, Scan):
                yield first, scan_bits(scan, first, last)
                continue
            found = inside_layers(scan, first, last)
            counts["inside"] = counts.get("inside", 0) + int(np.count_nonzero(found.mask))
            counts["undecided"] = counts.get("undecided", 0) + found.undecided
            yield first, pack(found.mask)

    def told(self, counts: dict[str, int]) -> dict[str, Any]:
        if self.method == "scanline":
            return {}
        return {"undecided_share": counts.get("undecided", 0) / max(1, counts.get("inside", 0))}
