"""Pictures of meshes, judged by areas, order of depth and symmetry."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.pictures.camera import Camera
from sppm_pipeline.services.pictures.mesh_view import render_mesh

CUBE = np.array([[i, j, k] for i in (0.0, 1.0) for j in (0.0, 1.0) for k in (0.0, 1.0)])
# Two triangles a side: low x, high x, low y, high y, low z, high z.
SIDES = (
    np.array(
        ["013", "032", "467", "475", "045", "051", "237", "276", "026", "064", "157", "173"],
    )
    .view("U1")
    .reshape(-1, 3)
    .astype(int)
)
COLORS = np.repeat([[200, 0, 0], [0, 200, 0], [0, 0, 200]], 4, axis=0)
MAGENTA = (255, 0, 255)
FRONT = Camera(-90, 0)  # the viewer looks along y
PLAIN = {"size": (100, 100), "margin": 0.1, "supersampling": 1, "background": MAGENTA}


def ball(n=40):
    """Sphere of radius 1 about the origin."""
    polar, around = np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n, endpoint=False)
    p, a = np.meshgrid(polar, around, indexing="ij")
    vertices = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(range(n), range(2 * n), indexing="ij")
    a, b = (i * 2 * n + j).ravel(), (i * 2 * n + (j + 1) % (2 * n)).ravel()
    return vertices, np.concatenate([np.stack([a, a + 2 * n, b + 2 * n], 1), np.stack([a, b + 2 * n, b], 1)])


def covered(picture):
    return (picture != MAGENTA).any(axis=2)


def square(y, half=1.0, x=0.0):
    """A square across the y axis."""
    corners = np.array([[x - half, y, -half], [x + half, y, -half], [x + half, y, half], [x - half, y, half]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("camera", [Camera(), Camera(20, -70), Camera(-60, 25, 30)])
def test_silhouette_of_a_ball(camera):
    picture = render_mesh(*ball(), camera=camera, **(PLAIN | {"size": (300, 300)}))
    # In perspective, too, the picture of a centered ball is a disc that fills the picture up to the margin.
    assert covered(picture).sum() == pytest.approx(np.pi * 120**2, rel=0.01)
    rows, columns = np.nonzero(covered(picture))
    assert (rows.mean(), columns.mean()) == pytest.approx((149.5, 149.5), abs=0.3)


def test_a_cube_from_the_front_covers_its_square_exactly():
    shown = covered(render_mesh(CUBE, SIDES, camera=FRONT, **PLAIN))
    assert shown.sum() == 80 * 80
    assert shown[10:90, 10:90].all()


@pytest.mark.parametrize(
    ("camera", "color"),
    [(FRONT, 1), (Camera(90, 0), 1), (Camera(0, 0), 0), (Camera(180, 0), 0), (Camera(0, 90), 2), (Camera(0, -90), 2)],
)
def test_the_side_that_faces_the_viewer_is_seen(camera, color):
    picture = render_mesh(CUBE, SIDES, camera=camera, face_colors=COLORS, **PLAIN)
    inside = picture[12:88, 12:88].reshape(-1, 3)
    others = [c for c in range(3) if c != color]
    assert (inside[:, color] > 60).all()
    assert (inside[:, others].max(axis=1) < inside[:, color] / 2).all()


def test_three_sides_cover_equal_areas_along_the_diagonal():
    camera = Camera(-45, np.degrees(np.arcsin(1 / np.sqrt(3))))
    picture = render_mesh(CUBE, SIDES, camera=camera, face_colors=COLORS, **(PLAIN | {"size": (400, 400)}))
    seen = covered(picture)
    areas = np.bincount(picture[seen].argmax(axis=1), minlength=3)
    assert areas == pytest.approx(np.full(3, seen.sum() / 3), rel=0.01)


@pytest.mark.parametrize("view", [0.0, 40.0])
def test_the_nearer_one_hides_the_other_whatever_their_order(view):
    near, far = square(-1.0, 0.5), square(1.0, 1.0)
    camera = Camera(-90, 0, view)
    pictures = []
    for first, second, colors in (
        (near, far, [(220, 0, 0)] * 2 + [(0, 220, 0)] * 2),
        (far, near, [(0, 220, 0)] * 2 + [(220, 0, 0)] * 2),
    ):
        vertices, faces = np.concatenate([first[0], second[0]]), np.concatenate([first[1], second[1] + 4])
        pictures.append(render_mesh(vertices, faces, camera=camera, face_colors=colors, occlusion=0.0, **PLAIN))
    assert np.array_equal(*pictures)
    assert pictures[0][50, 50].argmax() == 0
    assert pictures[0][14, 50].argmax() == 1


def test_perspective_makes_near_things_larger():
    near, far = square(-1.0, 0.5, x=-1.0), square(1.0, 0.5, x=1.0)
    vertices, faces = np.concatenate([near[0], far[0]]), np.concatenate([near[1], far[1] + 4])
    areas = []
    for view in (0.0, 50.0):
        shown = covered(render_mesh(vertices, faces, camera=Camera(-90, 0, view), **PLAIN))
        areas.append((shown[:, :50].sum(), shown[:, 50:].sum()))
    assert areas[0][0] == areas[0][1]
    assert areas[1][0] > 1.5 * areas[1][1]


def test_edges_of_a_cube_stay_sharp_under_smooth_shading():
    smooth, flat = (render_mesh(CUBE, SIDES, smooth=s, size=(120, 90)) for s in (True, False))
    assert abs(smooth.astype(int) - flat).max() <= 1


def test_smooth_shading_hides_facets():
    vertices, faces = ball(12)
    steps = []
    for smooth in (True, False):
        row = render_mesh(vertices, faces, smooth=smooth, camera=FRONT, occlusion=0.0, size=(200, 200))[100, 40:160]
        steps.append(abs(np.diff(row.astype(int), axis=0)).max())
    assert steps[0] < 0.5 * steps[1]


def test_a_mesh_turned_inside_out_looks_the_same():
    vertices, faces = ball(15)
    pictures = [render_mesh(vertices, f, size=(80, 60)) for f in (faces, faces[:, ::-1])]
    assert abs(pictures[0].astype(int) - pictures[1]).mean() < 0.05


def test_same_mesh_same_bytes():
    vertices, faces = ball(10)
    first, second = (render_mesh(vertices, faces, camera=Camera(10, 20, 30), size=(90, 70)) for _ in range(2))
    assert first.tobytes() == second.tobytes()
    assert first.shape == (70, 90, 3)
    assert first.dtype == np.uint8


def test_light_comes_from_above():
    picture = render_mesh(*ball(), camera=FRONT, size=(100, 100)).astype(int)
    assert picture[20, 50].sum() > picture[80, 50].sum() + 60


def test_pits_are_darkened_and_open_planes_are_not():
    plane = square(0.0)
    open_, closed = (render_mesh(*plane, camera=Camera(-70, 20), occlusion=o, size=(120, 120)) for o in (0.0, 1.0))
    assert np.array_equal(open_, closed)
    # A box seen from above without its lid, in perspective: the floor is in the middle, the walls are around it.
    camera = Camera(0, 90, 60)
    lit, pit = (render_mesh(CUBE, SIDES[:10], camera=camera, occlusion=o, size=(120, 120)) for o in (0.0, 1.0))
    floor = np.flatnonzero((lit[60] == lit[60, 60]).all(axis=1))
    corner = pit[60, floor[2]].mean()
    assert lit[60, floor[2]].mean() - corner > 15
    assert pit[60, 60].mean() > corner + 15


def test_supersampling_mixes_light_at_edges():
    # Half of each pixel of the left border of the square is covered.
    corners, faces = square(0.0, 0.5)
    settings = {"camera": FRONT, "background": (0, 0, 0), "occlusion": 0.0, "margin": 0.05, "size": (30, 30)}
    picture = render_mesh(corners, faces, supersampling=2, **settings).astype(float) / 255
    inside, border = picture[15, 15], picture[15, 1]
    assert picture[15, 0].max() == 0.0
    linear = np.where(inside <= 0.04045, inside / 12.92, ((inside + 0.055) / 1.055) ** 2.4) / 2
    assert border == pytest.approx(1.055 * linear ** (1 / 2.4) - 0.055, abs=0.01)


def test_no_triangles_give_the_background():
    picture = render_mesh(np.zeros((0, 3)), np.zeros((0, 3), int), **PLAIN)
    assert not covered(picture).any()
    gradient = render_mesh(np.zeros((0, 3)), np.zeros((0, 3), int), size=(20, 30))
    assert (np.diff(gradient[:, 0].astype(int), axis=0) <= 0).all()


def test_flat_and_single_point_triangles_are_harmless():
    corners, faces = square(0.0)
    more = np.concatenate([faces, [[0, 0, 0], [0, 1, 1]]])
    assert np.array_equal(render_mesh(corners, more, size=(40, 40)), render_mesh(corners, faces, size=(40, 40)))


def test_unused_vertices_do_not_count_for_the_frame():
    corners, faces = square(0.0)
    vertices = np.concatenate([corners, [[50.0, 50.0, 50.0]] * 20])
    assert np.array_equal(render_mesh(vertices, faces, size=(40, 40)), render_mesh(corners, faces, size=(40, 40)))


@pytest.mark.parametrize(
    ("vertices", "faces", "word"),
    [
        (np.zeros((4, 2)), SIDES, "shape"),
        (CUBE, SIDES[:, :2], "shape"),
        (CUBE, SIDES + 1, "vertex 8"),
        (CUBE * np.nan, SIDES, "finite"),
    ],
)
def test_broken_meshes_are_refused(vertices, faces, word):
    with pytest.raises(ValueError, match=word):
        render_mesh(vertices, faces)


def test_bad_options_are_refused():
    with pytest.raises(DesignError, match="supersampling"):
        render_mesh(CUBE, SIDES, supersampling=0)
    with pytest.raises(ValueError, match="face_colors"):
        render_mesh(CUBE, SIDES, face_colors=COLORS[:3])
