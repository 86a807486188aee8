"""``write.3mf``: a triangle mesh as 3MF, the format of 3D printing programs, which knows its unit.

The file is called like the stage, as all are; a module whose name begins with a digit is loaded by that name
(``importlib.import_module("sppm_pipeline.stages.write.3mf")``), as the engine does, but cannot stand in an ``import``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import sppm_pipeline
from sppm_pipeline.data.mesh import RepeatedMesh, SurfaceMesh
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.families.mesh_writer import ADVICE, write_mesh, written
from sppm_pipeline.stage import Context, Stage, option


@dataclass(frozen=True, kw_only=True)
class WriteThreeMf(Stage):
    """Write a triangle mesh as 3MF, the format of 3D printing programs; its unit is the millimeter.

    What `extract.unit_cell` makes is written once and placed by a component for each cell. Slicing programs unite
    solids that touch.
    """

    name: ClassVar[str] = "write.3mf"
    advice: ClassVar[str] = ADVICE

    path: str = option("mesh.3mf", help="file to write", output=True)
    title: str | None = option(None, help="title of the file; the name of the mesh if omitted")
    description: str | None = option(
        None, help="a sentence kept in the file, for instance the parameters of the design"
    )

    def check_options(self) -> None:
        for name, text in (("title", self.title), ("description", self.description)):
            if text is not None and not text.isprintable():
                raise ConfigError(f"`{name}` has characters that cannot be printed: {text!r}")

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        return written(mesh)

    def run(self, context: Context, mesh: SurfaceMesh | RepeatedMesh) -> None:
        """Write the file."""
        from sppm_pipeline.formats.three_mf_encode import encode

        once = mesh.mesh if isinstance(mesh, RepeatedMesh) else mesh
        name = "".join(c if c.isprintable() else "?" for c in once.name)
        about = {"Title": self.title or name, "Application": f"sppm_pipeline {sppm_pipeline.__version__}"}
        if self.description:
            about["Description"] = self.description
        write_mesh(context, self.path, mesh, encode, name=name, metadata=about)
