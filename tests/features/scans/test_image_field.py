"""Fields of images: the spline through the voxels, and the stages that lay it."""

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from sppm_pipeline.errors import DesignError, InputError, ResourceError
from sppm_pipeline.features.scans.image_field import ImageField
from sppm_pipeline.features.scans.stages.field_voxels import FieldVoxels
from sppm_pipeline.features.scans.stages.read_scan import ReadScan
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.numerics import Grid, cell_centers, mesh_volume
from sppm_pipeline.testing.plain_context import PlainContext


def centers(n, *shape):
    return np.meshgrid(*((np.arange(k) + 0.5) / n for k in shape or (n, n, n)), indexing="ij")


def ball(n, radius=0.3, middle=(0.49, 0.51, 0.5)):
    """Distance to the surface of a ball at voxel centers, cell sizes."""
    return np.sqrt(sum((x - m) ** 2 for x, m in zip(centers(n), middle, strict=True))) - radius


def gyroid(n, shift=0.4):
    x, y, z = (2 * np.pi * axis for axis in centers(n))
    return np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x) + shift


def scan_of(tmp_path, values, **options):
    path = tmp_path / "scan.npy"
    np.save(path, values)
    context = PlainContext()
    return ReadScan(path=path, **options).run(context), context


def porosity(field, n):
    return 1 - field.to_numpy(n).mean()


def test_the_spline_passes_through_all_voxels_and_repeats():
    rng = np.random.default_rng(1)
    values = rng.normal(size=(8, 12, 16)).astype(np.float32)
    for periodic in (True, False):
        field = ImageField.through(values.copy(order="F"), (0.5, 0.5, 0.5), physical=True, periodic=periodic)
        assert field.cells == (2, 3, 4)
        assert field.edge_mm == 2.0
        assert field.sample(4) == pytest.approx(values, abs=2e-5)
        # against another evaluation of the same spline between the voxels
        grid = Grid((0.03, 0.11, 0.07), (0.37, 0.29, 0.41), (5, 6, 7))
        at = np.meshgrid(*(4 * grid.axis(axis) - 0.5 for axis in range(3)), indexing="ij")
        mode = "grid-wrap" if periodic else "reflect"
        assert field.sample(grid) == pytest.approx(map_coordinates(values, at, order=3, mode=mode), abs=2e-5)
        # by parts and threads the same bytes
        parts = [field.sample_layers(grid, k, k + 1) for k in range(7)]
        assert (np.concatenate(parts, 2) == field.sample_layers(grid, 0, 7, threads=3)).all()
    field = ImageField.through(values.copy(order="F"), (0.5, 0.5, 0.5), physical=True, periodic=True)
    far = Grid((2.03, -2.89, 4.07), grid.spacing, grid.shape)
    assert (field.sample(far) == field.sample(grid)).all()


def test_sides_of_a_scan_are_those_of_its_mirror_images():
    values = ball(16, 0.4, (0.2, 0.5, 0.6)).astype(np.float32)
    alone = ImageField.through(np.asfortranarray(values), (1.0,) * 3, physical=False, periodic=False)
    eight = values
    for axis in range(3):
        eight = np.concatenate((eight, np.flip(eight, axis)), axis)
    mirrored = ImageField.through(np.asfortranarray(eight), (1.0,) * 3, physical=False, periodic=True)
    assert mirrored.sample(64)[:32, :32, :32] == pytest.approx(alone.sample(32), abs=1e-5)


@pytest.mark.parametrize(
    ("made", "n", "error"), [(ball, 16, 1e-3), (ball, 32, 5e-5), (gyroid, 16, 2e-4), (gyroid, 32, 1e-5)]
)
def test_a_gray_image_has_the_porosity_of_what_was_sampled(tmp_path, made, n, error):
    exact = made(128) >= 0
    field, context = scan_of(tmp_path, made(n), threshold=0.0, invert=True)
    assert abs(porosity(field, 128) - exact.mean()) < error + 1e-4
    # at the sides, which nothing is known beyond, the first voxels are a little less exact
    inside = (slice(32, -32),) * 3
    assert np.mean((field.sample(128) >= 0)[inside] != exact[inside]) < 4 * error
    assert context.reported["threshold"] == 0.0


@pytest.mark.parametrize("made", [ball, gyroid])
def test_a_binary_image_keeps_its_solid_and_loses_its_steps(made):
    solid = made(32) < 0
    field = FieldVoxels().run(PlainContext(), Voxels.from_array(solid, periodic=True))
    assert field.periodic
    assert abs(field.to_numpy(128).mean() - solid.mean()) < 0.003
    # a surface between the voxels: a tenth of a voxel off, where that of the voxels is a quarter off
    fine = made(128) < 0
    steps = solid.repeat(4, 0).repeat(4, 1).repeat(4, 2)
    assert np.mean((field.sample(128) < 0) != fine) < 0.35 * np.mean(steps != fine)


def test_flat_walls_of_a_binary_image_stay_where_they_are():
    solid = np.zeros((20, 20, 20), bool)
    solid[4:11] = True
    field = FieldVoxels().run(PlainContext(), Voxels.from_array(solid, periodic=True))
    line = field.sample(Grid((0.0, 0.3, 0.3), (1e-3, 1, 1), (1000, 1, 1)))[:, 0, 0] < 0
    assert np.flatnonzero(line)[[0, -1]] / 1000 == pytest.approx([4 / 20, 11 / 20], abs=2e-3)


def test_crop_downsample_invert_mask_and_the_largest_part(tmp_path):
    values = (100 * ball(24)).astype(np.int16)
    values[:3, :3, :3] = -50
    whole, context = scan_of(tmp_path, values, threshold=0, invert=True, keep_largest=True)
    assert context.reported["removed_share"] == pytest.approx(27 / np.count_nonzero(values < 0), rel=0.1)
    assert not whole.solid(24)[:3, :3, :3].any()
    part, _ = scan_of(tmp_path, values, threshold=0, invert=True, crop=(4, 20, 4, 20, 8, 24), voxel=Length(0.5, "mm"))
    assert part.cells == (1, 1, 1)
    assert part.edge_mm == 8.0
    assert part.origin_mm == (2.0, 2.0, 4.0)
    assert part.sample(16) == pytest.approx(values[4:20, 4:20, 8:24], abs=1e-3)
    half, _ = scan_of(tmp_path, values, threshold=0, invert=True, downsample=2)
    assert half.sample(12) == pytest.approx(values.reshape(12, 2, 12, 2, 12, 2).mean((1, 3, 5)), abs=1e-3)
    mask = np.ones(values.shape, np.uint8)
    mask[12:] = 0
    np.save(tmp_path / "mask.npy", mask)
    masked, _ = scan_of(tmp_path, values, threshold=0, invert=True, mask=tmp_path / "mask.npy")
    assert not masked.solid(24)[12:].any()
    assert masked.solid(24)[:12].any()


def test_cells_of_images_that_are_no_cubes():
    def field(*shape, **options):
        values = np.asfortranarray(np.random.default_rng(0).normal(size=shape), np.float32)
        return ImageField.through(values, options.get("spacing", (1.0,) * 3), physical=True, periodic=False)

    assert field(20, 10, 30).cells == (2, 1, 3)
    assert field(15, 10, 10).cells == (3, 2, 2)
    assert field(10, 10, 40, spacing=(4.0, 4.0, 1.0)).cells == (1, 1, 1)
    assert field(101, 50, 50).lost == pytest.approx(1 / 101)
    with pytest.raises(DesignError, match="whole number of times"):
        ImageField.through(np.ones((10, 11, 10), np.float32), (1.0,) * 3, physical=True, periodic=True)


def test_images_that_mean_harm_are_named(tmp_path):
    values = ball(8)
    values[1, 2, 3] = np.nan
    with pytest.raises(InputError, match="1 values that are not finite"):
        scan_of(tmp_path, values)
    with pytest.raises(DesignError, match="8 x 8 x 1 voxels is too thin"):
        scan_of(tmp_path, ball(8)[:, :, :1], threshold=0)
    with pytest.raises(DesignError, match="all solid"):
        scan_of(tmp_path, np.ones((8, 8, 8), np.uint8))
    with pytest.raises(DesignError, match=r"all void: its values are -?0\..* to 0\..*, and the level is 9"):
        scan_of(tmp_path, ball(8), threshold=9)
    with pytest.raises(InputError, match="4 axes"):
        scan_of(tmp_path, np.zeros((8, 8, 8, 3), np.uint8))
    with pytest.raises(DesignError, match="does not lie in the 8 x 8 x 8"):
        scan_of(tmp_path, ball(8), crop=(0, 9, 0, 8, 0, 8))
    # negative gray values, such as Hounsfield units, are as good as others
    field, _ = scan_of(tmp_path, -1000 * ball(16) - 200, threshold=-200)
    assert porosity(field, 32) == pytest.approx(1 - 4 / 3 * math.pi * 0.3**3, abs=0.002)


def test_two_to_the_31_voxels_are_refused_before_they_are_converted(tmp_path):
    path = tmp_path / "large.npy"
    header = np.lib.format.open_memmap(path, "w+", np.uint8, (2048, 1024, 1024))  # a sparse file
    del header
    context = PlainContext()
    context.memory_limit = 3 * 10**9
    with pytest.raises(ResourceError, match=r"reading large.npy needs about 4.29 GB"):
        ReadScan(path=path, threshold=1).run(context)


def test_thin_solid_and_long_voxels_are_warned_about(tmp_path):
    values = np.zeros((16, 16, 16))
    values[8] = 1
    _, context = scan_of(tmp_path, values)
    assert any("thinner than 3 voxels" in message for message in context.warnings)
    _, context = scan_of(tmp_path, ball(16), threshold=0, voxel=tuple(Length(v, "mm") for v in (1, 1, 4)))
    assert any("4 times as long" in message for message in context.warnings)


def test_a_scan_is_measured_and_meshed_as_any_field(tmp_path):
    field, _ = scan_of(tmp_path, 255 * (gyroid(24) < 0) + np.arange(24) % 3, voxel=Length(0.1, "mm"))
    mesh = field.mesh(24)
    assert mesh_volume(mesh.vertices, mesh.faces) == pytest.approx(2.4**3 * field.to_numpy(48).mean(), rel=0.02)
    assert cell_centers(24, field.cells).shape == (24, 24, 24)
