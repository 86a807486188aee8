"""``read.primitive``: a part without a file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.estimate import Estimate, Given
from sppm_pipeline.data.length import Length
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.stage import Context, Stage, option

SHAPES = ("box", "ball", "cylinder", "torus", "torus_knot")


@dataclass(frozen=True, kw_only=True)
class ReadPrimitive(Stage):
    """Make a watertight mesh of a simple body standing on the build plate, centered on the z axis."""

    name: ClassVar[str] = "read.primitive"

    shape: str = option(help="which body", choices=SHAPES)
    size: tuple[Length, Length, Length] = option(
        help="box that the body just fills, along x, y, z", unit="mm", minimum=1e-3, maximum=1e5
    )
    facets: int = option(128, help="straight edges around a full turn of a round body", minimum=8, maximum=4096)

    def estimate(self, given: Given) -> Estimate:
        n = self.facets
        sx, sy, sz = (length.mm() for length in self.size)
        triangles = {
            "box": 12,
            "ball": 20 * 4 ** max(1, round(math.log2(n / 5))),
            "cylinder": 4 * n,
            "torus": n * n,
            "torus_knot": 4 * n * n,
        }[self.shape]
        # shares of the box: of its volume, and of the surface of its six sides
        filled, surface = {
            "box": (1.0, 1.0),
            "ball": (0.524, 0.524),
            "cylinder": (0.785, 0.785),
            "torus": (0.55, 0.9),
            "torus_knot": (0.35, 1.1),
        }[self.shape]
        return Estimate(
            makes={
                "triangles": triangles,
                "size_mm": (sx, sy, sz),
                "volume_mm3": filled * sx * sy * sz,
                "area_mm2": surface * 2 * (sx * sy + sy * sz + sz * sx),
            },
            keeps=24 * triangles,
            memory=200 * triangles,
            seconds=3e-7 * triangles,
            advice="lower `facets`",
        )

    def run(self, context: Context) -> SurfaceMesh:
        """Make the mesh."""
        from sppm_pipeline.numerics.domain import primitive_meshes as make

        sx, sy, sz = (length.mm() for length in self.size)
        middle, around = (0.0, 0.0, 0.0), self.facets
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
        return SurfaceMesh(placed, faces, name=self.shape)
