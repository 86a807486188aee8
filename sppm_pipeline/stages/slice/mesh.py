"""``slice.mesh``: layers of any mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from sppm_pipeline.data.length import Length
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.errors import DesignError
from sppm_pipeline.families import options
from sppm_pipeline.families.inside_test import outward_mesh
from sppm_pipeline.fields.mesh_slices import MeshSlices
from sppm_pipeline.fields.slice_stack import SliceStack, stack_size
from sppm_pipeline.stage import Context, Stage, option

MAX_PIXELS = 2**31
"""Pixels of a layer; more are a mistaken unit."""


@dataclass(frozen=True, kw_only=True)
class SliceMesh(Stage):
    """Cut a mesh into layers, each at its mid-height: a pixel is solid if its middle lies in the mesh.

    Shells that overlap are united. Layers are computed while they are written; memory does not grow with their number.
    A mesh that is not closed is tested as `fill.implicit` does.
    """

    name: ClassVar[str] = "slice.mesh"
    advice: ClassVar[str] = "give a larger `pixel` or `layer`"

    pixel: Length = options.pixel()
    layer: Length | None = options.layer(None)
    anchor: str = option(
        "part",
        help="where pixels and layers are counted from: the low corner of the part, or the origin of the coordinates, "
        "so that several parts share one grid",
        choices=("part", "origin"),
    )
    gray: int = options.gray(1, formerly="grey")
    inside: str = options.inside("auto")

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        layer = self.layer if self.layer is not None else self.pixel
        made = stack_size(mesh.body.in_unit(1.0), self.pixel.mm(), layer.mm(), self.gray)
        return replace(made, triangles=mesh.triangles)

    def run(self, context: Context, mesh: SurfaceMesh) -> SliceStack:
        """Test the mesh and place the pixels; no layer is computed yet."""
        mesh, method = outward_mesh(context, mesh, self.inside)
        pixel = self.pixel.mm()
        layer = self.layer.mm() if self.layer is not None else pixel
        pitch = (pixel, pixel, layer)
        start = mesh.lower.tolist() if self.anchor == "part" else [0.0, 0.0, 0.0]
        # whole pixels; a millionth of one is rounding, not part
        first = [math.floor((v - s) / h + 1e-6) for v, s, h in zip(mesh.lower, start, pitch, strict=True)]
        last = [math.ceil((v - s) / h - 1e-6) for v, s, h in zip(mesh.upper, start, pitch, strict=True)]
        nx, ny, nz = (max(1, b - a) for a, b in zip(first, last, strict=True))
        if nx * ny * self.gray**2 > MAX_PIXELS:
            raise DesignError(
                f"a layer would have {nx} x {ny} pixels of {pixel:g} mm, {self.gray} x {self.gray} samples each",
                hint="take a larger `pixel`, or check the unit of the mesh",
            )
        x, y, z = (s + a * h for s, a, h in zip(start, first, pitch, strict=True))
        return MeshSlices(mesh, pixel, layer, (x, y, z), (nx, ny, nz), method, self.gray)
