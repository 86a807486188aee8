"""The writer keeps the contract of writers, and its own promises."""

from __future__ import annotations

import re

import numpy as np
from my_plugin.openscad import WriteOpenScad

from sppm_pipeline import SurfaceMesh
from sppm_pipeline.numerics import mesh_volume
from sppm_pipeline.testing.contracts import WriterContract
from sppm_pipeline.testing.plain_context import PlainContext

CORNERS = [[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 1 / 3]]
TETRAHEDRON = SurfaceMesh.from_arrays(CORNERS, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


class TestWriteOpenScad(WriterContract):
    def stages(self):
        return [WriteOpenScad(), WriteOpenScad(path="parts/b.scad")]

    def inputs(self):
        return {"mesh": TETRAHEDRON}


def test_what_is_written_is_the_mesh_turned_inside_out():
    context = PlainContext()
    WriteOpenScad().run(context, TETRAHEDRON)
    text = (context.directory / "part.scad").read_text()
    vertices, faces = (re.findall(r"\[([^\[\]]+)\]", part) for part in text.split("faces"))
    vertices, faces = (np.array([row.split(", ") for row in rows], float) for rows in (vertices, faces))
    assert np.allclose(vertices, TETRAHEDRON.vertices, atol=1e-9)
    tetrahedron = mesh_volume(TETRAHEDRON.vertices, TETRAHEDRON.faces)
    assert np.isclose(mesh_volume(vertices, faces.astype(int)), -tetrahedron)
