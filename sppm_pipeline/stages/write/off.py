"""``write.off``: a triangle mesh as OFF, the plain text of computational geometry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.families import MeshWriter
from sppm_pipeline.stage import option


@dataclass(frozen=True, kw_only=True)
class WriteOff(MeshWriter):
    """Write a triangle mesh as OFF, the plain text of computational geometry. Coordinates are millimeters."""

    name: ClassVar[str] = "write.off"

    path: str = option("mesh.off", help="file to write", output=True)

    def encode(self, mesh: SurfaceMesh, threads: int) -> Iterator[bytes | memoryview]:
        from sppm_pipeline.formats import off

        return off.encode(mesh.vertices, mesh.faces, threads=threads)
