"""``write.mesh``: a triangle mesh as STL, PLY, OBJ, OFF, 3MF or GLB."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import sppm_pipeline
from sppm_pipeline import ConfigError, Context, DesignError, Palette, Size, Stage, SurfaceMesh, option, options
from sppm_pipeline.method.families.file_writer import (
    ADVICE,
    extension_of,
    require_format,
    require_triangles,
    write_pieces,
)
from sppm_pipeline.method.nouns.mesh import RepeatedMesh

if TYPE_CHECKING:
    from sppm_pipeline.features.files.piece_file import PieceFile

ENCODERS = {
    ".stl": "sppm_pipeline.services.formats.stl",
    ".ply": "sppm_pipeline.services.formats.ply",
    ".obj": "sppm_pipeline.features.files.formats.obj",
    ".off": "sppm_pipeline.features.files.formats.off",
    ".3mf": "sppm_pipeline.features.files.formats.three_mf_encode",
    ".glb": "sppm_pipeline.features.files.formats.glb_encode",
}
"""Extension -> module that encodes it."""

IN_PIECES = (".stl", ".ply", ".obj")
"""Formats that can be written while the mesh is made."""


@dataclass(frozen=True, kw_only=True)
class WriteMesh(Stage):
    """Write a triangle mesh; the extension chooses the format: binary STL or PLY, OBJ, OFF, 3MF or GLB.

    Coordinates are millimeters; a GLB is in meters with y up, as its specification says. The copies that
    `extract.unit_cell` places become one object of touching solids, which slicing programs unite. A .glb file holds
    their mesh once and places it, and so does a .3mf file with `copies: components`, which slicing programs may take
    for many parts to be laid side by side.
    """

    name: ClassVar[str] = "write.mesh"
    advice: ClassVar[str] = ADVICE

    path: str = options.write_path("mesh.stl", suffixes=ENCODERS)
    title: str | None = options.title(None, note="in a .3mf file; the name of the mesh if omitted")
    description: str | None = option(
        None, help="a sentence kept in a .3mf file, for instance the parameters of the design"
    )
    normals: bool = option(
        False, help="whether each vertex of a .glb file has a normal, so that viewers shade smoothly"
    )

    copies: str = option(
        "merged",
        help="what becomes of the copies of a cell in a .3mf file: merged into one object, or components that place a "
        "mesh that is stored once",
        choices=("merged", "components"),
    )

    def check_options(self) -> None:
        only_for = {"title": ".3mf", "description": ".3mf", "copies": ".3mf", "normals": ".glb"}
        require_format(self, self.path, ENCODERS, only_for)
        for name, text in (("title", self.title), ("description", self.description)):
            if text is not None and not text.isprintable():
                raise ConfigError(f"`{name}` has characters that cannot be printed: {text!r}")

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        if self._placed:
            return Size(triangles=mesh.triangles, copies=mesh.copies)
        return Size(triangles=mesh.triangles * max(1.0, mesh.copies))

    @property
    def rated_as(self) -> str:
        return f"write{extension_of(self.path)}" + (".normals" if self.normals else "")

    def begin(self, context: Context) -> PieceFile | None:
        extension = extension_of(self.path)
        if extension not in IN_PIECES:
            return None
        from sppm_pipeline.features.files.piece_file import PieceFile

        in_pieces = importlib.import_module(ENCODERS[extension]).in_pieces
        return PieceFile(context.scratch(), in_pieces, context.threads)

    def run(self, context: Context, mesh: SurfaceMesh | RepeatedMesh) -> None:
        """Write the file."""
        if isinstance(mesh, SurfaceMesh) and not mesh.is_whole:
            context.report(bytes=context.begun.hand_over(context, self.path), triangles=mesh.counts[1])
            return
        extension = extension_of(self.path)
        options: dict[str, Any] = {"threads": context.threads}
        placed = 1
        if isinstance(mesh, RepeatedMesh):
            require_triangles(mesh.mesh, self.path)
            if not len(mesh.offsets):
                raise DesignError(f"{mesh.mesh.name!r} has no copies: there is nothing to write to {self.path}")
            context.report(copies=len(mesh.offsets))
            if self._placed:
                once, placed, options["offsets"] = mesh.mesh, len(mesh.offsets), mesh.offsets
            else:
                once = mesh.whole()
        else:
            require_triangles(mesh, self.path)
            once = mesh
        if extension == ".3mf":
            options |= self._labels(once.name)
        elif extension == ".glb":
            options["normals"] = self.normals
        encode = importlib.import_module(ENCODERS[extension]).encode
        size = write_pieces(context, self.path, encode(once.vertices, once.faces, **options))
        context.report(bytes=size, triangles=placed * len(once.faces))

    @property
    def _placed(self) -> bool:
        """True if the file holds the mesh of copies once."""
        return extension_of(self.path) == ".glb" or self.copies == "components"

    def _labels(self, mesh_name: str) -> dict[str, Any]:
        """Name and metadata of a 3MF."""
        name = "".join(c if c.isprintable() else "?" for c in mesh_name)
        about = {"Title": self.title or name, "Application": f"sppm_pipeline {sppm_pipeline.__version__}"}
        if self.description:
            about["Description"] = self.description
        return {"name": name, "metadata": about}
