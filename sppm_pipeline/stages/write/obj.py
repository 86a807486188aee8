"""``write.obj``: a triangle mesh as Wavefront OBJ, a text that every program reads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.families import MeshWriter
from sppm_pipeline.stage import option


@dataclass(frozen=True, kw_only=True)
class WriteObj(MeshWriter):
    """Write a triangle mesh as Wavefront OBJ, a text that every program reads. Coordinates are millimeters."""

    name: ClassVar[str] = "write.obj"

    path: str = option("mesh.obj", help="file to write", output=True)

    def encode(self, mesh: SurfaceMesh, threads: int) -> Iterator[bytes | memoryview]:
        from sppm_pipeline.formats import obj

        return obj.encode(mesh.vertices, mesh.faces, threads=threads)
