"""Layers that are decided at sample points: those of a field, which is mesh-free slicing, and those of a mesh."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.nouns.printer import Printer
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.slicing.slice_stack import Pitched, Slab, Slabs
from sppm_pipeline.method.slicing.spool import Spool
from sppm_pipeline.services.arrays import U8, U64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.threads import computed_ahead

if TYPE_CHECKING:
    from sppm_pipeline.method.connectivity.streaming import IslandStatistics
    from sppm_pipeline.method.part.inside import Method
    from sppm_pipeline.method.slicing.slab_passes import IslandPass

SLAB_PIXELS = 2**22
"""Samples decided at a time; a slab holds at least one layer. Half as many, or twice, changes memory, hardly speed."""

WIDE_SLAB, WIDE_SLAB_PIXELS = 32, 3 * 2**29
"""Sheets of a wide field decided at a time, and their samples at most, of which 192 MB of bits are made.

Rows of such sheets are sampled some at a time, and what the sheets below have in common with them again: half of the
coarse samples for 16 sheets whose pixels are two thirds as far apart as these, a quarter for 32.
"""

VOTED_PIXELS = 2**25
"""The same for a vote of rays, which looks at all triangles for every slab."""


BitSlab = tuple[int, U64]
"""Index of the first sheet of samples, and the sheets as bits, see `services.bit_rows`."""


class _Kept:
    """Results of the first pass: the layers without islands, or the slabs that workers have kept, and the findings."""

    layers: Spool | None = None
    island_pass: IslandPass | None = None
    islands: dict[str, Any]
    summary: dict[str, Any]


@dataclass(frozen=True, eq=False, kw_only=True)
class SampledSlices(Pitched):
    """Base of layers decided at the mid-height of each, at the middle of the pixels or of their parts.

    A subclass decides which samples are solid. Islands are removed in a pass ahead of the delivering one; the
    layers are kept in between, and from then on for other readers, so that nothing is evaluated twice.
    """

    grid: Grid  # pixel centers of all layers, in the unit of the source
    pitch: tuple[float, float, float]  # pixel pitch along x and y, layer height, mm
    lower: tuple[float, float, float]  # world position of the low corner of the stack, mm
    islands: str  # "auto", as `connectivity.removal` limits it, "remove" or "keep"
    subsamples: int = 1  # for gray layers: each pixel is sampled on k x k points, its value is the solid fraction
    sublayers: int = 1  # for gray layers: so many heights of each layer are sampled
    machine: Printer | None = None  # the printer that the layers are cut for
    _kept: _Kept = field(default_factory=_Kept, init=False, compare=False, repr=False)

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
        """Data that `decided` needs for any sheet, made once for all readers."""
        return None

    @abstractmethod
    def decided(
        self, threads: int, counts: dict[str, int], start: int = 0, stop: int | None = None, prepared: Any = None
    ) -> Iterator[BitSlab]:
        """Slabs of bits, set where solid, of all samples, bottom first; its counts are added to `counts`.

        A slab begins with the first sheet of samples of a layer, and ends with the last one of a layer. Only the sheets
        start <= k < stop are decided, and are what they are among all.
        """

    def summary_of_counts(self, counts: dict[str, int]) -> dict[str, Any]:
        """Findings from the counts of `decided`."""
        return {}

    @property
    def height(self) -> int:
        """Sheets of samples that are decided at a time: some, or those of one layer."""
        nx, ny, _ = self.samples.shape
        # whole layers only, as the sheets of one layer become one picture
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

        They are shared and must not be changed.
        """
        return Slabs(self._watched(self._read_bits(threads)))

    def _read_bits(self, threads: int) -> Generator[BitSlab, None, dict[str, Any]]:
        from sppm_pipeline.services.bit_rows import count

        voxels = 0
        islands: dict[str, Any] = {}
        summary: dict[str, Any] = {}
        for start, solid in self._cleaned(threads, islands, summary):
            # after the removal: what is printed
            voxels += count(solid)
            yield start, solid
        return self.findings(islands, voxels, summary)

    def shaded(self, bits: U64) -> U8:
        """Layers as they are delivered from sheets of samples."""
        from sppm_pipeline.services.bit_rows import unpack

        if not self.gray:
            return unpack(bits, self.samples.shape[0], 255)
        from sppm_pipeline.method.assembly.occupancy import gray_by_coverage

        solid = unpack(bits, self.samples.shape[0])
        factor, m = (self.subsamples, self.subsamples), self.sublayers
        return np.stack([gray_by_coverage(solid[k : k + m], factor) for k in range(0, len(solid), m)])

    def porosity(self, solid: float, summary: dict[str, Any]) -> float | None:
        """Porosity of the whole part with so many solid samples; None if its volume is unknown."""
        return None

    def removal(self, statistics: IslandStatistics, summary: dict[str, Any]) -> dict[str, Any]:
        """Findings on the islands, before the first layer; an error if more is removed than `islands` allows."""
        from sppm_pipeline.method.connectivity.removal import check_removal

        solid, share = statistics.voxels, statistics.removed_share
        before, after = (self.porosity(count, summary) for count in (solid, solid * (1 - share)))
        check_removal(share, self.islands, None if before is None or after is None else (before, after))
        return summary_of(statistics)

    def findings(self, islands: dict[str, Any], count: int, summary: dict[str, Any]) -> dict[str, Any]:
        """Findings of a whole pass over the layers; `count` is that of solid samples."""
        _, (hx, hy, hz), (nx, ny, nz) = self.samples
        volume = {
            "solid_voxels": count,
            "solid_share_of_box": count / (nx * ny * nz),
            "solid_volume_mm3": count * hx * hy * hz * self.unit_mm**3,
        }
        return islands | volume | summary

    @property
    def is_kept(self) -> bool:
        """True if the layers without islands lie in this process, so that there is nothing left to evaluate."""
        return self._kept.layers is not None

    @property
    def island_pass(self) -> IslandPass | None:
        """Result of a first pass by workers, if they have made one."""
        return self._kept.island_pass

    def keep(self, island_pass: IslandPass) -> None:
        """Keep the result of a first pass by workers."""
        kept = self._kept
        kept.island_pass, kept.islands, kept.summary = island_pass, island_pass.islands, island_pass.summary

    def _cleaned(self, threads: int, found: dict[str, Any], summary: dict[str, Any]) -> Iterator[BitSlab]:
        """The solid, without islands if they are to be removed; findings on them are added to `found`."""
        counts: dict[str, int] = {}
        if self.islands == "keep":
            yield from self.decided(threads, counts)
            summary |= self.summary_of_counts(counts)
            return
        kept = self._kept
        if kept.layers is not None or kept.island_pass is not None:
            found |= kept.islands
            summary |= kept.summary
            if kept.layers is not None:
                yield from (kept.layers.slab(number) for number in range(len(kept.layers)))
            elif kept.island_pass is not None:
                yield from kept.island_pass.cleared(self, threads)
            return
        from sppm_pipeline.method.connectivity.streaming import IslandFilter

        # the last layer may join a piece of the first one to the largest component, so all are labeled before any goes
        nx, ny, _ = self.samples.shape
        spool = Spool()
        islands = IslandFilter(ny, nx)
        for start, solid in self.decided(threads, counts):
            islands.observe(solid)
            spool.append(start, solid)
        summary |= self.summary_of_counts(counts)
        found |= self.removal(islands.finish(), summary)
        if not spool.whole:  # the disk was full: the second pass evaluates the layers again
            for start, solid in self.decided(threads, {}):
                islands.clear(solid)
                yield start, solid
            return
        for number in range(len(spool)):
            start, solid = spool.slab(number)
            islands.clear(solid)
            spool.replace(number, solid)
            yield start, solid
        kept.islands, kept.summary = dict(found), dict(summary)
        # from now on the layers are read, not evaluated
        kept.layers = spool


def add_counts(counts: dict[str, int], more: dict[str, int]) -> None:
    """Add what another slab has counted; in place."""
    for name, count in more.items():
        counts[name] = counts.get(name, 0) + count


def summary_of(statistics: IslandStatistics) -> dict[str, Any]:
    """Findings on islands."""
    return {
        "components": statistics.components,
        "removed_share": statistics.removed_share,
        "spans": list(statistics.spans),
    }


@dataclass(frozen=True, eq=False, kw_only=True)
class FieldSlices(SampledSlices):
    """Sections of a field; its unit is the cell size."""

    source: ScalarField  # has a physical size

    @property
    def unit_mm(self) -> float:
        return self.source.physical_edge()

    def _at_once(self) -> int:
        if self.gray or not self.source.samples_by_rows(self.samples):
            return SLAB_PIXELS
        return min(WIDE_SLAB_PIXELS, WIDE_SLAB * math.prod(self.samples.shape[:2]))

    def decided(
        self, threads: int, counts: dict[str, int], start: int = 0, stop: int | None = None, prepared: Any = None
    ) -> Iterator[BitSlab]:
        def slab(span: tuple[int, int]) -> tuple[BitSlab, dict[str, int]]:
            asked = self.samples, *span, threads
            if isinstance(self.source, Part):
                solid, counted = self.source.counted_bits(*asked)
                return (span[0], solid), counted
            return (span[0], self.source.solid_bits(*asked)), {}

        # the reader of a slab looks for islands in it, by one thread
        slabs = computed_ahead(map(slab, self.spans(start, stop)), threads)
        for made, counted in slabs:
            add_counts(counts, counted)
            yield made

    def summary_of_counts(self, counts: dict[str, int]) -> dict[str, Any]:
        return dict(counts)

    def porosity(self, solid: float, summary: dict[str, Any]) -> float | None:
        domain = summary.get("domain", 0)
        return 1 - solid / domain if domain else None

    def findings(self, islands: dict[str, Any], count: int, summary: dict[str, Any]) -> dict[str, Any]:
        found = super().findings(islands, count, {})
        domain, skin = summary.get("domain", 0), summary.get("skin", 0)
        if not domain:
            return found
        # islands were counted as a share of the whole solid
        whole = count / (1 - islands.get("removed_share", 0.0)) if count else 0.0
        found |= {"porosity": 1 - count / domain, "porosity_with_islands": 1 - whole / domain}
        if skin and skin < domain:  # all void of the part lies beside its skin
            infill = domain - skin
            found["infill_porosity"] = (domain - count) / infill
            found["infill_porosity_with_islands"] = (domain - whole) / infill
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshSlices(SampledSlices):
    """Sections of a mesh, in mm; shells that overlap are united."""

    source: SurfaceMesh  # wound outwards
    method: Method = "scanline"  # of the inside test

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

    def summary_of_counts(self, counts: dict[str, int]) -> dict[str, Any]:
        if self.method == "scanline":
            return {}
        return {"undecided_share": counts.get("undecided", 0) / max(1, counts.get("inside", 0))}
