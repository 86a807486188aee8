"""Reports on meshes with one defect each."""

import numpy as np
import pytest

from sppm_pipeline.engine.plan.checking import declared_numbers, is_declared
from sppm_pipeline.engine.run.sweep_table import numbers_of
from sppm_pipeline.engine.strict_json import json_text, jsonable
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.surface.stages.check_mesh import CheckMesh
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh, torus_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import Rejected
from sppm_pipeline.testing.plain_context import PlainContext

BALL = ball_mesh((0, 0, 0), 3.0, 3)
BOX = box_mesh((0, 0, 0), (4, 3, 2))


def check(vertices, faces, **options):
    mesh = SurfaceMesh(np.array(vertices, float), np.array(faces), name="part.stl")
    stage, context = CheckMesh(**options), PlainContext()
    stage.check_options()
    assert stage.run(context, mesh) is mesh
    json_text(context.reported)
    declared = declared_numbers(CheckMesh, True, (SurfaceMesh,))
    for place in numbers_of([{"id": "mesh", "summary": jsonable(context.reported)}]):
        assert is_declared(place.removeprefix("mesh."), declared)
    assert len(context.warnings) == len(context.reported["problems"]) + bool(context.reported.get("cavities"))
    return context.reported


def two(a, b, inward=False):
    faces = b[1][:, ::-1] if inward else b[1]
    return np.concatenate([a[0], b[0]]), np.concatenate([a[1], faces + len(a[0])])


@pytest.mark.parametrize(("mesh", "genus"), [(BALL, 0), (BOX, 0), (torus_mesh((0, 0, 0), 3.0, 1.0), 1)])
def test_sound(mesh, genus):
    found = check(*mesh)
    assert found["problems"] == []
    assert found["verdict"].endswith("bounds a solid: watertight, manifold, wound outwards")
    assert (found["genus"], found["euler_number"], found["components"]) == (genus, 2 - 2 * genus, 1)
    for word in ("watertight", "manifold", "winding_consistent", "winding_outward", "self_intersections_complete"):
        assert found[word] is True
    for word in ("holes", "open_edges", "self_intersecting_triangles", "degenerate_triangles", "unused_vertices"):
        assert found[word] == 0


def test_figures_of_a_box():
    found = check(*BOX, thin=Length(2.5))
    assert found["volume_mm3"] == pytest.approx(24)
    assert found["area_mm2"] == pytest.approx(52)
    assert found["upper_mm"] == [2, 1.5, 1]
    assert found["thickness_minimum_mm"] == pytest.approx(2)
    assert found["thickness_median_mm"] == pytest.approx(3)
    assert found["thin_share"] == pytest.approx(24 / 52, abs=1e-4)
    assert found["problems"] == ["thin_walls"]
    assert "46.2% of the surface is on walls thinner than 2.5 mm" in found["verdict"]
    assert check(*BOX, thin=Length(2.5), thin_share=0.5)["problems"] == []


def test_holes():
    vertices, faces = BALL
    first, other = (np.flatnonzero((faces == corner).any(1)) for corner in (0, 200))
    found = check(vertices, np.delete(faces, np.concatenate([first, other]), 0))
    assert found["problems"] == ["open"]
    assert (found["holes"], found["open_edges"]) == (2, len(first) + len(other))
    assert (found["watertight"], found["manifold"], found["winding_consistent"]) == (False, True, True)
    assert found["unused_vertices"] == 2
    assert found["volume_mm3"] is None
    assert found["genus"] is None
    assert "2 holes with" in found["verdict"]


def test_a_seam_of_vertices_that_were_not_merged():
    vertices, faces = BOX
    found = check(vertices[faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert found["unmerged_vertices"] == 36 - 8
    assert found["self_intersecting_pairs"] == 0
    assert "were not merged" in found["verdict"]


def test_winding():
    vertices, faces = BALL
    flip = np.arange(len(faces)) % 7 == 0
    found = check(vertices, np.where(flip[:, None], faces[:, ::-1], faces))
    assert found["problems"] == ["winding"]
    assert found["triangles_to_turn"] == flip.sum()
    assert (found["watertight"], found["winding_consistent"], found["winding_outward"]) == (True, False, False)
    found = check(vertices, faces[:, ::-1])
    assert found["triangles_to_turn"] == len(faces)
    assert (found["winding_consistent"], found["winding_outward"]) == (True, False)
    assert found["volume_mm3"] < 0


def test_pieces_hollows_and_shells_inside():
    inner, beside = ball_mesh((0, 0, 0), 1.0, 2), ball_mesh((9, 0, 0), 1.0, 2)
    found = check(*two(BALL, inner, inward=True))
    assert found["problems"] == []
    assert (found["cavities"], found["components"], found["genus"]) == (1, 2, 0)
    assert found["component_volumes_mm3"][1] < 0
    assert found["cavity_mm3"] == pytest.approx(4 / 3 * np.pi, rel=0.05)
    found = check(*two(BALL, inner))
    assert found["problems"] == ["shells", "components"]
    assert found["shells_inside_others"] == 1
    found = check(*two(BALL, beside))
    assert found["problems"] == ["components"]
    found = check(*two(BALL, beside, inward=True))
    assert found["problems"] == ["winding", "components"]
    assert found["shells_inside_out"] == 1


def test_non_manifold_edges_and_vertices():
    corner = two(BOX, box_mesh((4, 3, 2), (4, 3, 2)))
    same = np.arange(16)
    same[8 + int(np.flatnonzero((corner[0][8:] == (2, 1.5, 1)).all(1))[0])] = int(
        np.flatnonzero((corner[0][:8] == (2, 1.5, 1)).all(1))[0]
    )
    found = check(corner[0], same[corner[1]])
    assert found["problems"] == ["non_manifold"]
    assert (found["non_manifold_edges"], found["non_manifold_vertices"]) == (0, 1)
    assert (found["genus"], list(found["genus_of_surfaces"])) == (0, [0, 0])
    vertices, faces = BOX
    fin = np.concatenate([vertices, [(0, 0, 9)]]), np.concatenate([faces, [(0, 1, 8)]])
    found = check(*fin)
    assert found["non_manifold_edges"] == 1
    assert found["watertight"] is False


def test_intersections_duplicates_and_flat_triangles():
    found = check(*two(BOX, box_mesh((1, 1, 1), (4, 3, 2))))
    assert found["problems"] == ["self_intersections", "components"]
    assert 0 < found["self_intersecting_triangles"] <= 24
    vertices, faces = BALL
    found = check(vertices, np.concatenate([faces, faces[:2], faces[:1, ::-1]]))
    assert found["duplicate_triangles"] == 3
    assert "duplicates" in found["problems"]
    middle = np.concatenate([vertices, [vertices[faces[0, :2]].mean(0)]])
    n = len(vertices)
    a, b, _ = faces[0]
    flat = check(middle, np.concatenate([faces, [(a, n, b)]]))
    assert flat["degenerate_triangles"] == 1


@pytest.mark.parametrize("word", ["open", "self_intersections", "thin_walls"])
def test_reject(word):
    meshes = {
        "open": (BOX[0], BOX[1][1:]),
        "self_intersections": two(BOX, box_mesh((1, 1, 1), (4, 3, 2))),
        "thin_walls": BOX,
    }
    for name, mesh in meshes.items():
        options = {"thin": Length(2.5 if name == "thin_walls" else 0.001), "reject": (word,)}
        if name == word:
            with pytest.raises(Rejected, match=r"part.stl is rejected") as caught:
                check(*mesh, **options)
            assert "repair" in caught.value.hint
        else:
            assert word not in check(*mesh, **options)["problems"]


def test_what_cannot_be_asked():
    with pytest.raises(ConfigError, match="needs `thin`"):
        check(*BOX, reject=("thin_walls",))
    with pytest.raises(InputError, match="no triangles"):
        check(np.zeros((3, 3)), np.empty((0, 3), int))
