"""Triangles chosen by the words of CAD faces and by names of groups."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline import InputError, SurfaceMesh
from sppm_pipeline.method.nouns.conditions import condition_of, held_of
from sppm_pipeline.method.nouns.named_faces import COLORS, named_triangles
from sppm_pipeline.method.part.primitive_meshes import box_mesh

NAMES = (
    "#1 plane color=#b3b3b3 body=plate",
    "#2 cylinder hole d=5 color=#f01010 body=plate name=bearing seat",
    "#3 cylinder hole d=8 color=#b3b3b3 body=plate",
    "#4 cylinder d=6 color=#1010e0 body=left arm",
    "#12 cone hole d=9.5 body=left arm name=seat",
    "flange, all of it",
)
MESH = SurfaceMesh(
    *box_mesh((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), groups=tuple((name, n, n + 1) for n, name in enumerate(NAMES))
)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("#1", [0]),
        ("face 12", [4]),
        ("holes", [1, 2, 4]),
        ("cylinder", [1, 2, 3]),
        ("cylinders hole", [1, 2]),
        ("cylinder d<6mm", [1]),
        ("d <= 6 mm", [1, 3]),
        ("cylinder d>=0.6cm", [2, 3]),
        ("hole d=5", [1]),
        ("d>6mm", [2, 4]),
        ("color red", [1]),
        ("color blue", [3]),
        ("color #b3b3b4", [0, 2]),
        ("color gray holes", [2]),
        ("body left arm", [3, 4]),
        ("body plate name bearing seat", [1]),
        ("name seat", [4]),
        ("holes body left arm", [4]),
        ("flange, all of it", [5]),
        (NAMES[3], [3]),
    ],
)
def test_words(text, found):
    assert np.flatnonzero(named_triangles(MESH, (text,))).tolist() == found


def test_texts_are_joined():
    assert np.flatnonzero(named_triangles(MESH, ("#1", "color red", "#3"))).tolist() == [0, 1, 2]
    assert not named_triangles(MESH, ()).any()


@pytest.mark.parametrize(
    "text",
    [
        "#5",
        "#",
        "flange",
        "color rot",
        "cylinder d<3mm",
        "d<6 furlong",
        "d<1.2.3",
        "d<.",
        "holes and planes",
        "",
        "torus",
        "body arm",
    ],
)
def test_what_is_not_there_is_named(text):
    with pytest.raises(InputError, match="has no group"):
        named_triangles(MESH, (text,))


def test_each_color_is_its_own():
    for n, (name, code) in enumerate(COLORS.items(), 1):
        mesh = SurfaceMesh(MESH.vertices, MESH.faces, groups=((f"#{n} plane color={code}", 0, 1),))
        assert named_triangles(mesh, (f"color {name}",))[0]
        with pytest.raises(InputError):
            named_triangles(mesh, (f"color {next(other for other in COLORS if other != name)}",))


def test_conditions_on_faces():
    one = condition_of("force", "0 0 -5 N on holes d<6mm", MESH)
    assert one.region.triangles.tolist() == MESH.vertices[MESH.faces[1:2]].tolist()
    assert held_of("x y on #12", MESH).values == (0.0, 0.0, None)
    assert len(held_of("color red", MESH).region.triangles) == 1
    with pytest.raises(InputError, match="no group 'face 7'"):
        held_of("face 7", MESH)
