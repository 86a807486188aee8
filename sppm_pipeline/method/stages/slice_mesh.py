"""``slice.mesh``: layers of any mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, DesignError, Length, Palette, Size, SliceStack, Stage, SurfaceMesh, option, options
from sppm_pipeline.method.families.inside_test import outward_mesh
from sppm_pipeline.method.nouns.printer import Printer, cut_for
from sppm_pipeline.method.slicing.sampled_slices import MeshSlices
from sppm_pipeline.method.slicing.slice_stack import stack_size
from sppm_pipeline.nouns.length import Pixel
from sppm_pipeline.services.grid import Grid, covering_voxels

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

    pixel: Pixel | None = options.pixel(None)
    layer: Length | None = options.layer(None)
    printer: str | None = options.printer(None, note="sets `pixel`")
    cards: Path | None = options.cards(None)
    anchor: str = option(
        "part",
        help="where pixels and layers are counted from: the low corner of the part, or the origin of the coordinates, "
        "so that several parts share one grid",
        choices=("part", "origin"),
    )
    islands: str = options.islands("keep")
    gray: int = options.gray(1, formerly="grey")
    gray_layers: int = options.gray_layers(1)
    inside: str = options.inside("auto")

    def check_options(self) -> None:
        self._cut()

    def _cut(self) -> tuple[Printer | None, tuple[float, float, float]]:
        return cut_for(self.printer, self.cards, self.pixel, self.layer)

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        made = stack_size(mesh.body.in_unit(1.0), self._cut()[1], self.gray, self.gray_layers, self.islands != "keep")
        return replace(made, triangles=mesh.triangles)

    def run(self, context: Context, mesh: SurfaceMesh) -> SliceStack:
        """Test the mesh and place the pixels; no layer is computed yet."""
        mesh, method = outward_mesh(context, mesh, self.inside)
        printer, pitch = self._cut()
        hx, hy, hz = pitch
        anchor = mesh.lower if self.anchor == "part" else np.zeros(3)
        (i, j, k), shape = covering_voxels(mesh.lower - anchor, mesh.upper - anchor, pitch)
        if shape[0] * shape[1] * self.gray**2 > MAX_PIXELS:
            raise DesignError(
                f"a layer would have {shape[0]} x {shape[1]} pixels of {hx:g} x {hy:g} mm, {self.gray} x {self.gray} "
                "samples each",
                hint="take a larger `pixel`, or check the unit of the mesh",
            )
        ox, oy, oz = anchor.tolist()
        x, y, z = lower = (ox + i * hx, oy + j * hy, oz + k * hz)
        stack = MeshSlices(
            source=mesh, grid=Grid((x + hx / 2, y + hy / 2, z + hz / 2), pitch, shape), pitch=pitch, lower=lower,
            islands=self.islands, subsamples=self.gray, sublayers=self.gray_layers, method=method, machine=printer,
        )  # fmt: skip
        return stack.require_room(self.cards)
