"""``fill.implicit``: microstructure AND part, decided point by point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sppm_pipeline.data.length import Length
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.families import options
from sppm_pipeline.families.inside_test import outward_mesh
from sppm_pipeline.fields.part import Part
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.stage import Context, Headline, Stage, option

FEWEST_CELLS = 2
"""Along the longest side of a part; a smaller one is seldom meant."""

NOTICED = 5e-3
"""Sealed void that is warned about, as a fraction of the part's bounding box; less is a voxel's doubt."""


@dataclass(frozen=True, kw_only=True)
class ImplicitFill(Stage):
    """Intersect the implicit fields of the microstructure and of the part (paper, "Mesh-free Slicing").

    The field is not evaluated here; layers, meshes and pictures evaluate the part where they need it. A part that is
    not closed is tested on a coarse grid: its triangles are wound outwards, and it is filled where its winding number
    is above one half, or refused if too much of it is near one half.

    A skin closes what it covers: how much void it seals, in which liquid resin or powder stays, is measured on a coarse
    grid and warned about. `check.print` measures it on the layers. `drains` open it: they win over skin and
    microstructure, where the part is, in the coordinates of the part.
    """

    name: ClassVar[str] = "fill.implicit"
    version: ClassVar[int] = 2
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("turned_triangles", "turned triangles"), Headline("skin_mm", "skin", "mm"),
        Headline("sealed_mm3", "void sealed by it", "mm^3"),
    )  # fmt: skip

    skin: Length | None = options.skin(None, minimum=1e-3, maximum=1e4)
    drains: tuple[tuple[float, float, float, float, float, float, float], ...] = option(
        (),
        help="holes through skin and microstructure: [x, y, z, x, y, z, radius], a ball that moves between two points",
        unit="mm",
        minimum=-1e5,
        maximum=1e5,
    )
    islands: str = options.islands("remove", note="in the finished part")
    inside: str = options.inside("auto")

    def check_options(self) -> None:
        """Drains that are open."""
        for number, drain in enumerate(self.drains, 1):
            if drain[6] <= 0:
                raise ConfigError(f"the radius of drain {number} is {drain[6]:g} mm; it must be above 0")

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
        part = Part(field, domain, self.skin.mm() if self.skin else 0.0, self.islands, method, self.drains)
        if part.skin_mm:
            sealed = sealed_void(part, context.threads)
            context.report(sealed_mm3=sealed)
            if sealed > NOTICED * float(np.prod(domain.upper - domain.lower)):
                context.warn(
                    f"the skin of {part.skin_mm:g} mm seals about {sealed:.3g} mm3 of void, in which liquid resin or "
                    "powder stays; give `drains` a hole for each of them, or leave out `skin`"
                )
        return part


def sealed_void(part: Part, threads: int) -> float:
    """Volume of the void of a part that opens nowhere, mm3, on a coarse grid."""
    from sppm_pipeline.numerics.printing.routes import find_traps

    solid, grid = part.coarse_solid(threads)
    return float(find_traps(solid).sizes.sum()) * math.prod(grid.spacing)
