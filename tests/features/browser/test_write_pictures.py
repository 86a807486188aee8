"""Pictures, charts and graphs: there, of the right size, the same bytes each time."""

import dataclasses
import json

import networkx
import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.browser.live.pictures import PHASE_COLORS, phase_surface
from sppm_pipeline.features.browser.stages.write_chart import WriteChart
from sppm_pipeline.features.browser.stages.write_picture import WritePicture
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.stages.write_graph import WriteGraph
from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.nouns.table import Table
from sppm_pipeline.services.pictures.shading import MATERIALS
from sppm_pipeline.testing.plain_context import PlainContext


def picture(stage, what, tmp_path, threads=1):
    context = PlainContext(directory=tmp_path, threads=threads)
    stage.run(context, what)
    data = (tmp_path / stage.path).read_bytes()
    with Image.open(tmp_path / stage.path) as image:
        return data, np.asarray(image.convert("RGB")).copy(), context


@pytest.mark.parametrize("name", ["cell", "wang_tiling", "ball", "part", "skinned"])
def test_pictures(name, request, tmp_path, wang_tiling, ball):
    parts = {"part": Part(wang_tiling, ball), "skinned": Part(wang_tiling, ball, 0.5)}
    what = parts.get(name) or request.getfixturevalue(name)
    stage = WritePicture(image_size=(160, 120), resolution=10)
    data, image, _ = picture(stage, what, tmp_path)
    assert image.shape == (120, 160, 3)
    shown = (image != image[:, :1]).any(2).mean()  # the background is a gradient from top to bottom
    assert 0.15 < shown < 0.95
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 30
    assert picture(stage, what, tmp_path, threads=2)[0] == data
    turned = picture(WritePicture(image_size=(160, 120), resolution=10, azimuth=30.0), what, tmp_path)[0]
    assert turned != data


def test_a_section_shows_the_inside(wang_tiling, ball, tmp_path):
    part = Part(wang_tiling, ball, 0.5)
    whole = picture(WritePicture(image_size=(160, 120), resolution=10), part, tmp_path)[1]
    half = picture(WritePicture(image_size=(160, 120), resolution=10, section=0.5), part, tmp_path)[1]
    assert not np.array_equal(whole, half)


@pytest.mark.parametrize("material", MATERIALS)
def test_the_surface_of_a_part_is_never_colored_like_a_cut(wang_tiling, ball, tmp_path, material):
    view = {"image_size": (160, 120), "resolution": 10, "annotate": False, "material": material}

    def copper(**options):
        pixels = picture(WritePicture(**view, **options), Part(wang_tiling, ball, 0.5), tmp_path)[1].astype(int)
        return (pixels[..., 0] > 1.3 * pixels[..., 1]).mean()

    assert copper() == copper(shadow=True) == copper(section=0.5, section_along="corner", cut="plain") == 0
    assert copper(section=0.5, section_along="corner") > 0.01


def test_voxels_in_colors_of_their_phases(tmp_path):
    values = np.zeros((4, 5, 6), np.uint8)
    values[:2, :4, :3], values[2:, :4, :3] = 1, 2
    values[:, 3] = 3
    image = Voxels.from_array(values, spacing=(0.5, 0.5, 0.2))
    vertices, faces, colors = phase_surface(image.values, image.spacing)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(np.count_nonzero(values) * 0.05)
    bone, blue, orange = PHASE_COLORS[:3].tolist()
    assert {tuple(c) for c in colors.tolist()} == {tuple(bone), tuple(blue), tuple(orange)}
    # what lies at large x is of phase 2 or 3
    assert {tuple(c) for c in colors[(a[:, 0] == 2) & (b[:, 0] == 2) & (c[:, 0] == 2)].tolist()} == {
        tuple(blue), tuple(orange)
    }  # fmt: skip
    # from the front the first two phases hide the lower half of the third one, until they are cut away
    front = {"image_size": (160, 120), "annotate": False, "azimuth": -90.0, "elevation": 0.0}
    shares = []
    for section in (None, 0.4):
        pixels = picture(WritePicture(**front, section=section), image, tmp_path)[1].reshape(-1, 3).astype(int)
        shares.append([np.mean(pixels[:, 2] - pixels[:, 0] > 90), np.mean(pixels[:, 0] - pixels[:, 2] > 90)])
    (blue_seen, orange_seen), (blue_left, orange_left) = shares
    assert blue_seen > 0.1
    assert orange_left > orange_seen + 0.1
    assert blue_left < 0.01
    fractions = Voxels.from_array(np.where(values > 0, 0.7, 0.2).astype(np.float32))
    assert len(np.unique(picture(WritePicture(image_size=(160, 120)), fractions, tmp_path)[1])) > 30


def test_a_sheet_of_tiles(wang, tmp_path):
    data, image, context = picture(WritePicture(resolution=8), wang, tmp_path)
    assert image.shape[1] > 4 * 270
    assert image.shape[0] > 2 * 250
    assert len(context.progress_calls) == 8
    assert picture(WritePicture(resolution=8), wang, tmp_path)[0] == data


TABLE = Table(
    {
        "n": (10, 10, 20, 20, 30, 30, 40),
        "rho": (0.1, 0.14, 0.2, 0.22, 0.33, 0.31, None),
        "status": ("done",) * 6 + ("failed",),
    }
)


@pytest.mark.parametrize("kind", ["points", "boxes"])
def test_charts(kind, tmp_path):
    stage = WriteChart(x="n", y="rho", kind=kind, line=True, title="t", path="c.png")
    data, image, context = picture(stage, TABLE, tmp_path)
    slope, intercept = np.polyfit(TABLE.columns["n"][:6], TABLE.columns["rho"][:6], 1)
    assert context.reported["slope"] == pytest.approx(slope)
    assert context.reported["intercept"] == pytest.approx(intercept)
    assert image.std() > 5
    assert picture(stage, TABLE, tmp_path)[0] == data
    assert picture(WriteChart(x="n", y="rho", kind=kind, path="c.png"), TABLE, tmp_path)[0] != data


def test_charts_of_what_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match="no column 'rh'") as caught:
        picture(WriteChart(x="n", y="rh"), TABLE, tmp_path)
    assert "rho" in caught.value.hint
    with pytest.raises(ConfigError, match="fewer than two"):
        picture(WriteChart(x="n", y="status"), TABLE, tmp_path)


def test_graphs_are_read_back(cell, tmp_path):
    for name in ("g.graphml", "deep/g.json"):
        context = PlainContext(directory=tmp_path)
        WriteGraph(path=name).run(context, cell)
        if name.endswith("json"):
            found = networkx.node_link_graph(json.loads((tmp_path / name).read_text()), edges="edges")
        else:
            found = networkx.read_graphml(tmp_path / name)
        assert found.number_of_nodes() == len(cell.graph.pores.centers)
        assert found.number_of_edges() == len(cell.graph.edges)
        first = (tmp_path / name).read_bytes()
        WriteGraph(path=name).run(context, cell.graph)
        assert (tmp_path / name).read_bytes() == first


def test_graphs_say_their_unit_of_length(cell, tmp_path):
    graph = cell.graph
    sized = dataclasses.replace(graph, pores=dataclasses.replace(graph.pores, cell=Cell(7.5, physical=True)))
    for made, expected in (
        (graph, {"length_unit": "cell size"}),
        (sized, {"length_unit": "cell size", "cell_size_mm": 7.5}),
    ):
        for name in ("g.graphml", "g.json"):
            WriteGraph(path=name).run(PlainContext(directory=tmp_path), made)
        assert networkx.read_graphml(tmp_path / "g.graphml").graph.items() >= expected.items()
        assert json.loads((tmp_path / "g.json").read_text())["graph"].items() >= expected.items()
        assert ("cell_size_mm" in json.loads((tmp_path / "g.json").read_text())["graph"]) == made.pores.cell.physical
