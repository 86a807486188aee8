"""Models of 3MF files: the ways to write one, and what is no table of numbers."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import InputError
from sppm_pipeline.features.files.formats.three_mf_model import CORE, PRODUCTION, Object, read_model

HEAD = f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="inch" xmlns="{CORE}" xmlns:p="{PRODUCTION}"><resources>'
TAIL = '</resources><build><item objectid="1"/></build></model>'
VERTICES = '<vertex x="0" y="0" z="0"/>\n<vertex x="1" y="0" z="0"/><vertex x="0" y="2.5e0" z="0"/>'
TRIANGLES = '<triangle v1="0" v2="1" v3="2"/>'
COMMENT = "<!-- a comment -->"


def text(vertices: str = VERTICES, triangles: str = TRIANGLES, before: str = "", after: str = "") -> bytes:
    mesh = f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>"
    return f'{HEAD}{before}<object id="1">{mesh}</object>{after}{TAIL}'.encode()


def first_object(content: bytes) -> Object:
    return read_model([content], "a.3mf", "m").objects[1]


def mesh_of(content: bytes) -> tuple[list[list[float]], list[list[int]]]:
    mesh = first_object(content).mesh
    assert mesh is not None
    return mesh[0].tolist(), mesh[1].tolist()


EXPECTED = ([[0, 0, 0], [1, 0, 0], [0, 2.5, 0]], [[0, 1, 2]])


@pytest.mark.parametrize(
    "content",
    [
        text(),
        text(COMMENT + VERTICES, COMMENT + TRIANGLES),
        text(VERTICES.replace("<vertex x", f"{COMMENT}<vertex x", 2), TRIANGLES + COMMENT),
        text(VERTICES.replace('"', "'"), TRIANGLES.replace('"', "'")),
        text(VERTICES.replace("/>", "></vertex>"), TRIANGLES.replace("/>", " />")),
        text(VERTICES.replace("<vertex ", "<vertex\n\t"), TRIANGLES.replace("/>", ' pid="3" p1="0"/>')),
        text('<vertex z="0" y="0" x="0"/><vertex z="0" x="1" y="0"/><vertex q="&lt;" y="2.5" x="0" z="0"/>'),
        text(VERTICES.replace('y="2', 'p:UUID="a>b" y="2')),
        text(VERTICES.replace('"1"', '" 1 "')),
        text(before="<!-- <vertices><vertex x='9' y='9' z='9'/></vertices> -->"),
        text(VERTICES + "<!-- <vertices><vertex x='9' y='9' z='9'/> -->"),
        text("<!-- > <vertex x='9' y='9' z='9'/> -->" + VERTICES),
        text().replace(b"<resources>", b'<resources xmlns:q="urn:q">').replace(b"/></v", b' q:a="1"/></v'),
        text().decode().replace("UTF-8", "UTF-16").encode("utf-16"),
        text()
        .replace(f'xmlns="{CORE}"'.encode(), f'xmlns:c="{CORE}"'.encode())
        .replace(b"<", b"<c:")
        .replace(b"<c:/", b"</c:")
        .replace(b"<c:?", b"<?"),
    ],
)
def test_ways_to_write_the_same(content: bytes) -> None:
    assert mesh_of(content) == EXPECTED


def test_rows_of_another_namespace_are_no_vertices() -> None:
    content = text().replace(b"<vertices>", b'<c:vertices xmlns:c="' + CORE.encode() + b'" xmlns="urn:other">')
    content = content.replace(b"</vertices>", b"</c:vertices>")
    with pytest.raises(InputError, match="there are 0 vertices"):
        first_object(content)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (text(VERTICES + "<other><vertex x='9' y='9' z='9'/></other>"), "a <vertex> stands in a table of its kind"),
        (text(VERTICES + "<vertices><vertex x='0' y='0' z='0'/></vertices>"), "one table <vertices>"),
        (text(VERTICES + "</vertices><vertices>" + VERTICES), "one table <vertices>"),
        (text(triangles=TRIANGLES + "</triangles></mesh><mesh><vertices/><triangles>" + TRIANGLES), "two meshes"),
        (text(VERTICES.replace("2.5e0", "two")), "three numbers"),
        (text(VERTICES.replace("2.5e0", "2.5 1")), "three numbers"),
        (text(VERTICES.replace('x="1" y="0"', 'x="1 2" y=""')), "a vertex has three numbers"),
        (text(VERTICES + '\n<vertex x="0" y="0"/>'), "m, line 4: a vertex has three numbers x, y and z"),
    ],
)
def test_what_is_no_table(content: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        first_object(content)


numbers = st.one_of(
    st.floats(-1e12, 1e12).map(repr),
    st.floats(-1e3, 1e3).map(lambda v: f"{v:.6f}"),
    st.integers(-(10**20), 10**20).map(str),
    st.sampled_from(["nan", "1e999", "-inf", "", "1_0", "0x1", "1.", ".5", "+3", "1e", "--1", "1 2", "1,2", "7" * 500]),
)


@settings(derandomize=True, deadline=None, max_examples=200)
@given(words=st.lists(numbers, min_size=3, max_size=3))
def test_numbers_are_read_as_python_reads_them_or_refused(words: list[str]) -> None:
    x, y, z = words
    try:
        found = mesh_of(text(VERTICES + f'<vertex x="{x}" y="{y}" z="{z}"/>'))
    except InputError:
        assert not all(
            re.fullmatch(r"[+-]?[0-9]+(\.[0-9]+)?(e[+-]?[0-9]{1,2})?", word[:200] + "." * (len(word) > 200))
            for word in words
        )
    else:
        assert found[0][3] == [float(word) for word in words]


def test_a_large_mesh() -> None:
    rng = np.random.default_rng(5)
    points = rng.normal(size=(70_000, 3)).round(6)
    faces = rng.integers(0, 70_000, (140_000, 3))
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in points.tolist())
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>\n' for a, b, c in faces.tolist())
    mesh = first_object(text(vertices, triangles)).mesh
    assert mesh is not None
    assert np.array_equal(mesh[0], points)
    assert np.array_equal(mesh[1], faces)
