"""Sections of fields against the sums themselves, and pictures of pores and tunnels against what they stand for."""

import dataclasses
import math

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.browser.live.pictures import TILE_COLORS
from sppm_pipeline.features.browser.stages import write_picture as graph_picture
from sppm_pipeline.features.browser.stages.write_picture import (
    BALL,
    CONNECTOR,
    EDGE,
    FACES,
    INNER,
    INTERIOR,
    TUNNEL,
    WritePicture,
)
from sppm_pipeline.features.browser.stages.write_section import WriteSection, plane_of, with_curve
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.nouns.palette import Blocks
from sppm_pipeline.testing.plain_context import PlainContext

A, B = np.array([0.3, 0.4, 0.5]), np.array([0.7, 0.6, 0.5])


@pytest.fixture(scope="module")
def graph():
    return TunnelGraph.from_arrays(PoreSet.from_array([A, B]), [[0, 1]])


@pytest.fixture(scope="module")
def field(graph):
    return GaussianField(omega=120.0, mu=60.0, level=0.25).run(PlainContext(), graph)


def drawn(stage, what, tmp_path):
    context = PlainContext(directory=tmp_path)
    stage.run(context, what)
    with Image.open(tmp_path / stage.path) as image:
        return np.asarray(image.convert("RGB")).astype(int), context.reported


def kernels(x, y):
    """Equations 1 to 3 for the two pores, in their plane."""
    points = np.stack([x, y, np.full_like(x, 0.5)], axis=-1)
    along = np.clip((points - A) @ (B - A) / ((B - A) @ (B - A)), 0, 1)[..., None]
    tunnel = np.exp(-60 * np.linalg.norm(points - (A + along * (B - A)), axis=-1))
    return sum(np.exp(-120 * ((points - p) ** 2).sum(-1)) for p in (A, B)) + tunnel


@pytest.mark.parametrize("pixels", [40, 96])
def test_a_section_has_the_values_of_the_equations(field, pixels):
    values = plane_of(field, 2, 0.5, pixels, 1)
    place = (np.arange(pixels) + 0.5) / pixels
    x, y = np.meshgrid(place, place[::-1])  # the first row is that of the largest y
    assert values + 0.25 == pytest.approx(kernels(x, y), abs=2e-4)


def test_sections_across_each_axis(field):
    x, y, z = (plane_of(field, axis, 0.45, 32, 1) for axis in range(3))
    whole = field.sample(32)
    at = 0.45 * 32 - 0.5
    below, above = int(at), int(at) + 1
    for axis, found in enumerate((x, y, z)):
        near = np.take(whole, [below, above], axis)
        low, high = near.min(axis), near.max(axis)
        between = (found.T[:, ::-1] >= low - 0.1) & (found.T[:, ::-1] <= high + 0.1)
        assert between.mean() > 0.98, axis


def test_shares_above_levels_are_reported_and_curves_drawn(field, tmp_path):
    stage = WriteSection(pixels=200, levels=(0.2, 0.6, 1.0))
    image, reported = drawn(stage, field, tmp_path)
    place = (np.arange(200) + 0.5) / 200
    true = kernels(*np.meshgrid(place, place))
    assert [reported["share_above"][n] for n in "123"] == pytest.approx(
        [float((true > level).mean()) for level in (0.2, 0.6, 1.0)], abs=2e-4
    )
    assert reported["highest"] == pytest.approx(true.max(), rel=1e-3)
    section = image[:200, :200]
    for level, (red, green, blue) in ((0.2, (16, 64, 224)), (0.6, (0, 160, 64)), (1.0, (240, 208, 0))):
        there = (np.abs(section - (red, green, blue)) <= 12).all(2)
        x, y = (np.nonzero(there)[1] + 0.5) / 200, 1 - (np.nonzero(there)[0] + 0.5) / 200
        assert there.sum() > 40
        # within two pixels of where the sum has that value: 0.01 times the steepest slope
        assert np.abs(kernels(x, y) - level).max() < 0.01 * 60 * 1.6
    # without levels there is one curve, the surface of the solid
    assert list(drawn(WriteSection(pixels=64), field, tmp_path)[1]["share_above"]) == ["1"]


def test_a_field_without_slope_has_no_curve():
    picture = np.zeros((8, 8, 3), np.uint8)
    assert not with_curve(picture, np.full((8, 8), 0.25), 0.25, (255, 255, 255)).any()
    ramp = np.tile(np.linspace(0, 1, 8), (8, 1))
    drawn = with_curve(picture, ramp, 0.5, (255, 255, 255))[0, :, 0]
    assert drawn[3] == drawn[4] == 255
    assert drawn[0] == drawn[7] == 0


def test_sections_of_parts_and_other_fields(wang_tiling, ball, tmp_path):
    part, reported = drawn(WriteSection(pixels=64), Part(wang_tiling, ball), tmp_path)
    assert 0 < reported["share_above"]["1"] < 1
    assert part.shape[0] <= 64


@pytest.mark.parametrize("levels", [(0.2, 0.2), tuple(range(9))])
def test_levels_that_can_not_be_told_apart_are_refused(levels):
    with pytest.raises(ConfigError, match="different values"):
        WriteSection(levels=levels).check_options()


def colors_of(shape):
    return {tuple(int(c) for c in color) for color in np.unique(shape.colors, axis=0)}


def test_pores_are_balls_and_tunnels_rods(graph):
    shape = graph_picture.graph_shape(graph.pores)
    assert colors_of(shape) == {INTERIOR, EDGE}
    balls = shape.vertices[np.unique(shape.faces[(shape.colors == INTERIOR).all(1)])]
    away = np.linalg.norm(balls[:, None] - np.stack([A, B]), axis=2).min(1)
    assert away == pytest.approx(np.full(len(balls), BALL))
    rods = graph_picture.graph_shape(graph)
    assert colors_of(rods) == {INTERIOR, EDGE, TUNNEL}
    tunnel = rods.vertices[np.unique(rods.faces[(rods.colors == TUNNEL).all(1)])]
    assert tunnel.mean(0) == pytest.approx((A + B) / 2)


def test_tunnels_that_leave_the_cell_come_in_again():
    pores = PoreSet.from_array([[0.1, 0.5, 0.5], [0.8, 0.5, 0.5]])
    shape = graph_picture.graph_shape(TunnelGraph.from_arrays(pores, [[0, 1]]))
    tunnel = shape.vertices[np.unique(shape.faces[(shape.colors == TUNNEL).all(1)])]
    x = np.unique(np.round(tunnel[:, 0], 9))
    assert x == pytest.approx([0.0, 0.1, 0.8, 1.0])


def test_pores_of_faces_are_seen_on_both_sides(cell):
    graph = cell.graph
    shape = graph_picture.graph_shape(graph)
    assert colors_of(shape) == {INTERIOR, EDGE, INNER, TUNNEL, CONNECTOR, *FACES}
    axis_of = graph.pores.axis_of_piece()[graph.pores.piece]
    per_ball = len(graph_picture._balls(np.zeros((1, 3)), BALL, INTERIOR).faces)
    for axis in range(3):
        own = graph.pores.centers[axis_of == axis]
        twins = sum(2 ** int((p == 0).sum()) for p in own)
        assert (shape.colors == FACES[axis]).all(1).sum() == per_ball * twins


def test_what_can_not_be_drawn_is_refused(graph, monkeypatch, tmp_path):
    monkeypatch.setattr(graph_picture, "MAX_SHOWN", 2)
    with pytest.raises(DesignError, match="up to 2 pores and tunnels"):
        graph_picture.graph_shape(graph)
    blocks = dataclasses.replace(graph.pores, blocks=Blocks(np.ones((1, 1, 1), bool), True))
    with pytest.raises(DesignError, match="no cell"):
        graph_picture.graph_shape(blocks)
    with pytest.raises(ConfigError, match="cuts solids"):
        drawn(WritePicture(section=0.5), graph, tmp_path)


def test_graphs_have_pictures(cell, tmp_path):
    stage = WritePicture(image_size=(160, 120))
    pores, graph = (drawn(stage, what, tmp_path)[0] for what in (cell.graph.pores, cell.graph))
    blue = [((picture - TUNNEL) ** 2).sum(2).min() for picture in (pores, graph)]
    assert blue[1] < blue[0] / 2


def test_planes_of_sections_have_colors(cell, tmp_path):
    def shown(cut):
        image, _ = drawn(
            WritePicture(image_size=(120, 90), resolution=12, section=0.5, cut=cut, annotate=False), cell, tmp_path
        )
        return [int((image[..., channel] > image[..., (channel + 1) % 3] + 60).sum()) for channel in range(3)]

    red, green, blue = (shown(cut) for cut in ("red", "green", "blue"))
    assert red[0] > green[0]
    assert blue[2] > red[2]


def test_cut_faces_of_tiles_have_their_colors(wang, tmp_path):
    image, _ = drawn(WritePicture(resolution=12), wang, tmp_path)
    hue = image / np.maximum(image.max(2, keepdims=True), 1)
    for n, color in enumerate(TILE_COLORS[: wang.palette_colors]):
        own = np.array(color) / max(color)
        shares = (np.abs(hue - own).max(2) < 0.08).mean()
        assert shares > 0.01, n
    assert math.isclose(image.shape[1] / 320, round(image.shape[1] / 320), abs_tol=0.1)
