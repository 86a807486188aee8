"""The extension decides, the content must agree."""

import struct

import pytest

from sppm_pipeline.errors import InputError
from sppm_pipeline.features.files.formats.detect import FORMATS, decode_mesh, format_of_name, sniff

OBJ = b"# words\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
OFF = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
STL = (
    b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"
)
BINARY_STL = bytes(80) + struct.pack("<I12fH", 1, *[0.0] * 6, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0)
PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    b"property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
)
FILES = {"obj": [OBJ], "off": [OFF, OFF.replace(b"OFF", b"COFF")], "stl": [STL, BINARY_STL], "ply": [PLY]}


@pytest.mark.parametrize("named", FORMATS)
@pytest.mark.parametrize("content", FILES)
def test_name_and_content(named: str, content: str) -> None:
    for data in FILES[content]:
        assert sniff(data) == content
        if named == content:
            vertices, faces = decode_mesh(data, f"some.dir/part.{named.upper()}")
            assert (len(vertices), len(faces)) == (3, 1)
        else:
            with pytest.raises(InputError, match=rf"named \.{named} but is an? {content.upper()}") as caught:
                decode_mesh(data, f"part.{named}")
            assert f"part.{content}" in str(caught.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"PK\x03\x04rest", "zip"),
        (b"glTF\x02\x00", "GLB"),
        (b"\n<!DOCTYPE html><html>", "HTML"),
        (b'{"asset": 1}', "JSON"),
        (b"\x1f\x8b\x08", "gzip"),
        (b"version https://git-lfs.github.com/spec/v1\n", "LFS"),
    ],
)
def test_files_of_another_kind(data: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        decode_mesh(data, "part.obj")


def test_the_byte_order_mark_of_utf_8_hides_no_vertex() -> None:
    for name, (data, *_) in FILES.items():
        if name != "stl" or data == STL:
            vertices, faces = decode_mesh(b"\xef\xbb\xbf" + data.replace(b"# words\n", b""), f"a.{name}")
            assert (len(vertices), len(faces)) == (3, 1)
    with pytest.raises(InputError, match="empty"):
        decode_mesh(b"\xef\xbb\xbf", "a.obj")


def test_unknown_extensions() -> None:
    with pytest.raises(InputError, match=r"a \.stp file holds a CAD model"):
        format_of_name("part.stp")
    with pytest.raises(InputError, match=r"did you mean '\.stl"):
        format_of_name("part.sttl")
    with pytest.raises(InputError, match="none"):
        decode_mesh(OBJ, "part")


def test_unclear_content_is_left_to_the_reader() -> None:
    assert sniff(b"hello") is None
    with pytest.raises(InputError, match="no faces"):
        decode_mesh(b"hello\n", "part.obj")
    with pytest.raises(InputError, match="empty"):
        decode_mesh(b"", "part.obj")
