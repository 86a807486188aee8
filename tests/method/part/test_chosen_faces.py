"""Which triangles are chosen, and the voxels within a distance of them, against distances one by one."""

import numpy as np
import pytest

from sppm_pipeline.method.part.chosen_faces import SLACK, add_skin_on, faces_toward, faces_within
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.nearest import squared_to_triangle

GRID = Grid((-0.1, -0.2, -0.15), (0.07, 0.05, 0.06), (20, 26, 24))


def triangles(rng, kind):
    made = rng.random((3, 3, 3))
    if kind in ("level", "along x"):
        made[:, :, 2 if kind == "level" else 0] = 0.5
    elif kind == "flat":  # a point, a segment, a point and a segment
        made[0, 1:] = made[0, 0]
        made[1, 2] = 2 * made[1, 1] - made[1, 0]
        made[2, 2] = made[2, 0]
    elif kind == "edges along x":
        made[:, 1, 1:] = made[:, 0, 1:]
    return made


def test_voxels_near_triangles_are_those_of_single_distances():
    rng = np.random.default_rng(0)
    x, y, z = (GRID.axis(a) for a in range(3))
    for kind in ("any", "level", "along x", "flat", "edges along x") * 3:
        some, thickness = triangles(rng, kind), rng.uniform(0.02, 0.4)
        inside = (rng.random(GRID.shape[::-1]) < 0.8).astype(np.uint8)
        before = (rng.random(GRID.shape[::-1]) < 0.1).astype(np.uint8)
        near = np.array([[[min(squared_to_triangle(t, a, b, c) for t in some) for a in x] for b in y] for c in z])
        doubtful = np.abs(np.sqrt(near) - thickness * SLACK) < 1e-9
        whole = before.copy()
        add_skin_on(some, GRID, 0, thickness, inside, whole)
        assert np.array_equal(whole, before | (inside & (np.sqrt(near) <= thickness))) or doubtful.any(), kind
        cut = before.copy()
        for start, stop in ((0, 3), (3, 4), (4, 24)):
            add_skin_on(some, GRID, start, thickness, inside[start:stop], cut[start:stop])
        assert np.array_equal(cut, whole)


def test_faces_by_direction():
    vertices, faces = box_mesh((0.0, 0.0, 0.0), (2.0, 4.0, 6.0))
    middles = vertices[faces].mean(1)
    up = faces_toward(vertices, faces, [(0, 0, 7)], 10)
    assert np.array_equal(up, np.isclose(middles[:, 2], 3))
    both = faces_toward(vertices, faces, [(0, 0, 1), (0, -1, 0)], 0)
    assert np.array_equal(both, np.isclose(middles[:, 2], 3) | np.isclose(middles[:, 1], -2))
    assert faces_toward(vertices, faces, [(1, 1, 0)], 44).sum() == 0
    assert faces_toward(vertices, faces, [(1, 1, 0)], 45).sum() == 4
    assert faces_toward(vertices, faces, [(1, 1, 1)], 180).all()
    vertices, faces = ball_mesh((0.0, 0.0, 0.0), 1.0, 3)
    low = faces_toward(vertices, faces, [(0, 0, -1)], 60)
    height = vertices[faces].mean(1)[:, 2]
    assert height[low].max() == pytest.approx(-0.5, abs=0.06)  # triangles are .1 high
    assert height[~low].min() == pytest.approx(-0.5, abs=0.06)
    nothing = np.array([[0, 0, 0], [0, 1, 1]], np.int32)
    assert not faces_toward(vertices, nothing, [(0, 0, 1)], 180).any()


def test_faces_near_another_mesh():
    vertices, faces = ball_mesh((0.0, 0.0, 0.0), 1.0, 3)
    corners, others = box_mesh((0.3, 0.1, 1.5), (0.5, 0.4, 0.6))
    tool = corners[others]
    for distance in (0.0, 0.35, 0.8, 5.0):
        far = np.array([min(squared_to_triangle(t, *p) for t in tool) for p in vertices]) > (distance * SLACK) ** 2
        assert np.array_equal(faces_within(vertices, faces, tool, distance), ~far[faces].any(1))
    assert 0 < faces_within(vertices, faces, tool, 0.8).sum() < len(faces)
