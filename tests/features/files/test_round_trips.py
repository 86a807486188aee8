"""What the encoders write is read back by us and by an independent reader."""

import io
from itertools import pairwise
from types import ModuleType

import numpy as np
import pytest
import trimesh

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.files.formats import obj, off
from sppm_pipeline.features.files.formats.detect import FORMATS, decode_mesh_file, sniff
from sppm_pipeline.services.formats import ply, stl
from sppm_pipeline.services.mesh.marching_cubes import marching_cubes
from sppm_pipeline.services.mesh.measures import measure_surface
from sppm_pipeline.services.mesh.rotation import rotated, upright

Mesh = tuple[np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    """More vertices and faces than the encoders write at once."""
    z, y, x = np.mgrid[-1:1:90j, -1:1:90j, -1:1:90j]
    field = np.cos(9 * x) * np.sin(9 * y) + np.cos(9 * y) * np.sin(9 * z) + np.cos(9 * z) * np.sin(9 * x)
    vertices, faces = marching_cubes(field, 0, (-31.4, 0.25, 1e-4), (0.1, 0.1, 0.1))
    assert len(faces) > 65536
    return vertices, faces


def error_allowed(name: str, vertices: np.ndarray) -> float:
    return {"ply": 0.0, "stl": 4e-6, "glb": 4e-6}.get(name, 5.1e-8 if np.abs(vertices).max() > 10 else 5e-9)


def read_back(data: bytes, name: str) -> Mesh:
    """In millimeters, z up, as they were written."""
    file = decode_mesh_file(data, f"mesh.{name}")
    return rotated(file.vertices * file.mm, upright(file.up)), file.faces


def sorted_corners(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    return vertices[faces].reshape(-1, 3)


@pytest.mark.parametrize("name", FORMATS)
def test_we_read_what_we_write(name: str, mesh: Mesh) -> None:
    vertices, faces = mesh
    data = b"".join(FORMATS[name].encode(vertices, faces))
    assert sniff(data) == name
    read, read_faces = read_back(data, name)
    assert read.dtype == np.float64
    assert read_faces.dtype == np.int64
    error = np.abs(sorted_corners(read, read_faces) - sorted_corners(vertices, faces)).max()
    assert error <= error_allowed(name, vertices)
    if name != "stl":
        assert np.array_equal(read_faces, faces)
    assert measure_surface(read, read_faces).edges == measure_surface(vertices, faces).edges


@pytest.mark.parametrize("name", FORMATS)
def test_trimesh_reads_what_we_write(name: str, mesh: Mesh) -> None:
    vertices, faces = mesh
    data = b"".join(FORMATS[name].encode(vertices, faces))
    if name == "3mf":
        pytest.importorskip("lxml", reason="trimesh reads 3MF by lxml")
    read = trimesh.load(io.BytesIO(data), file_type=name, process=False, maintain_order=True)
    if isinstance(read, trimesh.Scene):
        read = read.to_mesh()
    points = np.asarray(read.vertices)
    if name == "glb":
        points = rotated(points * 1000, upright("y"))
    error = np.abs(sorted_corners(points, read.faces) - sorted_corners(vertices, faces)).max()
    assert error <= error_allowed(name, vertices)


@pytest.mark.parametrize("name", FORMATS)
def test_we_read_what_trimesh_writes(name: str) -> None:
    if name == "3mf":
        pytest.importorskip("lxml", reason="trimesh writes 3MF by lxml")
    torus = trimesh.creation.torus(2.0, 0.5)
    written = torus.export(file_type=name)
    data = written.encode() if isinstance(written, str) else written
    vertices, faces = FORMATS[name].decode(data, "mesh")
    measures = measure_surface(vertices, faces)
    assert measures.genus == 1
    assert measures.volume == pytest.approx(torus.volume, rel=1e-5)
    assert measures.faces == len(torus.faces)


@pytest.mark.parametrize("name", ["stl_ascii", "ply_ascii"])
def test_we_read_the_text_forms_of_trimesh(name: str) -> None:
    ball = trimesh.creation.icosphere(2)
    if name == "stl_ascii":
        data = trimesh.exchange.stl.export_stl_ascii(ball).encode()
    else:
        data = trimesh.exchange.ply.export_ply(ball, encoding="ascii")
    vertices, faces = FORMATS[name[:3]].decode(data, "mesh")
    assert measure_surface(vertices, faces).genus == 0
    assert len(faces) == len(ball.faces)


@pytest.mark.parametrize("module", FORMATS.values(), ids=FORMATS)
def test_same_mesh_same_bytes_in_bounded_pieces(module: ModuleType, mesh: Mesh) -> None:
    first, second = list(module.encode(*mesh)), list(module.encode(*mesh))
    assert first == second
    assert max(map(len, first)) < 65536 * 64
    assert list(module.encode(*mesh, threads=3)) == first


def test_ply_keeps_the_type_of_the_coordinates() -> None:
    vertices, faces = np.eye(3), np.array([[0, 1, 2]])
    assert b"property double x" in b"".join(ply.encode(vertices / 3, faces))
    assert b"property float x" in b"".join(ply.encode((vertices / 3).astype(np.float32), faces))
    assert (ply.decode(b"".join(ply.encode(vertices / 3, faces)), "x")[0] == vertices / 3).all()


def test_stl_normals_are_unit_and_outward() -> None:
    corners = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3], [1, 1, 2]])
    data = b"".join(stl.encode(corners, faces))
    assert len(data) == 84 + 50 * 5
    assert not data.startswith(b"solid")
    records = np.frombuffer(data, np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]), 5, 84)
    assert records["n"][:3].tolist() == [[0, 0, -1], [0, -1, 0], [-1, 0, 0]]
    assert np.linalg.norm(records["n"][3]) == pytest.approx(1, abs=1e-6)
    assert (records["n"][3] > 0).all()
    assert (records["n"][4] == 0).all()
    assert (records["a"] == 0).all()


@pytest.mark.parametrize("module", [obj, off])
@pytest.mark.parametrize("size", [1e-40, 1e-6, 1.0, 1e7, 1e20, 1e200])
def test_text_of_any_size(module: ModuleType, size: float) -> None:
    vertices = np.random.default_rng(0).uniform(-size, size, (50, 3))
    read, _ = module.decode(b"".join(module.encode(vertices, np.array([[0, 1, 2]]))), "x")
    assert np.abs(read - vertices).max() <= 5.1e-10 * 10 ** np.ceil(np.log10(np.abs(vertices).max()))


@pytest.mark.parametrize("name", FORMATS)
def test_meshes_that_can_not_be_written(name: str) -> None:
    eye, face = np.eye(3), np.array([[0, 1, 2]])
    for vertices, faces, match in (
        (eye * np.nan, face, "finite"),
        (eye, face + 1, "vertices"),
        (eye, face - 1, "vertices"),
        (eye[:, :2], face, r"\(n, 3\)"),
        (eye, face[:, :2], r"\(n, 3\)"),
    ):
        with pytest.raises(ValueError, match=match):
            list(FORMATS[name].encode(vertices, faces))
    with pytest.raises(DesignError, match="float32"):
        list(stl.encode(eye * 1e39, face))


def test_pieces_of_a_large_mesh_follow_each_other(mesh: Mesh) -> None:
    lines = b"".join(obj.encode(*mesh)).split(b"\n")
    kinds = [line[:1] for line in lines[1:-1]]
    assert kinds == [b"v"] * len(mesh[0]) + [b"f"] * len(mesh[1])
    assert sum(a != b for a, b in pairwise(kinds)) == 1
