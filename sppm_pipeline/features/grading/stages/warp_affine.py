"""``warp.affine``: cells are stretched along axes and turned, everywhere alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, Palette, ScalarField, Size, SurfaceMesh, option, options
from sppm_pipeline.features.grading.curved_cells import AffineCells
from sppm_pipeline.features.grading.warper import Warper
from sppm_pipeline.method.families.tiler import tiling_size
from sppm_pipeline.method.nouns.stiffness_design import StiffnessDesign


@dataclass(frozen=True, kw_only=True)
class WarpAffine(Warper):
    """Stretch cells along x, y and z, and then turn them, everywhere alike; the porosity stays.

    After `design.stiffness` the stretch and the rotation are those of the design where the options are omitted. The
    stiffness of what comes out is exactly that of the stretched cell, turned. Cells that repeat fill a part that was
    read before; a box of others is stretched and turned about its middle.
    """

    name: ClassVar[str] = "warp.affine"
    reported: ClassVar[tuple[str, ...]] = ("volume_min", "volume_max")

    stretch: tuple[float, float, float] | None = option(
        None, help="how many times longer; cells, along x, y and z", minimum=0.05, maximum=20
    )
    turn: tuple[float, float, float] | None = options.turn(None, note="by which what was stretched is turned")

    def check_options(self) -> None:
        """Sizes of pores are those of the stretched cell."""
        if self.sizes == "fixed":
            raise ConfigError("`warp.affine` stretches pores with their cells", hint="leave out `sizes`")

    def estimate(self, palette: Palette, field: Size, cover: Size | None = None, design: Size | None = None) -> Size:
        return field if cover is None else tiling_size(None, None, cover, field)

    def run(
        self, context: Context, field: ScalarField, cover: SurfaceMesh | None = None,
        design: StiffnessDesign | None = None,
    ) -> ScalarField:  # fmt: skip
        """Bend the field."""
        if field.edge_mm is None:
            raise ConfigError("the size of a cell is missing", hint="give the `tile` stage `cell: 5 mm`")
        return self._with_field(context, field, self._cells(field, cover, design))

    def curved(self, field: ScalarField) -> AffineCells:
        return self._cells(field, None, None)

    def _cells(self, field: ScalarField, cover: SurfaceMesh | None, design: StiffnessDesign | None) -> AffineCells:
        from scipy.spatial.transform import Rotation

        stretch = self.stretch or ((1.0, 1.0, 1.0) if design is None else design.stretch)
        if self.turn is None:
            rotation = np.eye(3) if design is None else design.rotation
        else:
            rotation = Rotation.from_euler("xyz", self.turn, degrees=True).as_matrix()
        edge, origin = field.physical_edge(), np.array(field.origin_mm)
        region = np.array([cover.lower, cover.upper]) if cover is not None and field.periodic else None
        middle = origin + edge * np.array(field.cells) / 2 if region is None else region.mean(0)
        return AffineCells(field.cells, edge, 0.0, 0.0, rotation * np.asarray(stretch), middle, region)
