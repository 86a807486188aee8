"""Occupancy by scanlines against inside tests that know nothing of rays, also where rays meet edges and vertices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import InputError
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh, cylinder_mesh, torus_knot_mesh, torus_mesh
from sppm_pipeline.method.part.ray_crossings import prepare_scan, ray_crossings
from sppm_pipeline.method.part.scanline import scan_bits, scan_layers
from sppm_pipeline.services.bit_rows import unpack
from sppm_pipeline.services.grid import Grid


def scan(mesh, grid, axis=0):
    prepared = prepare_scan(*mesh, grid, axis)
    return scan_layers(prepared, 0, prepared.shape[2])


def rays(mesh, grid):
    """Number of rays along x that meet a mesh, and of those that do not leave it as often as they enter."""
    crossed = opened = 0
    for _, _, starts, keys in ray_crossings(prepare_scan(*mesh, grid), 0, grid.shape[2]):
        sums = np.diff(np.concatenate([[0], np.cumsum(2 * (keys & 1) - 1)])[starts])
        crossed += int(np.count_nonzero(np.diff(starts)))
        opened += int(np.count_nonzero(sums))
    return crossed, opened


def join(*meshes):
    offsets = np.cumsum([0] + [len(v) for v, _ in meshes])
    return np.concatenate([v for v, _ in meshes]), np.concatenate(
        [f + o for (_, f), o in zip(meshes, offsets, strict=False)]
    )


def slow_winding(mesh, grid):
    """Winding number of each sample: the sum of the solid angles of all triangles (van Oosterom and Strackee)."""
    vertices, faces = mesh
    x, y, z = (grid.axis(a) for a in range(3))
    points = np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1).reshape(-1, 1, 3)
    a, b, c = (vertices[faces[:, i]] - points for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    dot = lambda u, v: (u * v).sum(axis=2)  # noqa: E731 - a name for the formula
    below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    angle = 2 * np.arctan2(dot(a, np.cross(b, c)), below)
    return (angle.sum(axis=1) / (4 * np.pi)).reshape(grid.shape[::-1])


def on_surface(mesh, n):
    """Which integer points 0 <= x, y, z < n lie on a triangle with integer corners, in integer arithmetic."""
    points = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij")[::-1], axis=-1)
    found = np.zeros((n, n, n), bool)
    for face in mesh[1]:
        a, b, c = mesh[0][face].astype(int)
        normal = np.cross(b - a, c - a)
        within = ((points - a) @ normal) == 0
        if normal.any():
            for p, q in ((a, b), (b, c), (c, a)):
                within &= np.cross(q - p, points - p) @ normal >= 0
        found |= within
    return found


@pytest.mark.parametrize(
    "mesh",
    [
        box_mesh((0, 0, 0), (1.47, 1.23, 1.69)),
        ball_mesh((0.05, 0, -0.03), 0.9, 1),
        cylinder_mesh((0, 0, 0), 0.7, 1.4, 17),
        torus_mesh((0, 0, 0), 0.6, 0.3, 13, 7),
        torus_knot_mesh((0, 0, 0), (2, 3), 0.6, 0.25, 0.15, 40, 5),
        join(ball_mesh((-0.3, 0, 0), 0.6, 1), ball_mesh((0.3, 0.1, 0), 0.6, 1), box_mesh((0, 0, 0), (0.5, 1.8, 0.4))),
    ],
    ids=["box", "ball", "cylinder", "torus", "knot", "overlapping"],
)
def test_inside_is_where_the_winding_number_is_positive(mesh):
    grid = Grid((-1.01, -0.987, -0.973), (0.13, 0.14, 0.15), (16, 15, 14))
    found = scan(mesh, grid)
    np.testing.assert_array_equal(found.mask, slow_winding(mesh, grid) > 0.5)
    crossed, opened = rays(mesh, grid)
    assert opened == 0 < crossed


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_rays_through_edges_and_vertices_count_once(seed, pieces):
    """Tetrahedra with corners on the samples: nearly every ray meets edges, vertices or faces seen edge-on."""
    rng = np.random.default_rng(seed)
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    meshes = []
    for _ in range(pieces):
        corners = rng.integers(0, 7, (4, 3)).astype(float)
        if np.linalg.det(corners[1:] - corners[0]) < 0:
            corners = corners[[1, 0, 2, 3]]
        meshes.append((corners, tetrahedron))
    grid = Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (7, 7, 7))
    mesh = join(*meshes)
    found = scan(mesh, grid)
    assert rays(mesh, grid)[1] == 0
    free = ~on_surface(mesh, 7)
    np.testing.assert_array_equal(found.mask[free] > 0, slow_winding(mesh, grid)[free] > 0.5)
    # moved off the samples, every one of them is clear of the surface
    nudge = np.array([1e-3, 3.7e-4, 1.9e-4]) / np.sqrt(7)
    winding = slow_winding(mesh, Grid(tuple(nudge), grid.spacing, grid.shape))
    np.testing.assert_array_equal(scan((mesh[0] - nudge, mesh[1]), grid).mask > 0, winding > 0.5)


def test_boxes_that_share_faces_fill_space_without_gap_or_overlap():
    edges = np.arange(0.0, 9.0, 2.0)
    total = np.zeros((9, 9, 9), int)
    grid = Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (9, 9, 9))
    for x in edges[:-1]:
        for y in edges[:-1]:
            for z in edges[:-1]:
                total += scan(box_mesh((x + 1, y + 1, z + 1), (2, 2, 2)), grid).mask
    assert (total[:8, :8, :8] == 1).all()
    assert total.sum() == 512


@settings(derandomize=True, deadline=None, max_examples=80)
@given(st.floats(-3, 3), st.floats(0.01, 1.0), st.integers(0, 20), st.integers(1, 18), st.booleans())
def test_samples_lie_where_the_grid_says_to_the_last_bit(origin, h, first, length, above):
    """A face exactly at origin + i * h has sample i behind it, and one just above has it in front."""
    grid = Grid((origin,) * 3, (h,) * 3, (40, 40, 40))
    axis = grid.axis(0)
    corners, faces = box_mesh((0.5, 0.5, 0.5), (1, 1, 1))
    expected = np.zeros((40, 40, 40), np.uint8)
    expected[(slice(first + above, first + length + above),) * 3] = 1
    if above:
        axis = np.nextafter(axis, np.inf)
    vertices = np.where(corners == 0.0, axis[first], axis[first + length])
    np.testing.assert_array_equal(scan((vertices, faces), grid).mask, expected)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=6), st.floats(0.5, 2.0))
def test_slabs_equal_the_whole(sizes, stretch):
    vertices, faces = torus_knot_mesh((0, 0, 0), (2, 3), 0.6, 0.25, 0.15, 60, 8)
    mesh = vertices * np.array([1, 1, stretch]), faces
    grid = Grid((-1.0, -1.0, -1.0), (0.1, 0.1, 0.03), (20, 21, 67))
    prepared = prepare_scan(*mesh, grid)
    whole = scan_layers(prepared, 0, 67)
    assert np.array_equal(unpack(scan_bits(prepared, 3, 60), prepared.shape[0]), whole.mask[3:60])
    k, parts = 0, []
    while k < 67:
        n = min(sizes[len(parts) % len(sizes)], 67 - k)
        parts.append(scan_layers(prepared, k, k + n))
        k += n
    np.testing.assert_array_equal(np.concatenate([p.mask for p in parts]), whole.mask)
    assert scan_layers(prepared, 5, 5).mask.shape == (0, 21, 20)


def test_a_triangle_soup_without_merged_vertices_closes_as_well():
    vertices, faces = ball_mesh((0, 0, 0), 1.0, 3)
    grid = Grid((-1.0, -1.0, -1.0), (0.1, 0.1, 0.1), (21, 21, 21))
    soup = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    merged, loose = scan((vertices, faces), grid), scan(soup, grid)
    np.testing.assert_array_equal(loose.mask, merged.mask)
    assert rays(soup, grid)[1] == 0


def test_rows_with_many_crossings():
    """Forty plates in a row, and a part that reaches out of the grid on every side."""
    plates = join(*[box_mesh((i + 0.25, 0, 0), (0.5, 4, 4)) for i in range(40)])
    grid = Grid((-0.45, -1.0, -1.0), (0.1, 1.0, 1.0), (400, 3, 3))
    x = grid.axis(0)
    expected = (x > 0) & (x % 1 < 0.5)
    found = scan(plates, grid)
    assert (found.mask == expected).all()
    assert scan(box_mesh((0, 0, 0), (1e3, 1e3, 1e3)), grid).mask.all()
    assert not scan(box_mesh((0, 1e3, 0), (1, 1, 1)), grid).mask.any()


def test_a_missing_wall_is_noticed_and_does_not_leak():
    vertices, faces = box_mesh((0, 0, 0), (1, 1, 1))
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    grid = Grid((-0.95, -0.95, -0.95), (0.1, 0.1, 0.1), (20, 20, 20))
    assert rays((vertices, faces), grid) == (100, 0)
    for sign in (-1, 1):
        broken = vertices, faces[normals[:, 0] * sign <= 0]
        assert rays(broken, grid) == (100, 100)
        assert not scan(broken, grid).mask.any()
    inside_out = vertices, faces[:, ::-1]
    assert rays(inside_out, grid)[1] == 0
    assert not scan(inside_out, grid).mask.any()


def test_no_triangles_no_voxels():
    grid = Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (4, 5, 6))
    nothing = np.zeros((0, 3)), np.zeros((0, 3), int)
    found = scan(nothing, grid)
    assert found.mask.shape == (6, 5, 4)
    assert not found.mask.any()
    assert rays(nothing, grid) == (0, 0)


def test_nonsense_is_refused():
    grid = Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (4, 5, 6))
    with pytest.raises(InputError, match="finite"):
        prepare_scan([[0, 0, np.nan]] * 3, [[0, 1, 2]], grid)
