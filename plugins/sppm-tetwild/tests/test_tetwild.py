"""Solids filled with tetrahedra: volume, orientation, repeatability, and what is refused."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sppm_tetwild import random_device
from sppm_tetwild.quality import cell_volumes, dihedral_angles
from sppm_tetwild.tetwild import TetWild

import sppm_pipeline
from sppm_pipeline.engine.process import NativeResult
from sppm_pipeline.errors import DesignError, InputError, ResourceError
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.mesh.measures import edge_counts, volume
from sppm_pipeline.stage import Stage
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext

needs_pytetwild = pytest.mark.skipif(
    find_spec("pytetwild") is None, reason="needs pytetwild: pip install 'pytetwild<0.5'"
)
seedable = sys.platform == "linux" and platform.machine() in ("x86_64", "aarch64")

BALL = SurfaceMesh(*ball_mesh((5.0, 5.0, 5.0), 5.0, 1), name="ball")
QUICK: dict[str, Any] = {"epsilon": Length(0.03), "ideal_edge_length": Length(0.2), "rounds": 10}


@needs_pytetwild
class TestContract(StageContract):
    def stages(self) -> Sequence[Stage]:
        return [TetWild(**QUICK)] if seedable else []

    def inputs(self) -> Mapping[str, Any]:
        return {"mesh": BALL}


@needs_pytetwild
@pytest.mark.parametrize("options", [{}, {"optimize": False}, {"coarsen": True}])
def test_a_ball_is_filled(options):
    context, made_to_last = PlainContext(1), options.get("optimize", True)
    made = TetWild(**QUICK | options).run(context, BALL)
    assert made.volume == pytest.approx(volume(BALL.vertices, BALL.faces), rel=0.1)
    assert (cell_volumes(made.nodes, made.cells) > 0).all()
    assert len(np.unique(made.cells)) == len(made.nodes)
    assert made.box is None
    assert (made.materials == 1).all()
    assert context.reported["volume_change"] == pytest.approx(made.volume / volume(BALL.vertices, BALL.faces) - 1)
    assert context.reported["smallest_dihedral_angle"] == dihedral_angles(made.nodes, made.cells).min()
    assert context.reported["smallest_dihedral_angle"] > 1 or not made_to_last
    assert context.reported["largest_aspect_ratio"] >= context.reported["mean_aspect_ratio"] >= 1
    sides = np.sort(made.cells[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3), axis=1)
    unique, counts = np.unique(sides, axis=0, return_counts=True)
    assert counts.max() == 2
    assert edge_counts(unique[counts == 1]).boundary == 0


@needs_pytetwild
@pytest.mark.skipif(not seedable, reason="the random device can be replaced on Linux only")
def test_the_seed_makes_the_mesh():
    digests = []
    for seed in (1, 1, 2):
        context = PlainContext(seed)
        digests.append(TetWild(**QUICK | {"epsilon": Length(0.01)}).run(context, BALL).digest())
        assert context.reported["reproducible"] is True
        assert not any("repeated" in warning for warning in context.warnings)
    assert digests[0] == digests[1] != digests[2]


@needs_pytetwild
def test_lengths_may_have_a_unit():
    diagonal = float(np.linalg.norm(BALL.upper - BALL.lower))
    made = [
        TetWild(epsilon=epsilon, ideal_edge_length=edge, rounds=10).run(PlainContext(4), BALL)
        for epsilon, edge in [
            (Length(0.03), Length(0.1)),
            (Length(0.03 * diagonal, "mm"), Length(0.01 * diagonal, "cm")),
            (Length(0.03), Length(0.2)),
        ]
    ]
    if seedable:
        assert len(made[0].cells) == len(made[1].cells)
    assert len(made[0].cells) > 1.5 * len(made[2].cells)


@needs_pytetwild
def test_a_cell_gets_its_box():
    cube = SurfaceMesh(*box_mesh((1.0, 1.0, 0.5), (2.0, 2.0, 1.0)))
    made = TetWild(**QUICK, cell=Length(2, "mm")).run(PlainContext(), cube)
    np.testing.assert_array_equal(made.box, [[0, 0, 0], [2, 2, 2]])
    assert made.summary()["porosity"] == pytest.approx(0.5, abs=0.01)
    made.check()
    with pytest.raises(DesignError, match="reaches from 0 to 1 mm"):
        TetWild(**QUICK, cell=Length(1, "mm")).run(PlainContext(), cube)


@needs_pytetwild
def test_the_time_limit_is_kept():
    with pytest.raises(ResourceError, match=r"^pytetwild \S+ used up its 0.05 s"):
        TetWild(epsilon=Length(1e-4), time_limit=0.05).run(PlainContext(), BALL)


@needs_pytetwild
def test_the_current_folder_stays_clean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    TetWild(**QUICK).run(PlainContext(), BALL)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3), np.int32), "no triangles"),
        (BALL.vertices * [1, 1, 0], BALL.faces, "flat"),
        (BALL.vertices * [1, 1, 1e-9], BALL.faces, "flat"),
        (BALL.vertices, BALL.faces[1:], "3 open edges"),
        (BALL.vertices, BALL.faces[:, ::-1], "inside out"),
        (BALL.vertices, np.concatenate([BALL.faces, BALL.faces[:, ::-1]]), "two sheets"),
    ],
)
def test_what_would_crash_is_refused(vertices, faces, words):
    with pytest.raises(InputError) as caught:
        TetWild().run(PlainContext(), SurfaceMesh(vertices, faces))
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "options", [{"ideal_edge_length": Length(1.1)}, {"epsilon": Length(0.2)}, {"ideal_edge_length": Length(1, "m")}]
)
def test_lengths_beyond_the_part_are_refused(options):
    with pytest.raises(DesignError, match="as long as the diagonal"):
        TetWild(**options).run(PlainContext(), BALL)


def answer(monkeypatch, nodes, cells, draws=2):
    """Let the child return what it should not."""
    arrays = {"nodes": np.array(nodes, float), "cells": np.array(cells, np.int32).reshape(-1, 4)}
    monkeypatch.setattr(sppm_pipeline, "run_native", lambda *_, **__: NativeResult(arrays, {"draws": draws}))


TETRAHEDRON = SurfaceMesh(np.eye(4, 3, -1), [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], "corner")


@pytest.mark.parametrize(
    ("cells", "words"),
    [
        ([], "no tetrahedra"),
        ([[0, 1, 2, 9]], "do not exist"),
        ([[0, 1, 2, 2]], "1 are flat"),
        ([[0, 1, 2, 3]] * 3, "more than two"),
        ([[0, 1, 2, 3]] * 2, "the surface encloses"),
    ],
)
def test_bad_answers_are_refused(monkeypatch, cells, words):
    answer(monkeypatch, TETRAHEDRON.vertices, cells)
    with pytest.raises(DesignError, match=words):
        TetWild().run(PlainContext(), TETRAHEDRON)


def test_inverted_tetrahedra_are_turned_and_unused_nodes_dropped(monkeypatch):
    nodes = np.concatenate([[[7.0, 7, 7]], TETRAHEDRON.vertices])
    answer(monkeypatch, nodes, [[1, 3, 2, 4]], draws=0)
    context = PlainContext()
    made = TetWild().run(context, TETRAHEDRON)
    assert made.volume == pytest.approx(1 / 6)
    assert len(made.nodes) == 4
    assert context.reported["reproducible"] is False
    assert "can't be repeated" in context.warnings[0]


def test_a_thick_envelope_is_told(monkeypatch):
    answer(monkeypatch, TETRAHEDRON.vertices, [[0, 1, 2, 3]])
    context = PlainContext()
    TetWild(epsilon=Length(0.05)).run(context, TETRAHEDRON)
    assert "thin walls may close" in context.warnings[0]


@pytest.mark.parametrize("data", [b"", b"\x7fELF\x02\x01", b"\x7fELF\x01\x01" + bytes(100), b"MZ" + bytes(100)])
def test_other_libraries_are_left_alone(tmp_path, data):
    library = tmp_path / "library.so"
    library.write_bytes(data)
    device = random_device.SeededDevice(library, "anything", 1)
    assert device.drawn == 0


@pytest.mark.skipif(not seedable, reason="the random device can be replaced on Linux only")
def test_a_library_without_a_random_device_is_left_alone():
    import _ctypes

    path = Path(getattr(_ctypes, "__file__", ""))
    if not path.is_file():
        pytest.skip("ctypes is built into the interpreter")
    with pytest.raises(ValueError, match="random device"):
        random_device._find(path.read_bytes(), b"PyInit__ctypes")
