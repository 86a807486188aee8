"""``write.ply``: a triangle mesh as binary PLY, small and exact."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.families import MeshWriter
from sppm_pipeline.stage import option


@dataclass(frozen=True, kw_only=True)
class WritePly(MeshWriter):
    """Write a triangle mesh as binary PLY, small and exact. Coordinates are millimeters."""

    name: ClassVar[str] = "write.ply"

    path: str = option("mesh.ply", help="file to write", output=True)

    def encode(self, mesh: SurfaceMesh, threads: int) -> Iterator[bytes | memoryview]:
        from sppm_pipeline.formats import ply

        return ply.encode(mesh.vertices, mesh.faces, threads=threads)
