"""STEP and IGES files of known bodies: volumes, units, faces by name; and files that are refused."""

from __future__ import annotations

import math
import re
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from sppm_cad.read_cad import ReadCad

from sppm_pipeline import InputError, Length
from sppm_pipeline.testing.plain_context import PlainContext

sys.path.insert(0, str(Path(__file__).parent))
import models

FACES = {
    r"#\d+ cylinder hole d=5 color=#b3b3b3 body=bracket": 2,
    r"#\d+ cylinder hole d=8 color=#ff0000 body=bracket name=bearing seat": 1,
    r"#\d+ cylinder d=6 color=#b3b3b3 body=bracket": 1,
    r"#\d+ plane color=#b3b3b3 body=bracket": 15,
}
EXACT = 60 * 30 * 6 + 6 * 30 * 34 - math.pi * (2 * 2.5**2 * 6 + 4**2 * 6) + math.pi * 9 * 5


def in_this_process(function, arrays, options, **_):
    """As `run_native`, without the seconds that a process takes to load Open CASCADE."""
    module, _, name = function.partition(":")
    made, values = getattr(import_module(module), name)(arrays, options)
    return SimpleNamespace(arrays=made, values=values)


def read(path, folder, native=False, **options):
    context = PlainContext(directory=folder)
    with pytest.MonkeyPatch.context() as patch:
        if not native:
            patch.setattr("sppm_pipeline.run_native", in_this_process)
        return ReadCad(path=path, **options).run(context), context


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cad")
    body = models.bracket()
    models.write(folder / "mm.step", {"bracket": body})
    models.write(folder / "inch.step", {"bracket": body}, unit="INCH")
    models.write(folder / "mm.igs", {"bracket": body})
    return folder


@pytest.mark.parametrize("name", ["mm.step", "inch.step", "mm.igs"])
def test_bracket(files, tmp_path, name):
    mesh, context = read(files / name, tmp_path)
    assert mesh.bounds_solid
    assert mesh.summary()["volume_mm3"] == pytest.approx(EXACT, rel=5e-4)
    assert context.reported["exact_volume_mm3"] == pytest.approx(EXACT, rel=1e-9)
    np.testing.assert_allclose([mesh.lower, mesh.upper], [[0, 0, 0], [60, 30, 40]], atol=1e-5)
    for pattern, count in FACES.items():
        assert sum(bool(re.fullmatch(pattern, group[0])) for group in mesh.groups) == count, pattern
    # each triangle belongs to one face, and lies on it
    assert [group[1] for group in mesh.groups[1:]] == [group[2] for group in mesh.groups[:-1]]
    assert (mesh.groups[0][1], mesh.groups[-1][2]) == (0, len(mesh.faces))
    for group, first, last in mesh.groups:
        if "d=8" in group:
            points = mesh.vertices[mesh.faces[first:last]].reshape(-1, 3)
            np.testing.assert_allclose(np.hypot(points[:, 0] - 48, points[:, 1] - 15), 4, atol=2e-5)


@pytest.mark.parametrize("chord", [0.2, 0.02, 0.005])
def test_chord_and_volume_hold(tmp_path, chord):
    path = models.write(tmp_path / "ball.step", {"ball": models.ball(0, 0, 0, 12)})
    mesh, context = read(path, tmp_path, chord=Length(chord))
    middles = np.linalg.norm(mesh.vertices[mesh.faces].mean(1), axis=1)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 12, atol=1e-6)
    assert 12 - middles.min() <= chord
    assert abs(context.reported["volume_error"]) <= 5e-4
    assert mesh.groups[0][0] == "#1 sphere d=24 color=#b3b3b3 body=ball"


def test_several_bodies_in_their_places(tmp_path):
    shapes = {"plate": models.box(10, 10, 2), "ball": models.ball(20, 5, 5, 4)}
    path = models.write(tmp_path / "two.step", shapes)
    mesh, context = read(path, tmp_path)
    assert context.reported["bodies"] == 2
    assert mesh.summary()["volume_mm3"] == pytest.approx(200 + 4 / 3 * math.pi * 64, rel=5e-4)
    only = [read(path, tmp_path, bodies=bodies)[0].summary()["volume_mm3"] for bodies in (("plate",), ("1",))]
    assert only == [pytest.approx(200, rel=1e-9)] * 2
    with pytest.raises(InputError, match="no body 'lid'"):
        read(path, tmp_path, bodies=("lid",))
    # copies of an assembly
    mesh, context = read(models.write(tmp_path / "row.step", {"box": models.box(1, 1, 1)}, copies=5), tmp_path)
    assert context.reported["bodies"] == 5
    np.testing.assert_allclose(mesh.upper, [81, 1, 1])


def test_placed(files, tmp_path):
    mesh, _ = read(files / "mm.step", tmp_path, turn=(90.0, 0.0, 0.0), scale=0.5, place="corner")
    np.testing.assert_allclose([mesh.lower, mesh.upper], [[0, 0, 0], [30, 20, 15]], atol=1e-6)
    assert mesh.summary()["volume_mm3"] == pytest.approx(EXACT / 8, rel=5e-4)
    assert sum("hole d=2.5 " in group[0] for group in mesh.groups) == 2
    mesh, _ = read(files / "mm.step", tmp_path, place="center")
    np.testing.assert_allclose([mesh.lower, mesh.upper], [[-30, -15, 0], [30, 15, 40]], atol=1e-6)


def test_a_concave_fillet_is_no_hole(tmp_path):
    quarter = models.BRepAlgoAPI_Cut(models.box(10, 10, 4), models.cylinder(0, 0, -1, (0, 0, 1), 5, 6)).Shape()
    mesh, context = read(models.write(tmp_path / "q.step", {"q": quarter}), tmp_path)
    assert context.reported["holes"] == 0
    assert sum(" cylinder d=10" in group[0] for group in mesh.groups) == 1


def test_the_same_bytes_in_another_process(files, tmp_path):
    one, other = (read(files / "mm.step", tmp_path, native=native)[0] for native in (False, True))
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert (one.faces.tobytes(), one.groups) == (other.faces.tobytes(), other.groups)


def test_units_that_are_missing_or_replaced(files, tmp_path):
    text = (files / "mm.step").read_text()
    bare = tmp_path / "bare.step"
    # contexts without units, as some exporters write them
    bare.write_text(re.sub(r"GLOBAL_UNIT_ASSIGNED_CONTEXT\(\([#\d,\s]*\)\)", "GLOBAL_UNIT_ASSIGNED_CONTEXT(())", text))
    with pytest.raises(InputError, match="states no unit"):
        read(bare, tmp_path)
    mesh, _ = read(bare, tmp_path, unit="cm")
    np.testing.assert_allclose(mesh.upper, [600, 300, 400], atol=1e-5)
    mesh, context = read(files / "inch.step", tmp_path, unit="mm")
    np.testing.assert_allclose(mesh.upper, np.array([60, 30, 40]) / 25.4, atol=1e-6)
    assert "inch" in context.warnings[0]


def test_hostile_files(files, tmp_path):
    def refused(name, content, match):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(InputError, match=match):
            read(path, tmp_path)

    whole = (files / "mm.step").read_bytes()
    refused("empty.step", b"", "is empty")
    refused("stl.step", b"solid x\nendsolid x\n", "no STEP file by its content")
    refused("head.step", whole[: whole.index(b"DATA;")], "no STEP file|no shape")
    refused(
        "none.step", whole[: whole.index(b"DATA;")] + b"DATA;\nENDSEC;\nEND-ISO-10303-21;\n", "no STEP file|no shape"
    )
    refused("cut.step", whole[: len(whole) // 2], "STEP file|no shape|no solid|faces")
    refused("empty.igs", b"", "is empty")
    refused("text.igs", b"hello\n" * 50, "no IGES file by its content")
    refused("part.stl", whole, "no STEP or IGES file by its extension")
    with pytest.raises(InputError, match="no solid body: it has sheets that enclose no volume, 'lid'"):
        read(models.write(tmp_path / "sheet.step", {"lid": models.sheet()}), tmp_path)
    mesh, context = read(
        models.write(tmp_path / "both.step", {"lid": models.sheet(), "box": models.box(1, 2, 3)}), tmp_path
    )
    assert mesh.summary()["volume_mm3"] == pytest.approx(6)
    assert "sheets" in context.warnings[0]
    with pytest.raises(InputError, match="assembly of 500 bodies; at most 100"):
        read(models.write(tmp_path / "many.step", {"box": models.box(1, 1, 1)}, copies=500), tmp_path)
