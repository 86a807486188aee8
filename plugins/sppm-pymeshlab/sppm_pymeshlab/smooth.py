"""``mesh.smooth``: noise is removed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import ConfigError, Context, Stage, SurfaceMesh, option, options
from sppm_pymeshlab.meshlab import worked


@dataclass(frozen=True, kw_only=True)
class SmoothMesh(Stage):
    """Smooth a surface without shrinking it (Taubin 1995): each round moves vertices inwards, then outwards again.

    Triangles stay who they are, so a closed mesh stays closed. MeshLab runs in a child process.
    """

    name: ClassVar[str] = "mesh.smooth"

    rounds: int = options.rounds(10, maximum=10_000, formerly="iterations")
    shrink: float = option(
        0.5, help="share of the way to the mean of its neighbors that a vertex moves", above=0, maximum=1
    )
    inflate: float = option(0.53, help="share of the way that it moves back; a little more than `shrink`", above=0)
    time_limit: float = options.time_limit(600.0)

    def check_options(self) -> None:
        if not self.shrink < self.inflate <= 2 * self.shrink:
            raise ConfigError(
                f"`inflate` must be more than `shrink` and at most twice as much, got {self.inflate:g} and "
                f"{self.shrink:g}",
                hint="0.5 and 0.53 let pass what is longer than about six edges",
            )

    def run(self, context: Context, mesh: SurfaceMesh) -> SurfaceMesh:
        """Smooth, and report volumes."""
        return worked(
            context,
            mesh,
            "smooth",
            self.time_limit,
            iterations=self.rounds,
            shrink=self.shrink,
            inflate=self.inflate,
        )
