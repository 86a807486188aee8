"""``fill.implicit``: microstructure AND part, decided point by point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from sppm_pipeline.data.length import Length
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.families import options
from sppm_pipeline.families.inside_test import outward_mesh
from sppm_pipeline.fields.part import Part
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.stage import Context, Stage

FEWEST_CELLS = 2
"""Along the longest side of a part; a smaller one is seldom meant."""


@dataclass(frozen=True, kw_only=True)
class ImplicitFill(Stage):
    """Intersect the implicit fields of the microstructure and of the part (paper, "Mesh-free Slicing").

    The field is not evaluated here; layers, meshes and pictures evaluate the part where they need it. A part that is
    not closed is tested on a coarse grid: its triangles are wound outwards, and it is filled where its winding number
    is above one half, or refused if too much of it is near one half.
    """

    name: ClassVar[str] = "fill.implicit"
    version: ClassVar[int] = 2

    skin: Length | None = options.skin(None, minimum=1e-3, maximum=1e4)
    islands: str = options.islands("remove", note="in the finished part")
    inside: str = options.inside("auto")

    def estimate(self, palette: Palette, field: Size, domain: Size) -> Size:
        body, part = field.body, domain.body.in_unit(field.body.scale)
        made = replace(body, box=part.box, volume=part.volume, envelope=part.envelope)
        return Size(nodes=domain.triangles / 2, design=field.design, geometry=made)

    def run(self, context: Context, field: ScalarField, domain: SurfaceMesh) -> Part:
        """Put the two together."""
        edge = field.physical_edge()
        domain, method = outward_mesh(context, domain, self.inside)
        extent = domain.upper - domain.lower if len(domain.faces) else None
        if extent is not None and extent.max() < FEWEST_CELLS * edge:
            context.warn(
                f"{domain.name} is {' x '.join(f'{side:.4g}' for side in extent)} mm in size, less than {FEWEST_CELLS} "
                f"cells of {edge:g} mm; if its file is in inches, `unit: in` of `read.mesh` makes it "
                f"{' x '.join(f'{25.4 * side:.4g}' for side in extent)} mm"
            )
        return Part(field, domain, self.skin.mm() if self.skin else 0.0, self.islands, method)
