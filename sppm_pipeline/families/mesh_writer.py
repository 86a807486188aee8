"""Base class of stages that write a triangle mesh: one method names the encoder."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.estimate import Estimate, Given
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.stage import Context, Stage

__all__ = ["MeshWriter"]


@dataclass(frozen=True, kw_only=True)
class MeshWriter(Stage):
    """Base of mesh writers: implement `encode` and declare the option `path`."""

    path: str

    bytes_of_a_triangle: ClassVar[float] = 50.0

    def estimate(self, given: Given) -> Estimate:
        triangles = given["mesh"]["triangles"]
        return Estimate(
            disk=84 + self.bytes_of_a_triangle * triangles, memory=30e6, seconds=1.5e-7 * triangles,
            advice="extract with a lower `resolution`, or slice without a mesh (`slice.field`)",
        )  # fmt: skip

    @abstractmethod
    def encode(self, mesh: SurfaceMesh) -> Iterator[bytes]:
        """The content of the file, piece by piece."""

    def run(self, context: Context, mesh: SurfaceMesh) -> None:
        """Write the file chunk by chunk."""
        size = 0
        with context.output(self.path).open("wb") as file:
            for chunk in self.encode(mesh):
                size += file.write(chunk)
        context.report(bytes=size, triangles=len(mesh.faces))
