"""``write.stl``: a triangle mesh as binary STL, the format that slicers read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.families import MeshWriter
from sppm_pipeline.stage import option


@dataclass(frozen=True, kw_only=True)
class WriteStl(MeshWriter):
    """Write a triangle mesh as binary STL, the format that slicers read. Coordinates are millimeters."""

    name: ClassVar[str] = "write.stl"

    path: str = option("mesh.stl", help="file to write", output=True)

    def encode(self, mesh: SurfaceMesh, threads: int) -> Iterator[bytes | memoryview]:
        from sppm_pipeline.formats import stl

        return stl.encode(mesh.vertices, mesh.faces, threads=threads)
