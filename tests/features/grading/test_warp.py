"""The family ``warp``: the graph is mapped and nothing else; the porosity stays with radii that follow the cells."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import meshio
import numpy as np
import pytest
from scipy import ndimage

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.grading.curved_porosity import CurvedSamples
from sppm_pipeline.features.grading.laid_graph import laid_graph
from sppm_pipeline.features.grading.laws import as_tetrahedra
from sppm_pipeline.features.grading.stages.warp_cylinder import WarpCylinder
from sppm_pipeline.features.grading.stages.warp_hexahedra import WarpHexahedra, block_of, mapped_in_block
from sppm_pipeline.features.grading.stages.warp_sphere import WarpSphere
from sppm_pipeline.method.fields.formula import FormulaField
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_free_faces import FreeFacesTiling
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.method.stages.tile_scattered import ScatteredTiling
from sppm_pipeline.method.stages.tileset_free_faces import FreeFacesTileSet
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.nearest import element_tree, locate
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of
from tests.features.grading.hexahedral_meshes import star

EDGE = 5.0
RECIPE = recipe_of(
    MirroredFaces(total=60, share=0.5),
    DartThrowing(total=60),
    BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
    GaussianField(pore_radius=Length(0.12), tunnel_radius=Length(0.04)),
)


@pytest.fixture(scope="module")
def tileset():
    made = FreeFacesTileSet(colors=2, interiors=4, porosity=0.5, resolution=24, tolerance=0.05)
    return made.run(PlainContext(seed=1), RECIPE)


def laid(tileset, cells, periodic=False):
    return FreeFacesTiling(cell=Length(EDGE, "mm"), cells=cells, periodic=periodic).run(PlainContext(), tileset, None)


def nodes(shape, bend=0.0):
    """Nodes (nx + 1, ny + 1, nz + 1, 3) of a block of cells, the inner ones moved."""
    place = np.stack(np.meshgrid(*(np.arange(n + 1.0) for n in shape), indexing="ij"), -1) * EDGE
    return place + bend * np.random.default_rng(0).uniform(-1, 1, place.shape)


def elements(shape):
    index = np.arange(np.prod(np.add(shape, 1))).reshape(np.add(shape, 1))
    low, high = [slice(None, -1)], [slice(1, None)]
    corners = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    return np.stack([index[tuple((low, high)[c][0] for c in corner)].ravel() for corner in corners], 1)


def saved(path, points, cells):
    meshio.write(path, meshio.Mesh(points.reshape(-1, 3), [("hexahedron", cells)]))
    return path


def grid_over(field, low, high, n):
    """Voxels n along an edge over a box of the world, and their places in mm, (nx, ny, nz, 3)."""
    h = EDGE / n
    shape = tuple(round(float(size)) for size in (np.array(high) - low) / h)
    axes = [a + h * (np.arange(m) + 0.5) for a, m in zip(low, shape, strict=True)]
    edge = field.physical_edge()
    start = tuple(float(axis[0] - o) / edge for axis, o in zip(axes, field.origin_mm, strict=True))
    return Grid(start, (h / edge,) * 3, shape), np.stack(np.meshgrid(*axes, indexing="ij"), -1)


def test_straight_elements_change_nothing(tmp_path, tileset):
    """The field of the mapped graph is that of the tiling, to the cut-off of the kernels; of any kind of tiling."""
    shape = (3, 2, 2)
    stage = WarpHexahedra(path=saved(tmp_path / "a.vtu", nodes(shape), elements(shape)))
    cell = RECIPE.run(PlainContext())
    size = {"cell": Length(EDGE, "mm"), "cells": shape}
    for tiling in (
        laid(tileset, shape),
        laid(tileset, shape, periodic=True),
        PeriodicTiling(**size).run(PlainContext(), cell, None),
        ScatteredTiling(**size).run(PlainContext(), RECIPE, None),
    ):
        made = stage.run(PlainContext(), tiling)
        made.check()
        made.tileset.micro.graph.check()
        made.tileset.micro.graph.pores.check()
        grid, _ = grid_over(made, np.zeros(3), EDGE * np.array(shape), 12)
        own, _ = grid_over(tiling, np.zeros(3), EDGE * np.array(shape), 12)
        np.testing.assert_allclose(made.exactly().sample(grid), tiling.exactly().sample(own), atol=2e-4)


def test_all_pores_are_there_once_and_all_tunnels(tileset):
    tiling = laid(tileset, (6, 2, 2), periodic=True)
    graph = laid_graph(tiling, (True, False, False))
    # one turn of x; beyond y and z one cell more on either side, whose outer tunnels lead nowhere
    inner = ((graph.points[:, 1:] >= 0) & (graph.points[:, 1:] < 2)).all(axis=1)
    pores, arrays = tiling.tileset.micro.graph.pores, tiling.arrays
    counts = np.bincount(pores.piece, minlength=pores.interiors + sum(pores.colors))
    expected = counts[arrays.interior].sum()
    for axis in range(3):
        planes = arrays.faces[axis].take(range(arrays.shape[axis]), axis)
        expected += counts[pores.face_piece(axis, 0) + planes].sum()
    assert inner.sum() == expected
    degree = np.bincount(graph.edges.ravel(), minlength=len(graph.points))
    assert degree[inner].min() >= 2
    assert len(np.unique(graph.points.round(9), axis=0)) == len(graph.points)


def test_a_tube_keeps_its_porosity_ring_by_ring(tileset):
    tiling = laid(tileset, (8, 2, 2), periodic=True)
    flat = (tiling.sample(20) >= 0).mean(axis=(0, 1)).reshape(2, 20).mean(axis=1)
    radius = 8 * EDGE / (2 * np.pi) - EDGE  # cells of the middle are as long as they are high
    context = PlainContext()
    found = {}
    for sizes in ("cell", "fixed"):
        made = WarpCylinder(inner_radius=Length(radius, "mm"), sizes=sizes).run(context, tiling)
        outer = radius + 2 * EDGE
        grid, place = grid_over(made, np.array([-outer, -outer, 0]), np.array([outer, outer, 2 * EDGE]), 14)
        void, r = made.sample(grid) >= 0, np.hypot(place[..., 0], place[..., 1])
        found[sizes] = np.array(
            [void[(r >= radius + k * EDGE) & (r < radius + (k + 1) * EDGE)].mean() for k in range(2)]
        )
    CheckConnectivity(resolution=8).run(context, made)
    assert context.reported["graph_parts"] == 1
    np.testing.assert_allclose(found["cell"], flat, atol=0.015)
    assert found["fixed"][0] > flat[0] + 0.05
    assert found["fixed"][1] < flat[1] - 0.05
    assert context.reported["volume_min"] < 0.6
    assert context.reported["volume_max"] > 1.4


def test_tunnels_beyond_the_cells_make_no_grid_finer(tmp_path, tileset):
    """Towards the axis of a tube, and beyond elements that taper, what is mapped becomes as small as one likes."""
    shape = (3, 3, 3)
    tube = WarpCylinder(inner_radius=Length(1.0, "mm")).run(PlainContext(), laid(tileset, (8, 2, 2), periodic=True))
    path = saved(tmp_path / "a.vtu", nodes(shape, bend=1.5), elements(shape))
    block = WarpHexahedra(path=path).run(PlainContext(), laid(tileset, shape))
    flat = laid(tileset, shape).finest_radius * EDGE
    for made in (tube, block):
        t = np.linspace(0.02, 0.98, 7)
        within = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
        cell = np.repeat(np.arange(made.curved.count), len(within))
        least = np.cbrt(made.curved.mapped_with_volume(cell, np.tile(within, (made.curved.count, 1)))[1].min()) / EDGE
        assert 0.7 * least < made.finest_radius * made.edge / flat < 1.5 * least
        assert made.finest_radius > 2 * made.tileset.micro.finest_radius
        assert made.coarse_pitch > 1.5 * made.tileset.micro.coarse_pitch
        assert made.exactly().coarse_pitch is None
    grid, place = grid_over(block, np.full(3, 4.0), np.full(3, 5.0), 300)
    inside = block.curved.places(place.reshape(-1, 3)).cell.reshape(grid.shape) >= 0
    values, exact = block.sample(grid), block.exactly().sample(grid)
    assert inside.mean() > 0.9
    assert (values != exact)[inside].any()  # interpolated
    assert ((values >= 0) != (exact >= 0))[inside].mean() < 1e-4  # and well


def test_a_zone_of_a_shell_keeps_its_porosity(tileset):
    tiling = laid(tileset, (12, 5, 1), periodic=True)
    flat = (tiling.sample(20) >= 0).mean()
    radius = 12 * EDGE / (2 * np.pi)
    made = WarpSphere(inner_radius=Length(radius, "mm"), latitudes=(-60.0, 60.0)).run(PlainContext(), tiling)
    outer = radius + EDGE
    top = outer * np.sin(np.pi / 3)
    grid, place = grid_over(made, np.array([-outer, -outer, -top]), np.array([outer, outer, top]), 9)
    r = np.linalg.norm(place, axis=-1)
    shell = (r >= radius) & (r < outer) & (np.abs(place[..., 2]) < r * np.sin(np.pi / 3))
    assert abs((made.sample(grid)[shell] >= 0).mean() - flat) < 0.015


def test_distorted_elements_keep_the_porosity_of_their_cells(tmp_path, tileset):
    shape = (3, 3, 3)
    tiling = laid(tileset, shape)
    points, hexes = nodes(shape, bend=0.8), elements(shape)
    made = WarpHexahedra(path=saved(tmp_path / "a.vtu", points, hexes)).run(PlainContext(), tiling)
    grid, place = grid_over(made, np.full(3, -EDGE / 4), np.full(3, 3.25 * EDGE), 16)
    tetrahedra = as_tetrahedra([("hexahedron", hexes)])
    corners = points.reshape(-1, 3)[tetrahedra]
    which, _ = locate(element_tree(corners), corners, place.reshape(-1, 3))
    void = made.sample(grid).reshape(-1) >= 0
    inside = which >= 0
    found = np.bincount(which[inside] // 6, void[inside]) / np.bincount(which[inside] // 6)
    flat = (tiling.sample(16) >= 0).reshape(3, 16, 3, 16, 3, 16).mean(axis=(1, 3, 5)).ravel()
    assert abs(found.mean() - flat.mean()) < 0.01
    assert np.sqrt(np.mean((found - flat) ** 2)) < 0.03  # a corner of an element has another cell's pores


def test_blocks_are_found_in_any_order_of_elements_and_nodes():
    rng = np.random.default_rng(1)
    shape = (4, 2, 3)
    hexes = elements(shape)
    turns = [[1, 2, 3, 0, 5, 6, 7, 4], [4, 0, 3, 7, 5, 1, 2, 6]]  # about z and about y
    mixed = []
    for cell in rng.permutation(hexes):
        for turn in rng.integers(0, 2, 5):
            cell = cell[turns[turn]]
        mixed.append(cell)
    block = block_of(np.array(mixed))
    assert sorted(block.shape) == [3, 4, 5]
    points = nodes(shape).reshape(-1, 3)
    _, det = mapped_in_block(points[block], np.array(block.shape)[None] / 2.0 - 0.7)
    np.testing.assert_allclose(det, EDGE**3)  # not mirrored
    np.testing.assert_array_equal(block_of(hexes), np.arange(60).reshape(5, 3, 4))


def test_places_between_nodes_are_trilinear():
    corners = nodes((2, 1, 1), bend=1.0)
    rng = np.random.default_rng(2)
    places = rng.random((50, 3)) * [2, 1, 1]
    det = mapped_in_block(corners, places)[1]
    e = 1e-6
    columns = [
        (mapped_in_block(corners, places + e * axis)[0] - mapped_in_block(corners, places - e * axis)[0]) / (2 * e)
        for axis in np.eye(3)
    ]
    smooth = np.abs(places[:, 0] - 1) > 2 * e
    np.testing.assert_allclose(det[smooth], np.linalg.det(np.stack(columns, -1))[smooth], rtol=1e-5)
    at = mapped_in_block(corners, np.array([[0, 0, 0], [1, 1, 0], [2, 1, 1]], float))[0]
    np.testing.assert_allclose(at, [corners[0, 0, 0], corners[1, 1, 0], corners[2, 1, 1]])


def test_a_block_is_found_however_its_nodes_are_listed(tmp_path, tileset):
    """Once an element, or in the order of other programs; the same graph comes out, and the order is told."""
    shape = (3, 2, 1)
    tiling, points, hexes = laid(tileset, shape), nodes(shape, bend=0.4), elements(shape)
    upside_down = [4, 5, 6, 7, 0, 1, 2, 3]
    graphs = []
    for where, cells, words in (
        (points, hexes, []),
        (points.reshape(-1, 3)[hexes], np.arange(hexes.size).reshape(-1, 8), []),
        (points, hexes[:, upside_down], ["numbered with the upper four nodes first"]),
    ):
        context = PlainContext()
        made = WarpHexahedra(path=saved(tmp_path / "a.vtu", where, cells)).run(context, tiling)
        assert len(context.warnings) == len(words)
        assert all(word in told for word, told in zip(words, context.warnings, strict=True))
        graphs.append(made.tileset.micro.graph)
    for graph in graphs[1:]:
        np.testing.assert_array_equal(graph.pores.centers, graphs[0].pores.centers)
        np.testing.assert_array_equal(graph.edges, graphs[0].edges)


def test_a_ring_stays_open_where_its_nodes_are_listed_twice(tmp_path, tileset):
    shape = (6, 1, 1)
    place = nodes(shape) / EDGE
    angle, r = -2 * np.pi * place[..., 0] / 6, 3 * EDGE + EDGE * place[..., 1]
    ring = np.stack([r * np.cos(angle), r * np.sin(angle), EDGE * place[..., 2]], -1)
    ring[-1] = ring[0]  # equal to the last bit
    hexes = elements(shape)[:, [3, 2, 1, 0, 7, 6, 5, 4]][:, [4, 5, 6, 7, 0, 1, 2, 3]]
    tiling = laid(tileset, shape)
    made = WarpHexahedra(path=saved(tmp_path / "a.vtu", ring, hexes)).run(PlainContext(), tiling)
    assert made.curved.shape == shape
    joined = hexes.copy()
    for there in np.flatnonzero((place[..., 0] == 6).ravel()):
        joined[joined == there] = np.argmin(np.abs(ring.reshape(-1, 3) - ring.reshape(-1, 3)[there]).sum(-1))
    with pytest.raises(InputError, match="neighbors in two ways"):
        WarpHexahedra(path=saved(tmp_path / "b.vtu", ring, joined)).run(PlainContext(), tiling)


def test_what_cannot_be_warped(tmp_path, tileset):
    shape = (2, 2, 2)
    tiling, hexes, points = laid(tileset, shape), elements(shape), nodes(shape)
    with pytest.raises(ConfigError, match="periodic: true"):
        WarpCylinder(inner_radius=Length(5.0)).run(PlainContext(), tiling)
    WarpCylinder(inner_radius=Length(5.0), around=90.0).run(PlainContext(), tiling)
    with pytest.raises(ConfigError, match="wrong order"):
        WarpSphere(inner_radius=Length(5.0), latitudes=(10.0, -10.0)).check_options()
    with pytest.raises(ConfigError, match="known are"):
        WarpHexahedra(path=tmp_path / "a.stl").check_options()
    flipped = np.concatenate([hexes[:1][:, [4, 5, 6, 7, 0, 1, 2, 3]], hexes[1:]])
    folded = points.copy()
    folded[1, 1, 1] = 3 * EDGE
    for where, cells, words in (
        (points, hexes[:7], "do not fill a block of 2 x 2 x 2"), (points, hexes[[0, 7]], "not all connected"),
        (folded, hexes, "hexahedron 1 is inside out or flat at a corner"), (points, flipped, "inside out"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            WarpHexahedra(path=saved(tmp_path / "a.vtu", where, cells)).run(PlainContext(), tiling)
    path = saved(tmp_path / "a.vtu", points, hexes)
    with pytest.raises(ConfigError, match=r"\[3, 2, 2\] cells do not fit into \[2, 2, 2\] elements"):
        WarpHexahedra(path=path).run(PlainContext(), laid(tileset, (3, 2, 2)))
    finer = WarpHexahedra(path=path).run(PlainContext(), laid(tileset, (4, 2, 2)))
    np.testing.assert_allclose(finer.tileset.micro.graph.pores.per_cell, 60, rtol=0.5)


@dataclass(frozen=True, eq=False, kw_only=True)
class Octet(FormulaField):
    """Struts from each corner and middle of a face to those next to it, which meet in sharp joints."""

    def evaluate(self, x, y, z):
        squared = []
        for across, along in ((x - y, z), (x + y, z), (x - z, y), (x + z, y), (y - z, x), (y + z, x)):
            for start in (0.0, 0.5):
                u, v = across - start, along - start
                squared.append((u - np.round(u)) ** 2 / 2 + (v - np.round(v)) ** 2)
        return np.sqrt(functools.reduce(np.minimum, squared)) - 0.05


def test_a_lone_cell_that_repeats_is_sampled_more_finely():
    """Sharp joints are kinks of the field, which cubics round off."""
    base, flips = Octet(edge=EDGE), {}
    field = PeriodicTiling(cell=Length(EDGE, "mm"), cells=(8, 1, 2)).run(PlainContext(), base, None)
    within = np.random.default_rng(0).random((100_000, 3))
    for resolution in (None, 64):
        made = WarpCylinder(inner_radius=Length(3.0, "mm"), resolution=resolution).run(PlainContext(), field)
        assert made.samples == (resolution or 128)
        found = made._at(made.curved.points(np.zeros(len(within), int), within)) < 0
        flips[resolution] = np.mean(found != (base.evaluate(*within.T) < 0))
    assert flips[None] < 1.5e-4
    assert flips[None] < 0.5 * flips[64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Surface(FormulaField):
    """A network: Schwarz P, or a gyroid, whose sides differ."""

    gyroid: bool = False

    def evaluate(self, x, y, z):
        x, y, z = (2 * np.pi * v for v in (x, y, z))
        if self.gyroid:
            return np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
        return np.cos(x) + np.cos(y) + np.cos(z)


def test_other_fields_are_bent_themselves(tmp_path):
    """The porosity of each ring stays that of the cell, and both phases stay in one piece."""
    base = Surface(edge=EDGE)
    field = PeriodicTiling(cell=Length(EDGE, "mm"), cells=(8, 1, 2)).run(PlainContext(), base, None)
    context = PlainContext()
    radius = 8 * EDGE / (2 * np.pi) - EDGE
    made = WarpCylinder(inner_radius=Length(radius, "mm"), resolution=32).run(context, field)
    shares = CurvedSamples(made, made.curved, 20).shares()
    np.testing.assert_allclose(shares.porosity, 0.5, atol=0.01)
    assert context.reported["volume_min"] < 0.9 < 1.1 < context.reported["volume_max"]
    grid, place = grid_over(made, np.array([-11.5, -11.5, 0]), np.array([11.5, 11.5, EDGE]), 12)
    r = np.hypot(place[..., 0], place[..., 1])
    inside, solid = (r > radius) & (r < radius + 2 * EDGE), made.sample(grid) < 0
    for phase in (solid & inside, ~solid & inside):
        labels, count = ndimage.label(phase)
        assert np.bincount(labels[phase]).max() > 0.999 * phase.sum(), count
    path = saved(tmp_path / "five.vtu", *star(5, EDGE, layers=1))
    filled = WarpHexahedra(path=path, resolution=32).run(context, base)
    assert filled.curved.count == 5
    np.testing.assert_allclose(CurvedSamples(filled, filled.curved, 20).shares().porosity, 0.5, atol=0.01)
    with pytest.raises(InputError, match="looks different from its sides"):
        WarpHexahedra(path=path).run(context, Surface(edge=EDGE, gyroid=True))
    block = saved(tmp_path / "block.vtu", nodes((2, 1, 1), bend=0.5), elements((2, 1, 1)))
    assert WarpHexahedra(path=block).run(context, Surface(edge=EDGE, gyroid=True)).curved.shape == (2, 1, 1)
    with pytest.raises(ConfigError, match="has no sizes that could stay"):
        WarpHexahedra(path=block, sizes="fixed").run(context, base)
