"""Pixels that are not square, and layers thinner or thicker than they: what is printed has the right size and shape."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.connectivity.islands import keep_largest
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.method.slicing.slice_stack import stack_size
from sppm_pipeline.method.stages.slice_field import SliceField
from sppm_pipeline.method.stages.slice_mesh import SliceMesh
from sppm_pipeline.method.stages.write_png import WritePng
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.size import Geometry
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.testing.contracts import SlicerContract
from sppm_pipeline.testing.plain_context import PlainContext

PRINTER = (0.019, 0.024, 0.05)
"""Pixels along x and y and layer of a printer of these years, mm."""

CUBE = SurfaceMesh(*box_mesh((0.123, -3.21, 7.7), (10, 10, 10)), name="cube")
BAR = SurfaceMesh(*box_mesh((-1.007, 0.013, 0.29), (9, 4, 1.5)), name="bar")
BALL = SurfaceMesh(*ball_mesh((1.1, 2.2, 3.3), 4.0, 6), name="ball")


@dataclass(frozen=True, eq=False)
class Solid(ScalarField):
    """Solid everywhere, in cells that no pitch divides."""

    cells = (4, 4, 6)
    periodic = False
    edge_mm = 3.7
    origin_mm = (-3.003, -4.007, -1.009)

    def sample_layers(self, grid, start, stop, threads=1):
        return np.full((*grid.shape[:2], stop - start), np.float32(-1))


def options(pitch, **others):
    x, y, layer = pitch
    return {"pixel": (Length(x, "mm"), Length(y, "mm")), "layer": Length(layer, "mm"), **others}


def of_mesh(body, pitch, **others):
    return SliceMesh(**options(pitch, **others)).run(PlainContext(), body)


def of_field(field, pitch, **others):
    return SliceField(**options(pitch, **others)).run(PlainContext(), field)


def of_part(body, pitch, **others):
    return of_field(Part(Solid(), body, 0.0, "keep"), pitch, **others)


def printed(stack, folder):
    """What a printer is given: layers [layer, y, x] in order of increasing y, pixels in mm by the files, manifest."""
    WritePng(sheet=1).run(PlainContext(directory=folder, threads=2), stack)
    manifest = json.loads((folder / "slices/manifest.json").read_text())
    layers, pixels = [], set()
    for file in sorted((folder / "slices").glob("*.png")):
        with Image.open(file) as image:
            layers.append(np.asarray(image)[::-1])
            pixels.add(tuple(25.4 / dpi for dpi in image.info["dpi"]))
    (pixel,) = pixels
    return np.stack(layers) != 0, pixel, manifest


@pytest.mark.parametrize("sliced", [of_mesh, of_part])
@pytest.mark.parametrize("body", [CUBE, BAR, BALL], ids=lambda body: body.name)
def test_a_part_is_printed_as_large_as_it_is(body, sliced, tmp_path):
    solid, pixel, manifest = printed(sliced(body, PRINTER), tmp_path)
    assert manifest["pixel_mm"] == [0.019, 0.024]
    assert pixel == pytest.approx((0.019, 0.024), rel=1e-4)  # the files hold whole pixels per meter
    for axis, pitch in enumerate(PRINTER):
        index = np.flatnonzero(solid.any(tuple(a for a in range(3) if a != 2 - axis)))
        low = manifest["origin_mm"][axis] + index[0] * pitch
        high = manifest["origin_mm"][axis] + (index[-1] + 1) * pitch
        assert low == pytest.approx(body.lower[axis], abs=pitch)
        assert high == pytest.approx(body.upper[axis], abs=pitch)
        assert len(index) * pitch == pytest.approx(body.upper[axis] - body.lower[axis], abs=pitch)
    volume = {"cube": 1000.0, "bar": 54.0, "ball": 4 / 3 * np.pi * 64}[body.name]
    resin = np.count_nonzero(solid) * np.prod(PRINTER)
    assert manifest["solid_volume_mm3"] == pytest.approx(resin)
    assert resin == pytest.approx(volume, rel=1.2e-3 if body is BALL else sum(PRINTER) / 1.5)
    with Image.open(tmp_path / "slices-overview.png") as sheet:
        shown = np.asarray(sheet.convert("L")) == 255  # white is solid, as in the files
    across, along = (np.ptp(np.flatnonzero(shown.any(axis))) + 1 for axis in (0, 1))
    sides = body.upper - body.lower
    assert across / along == pytest.approx(sides[0] / sides[1], rel=0.01)  # a disk is shown as a disk


def test_pixels_along_x_and_y_are_not_taken_for_each_other(wang_tiling):
    """A stack is the transposed one of the transposed body at transposed pixels, and no other."""
    turned = SurfaceMesh(BAR.vertices[:, [1, 0, 2]], BAR.faces[:, ::-1], name="turned")
    stack = of_mesh(BAR, (0.3, 0.2, 0.5))
    assert stack.shape == (30, 20, 3)
    other = of_mesh(turned, (0.2, 0.3, 0.5))
    assert np.array_equal(stack.to_numpy(), other.to_numpy().transpose(0, 2, 1))
    assert of_mesh(BAR, (0.2, 0.3, 0.5)).shape == (45, 14, 3)
    pitch = (0.31, 0.17, 0.43)
    found = of_field(wang_tiling, pitch, islands="keep").to_numpy() > 0
    for axis, name in enumerate("xyz"):
        assert found.shape[2 - axis] == -(-wang_tiling.cells[axis] * 4 // pitch[axis]), name
    x, y, z = ((np.arange(n) + 0.5) * h / 4 for n, h in zip(found.shape[::-1], pitch, strict=True))
    for i, j, k in np.random.default_rng(1).integers(0, found.shape[::-1], (40, 3)):
        at = Grid((x[i], y[j], z[k]), (1.0, 1.0, 1.0), (1, 1, 1))
        assert bool(wang_tiling.solid(at)) == found[k, j, i]


@pytest.mark.parametrize("layer", [0.013, 0.05])
def test_the_porosity_of_layers_is_that_of_the_field(wang_tiling, layer):
    """In the proportions of the printer, at four times its size; for layers far thinner than pixels, too."""
    pitch = (4 * 0.019, 4 * 0.024, 4 * layer)
    stack = of_field(wang_tiling, pitch, islands="keep")
    whole = [int(cells * 4 / h + 1e-9) for cells, h in zip(wang_tiling.cells, pitch, strict=True)]  # within the cells
    nx, ny, nz = whole
    found = stack.to_numpy()[:nz, :ny, :nx] > 0
    sx, sy, sz = (n * h / 4 / m for n, h, m in zip(whole, pitch, (300, 200, 200), strict=True))
    reference = wang_tiling.solid(Grid((sx / 2, sy / 2, sz / 2), (sx, sy, sz), (300, 200, 200)))
    assert found.mean() == pytest.approx(reference.mean(), abs=5e-4)


@pytest.mark.parametrize("layer", [0.1, 0.9])
def test_layers_thinner_and_thicker_than_pixels_are_cut_at_mid_height(wang_tiling, layer):
    stack = of_field(wang_tiling, (0.3, 0.4, layer), islands="keep")
    found = stack.to_numpy() > 0
    (x, y, _), (hx, hy, _), (nx, ny, nz) = stack.grid
    for k in (0, 1, nz // 2, nz - 1):
        section = wang_tiling.solid(Grid((x, y, (k + 0.5) * layer / 4), (hx, hy, 1.0), (nx, ny, 1))).T[0]
        assert np.count_nonzero(found[k] != section) <= 1  # positions are rounded apart
        assert found[k].any()


def test_gray_of_pixels_that_are_not_square(wang_tiling):
    stack = of_field(wang_tiling, (0.3, 0.2, 0.5), gray=4, islands="keep")
    fine = of_field(wang_tiling, (0.075, 0.05, 0.5), islands="keep")
    ny, nx = stack.shape[1::-1]
    padded = np.zeros((stack.shape[2], 4 * ny, 4 * nx))
    solid = fine.to_numpy() > 0
    padded[:, : solid.shape[1], : solid.shape[2]] = solid
    share = padded.reshape(-1, ny, 4, nx, 4).mean((2, 4))
    shades = stack.to_numpy()[:, :, : nx - 1] / 255  # the last pixels reach beyond the cells
    assert np.abs(shades - share[:, :, : nx - 1]).max() <= 0.5 / 255 + 1e-9
    assert len(np.unique(shades)) > 10


@pytest.mark.parametrize("sliced", [of_mesh, of_part])
def test_islands_do_not_care_for_the_pitch(sliced):
    beside, behind = np.array((0, 4.5, 0)), np.array((0, 8, 0))
    apart = SurfaceMesh(
        np.concatenate([BAR.vertices, BAR.vertices + beside, BALL.vertices + behind]),
        np.concatenate([BAR.faces, BAR.faces + 8, BALL.faces + 16]),
        name="three",
    )
    kept = sliced(apart, (0.3, 0.4, 0.2)).to_numpy() > 0
    assert ndimage.label(kept)[1] == 3
    if sliced is of_mesh:
        stack = of_mesh(apart, (0.3, 0.4, 0.2), islands="remove")
    else:
        stack = of_field(Part(Solid(), apart, 0.0, "remove"), (0.3, 0.4, 0.2))
    layers = stack.slabs()
    found = np.concatenate([slab.copy() for _, slab in layers]) > 0
    assert np.array_equal(found, keep_largest(kept.astype(np.uint8), (False,) * 3) > 0)
    assert layers.findings["components"] == 3
    assert layers.findings["removed_share"] == pytest.approx(1 - found.sum() / kept.sum())


@pytest.mark.parametrize("pitch", [(0.1, 0.15, 0.4), (0.3, 0.2, 0.1)])
def test_the_skin_is_as_thick_along_all_axes(wang_tiling, wedge, pitch):
    part = Part(wang_tiling, wedge, 0.5, "keep")
    stack = of_field(part, pitch)
    found = stack.to_numpy() > 0
    inside = of_mesh(wedge, pitch, anchor="origin").to_numpy() > 0
    assert inside.shape == found.shape
    away = ndimage.distance_transform_edt(np.pad(inside, 1), sampling=pitch[::-1])[1:-1, 1:-1, 1:-1]
    assert found[inside & (away <= 0.5)].all()
    assert not found[~inside].any()
    assert not found[inside].all()


def test_a_skin_thinner_than_a_layer_is_told(wang_tiling, wedge):
    for pitch, gray, words in (
        ((0.1, 0.15, 0.4), 1, ["layers of 0.4 mm"]),
        ((0.1, 0.5, 0.2), 1, ["pixels of 0.5 mm"]),
        ((0.1, 0.5, 0.2), 2, []),
        ((0.3, 0.3, 0.3), 1, []),
    ):
        context = PlainContext()
        SliceField(**options(pitch, gray=gray)).run(context, Part(wang_tiling, wedge, 0.3))
        told = [warning for warning in context.warnings if "skin" in warning]
        assert len(told) == len(words)
        assert all(word in warning for word, warning in zip(words, told, strict=True))


YAML = """
pipeline:
  - {{stage: read.primitive, shape: box, size: [1, 1, 1]}}
  - {{stage: slice.mesh, layer: 0.5 mm, pixel: {pixel}}}
  - {{stage: write.png}}
"""


@pytest.mark.parametrize("pixel", ["0.05 mm", "[0.05 mm, 50 um]", "[0.05, 0.05]", "[50 um, 0.005 cm]"])
def test_one_number_or_two(run_yaml, pixel):
    _, folder = run_yaml(YAML.format(pixel=pixel))
    manifest = json.loads((folder / "slices/manifest.json").read_text())
    assert manifest["pixel_mm"] == pytest.approx([0.05, 0.05])
    assert manifest["width_px"] == manifest["height_px"] == 20


@pytest.mark.parametrize(
    ("pixel", "words"),
    [
        ("[1, 2, 3]", "a length or a list of 2 lengths in mm, at least 1e-06, at most 1000, got [1, 2, 3]"),
        ("[1 mm]", "a list of 2 lengths"),
        ("[]", "a list of 2 lengths"),
        ("[0, 1]", "element 1: expected a length in mm, at least 1e-06, at most 1000, got 0"),
        ("[1, -1 mm]", "element 2: expected a length in mm, at least 1e-06, at most 1000, got '-1 mm'"),
        ("-1", "got -1"),
        ("square", "got 'square'"),
        ("[0.1 mm, wide]", "element 2: expected a length"),
        ("[0.1 mm, 2 parsec]", "unknown unit 'parsec'"),
        ("[0.1 mm, [1, 2]]", "element 2"),
        ("{x: 1, y: 2}", "got a map"),
        ("[0.1 mm, 0.2]", "`pixel: [0.1 mm, 0.2]` one has a unit and the other has none"),
        ("[.nan, 1]", "element 1"),
    ],
)
def test_what_is_no_pitch_is_refused_once_and_with_its_place(run_yaml, pixel, words):
    with pytest.raises(ConfigError) as caught:
        run_yaml(YAML.format(pixel=pixel))
    (error,) = getattr(caught.value, "errors", (caught.value,))
    text = str(error)
    assert words in text
    assert "slice.mesh" in text
    assert "pixel" in text
    assert error.hint
    assert error.where.line == 5


def test_pixels_that_are_not_square_need_a_layer():
    for stage in (SliceField, SliceMesh):
        with pytest.raises(ConfigError, match="`layer`") as caught:
            stage(pixel=(Length(19, "um"), Length(24, "um"))).check_options()
        assert "layer: 0.05 mm" in caught.value.hint
        stage(pixel=(Length(19, "um"), Length(0.019))[:1] * 2).check_options()


class TestMeshContract(SlicerContract):
    def stages(self):
        return [SliceMesh(**options((0.3, 0.2, 0.5))), SliceMesh(**options((0.3, 0.3, 0.5), gray=2, islands="remove"))]

    def inputs(self):
        return {"mesh": BALL}


class TestFieldContract(SlicerContract):
    def stages(self):
        return [SliceField(**options((0.3, 0.2, 0.5))), SliceField(resolution=7, gray=2)]

    def inputs(self):
        return {"field": Part(Solid(), BAR, 0.0)}


def test_the_expected_size_counts_three_pitches():
    body = Geometry(edge_mm=2.0, box=(3.0, 4.0, 5.0), volume=60.0)
    size = stack_size(body, (0.02, 0.05, 0.1), 2)
    assert (size.pixels, size.layers, size.samples) == (300 * 160, 100, 300 * 160 * 100 * 4)
    assert stack_size(body, (0.02, 0.05, 0.1), 2, 3).samples == 3 * size.samples
    turned = stack_size(body, (0.05, 0.02, 0.1), 2)
    assert turned.pixels == 120 * 400
    assert size.outline == pytest.approx(turned.outline)
