"""``write.my_word``: a mesh as OpenSCAD source."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import MeshWriter, SurfaceMesh, options


@dataclass(frozen=True, kw_only=True)
class WriteOpenScad(MeshWriter):
    """Write a mesh as a `polyhedron` of OpenSCAD, in millimeters, to be cut, joined and moved there."""

    name: ClassVar[str] = "write.my_word"

    path: str = options.write_path("part.scad", suffixes=(".scad",))

    def encode(self, mesh: SurfaceMesh, threads: int) -> Iterable[bytes]:
        """The file, piece by piece; a vertex and a triangle on a line of its own."""
        yield b"// millimeters\npolyhedron(convexity = 10, points = [\n"
        yield "".join(f"[{x:.9g}, {y:.9g}, {z:.9g}],\n" for x, y, z in mesh.vertices.tolist()).encode()
        yield b"], faces = [\n"
        # corners are clockwise there as seen from outside, and counterclockwise here
        yield "".join(f"[{a}, {c}, {b}],\n" for a, b, c in mesh.faces.tolist()).encode()
        yield b"]);\n"
