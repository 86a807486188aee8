"""Tile sets and rules: colors match, masks are respected, porosity is on target, less and less repeats."""

from dataclasses import replace

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.assembly.contents import check_tiling
from sppm_pipeline.method.assembly.gather import sample_exact
from sppm_pipeline.method.fields.scalar_field import CleanedField, RepeatedField
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.check_residual_periodicity import CheckResidualPeriodicity
from sppm_pipeline.method.stages.sample_elimination import Elimination
from sppm_pipeline.method.stages.slice_field import SliceField
from sppm_pipeline.method.stages.tile_corner_colors import CornerColorsTiling
from sppm_pipeline.method.stages.tile_free_faces import FreeFacesTiling
from sppm_pipeline.method.stages.tile_fresh import FreshTiling
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.method.stages.tile_wang_3color import WangTiling
from sppm_pipeline.method.stages.tileset_corner_colors import CornerColorsTileSet
from sppm_pipeline.method.stages.tileset_free_faces import FreeFacesTileSet
from sppm_pipeline.method.stages.tileset_wang_3color import WangTileSet
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

HOW = {"porosity": 0.5, "resolution": 16, "tolerance": 0.01}


@pytest.fixture(scope="module")
def sets(wang, recipe):
    return {
        "wang": wang,
        "free": FreeFacesTileSet(colors=2, interiors=10, **HOW).run(PlainContext(1), recipe()),
        "corner": CornerColorsTileSet(colors=2, interiors=10, **HOW).run(PlainContext(1), recipe()),
    }


RULES = {"wang": WangTiling, "free": FreeFacesTiling, "corner": CornerColorsTiling}


@pytest.mark.parametrize("kind", RULES)
def test_sets_have_the_porosity_wished_and_tell_that_of_every_tile(sets, kind):
    made = sets[kind]
    assert len(made.porosity) == made.micro.interiors == {"wang": 8, "free": 10, "corner": 10}[kind]
    assert made.summary()["porosity"] == pytest.approx(0.5, abs=0.02)
    assert made.summary()["tile_porosity_min"] < 0.5 < made.summary()["tile_porosity_max"]
    tiling = RULES[kind](cells=(6, 6, 6)).run(PlainContext(9), made, None)
    assert 1 - tiling.solid(cell_centers(12, tiling.cells)).mean() == pytest.approx(0.5, abs=0.005)


@pytest.mark.parametrize("kind", [*RULES, "periodic"])
def test_boxes_and_parts_have_the_porosity_of_the_set(sets, kind, ball):
    """A small box holds some tiles more often than others, and a part only pieces of them."""
    rule, tileset = RULES.get(kind, PeriodicTiling), sets.get(kind, sets["wang"])
    box = rule(cells=(3, 3, 3)).run(PlainContext(2), tileset, None)
    assert 1 - box.solid(cell_centers(67, box.cells)).mean() == pytest.approx(0.5, abs=1e-3)
    other = rule(cells=(2, 2, 2), porosity=0.3).run(PlainContext(2), tileset, None)
    assert 1 - other.solid(cell_centers(67, other.cells)).mean() == pytest.approx(0.3, abs=1e-3)
    part = Part(rule(cell=Length(4, "mm")).run(PlainContext(2), tileset, ball), ball, islands="keep")
    grid = SliceField(pixel=Length(0.09, "mm")).run(PlainContext(), part).samples
    inside = part.inside_zyx(grid, 0, grid.shape[2])
    assert 1 - part.solid_zyx(grid, 0, grid.shape[2]).sum() / inside.sum() == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("cells", [(12, 12, 12), (40, 40, 1), (3, 3, 200)])
def test_many_cells_of_few_tiles_have_their_porosity(recipe, cells):
    """Few samples a cell see nothing of a tile but their places in it, if these are the same in all cells."""
    tiles = WangTileSet(colors=2, porosity=0.6, resolution=24).run(PlainContext(3), recipe())
    laid = WangTiling(cells=cells, cell=Length(5.0)).run(PlainContext(4), tiles, None)
    n = 25
    grid = Grid((0.5 / n,) * 3, (1 / n,) * 3, tuple(n * count for count in cells))
    layers = range(0, grid.shape[2], 1 if cells[2] == 1 else 7)  # seven visits all places of 25
    assert np.mean([1 - laid.solid_zyx(grid, k, k + 1).mean() for k in layers]) == pytest.approx(0.6, abs=0.0015)


def test_a_repeated_field_has_no_porosity_of_its_own(recipe):
    cleaned = CheckConnectivity(resolution=16, islands="remove").run(
        PlainContext(), recipe().run(PlainContext(5)).with_level(0.02)
    )
    with pytest.raises(ConfigError, match="is that of its cell"):
        PeriodicTiling(cells=(2, 2, 2), porosity=0.5).run(PlainContext(), cleaned, None)


def test_tiles_of_the_paper_are_measured_alone(wang):
    grid = cell_centers(24)
    for t in (0, 3, 7):
        alone = wang.micro.alone(t, (t // 4, t // 2 % 2, t % 2)).solid(grid)
        assert wang.porosity[t] == pytest.approx(1 - alone.mean(), abs=0.001)
    assert np.mean(wang.porosity) == pytest.approx(0.5, abs=0.001)


def test_without_a_wish_the_recipe_s_level_stays(recipe):
    assert WangTileSet(colors=1, resolution=8).run(PlainContext(1), recipe(level=0.31)).micro.level == 0.31


@pytest.mark.parametrize(
    "stage",
    [
        WangTileSet(colors=2, resolution=8),
        FreeFacesTileSet(colors=1, interiors=3, resolution=8),
        CornerColorsTileSet(colors=2, interiors=3, resolution=8),
        FreshTiling(cells=(2, 1, 1)),
    ],
)
def test_interiors_without_faces_do_not_fit_together(stage):
    from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
    from sppm_pipeline.method.stages.field_gaussian import GaussianField

    bare = recipe_of(
        Elimination(count=8),
        BoundedDegreeSubgraph(mode="greedy"),
        GaussianField(pore_radius=Length(0.1), tunnel_radius=Length(0.03)),
    )
    arguments = (None,) if isinstance(stage, FreshTiling) else ()
    with pytest.raises(DesignError, match=r"makes \[0, 0, 0\] face patterns"):
        stage.run(PlainContext(1), bare, *arguments)


def test_a_tolerance_out_of_reach(recipe):
    with pytest.raises(DesignError, match="finer grid"):
        WangTileSet(colors=1, porosity=0.5, resolution=8, tolerance=1e-9).run(PlainContext(1), recipe())
    with pytest.raises(ConfigError, match="Microstructure"):
        WangTileSet(colors=1).run(PlainContext(1), recipe_of(Elimination(count=3)))


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("shape", [None, (5, 2, 3), (1, 1, 1)])
def test_every_rule_on_boxes_and_masks(sets, kind, shape, ball):
    tileset, rule = sets[kind], RULES[kind]
    stage = rule(cells=shape) if shape else rule(cell=Length(1.7, "mm"))
    tiling = stage.run(PlainContext(2), tileset, ball)
    check_tiling(tiling.arrays, tileset.micro.pieces)
    interior, faces, periodic, halo = tiling.arrays.surrounded()
    assert not periodic
    assert not halo
    filled = interior >= 0
    laid = np.pad(tiling.arrays.interior, 1, constant_values=-1)
    around = np.argwhere(np.ones((3, 3, 3), bool))
    assert tiling.arrays.halo == 1
    for place in np.ndindex(*filled.shape):
        neighbors = laid[tuple((np.array(place) + 1 + around).T)]
        assert filled[place] == (neighbors >= 0).all()
        assert interior[place] == (neighbors[13] if filled[place] else -1)
    if shape:
        assert interior.shape == shape
        assert filled.all()
    else:
        assert 0 < filled.sum() < filled.size
        assert tiling.edge_mm == 1.7
        # every sample of the ball lies in a cell that is filled
        points = np.random.default_rng(0).normal(size=(4000, 3))
        points *= (4.9 * np.random.default_rng(1).random((4000, 1)) ** (1 / 3)) / np.linalg.norm(points, axis=1)[
            :, None
        ]
        place = np.floor((points + 5 - np.array(tiling.origin_mm)) / 1.7).astype(int)
        assert filled[tuple(place.T)].all()
    for axis in range(3):
        low = np.zeros_like(faces[axis], bool)
        cut = [slice(None)] * 3
        for side in (slice(None, -1), slice(1, None)):
            cut[axis] = side
            low[tuple(cut)] |= filled
        assert np.array_equal(faces[axis] >= 0, low)
    allowed = tileset.combinations()
    if allowed is not None:
        rows = {tuple(row) for row in allowed.tolist()}
        for x, y, z in np.argwhere(filled):
            sides = [faces[0][x, y, z], faces[0][x + 1, y, z], faces[1][x, y, z], faces[1][x, y + 1, z],
                     faces[2][x, y, z], faces[2][x, y, z + 1]]  # fmt: skip
            assert (interior[x, y, z], *sides) in rows


def test_a_cover_is_centerd_and_sized(wang, wedge):
    tiling = WangTiling(cell=Length(0.2, "cm")).run(PlainContext(2), wang, wedge)
    middle = np.array(tiling.origin_mm) + np.array(tiling.cells) * 2.0 / 2
    assert np.allclose(middle, (wedge.lower + wedge.upper) / 2)
    assert (np.array(tiling.cells) == np.ceil((wedge.upper - wedge.lower) / 2)).all()


def test_what_is_missing_or_does_not_fit(sets, cell, wedge):
    with pytest.raises(ConfigError, match="no part to cover"):
        WangTiling(cell=Length(2, "mm")).run(PlainContext(), sets["wang"], None)
    with pytest.raises(ConfigError, match="size of a cell"):
        WangTiling().run(PlainContext(), sets["wang"], wedge)
    for rule in RULES:
        for kind in RULES:
            if rule != kind:
                with pytest.raises(ConfigError, match="kind"):
                    RULES[rule](cells=(2, 2, 2)).run(PlainContext(), sets[kind], None)
    with pytest.raises(ConfigError, match="periodic cells"):
        PeriodicTiling(cells=(2, 2, 2)).run(PlainContext(), sets["free"], None)
    with pytest.raises(ConfigError, match="no tile 8"):
        PeriodicTiling(cells=(2, 2, 2), tile=8).run(PlainContext(), sets["wang"], None)


def test_cleaned_cells_can_be_repeated(cell, ball):
    clean = CheckConnectivity(resolution=24).run(PlainContext(), cell.with_level(0.03))
    assert isinstance(clean, CleanedField)
    laid = PeriodicTiling(cell=Length(2.5, "mm")).run(PlainContext(), clean, ball)
    assert isinstance(laid, RepeatedField)
    assert laid.cells == (4, 4, 4)
    values = laid.sample(cell_centers(6, laid.cells))
    assert np.array_equal(values[:6, :6, :6], values[6:12, 12:18, 18:24])
    with pytest.raises(ConfigError, match="does not repeat"):
        PeriodicTiling(cells=(2, 2, 2)).run(PlainContext(), laid_once(cell), None)


def laid_once(cell):
    """A tiling that does not repeat."""
    from sppm_pipeline.method.fields.tileset import TileSet

    return WangTiling(cells=(2, 1, 1)).run(PlainContext(), TileSet(cell, "wang", 1), None)


@pytest.mark.parametrize("cells", [(2, 3, 4), (4, 3, 2), (1, 1, 1), None])
def test_fresh_cells_meet_at_their_faces_and_nothing_is_used_twice(recipe, cells, ball):
    stage = FreshTiling(cells=cells, cell=Length(3.4, "mm"), porosity=0.5, resolution=16)
    tiling = stage.run(PlainContext(3), recipe(), ball)
    interior, faces, *_ = tiling.arrays
    check_tiling(tiling.arrays, tiling.tileset.micro.pieces)
    for numbers in (interior, *faces):
        used = numbers[numbers >= 0]
        assert len(set(used.tolist())) == len(used)
    grid = Grid((0.01, 0.02, 0.03), (0.33, 0.29, 0.27), (13, 11, 9))
    exact = sample_exact(tiling.tileset.micro.pieces, tiling.arrays, grid, 1e-9) - np.float32(
        tiling.tileset.micro.level
    )
    assert np.abs(tiling.sample(grid) - exact).max() < 1e-3
    nodes = Grid((0.0,) * 3, (1 / 8,) * 3, tuple(8 * n + 1 for n in tiling.cells))
    assert np.isfinite(tiling.sample(nodes)).all()
    if cells == (2, 3, 4):
        assert 1 - tiling.solid(cell_centers(10, cells)).mean() == pytest.approx(0.5, abs=0.02)


def test_fresh_cells_are_bounded_in_number(recipe):
    with pytest.raises(DesignError, match="1728 cells, with those around it"):
        FreshTiling(cells=(10, 10, 10), limit=999).run(PlainContext(), recipe(), None)
    with pytest.raises(ConfigError, match="Microstructure"):
        FreshTiling(cells=(1, 1, 1)).run(PlainContext(), recipe_of(Elimination(count=3)), None)


def test_less_and_less_repeats(sets, recipe):
    cells = (5, 5, 5)

    def bragg(tiling):
        context = PlainContext()
        CheckResidualPeriodicity(resolution=10).run(context, tiling)
        return context.reported["bragg_share"]

    repeated = bragg(PeriodicTiling(cells=cells).run(PlainContext(1), sets["wang"], None))
    wang, free, corner = (bragg(RULES[k](cells=cells).run(PlainContext(1), sets[k], None)) for k in RULES)
    fresh = bragg(FreshTiling(cells=cells).run(PlainContext(1), recipe(), None))
    assert repeated == pytest.approx(1, abs=1e-3)
    assert repeated > wang > max(free, corner)
    assert min(free, corner) > fresh


def test_the_27_tiles_show_no_bars_along_the_edges_of_cells():
    """At porosity .70 corners and edges are solid as often as anything else; with the paper's faces almost always."""
    from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
    from sppm_pipeline.method.stages.field_gaussian import GaussianField
    from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
    from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces

    def folded(seed, way):
        cell = recipe_of(
            MirroredFaces(total=68, share=0.6, faces_margin=way),
            DartThrowing(total=68),
            BoundedDegreeSubgraph(mode="greedy"),
            GaussianField(pore_radius=Length(0.11), tunnel_radius=Length(0.03)),
        )
        made = WangTileSet(porosity=0.7, resolution=16, tolerance=0.02).run(PlainContext(seed), cell)
        context = PlainContext()
        tiling = WangTiling(cells=(6, 6, 6), periodic=True).run(PlainContext(seed), made, None)
        CheckResidualPeriodicity(resolution=16).run(context, tiling)
        box = WangTiling(cells=(3, 3, 3)).run(PlainContext(seed), made, None)
        solid = box.solid(cell_centers(16, (3, 3, 3)))
        # the far edges of a box, whose pores belong to faces beyond it
        far = [solid[-1:, -1:].mean(), solid[-1:, :, -1:].mean(), solid[:, -1:, -1:].mean()]
        return [*(context.reported[f"folded_{place}"] for place in ("corner", "edge", "face", "center")), np.mean(far)]

    paper = folded(1, "paper")
    assert min(paper[:2]) > 0.5
    level = np.mean([folded(seed, "homogeneous") for seed in range(5)], axis=0)
    assert np.abs(level[:4] - 0.3).max() < 0.1
    assert level[4] < 0.5


def assembled_graph(tiling):
    """Pores of a periodic tiling as (site, pore), and its tunnels: those of every cell, and of every face once."""
    graph, arrays = tiling.tileset.micro.graph, tiling.arrays
    pores, (shape, n) = graph.pores, (arrays.shape, len(graph.pores.centers))
    first, second = graph.edges.T
    a, b = pores.piece[first], pores.piece[second]
    axis_of, present, tunnels = pores.axis_of_piece(), [], []
    for site in np.ndindex(*shape):
        here = np.ravel_multi_index(site, shape) * n
        pieces = [arrays.interior[site]] + [pores.face_piece(x, arrays.faces[x][site]) for x in range(3)]
        present.append(here + np.flatnonzero(np.isin(pores.piece, pieces)))
        own = (a == b) & np.isin(a, pieces)
        tunnels.append(here + graph.edges[own])
        for axis, side in np.ndindex(3, 2):
            beside = tuple(c + side * (axis == x) for x, c in enumerate(site))
            face = pores.face_piece(axis, arrays.faces[axis][beside])
            there = np.ravel_multi_index(beside, shape, mode="wrap") * n
            crossing = (a == pieces[0]) & (b == face) & (graph.shift[:, axis] == side) & (axis_of[b] == axis) & (a != b)
            assert crossing.any()
            tunnels.append(np.stack([here + first[crossing], there + second[crossing]], 1))
    return np.concatenate(present), np.concatenate(tunnels)


@pytest.mark.parametrize("rule", RULES)
def test_all_pores_of_an_assembly_are_joined(rule, sets):
    """Those of edges and corners, too, whose owner is one of the faces that meet there."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    assert len(sets[rule].micro.graph.pores.around_edges())
    for seed in range(3):
        tiling = RULES[rule](cells=(3, 2, 3), periodic=True).run(PlainContext(seed), sets[rule], None)
        present, tunnels = assembled_graph(tiling)
        assert len(set(present.tolist())) == len(present)
        assert set(tunnels.ravel().tolist()) == set(present.tolist())
        size = int(present.max()) + 1
        links = coo_array((np.ones(len(tunnels), np.int8), tuple(tunnels.T)), (size, size))
        labels = connected_components(links, directed=False)[1]
        assert len(np.unique(labels[present])) == 1


@pytest.mark.parametrize("rule", RULES)
def test_boxes_that_repeat(rule, sets):
    """Opposite faces of the assembly are the same, and the field goes on beyond them."""
    tiling = RULES[rule](cells=(3, 2, 2), periodic=True).run(PlainContext(4), sets[rule], None)
    assert tiling.periodic
    n = 9
    values = tiling.sample(Grid((0, 0, 0), (1 / n,) * 3, (3 * n + 1, 2 * n + 1, 2 * n + 1)))
    for axis in range(3):
        assert np.array_equal(np.take(values, 0, axis), np.take(values, -1, axis))
    once = RULES[rule](cells=(3, 2, 2)).run(PlainContext(4), sets[rule], None)
    assert not once.periodic
    with pytest.raises(ConfigError, match="box of cells"):
        RULES[rule](periodic=True).check_options()


WRONG_RULES = {
    "99 where there are 8": (lambda interior, faces: (np.full_like(interior, 99), faces), "interior 99, of 8"),
    "turned": (lambda interior, faces: (interior.T, faces), r"shape of `mask`, \(4, 5, 6\), .* got \(6, 5, 4\)"),
    "faces turned": (lambda interior, faces: (interior, faces[::-1]), "faces of axis 0 have the shape"),
    "halves": (lambda interior, faces: (interior + 0.5, faces), "whole numbers"),
    "one face short": (lambda interior, faces: (interior, faces[:2]), "must return"),
    "not filled": (lambda interior, faces: (np.full_like(interior, -1), faces), r"cell \(0, 0, 0\) is -1"),
    "below -1": (lambda interior, faces: (interior, (faces[0] - 3, *faces[1:])), "-1 where there is none"),
    "of other colors": (lambda interior, faces: (7 - interior, faces), "which meets color"),
}


@pytest.mark.parametrize("how", WRONG_RULES)
def test_a_rule_that_lays_nonsense_is_told_what_was_expected(wang, how):
    spoil, said = WRONG_RULES[how]

    class Spoiled(WangTiling):
        def lay(self, rng, mask, tileset):
            return spoil(*super().lay(rng, mask, tileset))

    with pytest.raises(ValueError, match=said):
        Spoiled(cells=(2, 3, 4)).run(PlainContext(1), wang, None).check()


def test_a_cell_without_a_face_is_found(sets):
    tiling = FreeFacesTiling(cells=(2, 2, 2)).run(PlainContext(1), sets["free"], None)
    faces = [colors.copy() for colors in tiling.arrays.faces]
    faces[1][1, 4, 0] = -1
    with pytest.raises(ValueError, match=r"cell \(1, 3, 0\) has interior \d, but its high face of axis 1 has no color"):
        replace(tiling, arrays=tiling.arrays._replace(faces=tuple(faces))).check()
