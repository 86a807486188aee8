"""Layers of a field: mesh-free slicing."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.fields.slice_stack import Slab, SliceStack
from sppm_pipeline.numerics.grid import Grid

SLAB_PIXELS = 2**22
"""Pixels evaluated at a time; a slab holds at least one layer."""

KEPT_BITS = 2**30
"""Stacks up to this many voxels are kept, one bit each, between the two passes that remove islands."""


@dataclass(frozen=True, eq=False)
class FieldSlices(SliceStack):
    """Sections of a field at the mid-height of each layer; islands are removed in a pass ahead of the delivering one.

    Attributes
    ----------
    source : ScalarField
    grid : Grid
        Pixel centers of all layers, cell sizes.
    pixel, layer : float
        Pitch and height, mm.
    lower : tuple of 3 floats
        World position of the low corner of the stack, mm.
    islands : {"remove", "keep"}
    subsamples : int
        For gray layers: each pixel is sampled on k x k points, and its value is the solid fraction.
    """

    source: ScalarField
    grid: Grid
    pixel: float
    layer: float
    lower: tuple[float, float, float]
    islands: str = "remove"
    subsamples: int = 1

    @property
    def pixel_mm(self) -> float:
        return self.pixel

    @property
    def layer_mm(self) -> float:
        return self.layer

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.grid.shape

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.lower

    @property
    def gray(self) -> bool:
        return self.subsamples > 1

    def _fine(self) -> Grid:
        """The grid on which solid is decided: that of the pixels, or of their subsamples."""
        k = self.subsamples
        (x, y, z), (hx, hy, hz), (nx, ny, nz) = self.grid
        return Grid(
            (x - hx / 2 + hx / (2 * k), y - hy / 2 + hy / (2 * k), z), (hx / k, hy / k, hz), (nx * k, ny * k, nz)
        )

    def _solid(self, threads: int) -> Iterator[Slab]:
        fine = self._fine()
        nx, ny, nz = fine.shape
        step = max(1, SLAB_PIXELS // (nx * ny))
        for start in range(0, nz, step):
            yield start, self.source.solid_layers(fine, start, min(start + step, nz), threads)

    def read(self, threads: int) -> Generator[Slab, None, dict[str, Any]]:
        count = 0
        findings: dict[str, Any] = {}
        for start, solid in self._cleaned(threads, findings):
            count += int(np.count_nonzero(solid))
            if self.subsamples > 1:
                from sppm_pipeline.numerics.domain.occupancy import gray_by_coverage

                factor = (self.subsamples, self.subsamples)
                yield start, np.stack([gray_by_coverage(layer, factor) for layer in solid])
            else:
                np.multiply(solid, np.uint8(255), out=solid)
                yield start, solid
        _, (hx, hy, hz), (nx, ny, nz) = self._fine()
        edge = self.source.edge_mm or 1.0
        return findings | {
            "solid_voxels": count,
            "solid_share_of_box": count / (nx * ny * nz),
            "solid_volume_mm3": count * hx * hy * hz * edge**3,
        }

    def _cleaned(self, threads: int, findings: dict[str, Any]) -> Iterator[Slab]:
        """The solid, without islands if they are to be removed; what was removed is added to `findings`."""
        if self.islands == "keep":
            yield from self._solid(threads)
            return
        from sppm_pipeline.numerics.connectivity.streaming import IslandFilter

        nx, ny, nz = self._fine().shape
        keep_bits = nx * ny * nz <= KEPT_BITS
        kept: list[tuple[int, NDArray[np.uint8], tuple[int, ...]]] = []
        islands = IslandFilter(ny, nx)
        for start, solid in self._solid(threads):
            islands.observe(solid)
            if keep_bits:
                kept.append((start, np.packbits(solid), solid.shape))
        statistics = islands.finish("largest")
        findings["components"] = statistics.components
        findings["removed_share"] = statistics.removed_share
        findings["spans"] = list(statistics.spans)
        again: Iterator[Slab] = (
            ((start, np.unpackbits(bits, count=int(np.prod(shape))).reshape(shape)) for start, bits, shape in kept)
            if keep_bits
            else self._solid(threads)
        )
        for start, solid in again:
            yield start, islands.clear(solid)
