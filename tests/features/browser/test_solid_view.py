"""Pictures by rays, judged by areas, places and colors of bodies that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.features.browser.live.solid_view import Colors, Solid, render_solid
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.pictures.camera import Camera, framed, projected
from sppm_pipeline.services.pictures.mesh_view import render_mesh
from sppm_pipeline.services.pictures.shading import MATERIALS

N = 32
RED, GREEN, BLUE, GRAY = (200, 0, 0), (0, 200, 0), (0, 0, 200), (90, 90, 90)
COLORS = Colors(RED, GREEN, BLUE, GRAY)
GRID = Grid((-1.0, -1.0, -1.0), (2 / N,) * 3, (N + 1,) * 3)
BOX = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
SIDES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
SIZE = (160, 120)
FRONT = Camera(-90, 0)  # the viewer looks along y


def nodes():
    """Coordinates z, y, x of the samples."""
    return np.meshgrid(*(GRID.axis(2 - axis) for axis in range(3)), indexing="ij")


def radii():
    return np.sqrt(sum(axis**2 for axis in nodes())).astype(np.float32)


SOLID = np.full((N + 1,) * 3, -1, np.float32)


def view(solid, camera=FRONT, size=SIZE, **options):
    """Picture with a transparent background, and the camera that was pointed at the box."""
    frame = framed(camera, solid.vertices, size)
    settings = {"background": "transparent", "occlusion": 0.0, "colors": COLORS, "antialias": False} | options
    return render_solid(solid, frame, size, **settings), frame


def hue(picture):
    """Number of the largest channel of each pixel, -1 where nothing is seen."""
    return np.where(picture[..., 3] > 0, picture[..., :3].argmax(2), -1)


@pytest.mark.parametrize("camera", [FRONT, Camera(20, -70), Camera(-60, 25, 30)])
def test_a_solid_box_is_the_box_of_its_mesh(camera):
    shown = view(Solid(GRID, BOX, SIDES, SOLID), camera)[0][..., 3] > 0
    mesh = render_mesh(BOX, SIDES, camera=camera, size=SIZE, supersampling=1, background="transparent")[..., 3] > 0
    assert (shown != mesh).sum() <= 3
    assert shown.sum() > 0.2 * shown.size


@pytest.mark.parametrize("camera", [FRONT, Camera(-60, 25), Camera(-60, 25, 40)])
def test_silhouette_of_a_ball(camera):
    radius = 0.8
    picture, frame = view(Solid(GRID, BOX, SIDES, radii() - radius), camera, (240, 200), antialias=True)
    apart = frame.distance / np.sqrt(frame.distance**2 - radius**2) if frame.distance else 1.0
    cover = picture[..., 3] / 255
    # samples of the distance are interpolated along lines, which lie in the ball's inside: below a percent at this grid
    assert cover.sum() == pytest.approx(np.pi * (radius * apart * frame.scale) ** 2, rel=0.006)
    place = projected(frame, np.zeros((1, 3)))[0]
    rows, columns = np.indices(cover.shape) + 0.5
    assert (cover * columns).sum() / cover.sum() == pytest.approx(place[0], abs=0.1)
    assert (cover * rows).sum() / cover.sum() == pytest.approx(place[1], abs=0.1)


def test_rims_lie_on_the_surface_of_the_part():
    """A bore through a box along y: its rim in the front is a circle to a tenth of a sample."""
    _, _, x = nodes()
    z = nodes()[0]
    picture, frame = view(
        Solid(GRID, BOX, SIDES, (0.5 - np.sqrt(x**2 + z**2)).astype(np.float32)), size=(400, 400), antialias=True
    )
    hole = (picture[..., 3] < 128).sum() - (400**2 - (2 * frame.scale) ** 2)
    assert np.sqrt(hole / np.pi) / frame.scale == pytest.approx(0.5, abs=0.1 * 2 / N)
    # what is seen else is the front, all in the color of the part's surface
    assert set(np.unique(hue(picture)[picture[..., 3] == 255])) == {1}


def test_whose_surface_has_which_color():
    """A hollow ball with a skin at the sides of the box: front, section and inside."""
    z, y, x = nodes()
    skin = (np.minimum.reduce([1 - abs(x), 1 - abs(y), 1 - abs(z)]) - 0.2).astype(np.float32)
    solid = Solid(GRID, BOX, SIDES, 0.9 - radii(), skin)
    assert set(np.unique(hue(view(solid)[0]))) == {-1, 2}
    cut, frame = view(solid, section=[((0.0, -1.0, 0.0), 0.0)])
    seen, middle = hue(cut), projected(frame, np.zeros((1, 3)))[0]

    def at(right, up):
        return seen[int(middle[1] - up * frame.scale), int(middle[0] + right * frame.scale)]

    assert at(0.9, 0.0) == 2  # the skin, cut
    assert at(0.0, 0.0) == 2  # the skin at the back, as the ball reaches into it
    assert at(0.6, 0.0) == 0  # the ball's inside
    corner = cut[int(middle[1] - 0.7 * frame.scale), int(middle[0] + 0.7 * frame.scale), :3]
    assert np.ptp(corner.astype(int)) < 60  # the section's gray
    assert corner.any()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_section_keeps_the_far_side(axis):
    camera = Camera(-60, 25)
    normal = np.zeros(3)
    normal[axis] = 1.0 if axis != 1 else -1.0
    solid = Solid(GRID, BOX, SIDES, SOLID)
    cut, frame = view(solid, camera, section=[(normal, -0.2)], antialias=True)
    half = BOX.copy()
    half[:, axis] = np.clip(half[:, axis] * normal[axis], -1, -0.2) * normal[axis]
    small = render_solid(
        Solid(GRID, half, SIDES, SOLID), frame, SIZE, background="transparent", occlusion=0.0, colors=COLORS
    )
    assert np.abs(cut[..., 3].astype(int) - small[..., 3]).max() <= 60
    assert np.abs(cut[..., 3].astype(int) - small[..., 3]).sum() / 255 < 3
    gray = (np.ptp(cut[..., :3].astype(int), axis=2) < 60) & (cut[..., 3] > 0)
    assert gray.sum() > 0.15 * (cut[..., 3] > 0).sum()
    assert not ((np.ptp(small[..., :3].astype(int), axis=2) < 60) & (small[..., 3] == 255)).any()


@pytest.mark.parametrize("camera", [Camera(-60, 25), Camera(-45, 60), FRONT, Camera(-60, 25, 30)])
def test_a_corner_is_left_out_where_both_planes_are_passed(camera):
    _, y, x = nodes()
    # the same as a field, whose surface is off by less than a sample
    void = np.minimum(x - 0.2, -y - 0.3).astype(np.float32)
    planes = [((1.0, 0.0, 0.0), 0.2), ((0.0, -1.0, 0.0), 0.3)]
    cut, _ = view(Solid(GRID, BOX, SIDES, SOLID), camera, section=planes, antialias=True)
    field = view(Solid(GRID, BOX, SIDES, void), camera, antialias=True)[0]
    apart = np.abs(cut[..., 3].astype(int) - field[..., 3])
    assert apart.sum() / 255 < 0.02 * (field[..., 3] > 0).sum()
    gray = (np.ptp(cut[..., :3].astype(int), axis=2) < 60) & (cut[..., 3] > 0)
    red = hue(field) == 0  # the surface of the field, where the other has its cuts
    assert gray.sum() > 0.1 * (cut[..., 3] > 0).sum()
    assert (gray != red).sum() < 0.1 * gray.sum()


def test_a_ball_casts_its_shadow_on_the_ground_and_on_itself():
    solid, camera = Solid(GRID, BOX, SIDES, radii() - 0.5), Camera(-60, 25)
    bare, _ = view(solid, camera)
    dark = view(solid, camera, shadow=True)[0]
    ball = bare[..., 3] == 255
    assert (dark[..., :3][ball] <= bare[..., :3][ball]).mean() > 0.99
    fallen = ~ball & (dark[..., 3] > 20)
    assert fallen.sum() > 0.1 * ball.sum()
    assert (dark[fallen][:, :3] < 60).all()  # black, of some opacity
    assert np.nonzero(fallen)[0].mean() > np.nonzero(ball)[0].mean()  # below
    again = view(solid, camera, shadow=True, threads=2)[0]
    assert np.array_equal(dark, again)


def test_materials_shine():
    solid, camera = Solid(GRID, BOX, SIDES, radii() - 0.8), Camera(-60, 25)
    grays = Colors(GRAY, GRAY, GRAY, GRAY)
    seen = {name: view(solid, camera, colors=grays, material=MATERIALS[name])[0] for name in MATERIALS}
    brightest = {name: picture[picture[..., 3] == 255][:, :3].max() for name, picture in seen.items()}
    assert brightest["bone"] < brightest["resin"] < 255
    assert brightest["bone"] < brightest["titanium"] < 255


def test_a_part_that_its_triangles_do_not_bound_ends_at_its_field():
    outer = radii() - 0.6
    picture, frame = view(Solid(GRID, BOX, SIDES, SOLID, outer=outer), antialias=True)
    assert (picture[..., 3] / 255).sum() == pytest.approx(np.pi * (0.6 * frame.scale) ** 2, rel=0.01)
    assert set(np.unique(hue(picture))) == {-1, 1}


def test_shells_that_overlap_are_one():
    """Two boxes, one of them moved: within both nothing begins anew."""
    moved = 0.6 * BOX + [0.3, 0.0, 0.0]
    both = Solid(GRID, np.concatenate([0.6 * BOX, moved]), np.concatenate([SIDES, SIDES + 8]), SOLID)
    camera = Camera(-60, 25)
    frame = framed(camera, BOX, SIZE)
    together = render_solid(both, frame, SIZE, background="transparent", antialias=False)
    union = np.concatenate([0.6 * BOX[:4], moved[4:]])
    one = render_solid(Solid(GRID, union, SIDES, SOLID), frame, SIZE, background="transparent", antialias=False)
    assert (together[..., 3] == one[..., 3]).all()
    assert (np.abs(together.astype(int) - one).max(2) > 2).mean() < 0.01


def test_bytes_do_not_depend_on_threads_and_edges_are_smooth():
    solid = Solid(GRID, BOX, SIDES, radii() - 0.8)
    one, three = (view(solid, Camera(), occlusion=1.0, background="dark", antialias=True, threads=t)[0] for t in (1, 3))
    assert np.array_equal(one, three)
    levels = [len(np.unique(view(solid, antialias=a)[0][..., 3])) for a in (False, True)]
    assert levels[0] == 2
    assert levels[1] > 6
