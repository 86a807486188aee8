"""Broken and hostile files end in an InputError that says where, without much memory."""

import contextlib
import struct
import tracemalloc

import numpy as np
import pytest

from sppm_pipeline.errors import InputError
from sppm_pipeline.features.files.formats.detect import FORMATS, decode_mesh, format_of_name

V3 = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
O3 = "0 0 0\n1 0 0\n0 1 0\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"
LIST = "property list uchar int vertex_indices\n"


def ply(
    body: bytes = b"", form: str = "binary_little_endian", n: int = 3, m: int = 1, xyz: str = XYZ, faces: str = LIST
) -> bytes:
    return f"ply\nformat {form} 1.0\nelement vertex {n}\n{xyz}element face {m}\n{faces}end_header\n".encode() + body


def stl(claimed: int, triangles: int, value: float = 1.0) -> bytes:
    return bytes(80) + struct.pack("<I", claimed) + struct.pack("<12fH", *[0.0] * 3, *[value] * 9, 0) * triangles


POINTS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
FACET = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"

HOSTILE = {
    "empty.obj": (b"", "empty"),
    "empty.stl": (b"", "empty"),
    "empty.ply": (b"", "empty"),
    "empty.off": (b"", "empty"),
    # OBJ
    "points.obj": (V3, "no faces"),
    "noise.obj": (b"\x00\xff" * 5000, "no faces"),
    "large_index.obj": (V3 + "f 1 2 4\n", r"line 4 \(byte 30\): there is no vertex '4'.* 3 vertices"),
    "huge_index.obj": (V3 + "f 1 2 99999999999999999999\n", "line 4"),
    "zero_index.obj": (V3 + "f 0 1 2\n", "line 4"),
    "negative_index.obj": (V3 + "f -1 -2 -4\n", r"line 4 .*'-4'"),
    "relative_too_early.obj": ("f -1 -2 -3\n" + V3, "line 1"),
    "real_index.obj": (V3 + "f 1.0 2 3\n", r"line 4 .*'1\.0'"),
    "word_index.obj": (V3 + "f a b c\n", "line 4"),
    "two_corners.obj": (V3 + "f 1 2\n", r"line 4 .*three corners"),
    "no_corners.obj": (V3 + "f \n", "line 4"),
    "nan.obj": (V3 + "v 0 nan 0\nf 1 2 3\n", r"line 4 \(byte 28\): a coordinate must be finite, not 'nan'"),
    "infinite.obj": (V3 + "v 0 1e999 0\nf 1 2 3\n", "line 4 .*finite"),
    "word.obj": (V3 + "v 0 0 zero\nf 1 2 3\n", "line 4 .*'zero'"),
    "short_vertex.obj": (V3 + "v 0 0\nf 1 2 3\n", "line 4 .*three coordinates"),
    "cut_vertex.obj": (V3 + "f 1 2 3\nv 0 0", "line 5"),
    "long_number.obj": (V3 + "v 0 0 " + "7" * 3_000_000 + "\nf 1 2 3\n", "line 4 .*number"),
    "crlf_error.obj": (V3.replace("\n", "\r\n") + "f 1 2 9\r\n", "line 4"),
    # OFF
    "no_magic.off": ("3 1 0\n" + O3 + "3 0 1 2\n", "OFF"),
    "claims.off": ("OFF\n1000000000 1 0\n" + O3, r"claims 1000000000 vertices"),
    "claims_faces.off": ("OFF\n3 1000000000 0\n" + O3 + "3 0 1 2\n", r"claims 1000000000 faces"),
    "claims_digits.off": ("OFF\n" + "9" * 5000 + " 1 0\n", "number of vertices"),
    "claims_negative.off": ("OFF\n-3 1 0\n" + O3, "number of vertices"),
    "claims_corners.off": ("OFF\n3 1 0\n" + O3 + "1000000000 0 1 2\n", r"line 6 .*too few"),
    "claims_corners_often.off": ("OFF\n3 50000 0\n" + O3 + "150000 0 1 2\n" * 50000, r"line 6 .*too few"),
    "no_counts.off": ("OFF\n", "missing"),
    "comments_only.off": ("OFF\n" + "#\n" * 500_000, "missing"),
    "cut.off": ("OFF\n3 2 0\n" + O3 + "3 0 1 2\n", "bytes|ends"),
    "cut_vertices.off": ("OFF\n3 0 0\n0 0 0\n1 0 0          \n", "ends"),
    "large_index.off": ("OFF\n3 1 0\n" + O3 + "3 0 1 3\n", "line 6 .*no vertex '3'"),
    "negative_index.off": ("OFF\n3 1 0\n" + O3 + "3 0 1 -1\n", "line 6"),
    "short_row.off": ("OFF\n3 1 0\n" + O3.replace("1 0 0", "1 0") + "3 0 1 2\n", "line 4 .*too few"),
    "infinite.off": ("OFF\n3 1 0\n" + O3.replace("1 0 0", "inf 0 0") + "3 0 1 2\n", "line 4 .*finite"),
    "two_corners.off": ("OFF\n3 1 0\n" + O3 + "2 0 1   \n", "line 6 .*three corners"),
    "no_faces.off": ("OFF\n3 0 0\n" + O3, "no faces"),
    "binary.off": (b"OFF BINARY\n\x00\x00\x00\x03", "number of vertices"),
    # STL
    "claims.stl": (stl(10**9, 1), "claims 1000000000 triangles, which take at least 50000000000 bytes"),
    "claims_most.stl": (stl(2**32 - 1, 1), "claims 4294967295"),
    "claims_few.stl": (stl(1, 3), "claims 1 triangles, but 100 more"),
    "cut.stl": (stl(3, 3)[:-10], "claims 3 triangles"),
    "short.stl": (b"\x00" * 50, "too few"),
    "header_only.stl": (stl(0, 0), "no faces"),
    "nan.stl": (stl(2, 1) + struct.pack("<12fH", *[0.0] * 10, np.nan, 0.0, 0), r"triangle 1 \(byte 134\).*finite"),
    "infinite.stl": (stl(1, 1, np.inf), "triangle 0"),
    "cut_ascii.stl": ("solid a\n" + FACET[:50], "ends within"),
    "four_vertices.stl": ("solid a\n" + FACET.replace("endloop", "vertex 1 1 1\nendloop"), "line 8 .*exactly three"),
    "two_vertices.stl": ("solid a\n" + FACET.replace("vertex 1 0 0\n", "") + "endsolid", "line 6 .*exactly three"),
    "loop_in_loop.stl": ("solid a\n" + FACET.replace("vertex 1", "outer loop\nvertex 1"), "line 5 .*exactly three"),
    "word.stl": ("solid a\n" + FACET.replace("endloop", "endlop"), "line 7 .*'endlop'"),
    "no_number.stl": ("solid a\n" + FACET.replace("1 0 0", "1 O 0"), "line 5 .*'O'"),
    "too_large.stl": ("solid a\n" + FACET.replace("1 0 0", "1e39 0 0"), "float32"),
    "nothing.stl": ("solid a\nendsolid a\n", "no faces"),
    # PLY
    "claims.ply": (ply(POINTS, n=10**9), "claims 1000000000 elements 'vertex'"),
    "claims_faces.ply": (ply(POINTS, m=10**9), "claims 1000000000 elements 'face'"),
    "claims_ascii.ply": (ply(O3.encode(), "ascii", n=10**9), "claims 1000000000 vertex"),
    "claims_list.ply": (
        ply(POINTS + struct.pack("<I3i", 10**9, 0, 1, 2), faces=LIST.replace("uchar", "uint")),
        "face 0 .*past the end",
    ),
    "negative_list.ply": (
        ply(POINTS + struct.pack("<b3i", -3, 0, 1, 2), faces=LIST.replace("uchar", "char")),
        "face 0 .*negative",
    ),
    "cut.ply": (ply(POINTS + bytes([3]) + struct.pack("<2i", 0, 1)), "face 0"),
    "cut_vertices.ply": (ply(POINTS[:-4]), "vertex"),
    "large_index.ply": (ply(POINTS + bytes([3]) + struct.pack("<3i", 0, 1, 3)), "face 0 .*3 vertices"),
    "negative_index.ply": (ply(POINTS + bytes([3]) + struct.pack("<3i", 0, 1, -1)), "face 0"),
    "large_index_ascii.ply": (ply((O3 + "3 0 1 3\n").encode(), "ascii"), "line 13 .*'3'"),
    "two_corners.ply": (ply(POINTS + bytes([2]) + struct.pack("<3i", 0, 1, 0)), "face 0 .*three corners"),
    "nan.ply": (ply(struct.pack("<9f", *[np.nan] * 9) + bytes([3]) + bytes(12)), "vertex 0 .*finite"),
    "signalling_nan.ply": (ply(bytes([1, 0, 160, 127]) * 9 + bytes([3]) + bytes(12)), "vertex 0 .*finite"),
    "no_end.ply": (ply().replace(b"end_header\n", b""), "end_header"),
    "endless.ply": (b"ply\n" + b"comment\n" * 400_000, "end_header"),
    "format.ply": (ply(form="binary_middle_endian"), "line 2"),
    "no_format.ply": (ply().replace(b"format binary_little_endian 1.0\n", b""), "format"),
    "type.ply": (ply(xyz=XYZ.replace("float", "quad")), "line 4"),
    "count.ply": (ply().replace(b"vertex 3", b"vertex " + b"9" * 30), "line 3"),
    "no_count.ply": (ply().replace(b"vertex 3", b"vertex many"), "line 3"),
    "property_first.ply": (b"ply\nformat ascii 1.0\nproperty float x\nend_header\n", "line 3"),
    "float_list.ply": (ply(faces=LIST.replace("uchar", "float")), "line 8"),
    "no_z.ply": (ply(xyz=XYZ[:34]), "x, y and z"),
    "no_list.ply": (ply(faces="property int vertex_indices\n"), "list"),
    "strips.ply": (ply().replace(b"face", b"tristrips"), "'face'"),
    "points.ply": (ply(POINTS, m=0), "no faces"),
    "no_magic.ply": (b"poly\n" * 10, "'ply'"),
    "many_empty_rows.ply": (
        ply().replace(b"element vertex", b"element nothing 999999999999999999\nelement vertex"),
        "vertex",
    ),
}


@pytest.fixture(scope="module", autouse=True)
def _compiled() -> None:
    """The memory is that of reading, not of compiling."""
    for name, data in (
        ("a.obj", V3 + "f 1 2 3\n"),
        ("a.off", "OFF\n3 1 0\n" + O3 + "3 0 1 2\n"),
        ("a.stl", "solid a\n" + FACET + "endsolid a\n"),
    ):
        decode_mesh(data.encode(), name)
    decode_mesh(ply(POINTS + bytes([3]) + struct.pack("<3i", 0, 1, 2)), "a.ply")


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile(name: str) -> None:
    content, message = HOSTILE[name]
    data = content.encode() if isinstance(content, str) else content
    with contextlib.suppress(InputError):
        FORMATS[format_of_name(name)].decode(data, name)  # what is imported only then is not the file's
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=message) as caught:
            FORMATS[format_of_name(name)].decode(data, name)
        assert tracemalloc.get_traced_memory()[1] < 30 * len(data) + 2_000_000
    finally:
        tracemalloc.stop()
    assert str(caught.value).startswith(name)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("name", HOSTILE)
def test_each_cut_of_a_hostile_file_is_refused_or_read(name: str) -> None:
    content = HOSTILE[name][0]
    data = content.encode() if isinstance(content, str) else content
    for length in np.unique(np.linspace(0, min(len(data), 600), 12).astype(int)):
        try:
            vertices, faces = decode_mesh(data[:length], name)
        except InputError:
            continue
        assert faces.min() >= 0
        assert faces.max() < len(vertices)
        assert np.isfinite(vertices).all()


@pytest.mark.parametrize("name", ["a.obj", "a.off", "a.ply", "a.stl"])
def test_noise_after_a_good_beginning(name: str) -> None:
    rng = np.random.default_rng(17)
    good = {
        "a.obj": (V3 + "f 1 2 3\n").encode(),
        "a.off": ("OFF\n3 1 0\n" + O3 + "3 0 1 2\n").encode(),
        "a.ply": ply(POINTS + bytes([3]) + struct.pack("<3i", 0, 1, 2)),
        "a.stl": stl(1, 1),
    }[name]
    for _ in range(300):
        data = np.frombuffer(good, np.uint8).copy()
        places = rng.integers(0, len(data), rng.integers(1, 4))
        data[places] = rng.integers(0, 256, len(places))
        try:
            vertices, faces = FORMATS[name[2:]].decode(data.tobytes(), name)
        except InputError:
            continue
        assert 0 <= faces.min() <= faces.max() < len(vertices)
        assert np.isfinite(vertices).all()
