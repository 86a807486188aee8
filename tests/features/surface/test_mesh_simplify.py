"""Fewer triangles: within the tolerance of the surface, of the same topology, and not flat."""

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError, InputError
from sppm_pipeline.features.surface.numerics import simplifying
from sppm_pipeline.features.surface.numerics.simplifying import Simplified, qualities, simplify
from sppm_pipeline.features.surface.stages.mesh_simplify import SimplifyMesh
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.mesh.closing import capped_marching_cubes
from sppm_pipeline.services.mesh.measures import edge_counts, euler_number, genus, volume
from sppm_pipeline.testing.plain_context import PlainContext


def gyroid(n=60, cells=1.5):
    t = 2 * np.pi * np.linspace(0, cells, n)
    z, y, x = np.meshgrid(t, t, t, indexing="ij")
    field = (np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)).astype(np.float32)
    h = float(t[1] - t[0])
    return capped_marching_cubes(field, 0.0, (0.0, 0.0, 0.0), (h, h, h))


def middles(vertices, faces):
    return vertices[faces].mean(1)


def test_a_ball_keeps_to_its_radius_at_vertices_and_middles():
    vertices, faces = ball_mesh((1.0, 2.0, 3.0), 5.0, 4)
    made = simplify(vertices, faces, 0.05)
    assert len(made.faces) < len(faces) / 8
    given = 5.0 - np.linalg.norm(middles(vertices, faces) - [1, 2, 3], axis=1).min()  # of a polyhedron
    for points in (made.vertices, middles(*made[:2])):
        assert abs(np.linalg.norm(points - [1, 2, 3], axis=1) - 5.0).max() <= 0.05 + given
    assert edge_counts(made.faces).closed
    assert genus(made.faces) == 0
    assert 0 < made.farthest <= 0.05


def test_a_gyroid_keeps_its_genus_and_gets_no_needles():
    vertices, faces = gyroid()
    made = simplify(vertices, faces, 0.02)
    assert len(made.faces) < 0.35 * len(faces)
    assert euler_number(made.faces) == euler_number(faces)
    assert edge_counts(made.faces).closed
    assert volume(*made[:2]) == pytest.approx(volume(vertices, faces), rel=0.003)
    assert (qualities(*made[:2]) < 0.1).mean() < 0.4 * (qualities(vertices, faces) < 0.1).mean()
    # the exact distance, by all triangles of the surface given that are near
    from sppm_pipeline.services.nearest import squared_to_triangle

    corners = vertices[faces]
    center = corners.mean(1)
    for point in np.concatenate([made.vertices[::97], middles(*made[:2])[::97]]):
        near = np.flatnonzero(np.linalg.norm(center - point, axis=1) < 0.5)
        assert min(squared_to_triangle(corners[f], *point) for f in near) <= 0.02**2 * 1.001


def test_a_box_of_many_triangles_becomes_one_of_few_with_the_same_edges():
    n = 17
    field = np.ones((n, n, n), np.float32)
    field[4:-4, 4:-4, 4:-4] = -1
    vertices, faces = capped_marching_cubes(field, 0.0, (0.0,) * 3, (1.0,) * 3)
    made = simplify(vertices, faces, 0.01)
    assert len(made.faces) < len(faces) / 5
    assert volume(*made[:2]) == pytest.approx(volume(vertices, faces), rel=1e-3)


def test_open_boundaries_and_touching_corners_stay():
    vertices, faces = ball_mesh((0.0, 0.0, 0.0), 5.0, 4)
    open_faces = faces[middles(vertices, faces)[:, 2] < 3.0]
    made = simplify(vertices, open_faces, 0.05)
    assert edge_counts(made.faces).boundary == edge_counts(open_faces).boundary
    ahead = np.roll(open_faces, -1, axis=1)
    edges = np.sort(np.stack([open_faces, ahead], axis=-1).reshape(-1, 2), axis=1)
    _, index, counts = np.unique(edges, axis=0, return_index=True, return_counts=True)
    rim = vertices[np.unique(edges[index[counts == 1]])]
    kept = {tuple(point) for point in made.vertices}
    assert all(tuple(point) in kept for point in rim)
    # two balls that share a vertex: it stays
    tip = faces[0, 0]
    more = np.where(faces == tip, tip, faces + len(vertices))
    both = np.concatenate([vertices, 2 * vertices[tip] - vertices])
    touching = simplify(both, np.concatenate([faces, more[:, ::-1]]), 0.05)
    assert tuple(vertices[tip]) in {tuple(point) for point in touching.vertices}
    assert euler_number(touching.faces) == 3


def test_the_same_input_gives_the_same_bytes():
    vertices, faces = gyroid(30)
    a, b = simplify(vertices, faces, 0.02), simplify(vertices.copy(), faces.copy(), 0.02)
    assert np.array_equal(a.vertices, b.vertices)
    assert np.array_equal(a.faces, b.faces)


def test_the_stage_reports_and_keeps_the_name():
    context = PlainContext()
    made = SimplifyMesh(largest_distance=Length(0.05, "mm")).run(
        context, SurfaceMesh(*ball_mesh((0.0, 0.0, 0.0), 5.0, 4), name="ball")
    )
    assert made.name == "ball"
    assert context.reported["triangles_after"] == len(made.faces) < context.reported["triangles_before"] == 5120
    assert context.reported["farthest_mm"] <= 0.05


@pytest.mark.parametrize("spoiled", ["hole", "volume"])
def test_a_planted_violation_is_refused(monkeypatch, spoiled):
    vertices, faces = ball_mesh((0.0, 0.0, 0.0), 5.0, 3)

    def broken(vertices, faces, tolerance):
        return Simplified(vertices, faces[1:], 0.0) if spoiled == "hole" else Simplified(1.1 * vertices, faces, 0.0)

    monkeypatch.setattr(simplifying, "simplify", broken)
    with pytest.raises(DesignError, match="topology" if spoiled == "hole" else "volume"):
        SimplifyMesh().run(PlainContext(), SurfaceMesh(vertices, faces))


def test_what_cannot_be_simplified():
    with pytest.raises(InputError, match="no triangles"):
        SimplifyMesh().run(PlainContext(), SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))
    vertices, faces = box_mesh((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert len(simplify(vertices, faces, 1e-3).faces) == len(faces)
