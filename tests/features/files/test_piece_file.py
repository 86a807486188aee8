"""Mesh files that are written while the mesh is made: the bytes of those that are written from the whole mesh."""

from __future__ import annotations

import hashlib
import importlib
import time

import numpy as np
import pytest

from sppm_pipeline.engine.cache.session import CacheSession
from sppm_pipeline.engine.cache.store import Store
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.errors import SppmError
from sppm_pipeline.features.files.stages.write_mesh import ENCODERS, IN_PIECES, PieceFile, WriteMesh
from sppm_pipeline.features.surface.field_surface import FieldSurface
from sppm_pipeline.features.surface.mesh_stream import PieceWindow
from sppm_pipeline.features.surface.stages import extract_marching_cubes as marching_cubes
from sppm_pipeline.method.nouns.mesh import ExpectedSize, SurfaceMesh
from sppm_pipeline.method.part.part import node_grid
from sppm_pipeline.services.mesh.marching_cubes import marching_cubes_slabs
from sppm_pipeline.testing.plain_context import PlainContext

SCALE, ORIGIN = 7.5, np.array([0.3, -2.0, 11.0])
YAML = """sppm: 1
seed: 3
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: 30, share: 0.45}
    - {stage: sample.dart_throwing, total: 30}
    - {stage: connect.mbdst, degree: [2, 5], mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.13, tunnel_radius: 0.04}
pipeline:
  - {stage: tileset.free_faces, recipe: cell, porosity: 0.6, colors: 2, interiors: 2, resolution: 12, tolerance: 0.05}
  - {stage: tile.free_faces, cells: [2, 2, 1], cell: 3 mm}
  - {stage: extract.marching_cubes, resolution: 12}
"""
WRITERS = [f"  - {{stage: write.mesh, id: {kind[1:]}, path: out/mesh{kind}}}\n" for kind in IN_PIECES]
CHECK = "  - {stage: check.mesh}\n"


def pieces(rough: bool = False) -> list[tuple[np.ndarray, np.ndarray]]:
    if rough:  # as many vertices as sixteen bits count, and more
        field = np.random.default_rng(1).random((6, 160, 160), np.float32) - np.float32(0.5)
        return list(marching_cubes_slabs([field[:3], field[3:]]))
    axis = np.linspace(-0.5, 0.5, 17, dtype=np.float32)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    field = np.sqrt(x * x + y * y + z * z) - np.float32(0.4)
    return list(marching_cubes_slabs([field[k : k + 3] for k in range(0, 17, 3)], spacing=(0.1, 0.1, 0.1)))


def given(file: PieceFile, made: list[tuple[np.ndarray, np.ndarray]], more: int = 0) -> tuple[bool, SurfaceMesh]:
    """Give a file all pieces of a mesh, of which so many more vertices are predicted; whether it has taken them."""
    window = PieceWindow(SCALE, ORIGIN)
    vertices = np.concatenate([v for v, _ in made]) * SCALE + ORIGIN
    faces = np.concatenate([f for _, f in made])
    box = np.array([vertices.min(axis=0), vertices.max(axis=0)])
    assert file.begin(ExpectedSize(len(vertices) + more, len(faces), box, box))
    for some, triangles in made:
        points = window.push(some)
        file.add(points, window.base, window.known, triangles)
    return file.finish(), SurfaceMesh(vertices, faces)


def test_a_window_stays_until_the_call_after_the_next_one():
    made = [vertices for vertices, _ in pieces()]
    whole = np.concatenate(made) * SCALE + ORIGIN
    window, before = PieceWindow(SCALE, ORIGIN), None
    for vertices in made:
        points = window.push(vertices)
        first = window.base
        assert len(vertices) == len(points) - window.known
        if before is not None:
            assert np.array_equal(before[0], whole[before[1] : before[1] + len(before[0])])
        assert np.array_equal(points, whole[first : first + len(points)])
        before = points, first
    assert first + len(points) == len(whole)


@pytest.mark.parametrize("kind", IN_PIECES)
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("rough", [False, True])
def test_a_file_of_pieces_is_that_of_the_whole(tmp_path, kind, threads, rough):
    context = PlainContext(threads=threads, directory=tmp_path)
    told = []
    context.hashed = lambda name, sha256: told.append(sha256)
    encoder = importlib.import_module(ENCODERS[kind])
    file = PieceFile(tmp_path, encoder.in_pieces, threads)
    taken, mesh = given(file, pieces(rough))
    assert taken
    expected = b"".join(map(bytes, encoder.encode(mesh.vertices, mesh.faces)))
    assert file.hand_over(context, f"mesh{kind}") == len(expected)
    assert (tmp_path / f"mesh{kind}").read_bytes() == expected
    assert told == [hashlib.sha256(expected).hexdigest()]
    assert [path.name for path in tmp_path.iterdir()] == [f"mesh{kind}"]


@pytest.mark.parametrize("kind", IN_PIECES)
def test_what_is_not_as_predicted_leaves_nothing(tmp_path, kind):
    file = PieceFile(tmp_path, importlib.import_module(ENCODERS[kind]).in_pieces, 2)
    taken, _ = given(file, pieces(), more=1)
    assert not taken
    file.drop()
    assert not list(tmp_path.iterdir())


def test_decimals_have_to_be_certain(tmp_path):
    obj = importlib.import_module("sppm_pipeline.features.files.formats.obj")
    assert obj.in_pieces(3, 1, (9.99, 10.0)) is not None
    assert obj.in_pieces(3, 1, (9.99, 10.01)) is None
    assert not obj.in_pieces(3, 1, (9.99, 10.0)).fits(10.01)
    assert importlib.import_module("sppm_pipeline.services.formats.stl").in_pieces(3, 1, (1.0, 1e39)) is None


@pytest.mark.parametrize("wrong", ["vertex", "corner"])
def test_pieces_are_looked_at(tmp_path, wrong):
    made = pieces()
    vertices, faces = made[2]
    if wrong == "vertex":
        vertices[0, 0] = np.nan
    else:
        faces[0, 0] = sum(len(v) for v, _ in made[:3])
    file = PieceFile(tmp_path, importlib.import_module("sppm_pipeline.services.formats.stl").in_pieces, 1)
    window = PieceWindow(SCALE, ORIGIN)
    file.begin(ExpectedSize(1, 1, np.zeros((2, 3)), np.ones((2, 3))))

    def give():
        for some, triangles in made:
            file.add(window.push(some), window.base, window.known, triangles)

    with pytest.raises(ValueError, match="finite" if wrong == "vertex" else "does not exist"):
        give()
    file.drop()


@pytest.mark.parametrize("caps", [True, False])
@pytest.mark.parametrize("threads", [1, 3])
def test_what_is_predicted_comes(free_tiling, caps, threads):
    stream = FieldSurface(free_tiling, node_grid(free_tiling, 15), "remove", caps).stream(threads)
    predicted = stream.predicted()
    made = [(piece.vertices.copy(), len(piece.faces)) for piece in stream]
    vertices = np.concatenate([some for some, _ in made])
    assert (predicted.vertices, predicted.faces) == (len(vertices), sum(faces for _, faces in made))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    assert (predicted.most[0] <= low).all()
    assert (low <= predicted.least[0]).all()
    assert (predicted.least[1] <= high).all()
    assert (high <= predicted.most[1]).all()
    if caps:
        assert np.array_equal(predicted.least, predicted.most)


def files(folder):
    return {path.name: path.read_bytes() for path in (folder / "out").iterdir()}


def test_a_run_writes_the_same_whether_the_mesh_is_kept_or_not(run_yaml, monkeypatch):
    begun = []
    monkeypatch.setattr(PieceFile, "hand_over", lambda *a, was=PieceFile.hand_over: begun.append(a[2]) or was(*a))
    direct, folder = run_yaml(YAML + "".join(WRITERS), threads=2)
    assert begun == [f"out/mesh{kind}" for kind in IN_PIECES]
    checked, other = run_yaml(YAML + CHECK + "".join(WRITERS), threads=1, to="other")
    assert len(begun) == len(IN_PIECES)  # a check wants the whole mesh
    assert files(folder) == files(other)
    numbers = [{s["id"]: dict(s["summary"]) for s in record["stages"]} for record in (direct, checked)]
    # the pieces of a mesh that goes by in a stream are not counted
    assert [found["extract.marching_cubes"].pop("pieces", None) for found in numbers] == [None, 1]
    for id_ in ("extract.marching_cubes", "stl", "ply", "obj"):
        assert numbers[0][id_] == numbers[1][id_]
    assert [output["sha256"] for stage in direct["stages"] for output in stage.get("outputs", ())] == [
        hashlib.sha256(files(folder)[f"mesh{kind}"]).hexdigest() for kind in IN_PIECES
    ]


def test_what_is_not_as_predicted_is_made_again(run_yaml, monkeypatch):
    _, folder = run_yaml(YAML + WRITERS[0])
    wrong = FieldSurface._predicted
    monkeypatch.setattr(
        FieldSurface, "_predicted", lambda self, vertices, faces, *box: wrong(self, vertices, faces + 1, *box)
    )
    _, other = run_yaml(YAML + WRITERS[0], to="other")
    assert files(folder) == files(other)


def test_a_run_that_fails_leaves_nothing(run_yaml, monkeypatch, tmp_path):
    monkeypatch.setattr(PieceFile, "finish", lambda self: 1 / 0)
    with pytest.raises(SppmError):
        run_yaml(YAML + "".join(WRITERS))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["run.json"]


def test_who_comes_later_is_given_the_mesh(tmp_path):
    def run(text, to):
        (tmp_path / "config.yaml").write_text(text)
        session = open_session(RunRequest(str(tmp_path / "config.yaml"), distributions=False))
        return run_plan(session.plan(), tmp_path / to, threads=2, store=Store(tmp_path / "cache"), about="test")

    run(YAML + WRITERS[0], "first")
    record = run(YAML + WRITERS[0] + CHECK, "then")
    assert files(tmp_path / "first") == files(tmp_path / "then")
    (checked,) = [stage for stage in record["stages"] if stage["id"] == "check.mesh"]
    assert checked["summary"]["triangles"] > 1000


LIFTED = """
from dataclasses import dataclass
from typing import ClassVar
from sppm_pipeline import Context, ScalarField, SurfaceMesh, hookimpl
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes

@dataclass(frozen=True, kw_only=True)
class Lifted(MarchingCubes):
    \"\"\"Extract a surface, and lift it by a millimeter.\"\"\"
    name: ClassVar[str] = "extract.lifted"

    def run(self, context: Context, field: ScalarField) -> SurfaceMesh:
        mesh = super().run(context, field)
        return SurfaceMesh(mesh.vertices + [0.0, 0.0, 1.0], mesh.faces, mesh.name)

@hookimpl
def sppm_stages():
    return {"extract.lifted": Lifted}
"""


def test_a_stage_built_upon_another_is_given_the_mesh(run_yaml, tmp_path):
    (tmp_path / "lifted.py").write_text(LIFTED)
    text = YAML.replace("extract.marching_cubes", "extract.lifted") + WRITERS[1]
    session = open_session(
        RunRequest("lifted.yaml", plugins=(str(tmp_path / "lifted.py"),), distributions=False, text=text)
    )
    lifted = run_plan(session.plan(), tmp_path / "lifted", threads=2)["stages"]
    plain, folder = run_yaml(YAML + WRITERS[1])
    assert lifted[2]["summary"]["vertices"] == plain["stages"][2]["summary"]["vertices"]
    assert files(tmp_path / "lifted")["mesh.ply"] != files(folder)["mesh.ply"]


def test_what_it_costs_to_make_a_file_again_is_known(tmp_path, monkeypatch):
    """A file that was written meanwhile is kept by what the whole took, not by the moment in which it was moved."""
    cost = {}
    was = CacheSession.keep
    monkeypatch.setattr(CacheSession, "keep", lambda *a, **b: cost.update({a[1].id: b["seconds"]}) or was(*a, **b))
    began = marching_cubes.node_grid
    monkeypatch.setattr(marching_cubes, "node_grid", lambda *a: (time.sleep(0.2), began(*a))[1])
    (tmp_path / "config.yaml").write_text(YAML + "".join(WRITERS[:2]))
    session = open_session(RunRequest(str(tmp_path / "config.yaml"), distributions=False))
    run_plan(session.plan(), tmp_path / "out", threads=2, store=Store(tmp_path / "cache"))
    assert min(cost["stl"], cost["ply"]) > 0.1


def test_other_formats_want_the_whole():
    assert WriteMesh(path="a.off").begin(PlainContext()) is None
    assert WriteMesh(path="A.PLY").begin(PlainContext()) is not None
    mesh = SurfaceMesh.handed_on(5, 6, "surface", (np.zeros(3), np.ones(3), 1.0))
    assert not mesh.is_whole
    assert mesh.summary()["vertices"] == 5
    with pytest.raises(AttributeError):
        mesh.vertices  # noqa: B018 - nobody shall take it for one without triangles
