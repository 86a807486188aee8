"""Base class of stages that write a volume mesh: one method names the encoder."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.data.volume_mesh import VolumeMesh
from sppm_pipeline.stage import Context, Stage


@dataclass(frozen=True, kw_only=True)
class VolumeMeshWriter(Stage):
    """Base of writers of volume meshes: implement `encode` and declare the option `path`."""

    path: str
    advice: ClassVar[str] = "mesh with a lower `resolution`"

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        return Size(tetrahedra=mesh.tetrahedra, nodes=mesh.nodes, mid_nodes=mesh.mid_nodes)

    @abstractmethod
    def encode(self, mesh: VolumeMesh) -> Iterator[bytes]:
        """The content of the file, piece by piece."""

    def run(self, context: Context, mesh: VolumeMesh) -> None:
        """Write the file chunk by chunk."""
        size = 0
        with context.output(self.path).open("wb") as file:
            for chunk in self.encode(mesh):
                size += file.write(chunk)
        context.report(bytes=size, cells=len(mesh.cells), nodes=len(mesh.nodes))
