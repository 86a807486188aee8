"""``read.primitive``: a part without a file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, Length, Palette, Size, Stage, SurfaceMesh, option, options
from sppm_pipeline.nouns.size import Geometry
from sppm_pipeline.services.arrays import F64, I32

SHAPES = ("box", "ball", "cylinder", "torus", "torus_knot")


@dataclass(frozen=True, kw_only=True)
class ReadPrimitive(Stage):
    """Make a watertight mesh of a simple body standing on the build plate, centered on the z axis."""

    name: ClassVar[str] = "read.primitive"
    reported: ClassVar[tuple[str, ...]] = ()
    advice: ClassVar[str] = "lower `facets`"

    shape: str = option(help="which body", choices=SHAPES)
    size: tuple[Length, Length, Length] = options.size()
    facets: int = option(128, help="straight edges around a full turn of a round body", minimum=8, maximum=4096)

    def estimate(self, palette: Palette) -> Size:
        """From coarse meshes of the same body: the number of triangles grows with a power of `facets`."""
        from sppm_pipeline.services.mesh.measures import surface_area, volume

        facets = 5 * 2.0 ** max(1, round(math.log2(self.facets / 5))) if self.shape == "ball" else self.facets
        fewer, more = self._mesh(min(self.facets, 20))[1], self._mesh(min(self.facets, 40))
        growth = math.log2(len(more[1]) / len(fewer)) if self.facets >= 40 else 0.0
        x, y, z = (length.mm() for length in self.size)
        part = Geometry(edge_mm=1.0, box=(x, y, z), volume=volume(*more), envelope=surface_area(*more))
        return Size(triangles=len(more[1]) * max(1.0, facets / 40) ** growth, geometry=part)

    def run(self, context: Context) -> SurfaceMesh:
        """Make the mesh."""
        return SurfaceMesh(*self._mesh(self.facets), name=self.shape)

    def _mesh(self, around: int) -> tuple[F64, I32]:
        """Vertices and faces of the placed body with so many edges around a full turn."""
        from sppm_pipeline.method.part import primitive_meshes as make

        sx, sy, sz = (length.mm() for length in self.size)
        middle = (0.0, 0.0, 0.0)
        if self.shape == "box":
            vertices, faces = make.box_mesh(middle, (1.0, 1.0, 1.0))
        elif self.shape == "ball":
            # an icosahedron has about five edges around; each subdivision doubles them
            vertices, faces = make.ball_mesh(middle, 1.0, max(1, round(math.log2(around / 5))))
        elif self.shape == "cylinder":
            vertices, faces = make.cylinder_mesh(middle, 1.0, 1.0, around)
        elif self.shape == "torus":
            vertices, faces = make.torus_mesh(middle, 1.0, 0.4, around, around // 2)
        else:
            vertices, faces = make.torus_knot_mesh(middle, tube=0.35, segments=4 * around, sides=around // 2)
        lower, upper = vertices.min(0), vertices.max(0)
        placed = (vertices - (lower + upper) / 2) / (upper - lower) * [sx, sy, sz] + [0, 0, sz / 2]
        return placed, faces
