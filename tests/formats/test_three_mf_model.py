"""Models of 3MF files: the quick way through long tables and the parser's own way agree."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats.three_mf_model import CORE, PRODUCTION, Object, read_model

HEAD = f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="inch" xmlns="{CORE}" xmlns:p="{PRODUCTION}"><resources>'
TAIL = '</resources><build><item objectid="1"/></build></model>'
VERTICES = '<vertex x="0" y="0" z="0"/>\n<vertex x="1" y="0" z="0"/><vertex x="0" y="2.5e0" z="0"/>'
TRIANGLES = '<triangle v1="0" v2="1" v3="2"/>'
SLOW = "<!-- the parser's turn -->"


def text(vertices: str = VERTICES, triangles: str = TRIANGLES, before: str = "", after: str = "") -> bytes:
    mesh = f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>"
    return f'{HEAD}{before}<object id="1">{mesh}</object>{after}{TAIL}'.encode()


def first_object(content: bytes, size: int = 2**20) -> Object:
    pieces = [content[k : k + size] for k in range(0, len(content), size)]
    return read_model(pieces, "a.3mf", "m").objects[1]


def mesh_of(content: bytes, size: int = 2**20) -> tuple[list[list[float]], list[list[int]]]:
    mesh = first_object(content, size).mesh
    assert mesh is not None
    return mesh[0].tolist(), mesh[1].tolist()


EXPECTED = ([[0, 0, 0], [1, 0, 0], [0, 2.5, 0]], [[0, 1, 2]])


@pytest.mark.parametrize("size", [1, 7, 50, 10**6])
@pytest.mark.parametrize(
    "content",
    [
        text(),
        text(SLOW + VERTICES, SLOW + TRIANGLES),
        text(VERTICES.replace("<vertex x", f"{SLOW}<vertex x", 2), TRIANGLES + SLOW),
        text(VERTICES.replace('"', "'"), TRIANGLES.replace('"', "'")),
        text(VERTICES.replace("/>", "></vertex>"), TRIANGLES.replace("/>", " />")),
        text(VERTICES.replace("<vertex ", "<vertex\n\t"), TRIANGLES.replace("/>", ' pid="3" p1="0"/>')),
        text('<vertex z="0" y="0" x="0"/><vertex z="0" x="1" y="0"/><vertex q="&lt;" y="2.5" x="0" z="0"/>'),
        text(VERTICES.replace('y="2', 'p:UUID="a>b" y="2')),
        text(VERTICES.replace('"1"', '" 1 "')),
        text(before="<!-- <vertices><vertex x='9' y='9' z='9'/></vertices> -->"),
        text(VERTICES + "<!-- <vertices><vertex x='9' y='9' z='9'/> -->"),
        text("<!-- > <vertex x='9' y='9' z='9'/> -->" + VERTICES),
        text(VERTICES + "<other><vertex x='9' y='9' z='9'/></other>"),
        text(VERTICES + "<vertices><triangle v1='0' v2='0' v3='0'/></vertices>"),
        text().decode().replace("UTF-8", "UTF-16").encode("utf-16"),
        text()
        .replace(f'xmlns="{CORE}"'.encode(), f'xmlns:c="{CORE}"'.encode())
        .replace(b"<", b"<c:")
        .replace(b"<c:/", b"</c:")
        .replace(b"<c:?", b"<?"),
    ],
)
def test_ways_to_write_the_same(content: bytes, size: int) -> None:
    assert mesh_of(content, size) == EXPECTED


def test_rows_of_another_namespace_are_no_vertices() -> None:
    content = text().replace(b"<vertices>", b'<c:vertices xmlns:c="' + CORE.encode() + b'" xmlns="urn:other">')
    content = content.replace(b"</vertices>", b"</c:vertices>")
    with pytest.raises(InputError, match="there are 0 vertices"):
        first_object(content)


numbers = st.one_of(
    st.floats(-1e12, 1e12).map(repr),
    st.floats(-1e3, 1e3).map(lambda v: f"{v:.6f}"),
    st.integers(-(10**20), 10**20).map(str),
    st.sampled_from(["nan", "1e999", "-inf", "", "1_0", "0x1", "1.", ".5", "+3", "1e", "--1", "1 2", "7" * 500]),
)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(words=st.lists(numbers, min_size=3, max_size=3), size=st.integers(1, 80))
def test_both_ways_take_and_refuse_the_same_numbers(words: list[str], size: int) -> None:
    x, y, z = words
    row = f'<vertex x="{x}" y="{y}" z="{z}"/>'
    found = []
    for start in ("", SLOW):
        try:
            found.append(mesh_of(text(start + VERTICES + row), size))
        except InputError:
            found.append(([], []))
    assert found[0] == found[1]


def test_lines_are_counted_through_tables() -> None:
    vertices = "\n".join('<vertex x="0" y="0" z="0"/>' for _ in range(5000))
    broken = text(vertices + '\n<vertex x="0" y="0" z="zero"/>\n')
    line = broken[: broken.index(b"zero")].count(b"\n") + 1
    for size in (100, 10**6):
        with pytest.raises(InputError, match=rf"m, line {line}: .*'zero'"):
            first_object(broken, size)


def test_many_rows() -> None:
    rng = np.random.default_rng(5)
    points = rng.normal(size=(20_000, 3)).round(6)
    faces = rng.integers(0, 20_000, (30_000, 3))
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in points.tolist())
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>\n' for a, b, c in faces.tolist())
    mesh = first_object(text(vertices, triangles), 100_003).mesh
    assert mesh is not None
    assert np.array_equal(mesh[0], points)
    assert np.array_equal(mesh[1], faces)
