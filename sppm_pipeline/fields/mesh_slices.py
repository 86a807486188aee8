"""Layers of a mesh: what is inside, at the middle of each pixel and layer."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.fields.slice_stack import Slab, SliceStack
from sppm_pipeline.numerics.grid import Grid

if TYPE_CHECKING:
    from sppm_pipeline.numerics.domain.inside import Method

SLAB_PIXELS = 2**22
"""Pixels scanned at a time; a slab holds at least one layer."""

VOTED_PIXELS = 2**25
"""The same for a vote, which looks at all triangles for every slab."""


@dataclass(frozen=True, eq=False)
class MeshSlices(SliceStack):
    """Sections of a mesh at the mid-height of each layer; shells that overlap are united.

    Attributes
    ----------
    source : SurfaceMesh
        Wound outwards.
    pixel, layer : float
        Pitch and height, mm.
    lower : tuple of 3 floats
        World position of the low corner of the stack, mm.
    size : tuple of 3 ints
        Pixels along x and y, number of layers.
    method : {"scanline", "winding", "vote"}
        Method of the inside test.
    subsamples : int
        For gray layers: each pixel is sampled on k x k points, and its value is the solid fraction.
    """

    source: SurfaceMesh
    pixel: float
    layer: float
    lower: tuple[float, float, float]
    size: tuple[int, int, int]
    method: Method = "scanline"
    subsamples: int = 1

    @property
    def pixel_mm(self) -> float:
        return self.pixel

    @property
    def layer_mm(self) -> float:
        return self.layer

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.size

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.lower

    @property
    def gray(self) -> bool:
        return self.subsamples > 1

    def samples(self) -> Grid:
        """Where the mesh is sampled: in the middle of the pixels or of their parts, mm."""
        (x, y, z), (nx, ny, nz), k = self.lower, self.size, self.subsamples
        h = self.pixel / k
        return Grid((x + h / 2, y + h / 2, z + self.layer / 2), (h, h, self.layer), (nx * k, ny * k, nz))

    def read(self, threads: int) -> Generator[Slab, None, dict[str, Any]]:
        from sppm_pipeline.numerics.domain.inside import inside_layers, prepare_inside
        from sppm_pipeline.numerics.domain.occupancy import gray_by_coverage

        grid = self.samples()
        nx, ny, nz = grid.shape
        scan = prepare_inside(self.source.vertices, self.source.faces, grid, self.method)
        step = max(1, (VOTED_PIXELS if self.method == "vote" else SLAB_PIXELS) // (nx * ny))
        count = undecided = 0
        for start in range(0, nz, step):
            found = inside_layers(scan, start, min(start + step, nz))
            inside = found.mask
            count += int(np.count_nonzero(inside))
            undecided += found.undecided
            if self.subsamples > 1:
                factor = (self.subsamples, self.subsamples)
                yield start, np.stack([gray_by_coverage(layer, factor) for layer in inside])
            else:
                np.multiply(inside, np.uint8(255), out=inside)
                yield start, inside
        hx, hy, hz = grid.spacing
        findings = {
            "solid_voxels": count,
            "solid_share_of_box": count / (nx * ny * nz),
            "solid_volume_mm3": count * hx * hy * hz,
        }
        return findings if self.method == "scanline" else findings | {"undecided_share": undecided / max(1, count)}
