"""Neighbors, boundary loops, winding and walls of meshes about which everything is known."""

import numpy as np
import pytest

from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh, torus_knot_mesh, torus_mesh
from sppm_pipeline.services.mesh.adjacency import BOUNDARY, NON_MANIFOLD, adjacency, boundary_loops
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.mesh.measures import edge_counts
from sppm_pipeline.services.mesh.orientation import orient, shells
from sppm_pipeline.services.mesh.rays import layers_around, wall_thickness

BALL = ball_mesh((0, 0, 0), 1.0, 3)
TORUS = torus_mesh((0, 0, 0), 1.0, 0.4)
KNOT = torus_knot_mesh((0, 0, 0), (2, 3), 0.6, 0.25, 0.15, 160, 24)


def joined(*meshes):
    """Meshes as one; vertices are not merged."""
    offsets = np.cumsum([0, *(len(v) for v, _ in meshes)])
    return (
        np.concatenate([v for v, _ in meshes]),
        np.concatenate([f + o for (_, f), o in zip(meshes, offsets, strict=False)]).astype(np.int32),
    )


def inward(mesh):
    return mesh[0], np.ascontiguousarray(mesh[1][:, ::-1])


def test_mates_are_the_two_sides_of_an_edge():
    faces = BALL[1]
    found = adjacency(faces)
    assert (found.opposite[found.opposite] == np.arange(3 * len(faces))).all()
    ends = np.stack([faces, np.roll(faces, -1, 1)], 2).reshape(-1, 2)
    assert np.array_equal(ends[found.opposite], ends[:, ::-1])
    assert (found.fan_count, found.surface_count, found.non_manifold_vertices) == (len(BALL[0]), 1, 0)


def test_non_manifold_edges_and_non_manifold_vertices():
    book = np.array([(0, 1, 2), (1, 0, 3), (0, 1, 4)])
    found = adjacency(book)
    assert np.count_nonzero(found.opposite == NON_MANIFOLD) == 3
    assert np.count_nonzero(found.opposite == BOUNDARY) == 6
    assert (found.surface_count, found.non_manifold_vertices) == (3, 2)
    hourglass = adjacency(np.array([(0, 1, 2), (0, 3, 4)]))
    assert hourglass.non_manifold_vertices == 1
    loop = adjacency(np.array([(0, 0, 1)]))
    assert loop.opposite[0] == NON_MANIFOLD
    assert adjacency(np.empty((0, 3), int)).fan_count == 0


def test_rims_of_holes():
    vertices, faces = BALL
    corner = np.flatnonzero((faces == 0).any(1))
    other = np.flatnonzero((faces == 100).any(1))
    assert not np.isin(corner, other).any()
    left = np.delete(faces, np.concatenate([corner, other]), 0)
    found = boundary_loops(vertices, left, adjacency(left))
    assert sorted(found.edges) == sorted([len(corner), len(other)])
    assert found.lengths[0] >= found.lengths[1] > 0
    radius = np.linalg.norm(vertices[np.unique(faces[corner])] - vertices[0], axis=1).max()
    assert radius < min(found.sizes) < 2 * 3**0.5 * radius
    # two holes that meet in a vertex are two holes, also where the winding is spoilt
    triangle = np.array([(0, 1, 2), (0, 3, 4), (5, 6, 7)])
    assert list(boundary_loops(np.eye(8, 3), triangle, adjacency(triangle)).edges) == [3, 3, 3]
    assert len(boundary_loops(vertices, faces, adjacency(faces)).edges) == 0


@pytest.mark.parametrize("mesh", [BALL, TORUS, KNOT, box_mesh((0, 0, 0), (1, 1, 1))])
@pytest.mark.parametrize("share", [0.4, 0.9])
def test_tangled_winding_is_put_right(mesh, share):
    vertices, faces = mesh
    flip = np.random.default_rng(3).random(len(faces)) < share
    found = orient(vertices, np.where(flip[:, None], faces[:, ::-1], faces))
    same = (found.faces == faces).all(1) | flip
    assert same.all()
    assert edge_counts(found.faces).closed
    assert found.turned == flip.sum()
    assert (found.patches, found.one_sided) == (1, 0)
    assert orient(vertices, faces).turned == 0


def test_open_patches_are_turned_by_what_rays_see():
    vertices, faces = KNOT
    left = faces[5:]
    flip = np.random.default_rng(3).random(len(left)) < 0.8
    found = orient(vertices, np.where(flip[:, None], left[:, ::-1], left))
    assert np.array_equal(np.sort(found.faces, 1), np.sort(left, 1))
    assert edge_counts(np.concatenate([found.faces, faces[:5]])).closed
    assert orient(vertices, left).turned == 0


def test_cavities_stay_and_pieces_that_are_inside_out_are_turned():
    outer, inner, beside = (ball_mesh(c, r, 2) for c, r in (((0, 0, 0), 2.0), ((0, 0, 0), 1.0), ((5, 0, 0), 1.0)))
    hollow = joined(outer, inward(inner), beside)
    found = shells(*hollow)
    assert list(found.cavities) == [False, True, False]
    assert list(found.around) == [0, 1, 0]
    assert not found.inside_out.any()
    assert not found.buried.any()
    assert np.allclose(found.volumes[0], -8 * found.volumes[1])
    assert orient(*hollow).turned == 0
    wrong = joined(outer, inward(inner), inward(beside))
    assert list(shells(*wrong).inside_out) == [False, False, True]
    assert np.array_equal(orient(*wrong).faces, hollow[1])
    everything = hollow[0], hollow[1][:, ::-1]
    assert np.array_equal(orient(*everything).faces, hollow[1])
    assert list(shells(*joined(outer, inner)).buried) == [False, True]
    # a ball within the hollow
    nested = joined(outer, inward(inner), ball_mesh((0, 0, 0), 0.5, 2))
    assert list(shells(*nested).around) == [0, 1, 0]
    assert orient(*nested).turned == 0


def test_a_moebius_strip_has_one_side():
    n = 20
    angle = np.arange(n) * 2 * np.pi / n
    ends = []
    for side in (-0.3, 0.3):
        r = 1 + side * np.cos(angle / 2)
        ends.append(np.stack([r * np.cos(angle), r * np.sin(angle), side * np.sin(angle / 2)], 1))
    i = np.arange(n - 1)
    quads = [(a, a + 1, n + a + 1, n + a) for a in i] + [(n - 1, n, 0, 2 * n - 1)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    assert orient(np.concatenate(ends), faces).one_sided == 1


def test_layers_are_counted_exactly_through_corners_and_edges():
    """Rays through lattice points of boxes with corners on the lattice hit corners and edges all the time."""
    boxes = [box_mesh((0, 0, 0), (4, 4, 4)), box_mesh((0, 0, 0), (2, 2, 2)), box_mesh((1, 1, 1), (2, 2, 2))]
    vertices, faces = joined(*boxes)
    axis = np.arange(-3, 4) + 0.25
    for offset in (0.0, 0.25):  # y and z on the corners, or not
        points = np.stack(np.meshgrid(axis, axis - 0.25 + offset, axis - 0.25 + offset, indexing="ij"), -1).reshape(
            -1, 3
        )
        labels = np.repeat(np.arange(3, dtype=np.int32), 12)
        found = layers_around(box_tree(vertices[faces]), labels, points, np.full(len(points), -1, np.int32))
        expected = np.zeros(len(points), int)
        for v, _ in boxes:
            low, high = v.min(0), v.max(0)
            # half open, as a point that lies on a face has to be on one side
            expected += ((points >= low) & (points < high)).all(1)
        assert np.array_equal(found, expected)
        one = layers_around(box_tree(vertices[faces]), labels, points, np.zeros(len(points), np.int32))
        assert (one <= found).all()
        assert (one < found).any()


def test_walls_of_a_box_a_ball_and_a_hollow_ball():
    vertices, faces = box_mesh((0, 0, 0), (1, 2, 3))
    found = wall_thickness(box_tree(vertices[faces]), 22_000)
    values, counts = np.unique(found.thickness.round(12), return_counts=True)
    assert list(values) == [1, 2, 3]
    assert np.abs(counts / 1000 - [12, 6, 4]).max() < 0.01
    assert found.quantile(0.05) == pytest.approx(1)
    assert found.share_below(1.5) == pytest.approx(12 / 22, abs=1e-3)
    assert abs(np.abs(found.points) / [0.5, 1, 1.5]).max() == pytest.approx(1)
    fine = ball_mesh((0, 0, 0), 2.0, 5)
    assert np.abs(wall_thickness(box_tree(fine[0][fine[1]])).thickness - 4).max() < 0.01
    hollow = joined(fine, inward(ball_mesh((0, 0, 0), 1.7, 5)))
    found = wall_thickness(box_tree(hollow[0][hollow[1]]))
    assert np.abs(found.thickness - 0.3).max() < 0.005
    opened = wall_thickness(box_tree(vertices[faces[:2]]))
    assert np.isinf(opened.thickness).all()
    assert len(wall_thickness(box_tree(np.zeros((2, 3, 3)))).thickness) == 0
