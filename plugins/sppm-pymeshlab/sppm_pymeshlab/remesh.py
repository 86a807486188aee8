"""``mesh.remesh``: triangles of even size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, DesignError, Length, Stage, SurfaceMesh, option, options
from sppm_pymeshlab.meshlab import LARGEST, worked


@dataclass(frozen=True, kw_only=True)
class Remesh(Stage):
    """Remesh a surface with triangles of even size (isotropic explicit remeshing, Botsch and Kobbelt 2004).

    Edges are split, collapsed and flipped, and vertices moved along the surface, until edges are about as long as
    requested. Creases stay. A closed mesh stays closed, or the stage fails. MeshLab runs in a child process.
    """

    name: ClassVar[str] = "mesh.remesh"

    edge_length: Length = option(help="length of the edges", unit="mm", above=0, formerly="edge")
    rounds: int = options.rounds(
        10, note="of splitting, collapsing, flipping and moving", maximum=200, formerly="iterations"
    )
    feature_angle: float = option(
        30.0, help="edges where the surface bends by more are creases and stay", unit="degrees", minimum=0, maximum=180
    )
    deviation: Length | None = option(
        None, help="largest distance from the old surface; a tenth of `edge_length` if omitted", unit="mm", above=0
    )
    adaptive: bool = option(False, help="shorter edges where the surface bends more")
    time_limit: float = options.time_limit(600.0)

    def run(self, context: Context, mesh: SurfaceMesh) -> SurfaceMesh:
        """Remesh, and report edges and volumes."""
        from sppm_pipeline.numerics import mesh_area as surface_area

        edge = self.edge_length.mm()
        expected = surface_area(mesh.vertices, mesh.faces) / (3**0.5 / 4 * edge**2)
        if expected > LARGEST:
            raise DesignError(
                f"edges of {self.edge_length} would make about {expected:.2g} triangles; at most {LARGEST} are allowed",
                hint="give a longer `edge_length`",
            )
        return worked(
            context,
            mesh,
            "remesh",
            self.time_limit,
            edge=edge,
            iterations=self.rounds,
            feature_angle=self.feature_angle,
            deviation=self.deviation.mm() if self.deviation is not None else edge / 10,
            adaptive=self.adaptive,
        )
