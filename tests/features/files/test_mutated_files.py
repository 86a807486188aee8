"""Files with a few bytes changed, cut or pushed in: read to a sound mesh, or refused with an InputError."""

import io
import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import InputError
from sppm_pipeline.features.files.formats.detect import FORMATS, decode_mesh
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh

VERTICES, TRIANGLES = ball_mesh((0.5, 1.5, -2.0), 3.0, 1)
FACES = TRIANGLES.astype(np.int32)


def ascii_stl() -> bytes:
    facets = (
        "facet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
        + "endloop\nendfacet\n"
        for corners in VERTICES[FACES][:12].tolist()
    )
    return f"solid a\n{''.join(facets)}endsolid a\n".encode()


def ply_of(form: str) -> bytes:
    head = f"ply\nformat {form} 1.0\nelement vertex {len(VERTICES)}\nproperty float x\nproperty float y\n"
    head += f"property float z\nelement face {len(FACES)}\nproperty list uchar int vertex_indices\nend_header\n"
    if form == "ascii":
        lines = [f"{x} {y} {z}" for x, y, z in VERTICES.tolist()] + [f"3 {a} {b} {c}" for a, b, c in FACES.tolist()]
        return (head + "\n".join(lines) + "\n").encode()
    rows = b"".join(b"\3" + row.astype(">i4").tobytes() for row in FACES)
    return head.encode() + VERTICES.astype(">f4").tobytes() + rows


def written(name: str) -> bytes:
    return b"".join(FORMATS[name].encode(VERTICES, FACES))


GOOD = {
    "ascii.stl": ascii_stl(),
    "ascii.ply": ply_of("ascii"),
    "big_endian.ply": ply_of("binary_big_endian"),
    **{f"ours.{name}": written(name) for name in FORMATS},
}

changes = st.lists(
    st.tuples(
        st.sampled_from(["flip", "set", "cut", "insert", "remove", "repeat"]),
        st.floats(0, 1, exclude_max=True),
        st.one_of(
            st.binary(min_size=1, max_size=9),
            st.sampled_from([b"-1", b"nan", b"inf", b"1e999", b"9" * 30, b"\n", b"\r", b" ", b"\0\0\0\0", b"\xff" * 4]),
        ),
    ),
    min_size=1,
    max_size=4,
)


def changed(data: bytes, how: list[tuple[str, float, bytes]]) -> bytes:
    for what, share, piece in how:
        place = int(share * len(data))
        if what == "flip" and data:
            flipped = data[place] ^ (1 << piece[0] % 8)
            data = data[:place] + bytes([flipped]) + data[place + 1 :]
        elif what == "set":
            data = data[:place] + piece + data[place + len(piece) :]
        elif what == "cut":
            data = data[:place]
        elif what == "insert":
            data = data[:place] + piece + data[place:]
        elif what == "remove":
            data = data[:place] + data[place + len(piece) :]
        else:
            data = data[:place] + data[place : place + 50] + data[place:]
    return data


def read_or_refuse(data: bytes, name: str) -> None:
    try:
        vertices, faces = decode_mesh(data, name)
    except InputError as refused:
        message = str(refused)
    else:
        message = ""
        SurfaceMesh(vertices, faces).check()
        assert vertices.dtype == np.float64
        assert len(faces)
        assert faces.min() >= 0
    assert not message or (message.startswith(name) and len(message) < 600)


@pytest.mark.parametrize("name", GOOD)
def test_unchanged(name: str) -> None:
    _, faces = decode_mesh(GOOD[name], name)
    assert len(faces) == (12 if name == "ascii.stl" else len(FACES))


@pytest.mark.parametrize("name", GOOD)
@settings(derandomize=True, deadline=None, max_examples=150)
@given(how=changes)
def test_changed_files(name: str, how: list[tuple[str, float, bytes]]) -> None:
    read_or_refuse(changed(GOOD[name], how), name)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(how=changes)
def test_changed_models_in_a_sound_archive(how: list[tuple[str, float, bytes]]) -> None:
    with zipfile.ZipFile(io.BytesIO(GOOD["ours.3mf"])) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    parts["3D/3dmodel.model"] = changed(parts["3D/3dmodel.model"], how)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        for name, content in parts.items():
            file.writestr(name, content)
    read_or_refuse(out.getvalue(), "a.3mf")


@settings(derandomize=True, deadline=None, max_examples=300)
@given(how=changes)
def test_changed_json_in_a_sound_container(how: list[tuple[str, float, bytes]]) -> None:
    data = GOOD["ours.glb"]
    size = int.from_bytes(data[12:16], "little")
    text = changed(data[20 : 20 + size], how)
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    head = b"glTF" + (2).to_bytes(4, "little") + (20 + len(text) + len(rest)).to_bytes(4, "little")
    read_or_refuse(head + len(text).to_bytes(4, "little") + b"JSON" + text + rest, "a.glb")


@settings(derandomize=True, deadline=None, max_examples=300)
@given(data=st.data())
def test_any_value_at_any_place_of_the_json(data: st.DataObject) -> None:
    whole = GOOD["ours.glb"]
    size = int.from_bytes(whole[12:16], "little")
    document = json.loads(whole[20 : 20 + size])
    place = document
    while True:
        keys = sorted(place) if isinstance(place, dict) else list(range(len(place)))
        key = data.draw(st.sampled_from(keys))
        if not isinstance(place[key], (dict, list)) or not place[key] or data.draw(st.booleans()):
            break
        place = place[key]
    place[key] = data.draw(
        st.one_of(
            st.none(),
            st.booleans(),
            st.integers(-(2**70), 2**70),
            st.floats(allow_nan=False),
            st.text(max_size=5),
            st.just([]),
            st.just({}),
            st.just([{}]),
        )
    )
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = whole[20 + size :]
    head = b"glTF" + (2).to_bytes(4, "little") + (20 + len(text) + len(rest)).to_bytes(4, "little")
    read_or_refuse(head + len(text).to_bytes(4, "little") + b"JSON" + text + rest, "a.glb")
