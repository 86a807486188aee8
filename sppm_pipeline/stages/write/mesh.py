"""``write.mesh``: a triangle mesh as STL, PLY, OBJ, OFF, 3MF or GLB."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any, ClassVar

import sppm_pipeline
from sppm_pipeline.data.mesh import RepeatedMesh, SurfaceMesh
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.families import options
from sppm_pipeline.families.file_writer import ADVICE, extension_of, require_format, require_triangles, write_pieces
from sppm_pipeline.stage import Context, Stage, option

ENCODERS = {".stl": "stl", ".ply": "ply", ".obj": "obj", ".off": "off", ".3mf": "three_mf_encode", ".glb": "glb_encode"}
"""Extension -> module of `sppm_pipeline.formats`."""

COPIES = (".3mf", ".glb")
"""Formats that hold a mesh once and place copies of it."""


@dataclass(frozen=True, kw_only=True)
class WriteMesh(Stage):
    """Write a triangle mesh; the extension chooses the format: binary STL or PLY, OBJ, OFF, 3MF or GLB.

    Coordinates are millimeters; a GLB is in meters with y up, as its specification says. What `extract.unit_cell` makes
    is written once, with a place for each copy, to a .3mf or .glb file; slicing programs unite solids that touch.
    """

    name: ClassVar[str] = "write.mesh"
    advice: ClassVar[str] = ADVICE

    path: str = options.write_path("mesh.stl", note=".stl, .ply, .obj, .off, .3mf or .glb")
    title: str | None = options.title(None, note="in a .3mf file; the name of the mesh if omitted")
    description: str | None = option(
        None, help="a sentence kept in a .3mf file, for instance the parameters of the design"
    )
    normals: bool = option(
        False, help="whether each vertex of a .glb file has a normal, so that viewers shade smoothly"
    )

    def check_options(self) -> None:
        require_format(self, self.path, ENCODERS, {"title": ".3mf", "description": ".3mf", "normals": ".glb"})
        for name, text in (("title", self.title), ("description", self.description)):
            if text is not None and not text.isprintable():
                raise ConfigError(f"`{name}` has characters that cannot be printed: {text!r}")

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        return Size(triangles=mesh.triangles, copies=mesh.copies)

    @property
    def rated_as(self) -> str:
        return f"write{extension_of(self.path)}" + (".normals" if self.normals else "")

    def run(self, context: Context, mesh: SurfaceMesh | RepeatedMesh) -> None:
        """Write the file."""
        extension = extension_of(self.path)
        once = mesh.mesh if isinstance(mesh, RepeatedMesh) else mesh
        options: dict[str, Any] = {"threads": context.threads}
        copies = 1
        require_triangles(once, self.path)
        if isinstance(mesh, RepeatedMesh):
            copies, options["offsets"] = len(mesh.offsets), mesh.offsets
            if not copies:
                raise DesignError(f"{once.name!r} has no copies: there is nothing to write to {self.path}")
            if extension not in COPIES:
                raise DesignError(
                    f"a {extension} file holds no copies of a mesh, and {once.name!r} stands at {copies} places",
                    hint="write a .3mf or .glb file, or extract the whole mesh by `extract.marching_cubes`",
                )
        if extension == ".3mf":
            options |= self._labels(once.name)
        elif extension == ".glb":
            options["normals"] = self.normals
        encode = importlib.import_module(f"sppm_pipeline.formats.{ENCODERS[extension]}").encode
        size = write_pieces(context, self.path, encode(once.vertices, once.faces, **options))
        context.report(bytes=size, triangles=copies * len(once.faces))
        if extension in COPIES:
            context.report(copies=copies)

    def _labels(self, mesh_name: str) -> dict[str, Any]:
        """Name and metadata of a 3MF."""
        name = "".join(c if c.isprintable() else "?" for c in mesh_name)
        about = {"Title": self.title or name, "Application": f"sppm_pipeline {sppm_pipeline.__version__}"}
        if self.description:
            about["Description"] = self.description
        return {"name": name, "metadata": about}
