"""Pictures of parts against their layers: what is shown is printed, and islands are not."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.browser.live.pictures import scene_of
from sppm_pipeline.features.browser.stages.write_picture import WritePicture
from sppm_pipeline.method.connectivity.islands import keep_largest
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.border import Border
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import box_mesh
from sppm_pipeline.method.tiling.lattice import dilated
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.pictures.camera import Camera
from sppm_pipeline.testing.plain_context import PlainContext

ABOVE = Camera(-90, 90)  # x to the right, y upwards
SIZE = (200, 200)


class Rods(ScalarField):
    """A rod along z that stays, a ball that floats, and one that scratches the inside of the box from without."""

    cells = (10, 10, 10)
    periodic = False
    edge_mm = 2.0

    def summary(self):
        return {}

    def sample_layers(self, grid, start, stop, threads=1):
        x, y, z = np.meshgrid(grid.axis(0), grid.axis(1), grid.axis(2)[start:stop], indexing="ij")
        rod = np.hypot(x - 3, y - 5) - 1
        balls = [np.sqrt((x - a) ** 2 + (y - b) ** 2 + (z - 5) ** 2) - 0.8 for a, b in ((7, 3), (9.77, 7))]
        return np.minimum.reduce([rod, *balls]).astype(np.float32)


BOX = SurfaceMesh(*box_mesh((10, 10, 10), (16, 16, 16)), name="box")  # mm, thus 1 to 9 cells


def cover(scene, **options):
    """The share of each pixel that is covered, and its place in the unit of the scene."""
    frame = scene.frame(SIZE, ABOVE)
    picture = scene.picture(SIZE, ABOVE, background="transparent", **options)
    rows, columns = np.indices(picture.shape[:2]) + 0.5
    places = [(columns - frame.column) / frame.scale, (frame.row - rows) / frame.scale]
    return picture[..., 3] / 255, [place + frame.target[axis] for axis, place in enumerate(places)], frame


@pytest.mark.parametrize("skin", [0.0, 0.3])
def test_islands_and_chips_are_left_out(skin):
    shown, (x, y), frame = cover(scene_of(Part(Rods(), BOX, skin), 4))
    inside = (abs(x - 5) < 3.7) & (abs(y - 5) < 3.7)
    if skin:
        assert shown[(abs(x - 5) < 3.9) & (abs(y - 5) < 3.9)].min() == 1.0  # the lid
        return
    assert shown.sum() == pytest.approx(np.pi * frame.scale**2, rel=0.02)
    assert not shown[np.hypot(x - 3, y - 5) > 1.1].any()
    kept = scene_of(Part(Rods(), BOX, skin, islands="keep"), 4)
    shown = cover(kept)[0]
    assert shown[inside & (np.hypot(x - 7, y - 3) < 0.7)].min() == 1.0
    assert kept.removed_share == 0.0


@pytest.mark.parametrize("azimuth", [-60.0, -20.0, 10.0, 45.0])
def test_a_border_does_not_change_the_frame(wang_tiling, ball, azimuth):
    plain, bordered = (scene_of(Part(wang_tiling, ball, border=border), 6) for border in (None, Border(0.3)))
    one, other = (scene.frame((80, 60), Camera(azimuth, 20.0)) for scene in (plain, bordered))
    assert one.scale == pytest.approx(other.scale, rel=1e-12)
    assert (one.column, one.row) == pytest.approx((other.column, other.row), rel=1e-12)


def test_the_share_of_islands_is_told(tmp_path):
    ball, rod = 4 / 3 * np.pi * 0.8**3, np.pi * 8
    context = PlainContext(directory=tmp_path)
    WritePicture(resolution=8, image_size=(40, 30)).run(context, Part(Rods(), BOX))
    assert context.reported["removed_share"] == pytest.approx(ball / (ball + rod), rel=0.03)


def test_no_pixel_is_solid_where_the_layers_are_void(wang_tiling, ball):
    part, n = Part(wang_tiling, ball), 24
    shown, places, _ = cover(scene_of(part, n))
    low, high = ((end - np.array(part.origin_mm)) / part.edge_mm for end in (part.domain.lower, part.domain.upper))
    x, y, z = (low + 0.5 / n).tolist()
    nx, ny, nz = np.ceil((high - low) * n).astype(int).tolist()
    solid = keep_largest(part.solid_zyx(Grid((x, y, z), (1 / n,) * 3, (nx, ny, nz)), 0, nz), (False,) * 3)
    column, row = (np.floor((place - low[axis]) * n).astype(int) + 1 for axis, place in enumerate(places))
    there = (row >= 0) & (column >= 0) & (row <= ny + 1) & (column <= nx + 1)

    def seen_from_above(voxels):
        flat = np.pad(voxels.any(0), 1)
        return flat[np.where(there, row, 0), np.where(there, column, 0)] & there

    assert (shown > 0.5).mean() > 0.3
    assert not ((shown > 0) & ~seen_from_above(dilated(solid.view(bool)))).any()  # within a voxel
    thick = ~dilated(~np.pad(solid.view(bool), 1))[1:-1, 1:-1, 1:-1]
    assert seen_from_above(thick).mean() > 0.1
    assert shown[seen_from_above(thick)].min() == 1.0


def test_a_mesh_is_cut_as_the_solid_that_it_bounds(tmp_path):
    def colors(**options):
        context = PlainContext(directory=tmp_path)
        stage = WritePicture(image_size=(60, 60), azimuth=-90.0, elevation=0.0, annotate=False, **options)
        stage.run(context, BOX)
        from PIL import Image

        with Image.open(tmp_path / "picture.png") as image:
            return np.asarray(image).astype(int)

    whole, cut = colors(), colors(section=0.5)
    assert np.abs(whole[30, 30] - cut[30, 30]).max() > 20  # the color of cuts
    assert (colors(background="transparent")[..., 3] / 255).mean() == pytest.approx(0.92**2, abs=0.01)
    open_mesh = SurfaceMesh(BOX.vertices, BOX.faces[1:])
    with pytest.raises(ConfigError, match="are for solids"):
        WritePicture(section=0.5).run(PlainContext(directory=tmp_path), open_mesh)


def test_sections_along_all_axes_keep_what_is_farther_away():
    scene = scene_of(BOX, 4)
    areas = {}
    for axis in "xyz":
        for share in (0.25, 0.75):
            shown = scene.picture(
                (120, 90), Camera(-60, 25), section=share, section_along=axis, background="transparent"
            )
            areas[axis, share] = (shown[..., 3] / 255).sum()
        assert areas[axis, 0.25] < areas[axis, 0.75]
    whole = scene.picture((120, 90), Camera(-60, 25), background="transparent")
    assert max(areas.values()) < (whole[..., 3] / 255).sum()
