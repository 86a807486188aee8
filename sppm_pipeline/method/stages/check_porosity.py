"""``check.porosity``: the void fraction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, Palette, Rejected, ScalarField, Size, Stage, option, options
from sppm_pipeline.services.grid import Grid


@dataclass(frozen=True, kw_only=True)
class CheckPorosity(Stage):
    """Measure the porosity of a field on a grid of voxel centers; reject it outside of given bounds."""

    name: ClassVar[str] = "check.porosity"
    reported: ClassVar[tuple[str, ...]] = ("porosity",)

    resolution: int = options.resolution(48)
    minimum: float = option(0.0, help="smallest porosity accepted", minimum=0, maximum=1)
    maximum: float = option(1.0, help="largest porosity accepted", minimum=0, maximum=1)

    def estimate(self, palette: Palette, field: Size) -> Size:
        return field.grid(self.resolution, at_once=field.body.samples(self.resolution) / field.body.box[2])

    def run(self, context: Context, field: ScalarField) -> None:
        """Count, one layer of cells after the other."""
        n, (nx, ny, nz) = self.resolution, field.cells
        h = 1.0 / n
        solid = 0
        for k in range(nz):
            solid += int(
                field.solid(Grid((h / 2, h / 2, k + h / 2), (h,) * 3, (nx * n, ny * n, n)), context.threads).sum()
            )
            context.progress(k + 1, nz, "layers of cells")
        porosity = 1 - solid / (nx * ny * nz * n**3)
        context.report(porosity=porosity)
        if not self.minimum <= porosity <= self.maximum:
            raise Rejected(f"the porosity is {porosity:.4f}; accepted are {self.minimum:g} to {self.maximum:g}")
