"""Remeshing, smoothing, decimation: closed stays closed, and the volume stays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from sppm_pymeshlab import meshlab
from sppm_pymeshlab.decimate import DecimateMesh
from sppm_pymeshlab.remesh import Remesh
from sppm_pymeshlab.smooth import SmoothMesh

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, torus_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.mesh.measures import edge_counts, genus, volume
from sppm_pipeline.stage import Stage
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext

pytestmark = pytest.mark.skipif(find_spec("pymeshlab") is None, reason="needs pymeshlab: pip install pymeshlab")


@pytest.mark.skipif(find_spec("pymeshlab") is None, reason="needs pymeshlab")
class TestContract(StageContract):
    def stages(self) -> Sequence[Stage]:
        return [DecimateMesh(keep=0.5)]

    def inputs(self) -> Mapping[str, Any]:
        return {"mesh": SurfaceMesh(*ball_mesh((0.0, 0.0, 0.0), 5.0, 2))}


@pytest.mark.parametrize("stage", [Remesh(edge_length=Length(2), rounds=3), SmoothMesh()], ids=lambda stage: stage.name)
def test_the_others_keep_the_contract(stage, ball):
    class Suite(StageContract):
        def stages(self) -> Sequence[Stage]:
            return [stage]

    suite = Suite()
    for name in ("has_a_name_of_family_and_word", "says_what_it_does", "is_frozen", "options_survive_a_run_record"):
        getattr(suite, f"test_{name}")()
    made = [stage.run(PlainContext(5, threads=threads), ball) for threads in (1, 3)]
    assert made[0].digest() == made[1].digest() != ball.digest()


def edge_lengths(mesh: SurfaceMesh) -> np.ndarray:
    corners = mesh.vertices[mesh.faces]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).ravel()


@pytest.fixture(scope="module")
def torus() -> SurfaceMesh:
    return SurfaceMesh(*torus_mesh((0.0, 0.0, 0.0), 8.0, 3.0, 48, 24), name="torus")


@pytest.mark.parametrize("edge", [0.8, 2.0])
def test_remeshed_edges_have_the_length(torus, edge):
    context = PlainContext()
    made = Remesh(edge_length=Length(edge, "mm"), deviation=Length(0.2)).run(context, torus)
    lengths = edge_lengths(made)
    assert lengths.mean() == pytest.approx(edge, rel=0.15)
    assert np.percentile(lengths, 99) < 1.8 * edge
    assert edge_counts(made.faces).closed
    assert genus(made.faces) == 1
    assert context.reported["mean_edge_mm"] == pytest.approx(lengths.mean())
    assert abs(context.reported["volume_change"]) < 0.05
    assert context.reported["volume_change"] == pytest.approx(
        volume(made.vertices, made.faces) / volume(torus.vertices, torus.faces) - 1
    )


def test_too_fine_an_edge_is_refused_before_any_work(torus):
    with pytest.raises(DesignError, match="would make about"):
        Remesh(edge_length=Length(1, "um")).run(PlainContext(), torus)


def test_smoothing_removes_noise_and_keeps_the_volume(ball):
    rng = np.random.default_rng(2)
    noisy = SurfaceMesh(ball.vertices * (1 + 0.02 * rng.standard_normal((len(ball.vertices), 1))), ball.faces)
    context = PlainContext()
    made = SmoothMesh(rounds=20).run(context, noisy)
    np.testing.assert_array_equal(made.faces, noisy.faces)
    radius_before, radius = (np.linalg.norm(mesh.vertices, axis=1) for mesh in (noisy, made))
    assert radius.std() < 0.5 * radius_before.std()
    assert abs(context.reported["volume_change"]) < 0.02


@pytest.mark.parametrize(("shrink", "inflate"), [(0.5, 0.5), (0.5, 0.4), (0.1, 0.3)])
def test_factors_that_would_shrink_or_explode(shrink, inflate):
    with pytest.raises(ConfigError, match="inflate"):
        SmoothMesh(shrink=shrink, inflate=inflate).check_options()


@pytest.mark.parametrize("options", [{"triangles": 500}, {"keep": 0.25}])
def test_decimation_meets_the_number(torus, options):
    context = PlainContext()
    made = DecimateMesh(**options).run(context, torus)
    target = options.get("triangles", len(torus.faces) * 0.25)
    assert len(made.faces) == pytest.approx(target, abs=2)
    assert edge_counts(made.faces).closed
    assert genus(made.faces) == 1
    assert abs(context.reported["volume_change"]) < 0.02
    assert not context.warnings


def test_the_topology_is_kept_before_the_number(torus):
    context = PlainContext()
    made = DecimateMesh(triangles=4).run(context, torus)
    assert genus(made.faces) == 1
    assert "would change the topology" in context.warnings[0]


def test_few_triangles_stay(ball):
    context = PlainContext()
    assert DecimateMesh(triangles=10**6).run(context, ball) is ball
    assert "stays as it is" in context.warnings[0]


@pytest.mark.parametrize("options", [{}, {"triangles": 10, "keep": 0.5}])
def test_one_measure_of_decimation_is_needed(options):
    with pytest.raises(ConfigError, match="either `triangles` or `keep`"):
        DecimateMesh(**options).check_options()


def test_a_filter_that_opens_a_mesh_fails(ball, monkeypatch):
    monkeypatch.setattr(meshlab, "filtered", lambda mesh, *_, **__: SurfaceMesh(mesh.vertices, mesh.faces[1:]))
    with pytest.raises(DesignError, match="decimate has opened ball: 3 open edges"):
        DecimateMesh(keep=0.5).run(PlainContext(), ball)


def test_a_filter_that_turns_a_mesh_inside_out_fails(ball, monkeypatch):
    monkeypatch.setattr(meshlab, "filtered", lambda mesh, *_, **__: SurfaceMesh(mesh.vertices, mesh.faces[:, ::-1]))
    with pytest.raises(DesignError, match="destroyed the volume"):
        SmoothMesh().run(PlainContext(), ball)


def test_open_meshes_are_taken_as_they_are(ball):
    cut = SurfaceMesh(ball.vertices, ball.faces[200:])
    context = PlainContext()
    made = DecimateMesh(keep=0.5).run(context, cut)
    assert edge_counts(made.faces).boundary > 0
    assert "volume_change" not in context.reported
