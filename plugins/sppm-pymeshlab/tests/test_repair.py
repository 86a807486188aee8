"""Broken meshes of which we know what was meant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from sppm_pymeshlab import meshlab
from sppm_pymeshlab.inside_test import InsideTest
from sppm_pymeshlab.repair import STEPS, RepairMesh

from sppm_pipeline.errors import ConfigError, DesignError, InputError, NativeCrash, PluginError
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.mesh.measures import edge_counts, measure_surface, volume
from sppm_pipeline.stage import Stage
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext

pytestmark = pytest.mark.skipif(find_spec("pymeshlab") is None, reason="needs pymeshlab: pip install pymeshlab")


def repaired(mesh: SurfaceMesh, **options: Any) -> tuple[SurfaceMesh, PlainContext]:
    context = PlainContext()
    return RepairMesh(**options).run(context, mesh), context


def kept(context: PlainContext) -> list[str]:
    return [entry["step"] for entry in context.reported["steps"] if entry["kept"]]


def volume_of(mesh: SurfaceMesh) -> float:
    return volume(mesh.vertices, mesh.faces)


@pytest.mark.skipif(find_spec("pymeshlab") is None, reason="needs pymeshlab")
class TestContract(StageContract):
    def stages(self) -> Sequence[Stage]:
        return [RepairMesh(steps=("close",), samples=100)]

    def inputs(self) -> Mapping[str, Any]:
        vertices, faces = ball_mesh((0.0, 0.0, 0.0), 5.0, 1)
        return {"mesh": SurfaceMesh(vertices, faces[1:])}


def test_a_good_mesh_stays_the_same_object(ball):
    made, context = repaired(ball)
    assert made is ball
    assert context.reported["steps"] == []
    assert context.reported["self_intersecting_triangles"] == 0
    assert context.warnings == []


def test_holes_are_closed(ball):
    open_ball = SurfaceMesh(ball.vertices, np.delete(ball.faces, [3, 4, 5, 700, 900, 901], axis=0), "holes")
    made, context = repaired(open_ball)
    assert edge_counts(made.faces).closed
    assert volume_of(made) == pytest.approx(volume_of(ball), rel=0.005)
    assert kept(context)[-1] == "close"
    closing = context.reported["steps"][-1]
    assert closing["open_edges_before"] == edge_counts(open_ball.faces).boundary
    assert closing["open_edges_after"] == 0
    assert closing["changed_share"] < 0.01
    assert context.reported["volume_before_mm3"] == pytest.approx(volume_of(open_ball))
    assert context.reported["volume_after_mm3"] == pytest.approx(volume_of(made))


def test_inside_out_is_turned_without_meshlab(ball):
    made, context = repaired(SurfaceMesh(ball.vertices, ball.faces[:, ::-1]))
    assert kept(context) == ["orient"]
    np.testing.assert_array_equal(made.faces, ball.faces)
    assert context.reported["changed_share"] == 0


def test_faces_that_disagree_are_wound_alike(ball):
    faces = ball.faces.copy()
    faces[::3] = faces[::3, ::-1]
    made, context = repaired(SurfaceMesh(ball.vertices, faces))
    assert "orient" in kept(context)
    assert volume_of(made) == pytest.approx(volume_of(ball))
    assert edge_counts(made.faces).closed


def test_duplicate_and_degenerate_triangles_go(ball):
    vertices = np.concatenate([ball.vertices, [[9.0, 9, 9]], ball.vertices[:1]])
    faces = np.concatenate([ball.faces, ball.faces[:4], [[0, 5, 5]]])
    made, context = repaired(SurfaceMesh(vertices, faces))
    assert kept(context) == ["clean"]
    assert len(made.faces) == len(ball.faces)
    assert volume_of(made) == pytest.approx(volume_of(ball))


def test_seams_are_merged(ball):
    """Each triangle has corners of its own, moved by less than the tolerance."""
    rng = np.random.default_rng(1)
    corners = ball.vertices[ball.faces].reshape(-1, 3)
    corners = corners + rng.uniform(-1e-6, 1e-6, corners.shape)
    made, context = repaired(
        SurfaceMesh(corners, np.arange(len(corners)).reshape(-1, 3)), merge_distance=Length(1e-5, "mm")
    )
    assert edge_counts(made.faces).closed
    assert measure_surface(made.vertices, made.faces).vertices == len(ball.vertices)
    assert "merge" in kept(context)


def test_overlapping_parts_are_united_exactly(boxes):
    mesh = boxes(((0, 0, 0), (4, 4, 4), False), ((3, 0.1, 0.2), (4, 2, 2), False))
    assert volume_of(mesh) == pytest.approx(80)
    made, context = repaired(mesh)
    assert kept(context) == ["unite"]
    assert volume_of(made) == pytest.approx(64 + 16 - 1 * 2 * 2)
    assert measure_surface(made.vertices, made.faces).components == 1
    assert context.reported["self_intersecting_triangles"] == 0
    assert context.reported["changed_share"] == 0


def test_cavities_stay(boxes):
    mesh = boxes(((0, 0, 0), (4, 4, 4), False), ((0, 0, 0), (2, 2, 2), True))
    made, _ = repaired(mesh)
    assert made is mesh
    turned, context = repaired(SurfaceMesh(mesh.vertices, mesh.faces[:, ::-1]))
    assert volume_of(turned) == pytest.approx(64 - 8)
    assert kept(context) == ["orient"]


def test_a_bowl_is_not_filled_in_secret(ball):
    """To close the boundary loop of half a ball with a lid changes what is inside; that is for the user to say."""
    bowl = SurfaceMesh(ball.vertices, ball.faces[ball.vertices[ball.faces].mean(1)[:, 2] < -1], "bowl")
    with pytest.raises(InputError, match=r"bowl can't be repaired: .*close \(undone\)"):
        repaired(bowl)
    made, context = repaired(bowl, steps=("close",))
    assert edge_counts(made.faces).closed
    assert any("would change sides" in warning for warning in context.warnings)


def test_soup_is_refused_or_wrapped(soup):
    with pytest.raises(InputError, match="soup can't be repaired: 90 open edges") as caught:
        repaired(soup)
    assert "last_resort: wrap" in caught.value.hint
    made, context = repaired(soup, last_resort="wrap", wrap_gap=Length(1.5))
    assert edge_counts(made.faces).bounds_solid
    assert any("was wrapped" in warning for warning in context.warnings)
    assert kept(context)[-1] == "wrap"


def test_what_is_left_open_is_handed_on_if_wished(soup):
    made, context = repaired(soup, steps="clean", must_close=False)
    assert len(made.faces) == 30
    assert context.warnings[-1] == "90 open edges are left"


def test_three_sheets_in_an_edge_are_cut(ball):
    """A fin on a ball: a triangle that stands on one of its edges."""
    a, b, _ = ball.faces[10]
    tip = ball.vertices[a] * 1.5
    mesh = SurfaceMesh(
        np.concatenate([ball.vertices, [tip]]), np.concatenate([ball.faces, [[a, b, len(ball.vertices)]]])
    )
    made, _ = repaired(mesh, steps=("split",), must_close=False)
    assert edge_counts(made.faces).non_manifold == 0


def test_a_crash_of_one_step_is_not_the_end(ball, monkeypatch):
    def crash(mesh, name, seconds, **options):
        if name == "clean":
            raise NativeCrash("pymeshlab died by SIGSEGV in step 'clean'")
        return filtered(mesh, name, seconds, **options)

    filtered = meshlab.filtered
    monkeypatch.setattr(meshlab, "filtered", crash)
    open_ball = SurfaceMesh(ball.vertices, ball.faces[1:])
    made, context = repaired(open_ball)
    assert edge_counts(made.faces).closed
    assert context.reported["steps"][0]["kept"] is False
    assert "SIGSEGV" in context.warnings[0]
    with pytest.raises(NativeCrash):
        repaired(open_ball, steps=("clean",))


def test_a_step_that_destroys_the_volume_is_undone(ball, monkeypatch):
    def destroy(mesh, name, seconds, **options):
        made = filtered(mesh, name, seconds, **options)
        if name != "close":
            return made
        flat = made.vertices * [1, 1, 0.2]
        return SurfaceMesh(flat, made.faces, made.name)

    filtered = meshlab.filtered
    monkeypatch.setattr(meshlab, "filtered", destroy)
    with pytest.raises(InputError, match=r"close \(undone\)"):
        repaired(SurfaceMesh(ball.vertices, ball.faces[1:]))


def test_refused_filters_are_no_crash(soup):
    with pytest.raises(DesignError, match="unite: Failed to apply filter"):
        repaired(soup, steps=("unite",))


def test_a_slender_part_is_measured_with_a_warning(boxes):
    mesh = boxes(((0, 0, 0), (10, 10, 0.01), False), ((5, 5, 5), (0.01, 0.01, 10), True))
    _, context = repaired(mesh, steps=("orient",), must_close=False)
    assert "lie inside" in context.warnings[0]


def test_the_inside_test_sees_what_changes_and_not_which_way_it_is_wound(ball):
    test = InsideTest(ball, 500, 1)
    assert test.inside.mean() == pytest.approx(np.pi / 6, abs=0.03)
    assert test.changed(SurfaceMesh(ball.vertices, ball.faces[:, ::-1])) == 0
    smaller = SurfaceMesh(ball.vertices * 0.5 ** (1 / 3), ball.faces)
    assert test.changed(smaller) == pytest.approx(0.5, abs=0.05)
    test.accept(smaller)
    assert test.changed(ball) == 0, "compared with the input, not with the last step"


@pytest.mark.parametrize("steps", [(), ("auto",), ("clean", "auto")])
def test_lists_of_steps_are_checked(steps):
    with pytest.raises(ConfigError, match="a list of steps"):
        RepairMesh(steps=steps).check_options()
    for step in STEPS:
        RepairMesh(steps=(step,)).check_options()


def test_an_empty_mesh_is_refused():
    with pytest.raises(InputError, match="no triangles"):
        repaired(SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))


def test_indices_out_of_range_stay_in_the_child():
    with pytest.raises((PluginError, NativeCrash)):
        meshlab.filtered(SurfaceMesh(np.eye(3), [[0, 1, 2**30]]), "clean", 60)
