"""`field.walls` in a cell, in tile sets, scattered, tuned, extracted and homogenized."""

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.printing.stages.check_sizes import CheckSizes
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.features.surface.numerics.meshcheck.self_intersections import self_intersections
from sppm_pipeline.features.surface.stages.extract_manifold_sdf import ManifoldSdf
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.features.walls.stages.field_walls import WallsField
from sppm_pipeline.method.connectivity.components import phase_report
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.connect_mst import MinimumSpanningTree
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_free_faces import FreeFacesTiling
from sppm_pipeline.method.stages.tile_scattered import ScatteredTiling
from sppm_pipeline.method.stages.tile_wang_3color import WangTiling
from sppm_pipeline.method.stages.tileset_free_faces import FreeFacesTileSet
from sppm_pipeline.method.stages.tileset_wang_3color import WangTileSet
from sppm_pipeline.method.stages.tune_porosity import TunePorosity
from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.services.mesh.adjacency import adjacency
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.mesh.measures import measure_surface
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

LATTICE = np.array([[x, y, z] for x in (0.25, 0.75) for y in (0.25, 0.75) for z in (0.25, 0.75)])


def made(graph, **options):
    stage = WallsField(**options)
    stage.check_options()
    context = PlainContext(1)
    field = stage.run(context, graph)
    field.check()
    return field, context.reported


def lattice(cell=None, edges=((0, 4), (4, 6), (6, 2), (0, 1), (1, 3), (3, 7), (7, 5))):
    pores = PoreSet(cell or Cell(), LATTICE, np.zeros(8, np.int32))
    return TunnelGraph(pores, np.array(edges).reshape(-1, 2), np.zeros((len(edges), 3), int))


def recipe(**field):
    return recipe_of(
        MirroredFaces(count=9, spacing=Length(0.2)),
        DartThrowing(count=20, spacing=Length(0.2)),
        BoundedDegreeSubgraph(degree=(2, 4), mode="greedy"),
        WallsField(**field),
    )


@pytest.fixture(scope="module")
def tuned():
    context = PlainContext(3)
    return TunePorosity(target=0.7, resolution=40, tolerance=0.003).run(context, recipe()), context.reported


def test_pores_on_a_lattice_have_flat_walls_of_the_given_thickness():
    """Walls in three pairs of planes, without a tunnel: the exact volume, and the field is the distance from them."""
    field, told = made(lattice(edges=((0, 1),)), thickness=Length(0.1), tunnel_radius=Length(1e-5), rounding=Length(0))
    n = 40
    x = (np.arange(n) + 0.5) / n
    to_wall = 0.25 - np.abs(x % 0.5 - 0.25)
    expected = np.minimum.reduce(np.meshgrid(to_wall, to_wall, to_wall, indexing="ij")) - 0.05
    values = field.sample(cell_centers(n))
    assert (np.abs(values - expected) < 1e-6).mean() > 0.998  # but for the neighborhood of tunnels as thin as threads
    assert (values < 0).mean() == pytest.approx(1 - 0.8**3)
    assert told["thickness"] == pytest.approx(0.1)
    assert told["mean_pore_distance"] == pytest.approx(0.5)
    assert told["missed"] == 6  # pores without a tunnel


def test_tunnels_pierce_walls():
    """One opening of the given radius in a wall, which no thickness closes."""
    for thickness in (0.05, 0.3):
        field, _ = made(lattice(), thickness=Length(thickness), tunnel_radius=Length(0.06), rounding=Length(0))
        y = np.linspace(0.15, 0.35, 201)
        plane = field.sample(Grid((0.5, 0.15, 0.25), (0.01, 0.001, 0.01), (1, 201, 1))).ravel()
        np.testing.assert_array_equal(plane > 1e-6, np.abs(y - 0.25) < 0.06 - 1e-6)
    assert field.finest_radius == pytest.approx(0.06)
    assert field.thinnest_wall == pytest.approx(0.3)


def test_lengths_in_all_units():
    plain, _ = made(lattice(), thickness=Length(0.06), tunnel_radius=Length(0.07), rounding=Length(0.03))
    expected = plain.sample(cell_centers(12))
    for cell, unit, scale in (
        (Cell(2.0), "cell", 1),
        (Cell(7.5, True), None, 1),
        (Cell(7.5, True), "mm", 7.5),
        (Cell(7.5, True), "um", 7500),
    ):
        sizes = {"thickness": 0.06, "tunnel_radius": 0.07, "rounding": 0.03}
        field, _ = made(lattice(cell), **{name: Length(scale * size, unit) for name, size in sizes.items()})
        np.testing.assert_allclose(field.sample(cell_centers(12)), expected, atol=1e-6)


def test_defaults_follow_the_mean_distance_of_pores():
    _, told = made(lattice())
    assert (told["thickness"], told["tunnel_radius"], told["rounding"]) == pytest.approx((0.05, 0.05, 0.035))


def test_tunnels_may_vary():
    field, told = made(lattice(), tunnel_spread=0.3)
    radii = 1 / field.pieces.kernels.mu
    assert len(np.unique(radii)) == len(radii)
    assert field.finest_radius == pytest.approx(radii.min()) == pytest.approx(told["thinnest_tunnel"])


def test_pores_without_a_tunnel_get_one():
    field, told = made(lattice(edges=((0, 4),)))
    assert told["missed"] == 6
    assert (np.bincount(field.graph.edges.ravel(), minlength=8) > 0).all()
    lone = PoreSet(Cell(), np.array([[0.5, 0.5, 0.5]]), np.zeros(1, np.int32))
    field, told = made(TunnelGraph(lone, np.zeros((0, 2), int), np.zeros((0, 3), int)))
    assert told["missed"] == 1
    assert field.graph.shift.tolist() == [[1, 0, 0]]
    assert phase_report((field.sample(24) >= 0).astype(np.uint8)).components == 1


def test_a_cell_that_its_walls_close_is_told():
    """A tree leads to the next cell through pores on faces only; loops may lead around the torus."""

    def warned(*stages):
        context = PlainContext(2)
        recipe_of(*stages, WallsField()).run(context)
        return [text for text in context.warnings if "from cell to cell" in text]

    inside = DartThrowing(count=30, spacing=Length(0.2))
    assert "along x, y, z:" in warned(inside, MinimumSpanningTree())[0]
    assert not warned(MirroredFaces(count=9, spacing=Length(0.2)), inside, MinimumSpanningTree())
    assert not warned(inside, BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"))
    assert "along y, z:" in " ".join(_closed_by_walls(((0, 4), (4, 0)), ((0, 0, 0), (1, 0, 0))))


def _closed_by_walls(edges, shifts):
    pores = PoreSet(Cell(), LATTICE, np.zeros(8, np.int32))
    context = PlainContext(1)
    WallsField().run(context, TunnelGraph(pores, np.array(edges), np.array(shifts)))
    return context.warnings


def test_no_pores_and_huge_lengths_are_refused():
    none = PoreSet(Cell(), np.zeros((0, 3)), np.zeros(0, np.int32))
    with pytest.raises(DesignError, match="no pores"):
        made(TunnelGraph(none, np.zeros((0, 2), int), np.zeros((0, 3), int)))
    with pytest.raises(ConfigError, match="thickness"):
        made(lattice(), thickness=Length(5.0))


def test_the_thickness_gives_a_porosity_exactly_and_leaves_tunnels_alone(tuned):
    field, told = tuned
    assert abs(told["porosity_error"]) < 0.003
    before = recipe().run(PlainContext(3), attempt=0)
    thin, thick = field.with_level(0.01), field.with_level(0.04)
    a, b = (f.sample(32) >= 0 for f in (thin, thick))
    assert a[b].all()
    assert a.sum() > b.sum()
    assert field.finest_radius == pytest.approx(before.finest_radius)


def test_void_and_solid_are_in_one_piece(tuned):
    field, _ = tuned
    void = (field.sample(64) >= 0).astype(np.uint8)
    assert phase_report(void).components == 1
    solid = phase_report(1 - void)
    assert solid.removed_share < 1e-3
    assert all(solid.wraps)


def test_the_field_repeats(tuned):
    values = tuned[0].sample(Grid((-0.3, 0.2, 0.9), (0.05, 0.05, 0.05), (40, 21, 21)))
    np.testing.assert_array_equal(values[:20], values[20:])
    np.testing.assert_array_equal(values[:, :, 0], values[:, :, 20])


@pytest.mark.parametrize("rounding", [0.0, 0.04])
def test_tiles_fit_together(rounding):
    """No jump at the faces of cells, whatever lies beside whatever: the field is as steep there as elsewhere."""
    cells = recipe(rounding=Length(rounding))
    free = FreeFacesTileSet(colors=2, interiors=3, porosity=0.6, resolution=16, tolerance=0.02)
    tiles = free.run(PlainContext(6), cells)
    tiling = FreeFacesTiling(cells=(2, 2, 2), cell=Length(4, "mm")).run(PlainContext(7), tiles, None)
    h = 1e-3
    values = tiling.sample(Grid((1 - 5.5 * h, 0.1, 0.1), (h, 0.05, 0.05), (12, 36, 36)))
    # soft minima jump where the nearest pore changes, that is deep in the solid
    steep = np.abs(np.diff(values, axis=0)) > 1.02 * h
    deep = np.maximum(values[1:], values[:-1]) < -0.5 * tiles.micro.level
    assert not (steep & ~deep).any()
    assert rounding or not steep.any()
    assert (values < 0).any()
    assert (values > 0).any()


def test_wang_tiles_and_layers():
    tiles = WangTileSet(colors=2, porosity=0.6, resolution=16, tolerance=0.02).run(PlainContext(4), recipe())
    assert np.mean(tiles.porosity) == pytest.approx(0.6, abs=0.01)
    tiling = WangTiling(cells=(2, 2, 1), cell=Length(4, "mm")).run(PlainContext(5), tiles, None)
    grid = cell_centers(20, tiling.cells)
    whole = tiling.solid(grid)
    np.testing.assert_array_equal(whole, tiling.sample(grid) < 0)
    for height in (1, 7):
        parts = [tiling.solid_layers(grid, k, min(20, k + height), 2) for k in range(0, 20, height)]
        assert np.concatenate(parts, axis=2).tobytes() == whole.tobytes()


def test_scattered_cells():
    scattered = ScatteredTiling(cells=(2, 2, 2), cell=Length(4, "mm"), periodic=True, porosity=0.6, resolution=24)
    tiling = scattered.run(PlainContext(8), recipe(tunnel_radius=Length(0.065)), None)
    void = tiling.sample(24) >= 0
    assert void.mean() == pytest.approx(0.6, abs=0.01)
    assert phase_report(void.astype(np.uint8)).removed_share < 1e-3


@pytest.mark.parametrize("extractor", [MarchingCubes(resolution=20), ManifoldSdf(resolution=20)], ids=lambda e: e.name)
def test_meshes_are_closed_and_sound(tuned, extractor):
    """Walls as thick as two cubes of the lattice; manifold3d leaves a few crossings where solid touches the box."""
    field = tuned[0].with_level(0.05)
    mesh = extractor.run(PlainContext(1), field)
    found = measure_surface(mesh.vertices, mesh.faces)
    assert found.edges.closed
    assert adjacency(mesh.faces).non_manifold_vertices == 0
    allowed = 5e-4 * len(mesh.faces) if extractor.name == "extract.manifold_sdf" else 0
    assert self_intersections(box_tree(mesh.vertices[mesh.faces])).pairs <= allowed
    assert found.volume == pytest.approx((field.sample(cell_centers(40)) < 0).mean(), rel=0.06)


def test_the_solid_carries(tuned):
    field, _ = tuned
    report = HomogenizeVoxel(resolution=24).run(PlainContext(1), field)
    young = report.summary()["isotropic"]["E"]
    density = 1 - report.summary()["porosity"]
    # far above structures that bend, below the bound of Hashin and Shtrikman, near density / (2 - density)
    assert 1.2 * density**2 < young < density / (2 - density)


def test_coarse_grids_are_warned_about(tuned):
    field = tuned[0]
    assert "walls" in field.coarseness(field.thinnest_wall * 1.2)
    assert field.coarseness(field.thinnest_wall / 2) is None


def test_sizes_of_the_design_are_told(tuned):
    context = PlainContext(1)
    CheckSizes(resolution=24).run(context, tuned[0])
    assert context.reported["thinnest_wall"] == pytest.approx(2 * tuned[0].level)
    assert context.reported["narrowest_tunnel"] == pytest.approx(2 * tuned[0].finest_radius)
    with pytest.raises(ConfigError, match="no physical size"):
        CheckSizes(resolution=24, printable=Length(0.1, "mm")).run(context, tuned[0])
    field, _ = made(lattice(Cell(4.0, True)), thickness=Length(0.2, "mm"), tunnel_radius=Length(0.15, "mm"))
    context = PlainContext(1)
    CheckSizes(resolution=24, printable=Length(0.25, "mm")).run(context, field)
    assert [text for text in context.warnings if "thinnest wall measures 0.2 mm" in text]
    assert not [text for text in context.warnings if "tunnel" in text]
    context = PlainContext(1)
    CheckSizes(resolution=24, printable=Length(0.35, "mm")).run(context, field)
    assert [text for text in context.warnings if "narrowest tunnel measures 0.3 mm" in text]


@pytest.mark.parametrize("struts", [0.4, 1.0])
def test_struts_are_the_weighted_mean_of_walls_and_kernels(struts):
    from sppm_pipeline.features.walls.stages.field_walls import KERNEL

    pores = PoreSet.from_array(np.random.default_rng(2).random((20, 3)))
    graph = TunnelGraph.from_arrays(pores, np.array([[0, 1]]))
    field, _ = made(graph, struts=struts, rounding=Length(0.0), tunnel_radius=Length(1e-3))
    length, rng = 20 ** (-1 / 3), np.random.default_rng(3)
    shifts = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), -1).reshape(-1, 3)
    images = (pores.centers[:, None] + shifts).reshape(-1, 3)
    for place in rng.random((30, 3)):
        squared = ((images - place) ** 2).sum(1)
        first = squared.argmin()
        apart = 2 * np.linalg.norm(images - images[first], axis=1)
        others = np.arange(len(images)) != first
        wall = ((squared - squared[first])[others] / apart[others]).min()
        nearest = np.sqrt(max(-np.log(np.exp(-KERNEL / length**2 * squared).sum()), 0) * length**2 / KERNEL)
        expected = (1 - struts) * wall + struts * (length - nearest) - field.level
        value = field.sample(Grid(tuple(place), (1.0,) * 3, (1, 1, 1)))[0, 0, 0]
        # far from tunnels and deep in the solid the field stays at the depth that is kept of tunnels
        assert value == pytest.approx(max(expected, -0.2 * length), abs=2e-4)


def test_the_share_of_struts_makes_softer_structures_of_one_density():
    found = []
    for share in (0.0, 0.5, 1.0):
        field = TunePorosity(target=0.65, resolution=32, tolerance=0.01).run(PlainContext(3), recipe(struts=share))
        assert (field.thinnest_wall is None) == (share > 0)
        found.append(HomogenizeVoxel(resolution=24).run(PlainContext(0), field).summary()["isotropic"]["E"])
    assert found[0] > 1.05 * found[1] > 1.2 * found[2]


def test_struts_fit_together_across_scattered_cells():
    tiling = ScatteredTiling(cells=(2, 2, 2), periodic=True, porosity=0.7).run(
        PlainContext(4), recipe_of(DartThrowing(total=30), MinimumSpanningTree(), WallsField(struts=0.5)), None
    )
    whole = tiling.sample(Grid((0.0, 0.0, 0.0), (0.05,) * 3, (40, 40, 40)))
    moved = tiling.sample(Grid((2.0, -2.0, 0.5), (0.05,) * 3, (40, 40, 10)))
    assert moved == pytest.approx(whole[:, :, 10:20], abs=1e-5)
    assert (whole < 0).mean() == pytest.approx(0.3, abs=0.01)
