"""What is no mesh, or pretends to be a huge one, is refused by the stage at once and within little memory."""

import json
import os
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from sppm_pipeline.errors import InputError
from sppm_pipeline.features.files.formats.detect import FORMATS
from sppm_pipeline.features.files.stages.read_mesh import MAX_COORDINATE, MAX_FILE_BYTES, ReadMesh
from sppm_pipeline.testing.plain_context import PlainContext

HANGS = 20.0
"""Seconds of processor time, many times what is needed: a guard against hanging, not a measurement."""

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def obj_of(vertices: np.ndarray, faces: np.ndarray = FACES) -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()), ""]).encode()


def refused(path: Path, match: str, **options: object) -> InputError:
    start = time.process_time()
    with pytest.raises(InputError, match=match) as caught:
        ReadMesh(path=path, **options).run(PlainContext())
    assert time.process_time() - start < HANGS
    return caught.value


BAD = {
    "flat.obj": (obj_of(CORNERS * [1, 1, 0]), "flat: its size is 1 x 1 x 0 mm"),
    "nearly_flat.obj": (obj_of(CORNERS * [1, 1, 1e-12]), "flat"),
    "point.obj": (obj_of(CORNERS * 0 + 7), "as small as a point"),
    "denormal.obj": (obj_of(CORNERS * 1e-310), "as small as a point"),
    "galaxy.obj": (obj_of(CORNERS * 1e30), f"reaches to 1e.30 mm; at most {MAX_COORDINATE:g}".replace("+", ".")),
    "overflow.obj": (obj_of(CORNERS * 1e307), "make sense"),
    "largest.obj": (obj_of(CORNERS * 1.7e308 - 0.9e308), "make sense"),
    "doubled.obj": (
        obj_of(CORNERS, np.concatenate([FACES, FACES[:, ::-1]])),
        "does not bound a volume|encloses nothing",
    ),
    "open.obj": (obj_of(CORNERS, FACES[:3]), "open edges"),
    "one.obj": (obj_of(CORNERS, FACES[3:]), "does not bound a volume"),
    "utf16.obj": (obj_of(CORNERS).decode().encode("utf-16"), "UTF-16"),
    "utf16.stl": ("solid a\nendsolid a\n".encode("utf-16-le"), "STL"),
    "noise.stl": (np.random.default_rng(1).integers(0, 256, 100_000, np.uint8).tobytes(), "noise.stl"),
    "long_line.obj": (b"f " + b"1 " * 3_000_000, "no vertex '1'"),
    "long_word.obj": (b"v 0 0 " + b"1" * 5_000_000 + b"\nf 1 1 1\n", "number"),
    "page.stl": (b"<!DOCTYPE html><html><body>404</body></html>" * 3, "HTML"),
    "pointer.obj": (b"version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 1\n", "LFS"),
    "scene.gltf": (b"{}", "export it as GLB"),
    "mesh.step": (b"ISO-10303-21;", "a CAD model"),
    "no_extension": (obj_of(CORNERS), "no mesh format"),
    "obj.stl": (obj_of(CORNERS), "named .stl but is an OBJ"),
    "glb.obj": (b"".join(FORMATS["glb"].encode(CORNERS, FACES)), "is a GLB"),
    "3mf.glb": (b"".join(FORMATS["3mf"].encode(CORNERS, FACES)), "is a 3MF"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files(name: str, tmp_path: Path) -> None:
    content, message = BAD[name]
    (tmp_path / name).write_bytes(content)
    error = refused(tmp_path / name, message)
    assert error.hint or name in ("page.stl", "pointer.obj", "utf16.obj", "long_line.obj", "long_word.obj", "3mf.glb")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    refused(tmp_path / "pipe.stl", "a pipe")
    (tmp_path / "folder.stl").mkdir()
    refused(tmp_path / "folder.stl", "a folder")
    refused(Path("/dev/zero"), "a device")
    with socket.socket(socket.AF_UNIX) as end:
        end.bind(str(tmp_path / "s.stl"))
        refused(tmp_path / "s.stl", "a socket")
    (tmp_path / "loop.stl").symlink_to(tmp_path / "loop.stl")
    refused(tmp_path / "loop.stl", "cannot read")
    refused(tmp_path / ("x" * 300 + ".stl"), "cannot read")
    refused(tmp_path / "a\0b.stl", "cannot read")


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "huge.stl").open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)  # a hole, which takes no room on the disk
    refused(tmp_path / "huge.stl", "the limit is")


CHILD = """
import json, resource, sys, time
from pathlib import Path
from sppm_pipeline.errors import InputError
from sppm_pipeline.features.files.stages.read_mesh import ReadMesh
from sppm_pipeline.testing.plain_context import PlainContext

ReadMesh(path=Path(sys.argv[1])).run(PlainContext())  # loads what is to be loaded
size = int(next(line for line in open("/proc/self/status") if line.startswith("VmSize")).split()[1]) * 1024
resource.setrlimit(resource.RLIMIT_AS, (size + 300_000_000,) * 2)
result = {}
for path in map(Path, sys.argv[2:]):
    start = time.process_time()
    try:
        ReadMesh(path=path).run(PlainContext())
        said = "read"
    except InputError as error:
        said = str(error)
    result[path.name] = [said, time.process_time() - start]
print(json.dumps(result))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_claims_of_gigabytes_fit_in_300_megabytes(tmp_path: Path) -> None:
    ply = "ply\nformat binary_little_endian 1.0\nelement vertex {}\n"
    ply += "property float x\nproperty float y\nproperty float z\n"
    ply += "element face {}\nproperty list uint int vertex_indices\nend_header\n"
    accessor = b'"count":4'
    claims = {
        "a.stl": bytes(80) + struct.pack("<I", 10**9) + bytes(50),
        "b.stl": bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(5000),
        "a.ply": ply.format(10**9, 10**9).encode() + bytes(5000),
        "b.ply": ply.format(3, 10**9).encode() + bytes(5000),
        "c.ply": ply.format(3, 1).encode() + bytes(36) + struct.pack("<I", 2**32 - 1) + bytes(5000),
        "a.off": b"OFF\n1000000000 1000000000 0\n0 0 0\n",
        "b.off": b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n1000000000 0 1 2\n",
        "a.obj": b"v 0 0 0\nf 1 1 1000000000\n",
        "a.glb": b"".join(FORMATS["glb"].encode(CORNERS, FACES)).replace(accessor, b'"count":' + b"9" * 30, 1),
        "a.3mf": b"".join(FORMATS["3mf"].encode(CORNERS, FACES, offsets=np.zeros((200_000, 3)))),
    }
    claims["a.glb"] = relengthened(claims["a.glb"])
    (tmp_path / "good.obj").write_bytes(obj_of(CORNERS))
    for name, content in claims.items():
        (tmp_path / name).write_bytes(content)
    command = [sys.executable, "-c", CHILD, str(tmp_path / "good.obj"), *(str(tmp_path / name) for name in claims)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout.splitlines()[-1])
    assert list(said) == list(claims)
    for name, (message, seconds) in said.items():
        assert message.startswith(name)
        assert seconds < HANGS


def relengthened(glb: bytes) -> bytes:
    """A GLB whose JSON was changed, with lengths that fit again."""
    place = glb.index(b"BIN\0") - 4
    text = glb[20:place].rstrip()
    text += b" " * (-len(text) % 4)
    rest = glb[place:]
    return glb[:8] + struct.pack("<II", 20 + len(text) + len(rest), len(text)) + b"JSON" + text + rest
