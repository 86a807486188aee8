"""Base class of stages that write a volume mesh: one method names the encoder."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.estimate import Estimate, Given
from sppm_pipeline.data.volume_mesh import VolumeMesh
from sppm_pipeline.stage import Context, Stage


@dataclass(frozen=True, kw_only=True)
class VolumeMeshWriter(Stage):
    """Base of writers of volume meshes: implement `encode` and declare the option `path`."""

    path: str

    bytes_of_a_node: ClassVar[float] = 24.0
    bytes_of_a_corner: ClassVar[float] = 4.0
    bytes_of_a_cell: ClassVar[float] = 10.0
    seconds_of_a_cell: ClassVar[float] = 1e-7
    memory_of_a_cell: ClassVar[float] = 30.0

    def estimate(self, given: Given) -> Estimate:
        facts = given["mesh"]
        cells, nodes = facts["cells"], facts["nodes"]
        a_cell = self.bytes_of_a_cell + self.bytes_of_a_corner * (4 if facts["order"] == 1 else 10)
        return Estimate(
            disk=1500 + self.bytes_of_a_node * nodes + a_cell * cells,
            memory=self.memory_of_a_cell * cells + 10e6,
            seconds=0.01 + self.seconds_of_a_cell * (cells + nodes),
            advice="mesh with a lower `resolution`",
        )

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
