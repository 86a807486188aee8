"""``write.vtu``: a volume mesh for ParaView and other programs that build on VTK."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePath
from typing import ClassVar

from sppm_pipeline.data.volume_mesh import VolumeMesh
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.families import VolumeMeshWriter
from sppm_pipeline.stage import option


@dataclass(frozen=True, kw_only=True)
class WriteVtu(VolumeMeshWriter):
    """Write a volume mesh as binary VTU, or as a legacy VTK file if the name ends so. Coordinates are millimeters."""

    name: ClassVar[str] = "write.vtu"

    path: str = option("mesh.vtu", help="file to write: .vtu or .vtk", output=True)
    compress: bool = option(
        False, help="make a .vtu file smaller; its bytes then depend on the version of the library zlib"
    )

    def check_options(self) -> None:
        kind = PurePath(self.path).suffix.lower()
        if kind not in (".vtu", ".vtk"):
            raise ConfigError(f"`path` is {self.path!r}; it must end in .vtu or .vtk")
        if kind == ".vtk" and self.compress:
            raise ConfigError("a legacy VTK file cannot be compressed", hint="leave out `compress`, or write a .vtu")

    def encode(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_pipeline.formats import vtk, vtu

        if PurePath(self.path).suffix.lower() == ".vtk":
            return vtk.encode(mesh.nodes, mesh.cells, mesh.material_of_cells)
        return vtu.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, self.compress)
