"""Odd but lawful files are read right."""

import struct

import numpy as np
import pytest

from sppm_pipeline.features.files.formats import obj, off
from sppm_pipeline.features.files.formats.detect import decode_mesh
from sppm_pipeline.services.formats import ply, stl
from sppm_pipeline.services.mesh.measures import edge_counts

SQUARE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
FAN = [[0, 1, 2], [0, 2, 3]]
TETRAHEDRON = ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def binary_stl(corners: np.ndarray, header: bytes = b"") -> bytes:
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *t.reshape(-1), 7) for t in np.asarray(corners, np.float32))
    return header.ljust(80, b" ") + struct.pack("<I", len(corners)) + records


def tetrahedron_corners() -> np.ndarray:
    vertices, faces = TETRAHEDRON
    return np.array(vertices, float)[np.array(faces)]


OBJ_SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    "text",
    [
        OBJ_SQUARE + "f 1 2 3 4\n",
        OBJ_SQUARE + "f 1 2 3 4",
        OBJ_SQUARE.replace("\n", "\r\n") + "f 1 2 3 4\r\n",
        (OBJ_SQUARE + "f 1 2 3 4\n").replace("\n", "\r"),
        "# made by hand\nmtllib a.mtl\no thing\n" + OBJ_SQUARE + "g a b\nusemtl none\ns off\nf 1 2 3 4 # the face\n",
        OBJ_SQUARE + "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1 4/1/1\n",
        OBJ_SQUARE + "f 1//1 2//1 3//1 4//1\n",
        OBJ_SQUARE + "f 1/1 2/1 3/1 4/1\n",
        OBJ_SQUARE + "f -4 -3 -2 -1\n",
        OBJ_SQUARE + "f -4/-1/-1 -3/-1/-1 -2/-1/-1 -1/-1/-1\n",
        OBJ_SQUARE + "f 1 2 \\\n3 4\n",
        OBJ_SQUARE + "f 1 2 \\\r\n3 4\r\n",
        OBJ_SQUARE + "f 1 2 3\nf 1 3 4\n",
        OBJ_SQUARE.replace("0\nv", "0 0.5 0.25 1\nv") + "f 1 2 3 4\n",
        OBJ_SQUARE.replace("v ", "  v\t ") + "\n\n\tf  1   2\t3 4  \n\n",
        "f 1 2 3 4\n" + OBJ_SQUARE,
        OBJ_SQUARE + "l 1 2\np 1\nf 1 2 3 4\n",
    ],
)
def test_obj(text: str) -> None:
    vertices, faces = obj.decode(text.encode(), "a.obj")
    assert vertices.tolist() == SQUARE
    assert faces.tolist() == FAN


def test_relative_numbers_count_from_where_the_face_stands() -> None:
    text = "v 9 9 9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 5 5\nf -1 -2 -3\n"
    assert obj.decode(text.encode(), "a.obj")[1].tolist() == [[1, 2, 3], [4, 3, 2]]


OFF_BODY = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"


@pytest.mark.parametrize(
    "text",
    [
        "OFF\n4 1 4\n" + OFF_BODY + "4 0 1 2 3\n",
        "OFF 4 1 4\n" + OFF_BODY + "4 0 1 2 3",
        "OFF\n4 1\n" + OFF_BODY + "4 0 1 2 3\n",
        "OFF\n# a comment\n\n4 1 0 # counts\n\n" + OFF_BODY + "\n# face\n4 0 1 2 3 255 0 0\n",
        ("OFF\n4 1 0\n" + OFF_BODY + "4 0 1 2 3\n").replace("\n", "\r\n"),
        "COFF\n4 2 0\n" + OFF_BODY.replace("\n", " 255 0 0 255\n") + "3 0 1 2\n3 0 2 3\n",
        "OFF\n#" + "x" * 9000 + "\n4 1 0\n" + OFF_BODY + "4  0 1 2 3 0.5 0.5 0.5\n",
    ],
)
def test_off(text: str) -> None:
    vertices, faces = off.decode(text.encode(), "a.off")
    assert vertices.tolist() == SQUARE
    assert faces.tolist() == FAN


PLY_ASCII = """ply
format ascii 1.0
comment made by hand
obj_info nothing
element camera 2
property float view
property list uchar float more
element vertex 4
property uchar red
property float z
property list uchar int marks
property double y
property float x
element face 2
property uchar flag
property list uchar uchar extra
property list uchar int vertex_indices
property float quality
element edge 1
property int a
end_header
1 2 5 6
2 0
7 0 0 0 0
7 0 2 8 9 0 1
7 0 1 8 1 1
7 0 0 1 0
9 0 3 0 1 2 0.5
9 2 1 1 3 0 2 3 0.5
4
"""


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_ply_ascii_with_much_else_in_it(ending: str) -> None:
    vertices, faces = ply.decode(PLY_ASCII.replace("\n", ending).encode(), "a.ply")
    assert vertices.tolist() == SQUARE
    assert faces.tolist() == FAN


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("lists", [False, True])
@pytest.mark.parametrize("index", ["b", "B", "h", "H", "i", "I", "q"])
def test_ply_binary_of_both_byte_orders(order: str, lists: bool, index: str) -> None:
    names = {"b": "char", "B": "uchar", "h": "int16", "H": "ushort", "i": "int", "I": "uint32", "q": "int64"}
    header = f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0\nelement camera 1\n"
    header += "property list ushort double view\nproperty float f\nelement vertex 4\nproperty uchar red\n"
    header += "property list uchar short marks\n" if lists else ""
    header += "property double x\nproperty float y\nproperty short z\nelement face 1\nproperty list uint float extra\n"
    header += f"property list char {names[index]} vertex_index\nproperty uchar flag\nelement edge 1\nproperty int a\n"
    body = struct.pack(order + "H2df", 2, 1.0, 2.0, 3.0)
    for k, (x, y, z) in enumerate(SQUARE):
        body += struct.pack(order + "B", 200)
        body += struct.pack(order + f"B{k}h", k, *range(k)) if lists else b""
        body += struct.pack(order + "dfh", x, y, int(z))
    body += struct.pack(order + f"I2fb4{index}B", 2, 0.5, 0.5, 4, 0, 1, 2, 3, 1) + struct.pack(order + "i", 5)
    vertices, faces = ply.decode((header + "end_header\n").encode() + body, "a.ply")
    assert vertices.tolist() == SQUARE
    assert faces.tolist() == FAN


def test_negative_coordinates_of_small_types() -> None:
    header = b"ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty short x\nproperty char y\nproperty int z\n"
    header += b"element face 1\nproperty list uchar uchar vertex_indices\nend_header\n"
    body = b"".join(struct.pack(">hbi", -300 * k, -k, -70000 * k) for k in range(3)) + bytes([3, 0, 1, 2])
    assert ply.decode(header + body, "a.ply")[0].tolist() == [[-300 * k, -k, -70000 * k] for k in range(3)]


def test_binary_stl_merges_equal_corners() -> None:
    vertices, faces = stl.decode(binary_stl(tetrahedron_corners()), "a.stl")
    assert vertices.tolist() == [[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1]]  # in the order of their first use
    assert edge_counts(faces).closed


def test_binary_stl_that_begins_with_solid() -> None:
    data = binary_stl(tetrahedron_corners(), b"solid facet normal")
    assert len(stl.decode(data, "a.stl")[1]) == 4
    assert len(stl.decode(data + b"tail", "a.stl")[1]) == 4


def test_minus_zero_is_zero() -> None:
    corners = tetrahedron_corners()
    corners[::2][corners[::2] == 0] = -0.0
    assert len(stl.decode(binary_stl(corners), "a.stl")[0]) == 4


def test_noise_where_zero_is_meant_is_merged_if_that_closes_the_surface() -> None:
    corners = tetrahedron_corners()
    corners[0][corners[0] == 0] = 2.7e-16
    vertices, faces = stl.decode(binary_stl(corners), "a.stl")
    assert len(vertices) == 4
    assert edge_counts(faces).closed


def test_fine_detail_of_an_open_mesh_is_not_merged() -> None:
    corners = np.array([[[0, 0, 0], [1e-9, 0, 0], [0, 1e-9, 0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    assert len(stl.decode(binary_stl(corners), "a.stl")[0]) == 5


FACET = "facet normal 0 0 1\n  outer loop\n    vertex {}\n    vertex {}\n    vertex {}\n  endloop\nendfacet\n"


@pytest.mark.parametrize(
    "change", [str, str.upper, lambda text: text.replace("\n", "\r\n"), lambda text: text.replace("\n  ", " ")]
)
def test_ascii_stl(change) -> None:  # type: ignore[no-untyped-def]
    text = "solid two of them\n" + FACET.format("0 0 0", "1 0 0", "1.0 1e0 0") + "endsolid two of them\n"
    text += "solid\n" + FACET.format("0 0 0", "1 1 0", "0 1 -0") + "endsolid"
    vertices, faces = stl.decode(change(text).encode(), "a.stl")
    assert vertices.tolist() == SQUARE
    assert faces.tolist() == FAN


def test_any_buffer_is_read() -> None:
    text = (OBJ_SQUARE + "f 1 2 3 4\n").encode()
    for data in (text, bytearray(text), memoryview(text), memoryview(b"x" + text)[1:]):
        assert decode_mesh(data, "A.OBJ")[1].tolist() == FAN
    data = b"?" + binary_stl(tetrahedron_corners())
    assert len(decode_mesh(memoryview(data)[1:], "a.stl")[1]) == 4
