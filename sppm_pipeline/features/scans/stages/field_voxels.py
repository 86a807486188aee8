"""``field.voxels``: an image of voxels as a field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, Palette, ScalarField, Size, Voxels
from sppm_pipeline.features.scans.image_field import ImageStage
from sppm_pipeline.nouns import Geometry


@dataclass(frozen=True, kw_only=True)
class FieldVoxels(ImageStage):
    """Make a field of an image of voxels: a smooth surface between them, as meshes, layers, sizes and grids need it.

    The steps of an image of phases, of which all but 0 are solid, are smoothed by a Gaussian, and as much solid as
    before is kept. Of solid fractions the surface is where a cubic spline through them is one half.
    """

    name: ClassVar[str] = "field.voxels"
    reported: ClassVar[tuple[str, ...]] = ("porosity", "thin_share", "face_mismatch.#3", "removed_share")

    def estimate(self, palette: Palette, image: Size) -> Size:
        """The work of the image; how much surface it has is unknown."""
        return Size(voxels=image.voxels, resident=image.voxels, geometry=image.geometry or Geometry())

    def run(self, context: Context, image: Voxels) -> ScalarField:
        """Lay a spline through the voxels."""
        values = self.cropped(image.values, "the image")
        corner = self.crop[::2] if self.crop else (0, 0, 0)
        x, y, z = (i * h * image.physical for i, h in zip(corner, image.spacing, strict=True))
        return self.made(
            context, values if image.fractions else values > 0, 0.5 if image.fractions else None, "the image",
            spacing=image.spacing, physical=image.physical, periodic=all(image.periodic) and self.crop is None,
            origin=(x, y, z),
        )  # fmt: skip
