"""Which mesh format a file is in: its extension decides, its content must agree."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import PurePath

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats import obj, off, ply, stl
from sppm_pipeline.formats.mesh_arrays import DecodedMesh, require_content

__all__ = ["FORMATS", "decode_mesh", "format_of_name", "sniff"]

#: The readers and writers of meshes by extension.
FORMATS = {"stl": stl, "obj": obj, "ply": ply, "off": off}

_STRANGERS = {
    b"PK\x03\x04": "a zip archive (3MF and others)",
    b"glTF": "a binary glTF (GLB)",
    b"\x89PNG": "a PNG image",
    b"\x1f\x8b": "a gzip archive",
    b"%PDF": "a PDF document",
    b"<": "an XML or HTML document",
    b"{": "a JSON document",
    b"ISO-10303-21": "a STEP file",
    b"version https://git-lfs": "a Git LFS pointer, not the file itself",
}
_OBJ_WORDS = {b"v", b"vn", b"vt", b"vp", b"f", b"l", b"o", b"g", b"s", b"mtllib", b"usemtl"}


def format_of_name(name: str) -> str:
    """The format that the extension of a file name stands for, in lower case.

    Raises
    ------
    InputError
        If the extension is none of `FORMATS`.
    """
    extension = PurePath(name).suffix[1:].lower()
    if extension not in FORMATS:
        known = ", ".join(f".{known}" for known in FORMATS)
        close = get_close_matches(extension, FORMATS, n=1)
        meant = f"; did you mean .{close[0]}?" if close else ""
        raise InputError(
            f"{name}: the extension {'.' + extension if extension else '(none)'} is no mesh format",
            hint=f"known are {known}{meant}",
        )
    return extension


def sniff(data: bytes | memoryview | bytearray) -> str | None:
    """What the content looks like: a key of `FORMATS`, a description of something else, or None if unclear."""
    head = bytes(data[:4096])
    if head[:4] in (b"ply\n", b"ply\r") or head[:4] == b"ply ":
        return "ply"
    if stl.is_binary(data) or stl.is_ascii(data):
        return "stl"
    for line in head.splitlines():
        words = line.split(b"#", 1)[0].split()
        if words:
            if words[0].endswith(b"OFF") and len(words[0]) <= 6:
                return "off"
            if words[0] in _OBJ_WORDS:
                return "obj"
            break
    for start, description in _STRANGERS.items():
        if head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(start):
            return description
    return None


def decode_mesh(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read a mesh in the format that the extension of `name` stands for.

    Returns
    -------
    vertices : (n, 3) float64
    faces : (m, 3) int64

    Raises
    ------
    InputError
        If the extension is unknown, the content is of another format, or it is broken.
    """
    expected = format_of_name(name)
    require_content(data, name)
    found = sniff(data)
    if found in FORMATS and found != expected:
        raise InputError(
            f"{name}: this file is named .{expected} but is {'an' if found in ('obj', 'off') else 'a'} {found.upper()}",
            hint=f"rename it to {PurePath(name).with_suffix('.' + found).name}",
        )
    if found is not None and found not in FORMATS:
        raise InputError(f"{name}: this file is named .{expected} but is {found}")
    mesh: DecodedMesh = FORMATS[expected].decode(data, name)
    return mesh
