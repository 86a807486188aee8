"""``tile.hexahedra`` and what tunes and checks it: so many pores a cell, the porosity of each, on meshes that are no
block. Porosities are counted again by code of its own."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from typing import ClassVar

import meshio
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from sppm_pipeline.errors import ConfigError, DesignError, InputError
from sppm_pipeline.features.grading.curved_cells import HexahedralCells
from sppm_pipeline.features.grading.hexahedral_cloud import Surroundings
from sppm_pipeline.features.grading.laid_graph import WarpedTiling
from sppm_pipeline.features.grading.stages.check_local_porosity import CheckLocalPorosity
from sppm_pipeline.features.grading.stages.grade_formula import GradeFormula
from sppm_pipeline.features.grading.stages.read_hexahedra import ReadHexahedra
from sppm_pipeline.features.grading.stages.tile_hexahedra import HexahedralTiling
from sppm_pipeline.features.grading.stages.tune_local_porosity import TuneLocalPorosity
from sppm_pipeline.features.grading.stages.warp_cylinder import WarpCylinder
from sppm_pipeline.method.families.sampler import Sampler
from sppm_pipeline.method.fields.level_field import LevelField
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_fresh import FreshTiling
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of
from tests.features.grading.hexahedral_meshes import o_grid, squares, star

EDGE = 4.0
JOINED = (
    BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
    GaussianField(pore_radius=Length(0.11), tunnel_radius=Length(0.035)),
)
RECIPE = recipe_of(DartThrowing(total=60, share=0.5), *JOINED)
RECIPE_WITH_FACES = recipe_of(MirroredFaces(total=60, share=0.5), DartThrowing(total=60), *JOINED)


@dataclass(frozen=True, kw_only=True)
class Uniform(Sampler):
    """A sampler that knows cubes alone."""

    name: ClassVar[str] = "sample.uniform"

    def throw(self, rng, box):
        return rng.random((40, 3))


def saved(path, mesh, order=None):
    points, cells = mesh
    meshio.write(path, meshio.Mesh(points, [("hexahedron", cells if order is None else cells[:, order])]))
    return path


def porosity_map(formula="0.5"):
    return GradeFormula(of="porosity", formula=formula).run(PlainContext(), None, None)


def counted_again(field, points, h=0.05):
    """Porosity at points (cells, n, 3) mm: samples of a fine grid, splined by scipy."""
    edge, origin = field.physical_edge(), np.array(field.origin_mm)
    low, high = points.min(axis=(0, 1)) - 0.4, points.max(axis=(0, 1)) + 0.4
    shape = np.ceil((high - low) / h).astype(int) + 1
    grid = Grid(tuple(((low - origin) / edge).tolist()), (h / edge,) * 3, tuple(int(n) for n in shape))
    values = np.asarray(field.exactly().sample(grid), np.float64)
    place = ((points - low) / h).reshape(-1, 3).T
    return (map_coordinates(values, place, order=3, mode="nearest") >= 0).reshape(len(points), -1).mean(axis=1)


def evenly(corner, sides, n):
    """Points evenly in a parallelepiped with a corner and sides (3, 3)."""
    t = (np.arange(n) + 0.5) / n
    return corner + np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3) @ sides


@pytest.fixture(scope="module")
def five(tmp_path_factory):
    """Five elements around an edge, before and after tuning."""
    path = saved(tmp_path_factory.mktemp("mesh") / "five.vtu", star(5, EDGE, layers=1))
    context = PlainContext(seed=2)
    made = HexahedralTiling(path=path, porosity=0.5, trials=2).run(context, RECIPE)
    before = dict(context.reported)
    tuned = TuneLocalPorosity(resolution=48).run(context, made, porosity_map())
    return path, made, before, tuned, dict(context.reported)


def rhombs(n):
    found = []
    for k in range(5):
        a, c = (EDGE * np.array([np.cos(t), np.sin(t), 0]) for t in 2 * np.pi * np.array([k, k + 1]) / 5)
        found.append(evenly(np.zeros(3), np.array([a, c, [0, 0, EDGE]]), n))
    return np.array(found)


def test_five_cells_around_an_edge_have_their_porosity(five):
    _, made, before, tuned, after = five
    assert isinstance(made, WarpedTiling)
    made.check()
    made.tileset.micro.graph.check()
    assert isinstance(tuned, LevelField)
    tuned.check()
    points = rhombs(56)  # other ones than those by which the level was tuned
    assert np.abs(counted_again(made, points) - 0.5).max() < 0.01
    assert before["error_max"] < 0.01
    assert np.abs(counted_again(tuned, points) - 0.5).max() < 0.001
    assert after["error_max"] < 0.001
    assert after["cells_tuned"] == 5
    assert 0.2 < after["level_min"] < after["level_max"] < 0.3


def test_every_cell_has_its_pores_and_all_are_joined(five):
    _, made, *_ = five
    context = PlainContext()
    CheckConnectivity(resolution=12).run(context, made)
    assert context.reported["graph_parts"] == 1
    graph = made.tileset.micro.graph
    pores = graph.pores
    points = (pores.centers + np.argwhere(made.arrays.interior >= 0)[pores.piece] - 1) * made.edge + made.origin
    counts = np.bincount(made.curved.places(points).cell + 1, minlength=6)
    assert (np.abs(counts[1:] - counts[1:].mean()) < 12).all()
    assert counts[0] > counts[1:].sum()  # around them, too
    degree = np.bincount(graph.edges.ravel(), minlength=len(points))
    assert degree.min() >= 1


def test_the_level_is_smooth_across_cells(five):
    """The level's slope is that of finite differences from either side of the faces between cells."""
    _, made, _, tuned, _ = five
    h, edge = 0.02, tuned.physical_edge()
    low = (np.array([EDGE / 2, -0.3, 1.0]) - np.array(tuned.origin_mm)) / edge
    grid = Grid(tuple(low.tolist()), (h / edge,) * 3, (3, 31, 3))
    ratio = np.log((tuned.sample(grid) + tuned.solid_below) / (made.sample(grid) + made.solid_below)).astype(float)
    second = np.diff(ratio[1, :, 1], 2) / h**2
    assert np.abs(second).max() < 5.0  # a kink of .01 in the slope would be .5 / h = 25


def test_the_part_is_checked_cell_by_cell(five, tmp_path):
    path, _, _, tuned, _ = five
    context = PlainContext(directory=tmp_path)
    surface = ReadHexahedra(path=path).run(context)
    assert surface.bounds_solid
    assert context.reported["hexahedra"] == 5
    part = ImplicitFill().run(context, tuned, surface)
    assert isinstance(part, Part)
    CheckLocalPorosity(resolution=24, path="porosity").run(context, part, porosity_map())
    assert context.reported["cells"] == 5
    assert context.reported["cell_error_max"] < 0.004  # fewer points
    rows = list(csv.DictReader((tmp_path / "porosity" / "cells.csv").read_text().splitlines()))
    assert [row["hexahedron"] for row in rows] == list("01234")
    assert {row["part"] for row in rows} == {"0"}
    assert all(float(row["share_inside"]) > 0.98 for row in rows)
    for name in ("section.png", "scatter.png", "porosity.vti"):
        assert (tmp_path / "porosity" / name).stat().st_size > 1000


def test_rings_of_a_tube_after_tuning():
    context = PlainContext(seed=3)
    size = {"cell": Length(EDGE, "mm"), "cells": (6, 1, 2)}
    tiling = FreshTiling(**size, periodic=True, porosity=0.5, resolution=20).run(context, RECIPE_WITH_FACES, None)
    radius = 6 * EDGE / (2 * np.pi) - 0.7 * EDGE
    made = WarpCylinder(inner_radius=Length(radius, "mm")).run(context, tiling)
    tuned = TuneLocalPorosity(resolution=48).run(context, made, porosity_map())
    assert context.reported["cells_tuned"] == 12
    n = 44
    t = (np.arange(n) + 0.5) / n
    errors = {"before": [], "after": []}
    for ring in range(2):
        # places as dense as the volume: evenly in the square of the radius
        inner, outer = (radius + EDGE * (ring + end) for end in range(2))
        r = np.sqrt(inner**2 + (outer**2 - inner**2) * t)
        angle = 2 * np.pi * (np.arange(6 * n) + 0.5) / (6 * n)
        a, y, x = (v.ravel() for v in np.meshgrid(angle, EDGE * t, r, indexing="ij"))
        points = np.stack([x * np.cos(a), x * np.sin(a), y], 1)[None]
        errors["before"].append(abs(counted_again(made, points, 0.07)[0] - 0.5))
        errors["after"].append(abs(counted_again(tuned, points, 0.07)[0] - 0.5))
    assert max(errors["before"]) < 0.02
    assert max(errors["after"]) < 0.001


def test_sizes_follow_the_mesh_or_stay(tmp_path):
    path = saved(tmp_path / "o.vtu", o_grid(6, 2.4, 1, 2, 1, 3))
    context = PlainContext(seed=1)
    follow = HexahedralTiling(path=path).run(context, RECIPE)
    fixed = HexahedralTiling(path=path, sizes="fixed", cell=Length(4.0, "mm")).run(context, RECIPE)
    assert context.reported["hexahedra"] == 9
    assert context.reported["volume_max_mm3"] > 1.5 * context.reported["volume_min_mm3"]
    spread = [np.ptp(made.tileset.micro.pieces.kernels.omega) for made in (follow, fixed)]
    assert spread[0] > 0
    assert spread[1] == 0
    radius = 0.11 * 4.0 / fixed.edge
    assert fixed.tileset.micro.pieces.kernels.omega[0] == pytest.approx(np.log(4) / radius**2, rel=1e-9)
    for made, per_volume in ((follow, None), (fixed, 60 / 4.0**3)):
        pores = made.tileset.micro.graph.pores
        points = (pores.centers + np.argwhere(made.arrays.interior >= 0)[pores.piece] - 1) * made.edge + made.origin
        counts = np.bincount(made.curved.places(points).cell + 1, minlength=10)[1:]
        expected = np.full(9, 60) if per_volume is None else made.curved.volumes * per_volume
        np.testing.assert_allclose(counts, expected, atol=1.01)


def test_cells_finer_than_the_mesh_and_the_same_on_all_threads(tmp_path):
    path = saved(tmp_path / "l.vtu", squares([(0, 0), (1, 0), (0, 1)], EDGE, layers=1))
    stage = HexahedralTiling(path=path, parts=2)
    made = stage.run(PlainContext(seed=4), RECIPE)
    assert made.curved.count == 24
    assert made.curved.names.max(axis=0).tolist() == [2, 7]
    again = stage.run(PlainContext(seed=4, threads=2), RECIPE)
    for name in ("centers", "omega", "starts", "ends", "mu"):
        np.testing.assert_array_equal(
            getattr(made.tileset.micro.pieces.kernels, name), getattr(again.tileset.micro.pieces.kernels, name)
        )
    other = stage.run(PlainContext(seed=5), RECIPE)
    assert not np.array_equal(other.tileset.micro.graph.pores.centers[:50], made.tileset.micro.graph.pores.centers[:50])


def test_a_map_of_porosity_is_followed_through_a_hole(tmp_path):
    around = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    path = saved(tmp_path / "hole.vtu", squares(around, EDGE, layers=1))
    context, wanted = PlainContext(seed=1), porosity_map("0.4 + 0.02*x")
    made = HexahedralTiling(path=path, trials=2).run(context, RECIPE, wanted)
    assert context.reported["error_max"] < 0.015
    assert context.reported["error_rms_of_rounds"][-1] < context.reported["error_rms_of_rounds"][0]
    TuneLocalPorosity(resolution=48).run(context, made, wanted)
    assert context.reported["error_max"] < 0.0015


def test_what_cannot_be_filled(tmp_path):
    good = saved(tmp_path / "five.vtu", star(5, EDGE, layers=1))
    context = PlainContext()
    with pytest.raises(ConfigError, match="known are"):
        HexahedralTiling(path=tmp_path / "a.stl").check_options()
    with pytest.raises(ConfigError, match="sizes follow the mesh"):
        HexahedralTiling(path=good, cell=Length(4.0)).check_options()
    scale = GradeFormula(of="scale", formula="1").run(context, None, None)
    with pytest.raises(ConfigError, match="can't follow 'scale'"):
        HexahedralTiling(path=good).run(context, RECIPE, scale)
    with pytest.raises(ConfigError, match="given twice"):
        HexahedralTiling(path=good, porosity=0.5).run(context, RECIPE, porosity_map())
    with pytest.raises(ConfigError, match="size of a cell is missing"):
        HexahedralTiling(path=good, sizes="fixed").run(context, RECIPE)
    with pytest.raises(ConfigError, match="can't fill a mesh of hexahedra"):
        HexahedralTiling(path=good).run(context, recipe_of(Uniform(), *JOINED))
    crowded = recipe_of(DartThrowing(count=60, spacing=Length(0.26)), *JOINED)
    with pytest.raises(DesignError, match=r"pores fit into cell \{'hexahedron': \d, 'part': 0\}"):
        HexahedralTiling(path=good).run(context, crowded)
    points, cells = star(5, EDGE, layers=1)
    meshio.write(tmp_path / "mixed.vtu", meshio.Mesh(points, [("hexahedron", cells), ("tetra", cells[:2, :4])]))
    with pytest.raises(InputError, match="2 elements of type tetra beside hexahedra"):
        HexahedralTiling(path=tmp_path / "mixed.vtu").run(context, RECIPE)
    bad = saved(tmp_path / "bad.vtu", (points, np.concatenate([cells, cells[2:3]])))
    with pytest.raises(InputError, match=r"bad.vtu: hexahedra 2 and 5 have the same nodes"):
        ReadHexahedra(path=bad).run(context)


def test_another_order_of_nodes_is_taken_with_a_word(tmp_path):
    path = saved(tmp_path / "five.vtu", star(5, EDGE, layers=1), [4, 5, 6, 7, 0, 1, 2, 3])
    context = PlainContext()
    assert ReadHexahedra(path=path, unit="cm").run(context).summary()["volume_mm3"] == pytest.approx(
        5 * EDGE**3 * np.sin(2 * np.pi / 5) * 1000
    )
    assert any("upper four nodes first" in warning for warning in context.warnings)


def test_no_spacing_is_wider_than_what_is_searched():
    """In a hexahedron that is much larger at one corner sizes exceed twice that of a cube with its volume."""
    nodes = [[-1.8, 1.7, 1.3], [1.4, -0.7, -0.1], [0.2, 2.1, 1.0], [-0.4, 0.6, 0.9],
             [2.4, -1.0, -1.9], [3.6, 2.3, 1.7], [2.0, 2.9, -1.1], [-1.1, 0.0, 2.7]]  # fmt: skip
    cells = HexahedralCells(np.array(nodes).reshape(1, 2, 2, 2, 3))
    around = Surroundings(cells, None)
    t = np.linspace(0, 1, 9)
    within = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
    sizes = around.size_at(cells.points(np.zeros(len(within), int), within))
    assert sizes.max() > 2 * around.edges[0]
    assert sizes.max() <= around.largest_edges[0] * (1 + 1e-9)
    assert Surroundings(cells, 2.5).largest_edges.tolist() == [2.5]
    cube = HexahedralCells(cells.corners * 0 + 2.0 * np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), -1))
    np.testing.assert_allclose(Surroundings(cube, None).largest_edges, 2.0)
