"""The quick winding number against the slow one, and against what meshes were before they got holes."""

import numpy as np
import pytest

from sppm_pipeline.method.part.domain_sampler import distance_layers, reach_bare_borders
from sppm_pipeline.method.part.inside import inside_layers, inside_test, prepare_inside
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh, torus_knot_mesh
from sppm_pipeline.method.part.ray_crossings import prepare_scan
from sppm_pipeline.method.part.scanline import scan_layers
from sppm_pipeline.method.part.spanned import prepare_spanned, spanned_layers, spanning_triangles
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.mesh.measures import edge_counts
from sppm_pipeline.services.mesh.winding_number import dipoles, winding_numbers

GRID = Grid((-1.07, -1.1, -0.83), (0.05, 0.06, 0.045), (43, 37, 39))
BALL = ball_mesh((0, 0, 0), 0.78, 3)
KNOT = torus_knot_mesh((0, 0, 0), (2, 3), 0.6, 0.25, 0.15, 100, 16)


def slow_numbers(vertices, faces, points):
    """The sum of all solid angles (van Oosterom and Strackee 1983), point by point."""
    numbers = np.empty(len(points))
    for i, p in enumerate(points):
        a, b, c = np.moveaxis(vertices[faces] - p, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        across = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        numbers[i] = np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), across).sum() / (2 * np.pi)
    return numbers


def pierced(mesh, seed, holes, radius):
    vertices, faces = mesh
    middle = vertices[faces].mean(axis=1)
    keep = np.ones(len(faces), bool)
    for hole in middle[np.random.default_rng(seed).choice(len(faces), holes)]:
        keep &= np.linalg.norm(middle - hole, axis=1) > radius
    return vertices, faces[keep]


def sample_points(grid):
    z, y, x = np.meshgrid(grid.axis(2), grid.axis(1), grid.axis(0), indexing="ij")
    return np.stack([x, y, z], -1).reshape(-1, 3)


def iou(a, b):
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


@pytest.mark.parametrize("mesh", [BALL, KNOT, pierced(KNOT, 1, 4, 0.2)])
def test_dipoles_are_near_the_sum(mesh):
    vertices, faces = mesh
    points = np.random.default_rng(0).uniform(-1, 1, (300, 3))
    found = winding_numbers(dipoles(box_tree(vertices[faces])), points)
    assert np.abs(found - slow_numbers(vertices, faces, points)).max() < 0.02
    assert 0.05 < np.mean(found > 0.5) < 0.6


def test_spans_close_any_mesh():
    rng = np.random.default_rng(2)
    soup = rng.random((60, 3)), np.arange(60).reshape(20, 3)
    tangled = BALL[0], np.where(rng.random(len(BALL[1]))[:, None] < 0.5, BALL[1][:, ::-1], BALL[1])
    fin = np.concatenate([BALL[0], [(0, 0, 2)]]), np.concatenate([BALL[1], [(0, 1, len(BALL[0]))]])
    for vertices, faces in (soup, tangled, fin, pierced(KNOT, 1, 4, 0.2)):
        more, spans = spanning_triangles(vertices, faces)
        assert len(more) > len(vertices)
        counts = edge_counts(np.concatenate([faces, spans]))
        assert counts.unbalanced == 0
    assert len(spanning_triangles(*BALL)[1]) == 0


@pytest.mark.parametrize(
    ("mesh", "holes", "radius"), [(BALL, 3, 0.2), (BALL, 1, 0.7), (KNOT, 5, 0.15), (KNOT, 40, 0.05)]
)
def test_every_voxel_is_that_of_the_winding_number(mesh, holes, radius):
    """Except where dipoles leave a doubt."""
    vertices, faces = pierced(mesh, 3, holes, radius)
    assert len(faces) < len(mesh[1])
    found = spanned_layers(prepare_spanned(vertices, faces, GRID), 0, 39)
    points, mask = sample_points(GRID), found.mask.ravel()
    numbers = winding_numbers(dipoles(box_tree(vertices[faces])), points)
    some = np.random.default_rng(0).choice(len(points), 500, replace=False)
    assert np.abs(numbers[some] - slow_numbers(vertices, faces, points[some])).max() < 0.02
    clear = np.abs(numbers - 0.5) > 0.02
    assert np.array_equal(mask[clear], numbers[clear] > 0.5)
    assert clear.mean() > 0.98
    doubtful = np.count_nonzero(np.abs(numbers - 0.5) < 0.25)
    assert doubtful > 0
    assert 0.7 * doubtful - 10 < found.undecided < 1.6 * doubtful + 10


def test_overlapping_shells_with_holes_are_united():
    a, b = box_mesh((-0.2, 0, 0), (0.81, 1, 1)), box_mesh((0.2, 0, 0), (0.83, 1.1, 0.9))
    vertices, faces = np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1] + 8])
    whole = scan_layers(prepare_scan(vertices, faces, GRID), 0, 39).mask
    found = spanned_layers(prepare_spanned(vertices, faces[1:], GRID), 0, 39).mask
    numbers = winding_numbers(dipoles(box_tree(vertices[faces[1:]])), sample_points(GRID)).reshape(found.shape)
    clear = np.abs(numbers - 0.5) > 0.02
    assert np.array_equal(found[clear], numbers[clear] > 0.5)
    assert iou(found, whole) > 0.9


def test_a_hole_in_the_plane_of_voxels():
    """A lid is missing whose plane holds samples: spanning triangles in it would be seen under plus or minus half."""
    vertices, faces = box_mesh((0, 0, 0), (2, 2, 2))
    keep = ~((vertices[faces][:, :, 2] == 1).all(1))
    grid = Grid((-1.5, -1.5, -1.5), (0.25, 0.25, 0.25), (13, 13, 13))
    assert keep.sum() == 10
    found = spanned_layers(prepare_spanned(vertices, faces[keep], grid), 0, 13).mask
    points = sample_points(grid)
    inner = (np.abs(points[:, :2]) < 0.9).all(1) & (np.abs(points[:, 2]) < 0.6)
    assert found.ravel()[inner].all()
    outer = (np.abs(points) > 1).any(1)
    assert not found.ravel()[outer].any()


@pytest.mark.parametrize("method", ["winding", "vote"])
def test_slabs_change_no_bit(method):
    vertices, faces = pierced(KNOT, 5, 6, 0.15)
    scan = prepare_inside(vertices, faces, GRID, method)
    whole = inside_layers(scan, 0, 39)
    for step in (1, 5, 13):
        parts = [inside_layers(scan, k, min(k + step, 39)) for k in range(0, 39, step)]
        assert np.concatenate([p.mask for p in parts]).tobytes() == whole.mask.tobytes()
        assert sum(p.undecided for p in parts) == whole.undecided


def test_a_closed_mesh_needs_no_winding_number():
    expected = scan_layers(prepare_scan(*KNOT, GRID), 0, 39)
    found = spanned_layers(prepare_spanned(*KNOT, GRID), 0, 39)
    assert np.array_equal(found.mask, expected.mask)
    assert found.undecided == 0


@pytest.mark.parametrize("seed", range(3))
def test_winding_is_nearer_to_the_truth_than_the_vote(seed):
    whole = scan_layers(prepare_scan(*KNOT, GRID), 0, 39).mask
    vertices, faces = pierced(KNOT, seed, 6, 0.15)
    by = {
        way: inside_layers(prepare_inside(vertices, faces, GRID, way), 0, 39).mask
        for way in ("scanline", "winding", "vote")
    }
    assert iou(by["winding"], whole) >= iou(by["vote"], whole)
    assert iou(by["winding"], whole) > 0.95


def test_judgement():
    found = inside_test(*KNOT)
    assert (found.method, found.closed, found.turned, found.undecided_share) == ("scanline", True, 0, 0.0)
    vertices, faces = pierced(KNOT, 1, 4, 0.12)
    flip = np.random.default_rng(0).random(len(faces)) < 0.4
    found = inside_test(vertices, np.where(flip[:, None], faces[:, ::-1], faces))
    assert (found.method, found.closed, found.turned) == ("winding", False, flip.sum())
    assert np.array_equal(found.faces, faces)
    assert 0 < found.undecided_share < 0.1
    assert 0 < found.disagreement < 0.1
    assert inside_test(vertices, faces, "vote").undecided_share > 0
    assert inside_test(vertices, faces, "scanline").undecided_share > inside_test(*KNOT, "scanline").undecided_share
    rng = np.random.default_rng(0)
    soup = inside_test(rng.random((120, 3)), np.arange(120, dtype=np.int32).reshape(40, 3))
    assert soup.undecided_share > 0.5
    bowl = inside_test(BALL[0], BALL[1][BALL[0][BALL[1]].max(1)[:, 2] < 0.2])
    assert bowl.undecided_share > 0.25


def signed_distance(vertices, faces, method="scanline"):
    distance = distance_layers(vertices[faces], GRID, 0, GRID.shape[2], 0.3)
    inside = inside_layers(prepare_inside(vertices, faces, GRID, method), 0, GRID.shape[2]).mask
    if method != "scanline":
        reach_bare_borders(distance, inside, 0, GRID.spacing)
    return np.where(inside, -distance, distance)


@pytest.mark.parametrize("method", ["winding", "vote"])
def test_distance_has_the_sign_of_the_voxels_and_knows_borders_without_triangles(method):
    vertices, faces = pierced(BALL, 2, 2, 0.3)
    inside = inside_layers(prepare_inside(vertices, faces, GRID, method), 0, 39).mask.astype(bool)
    found = signed_distance(vertices, faces, method)
    assert np.array_equal(found < 0, inside)
    whole = signed_distance(*BALL)
    # from one sample to the next the distance changes by not much more than the way, in the holes as well
    for axis, h in zip((2, 1, 0), GRID.spacing, strict=True):
        assert np.abs(np.diff(found, axis=axis)).max() < 2 * h
        assert np.abs(np.diff(whole, axis=axis)).max() < 1.01 * h
    assert np.abs(found).max() == pytest.approx(0.3)
    assert np.abs(found - whole).max() < 0.25  # holes of a radius of 0.3 have nearly flat lids
