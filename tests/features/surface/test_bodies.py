"""Bodies, cavities, and what floats in cavities."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.features.surface.numerics.meshcheck.bodies import find_shells, largest_body, used_vertices
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.services.mesh.measures import components, volume


def together(*meshes):
    starts = np.cumsum([0, *(len(v) for v, _ in meshes)])
    vertices = np.concatenate([v for v, _ in meshes])
    return vertices, np.concatenate([f + s for (_, f), s in zip(meshes, starts[:-1], strict=True)]).astype(np.int32)


def cavity(mesh):
    return mesh[0], mesh[1][:, ::-1]


def cube(size, at=(0.0, 0.0, 0.0)):
    return box_mesh(at, (size,) * 3)


def test_a_hollow_body_that_holds_a_hollow_body():
    big, hole = cube(10), cavity(cube(8))
    inner, inner_hole = ball_mesh((1, 0, 0), 2.0, 3), cavity(ball_mesh((1, 0, 0), 1.0, 2))
    aside, aside_hole = cube(4, (20, 0, 0)), cavity(cube(2, (20, 0, 0)))
    mesh = together(inner_hole, aside, inner, hole, big, aside_hole)
    shells = find_shells(*mesh)
    assert (shells.bodies, shells.cavities) == (3, 3)
    assert shells.volumes[4] == pytest.approx(1000)
    assert shells.volumes.sum() == pytest.approx(volume(*mesh))
    kept = largest_body(*mesh, shells)
    assert volume(*kept) == pytest.approx(1000 - 512)
    assert components(kept[1])[0] == 2
    assert len(kept[0]) == 16


def test_no_body():
    vertices, faces = largest_body(*(mesh := cavity(cube(1))), find_shells(*mesh))
    assert len(vertices) == len(faces) == 0
    none = np.empty((0, 3)), np.empty((0, 3), np.int32)
    assert find_shells(*none).bodies == 0


def test_vertices_without_triangle_go():
    vertices, faces = used_vertices(np.arange(15.0).reshape(5, 3), np.array([[4, 1, 3]], np.int32))
    assert vertices[:, 0].tolist() == [3, 9, 12]
    assert faces.tolist() == [[2, 0, 1]]
