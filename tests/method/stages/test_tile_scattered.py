"""Scattered pores: quotas, spacing and one graph across blocks, one field, one void, the same bytes on any way."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.browser.live.structures import _tiles
from sppm_pipeline.features.grading.laws import FormulaLaw, TableLaw
from sppm_pipeline.features.grading.local_porosity import LatticeCells
from sppm_pipeline.features.grading.stages.tile_graded import GradedTiling
from sppm_pipeline.features.grading.stages.warp_cylinder import WarpCylinder
from sppm_pipeline.features.surface.stages.extract_unit_cell import UnitCell
from sppm_pipeline.method.connectivity.components import phase_report
from sppm_pipeline.method.families.sampler import Sampler, start_of
from sppm_pipeline.method.families.tiler import MEASURED_CLOSELY, boxes_of, measured_per_edge
from sppm_pipeline.method.kernels.kernels import concatenated
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.sampling.blocks import block_quotas, spacing_at_share
from sppm_pipeline.method.stages.check_residual_periodicity import CheckResidualPeriodicity
from sppm_pipeline.method.stages.check_tiling import CheckTiling
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.connect_mst import MinimumSpanningTree
from sppm_pipeline.method.stages.connect_relative_neighbors import RelativeNeighbors
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_elimination import Elimination
from sppm_pipeline.method.stages.sample_hyperuniform import Hyperuniform
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_scattered import ScatteredTiling
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.palette import Blocks, Maps, Palette
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.services.metric import matrices
from sppm_pipeline.stage import option
from sppm_pipeline.testing.exact_sum import exact_sum
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

FIELD = GaussianField(pore_radius=Length(0.14), tunnel_radius=Length(0.07))
TREE = MinimumSpanningTree()


def scattered(*stages, threads=1, seed=1, cover=None, context=None, **options):
    context = context or PlainContext(seed, threads=threads)
    tiling = ScatteredTiling(**options).run(context, recipe_of(*stages), cover)
    tiling.check()
    tiling.tileset.micro.graph.pores.check()
    tiling.tileset.micro.graph.check()
    return tiling


def in_lattice(tiling):
    """Pores in cell sizes from the low corner of the lattice, the halo included."""
    pores = tiling.tileset.micro.graph.pores
    return pores.centers + pores.blocks.sites[pores.piece]


def smallest_distance(tiling):
    period = np.array(tiling.cells, float) if tiling.periodic else None
    points = in_lattice(tiling) % period if tiling.periodic else in_lattice(tiling)
    return cKDTree(points, boxsize=period).query(points, k=2)[0][:, 1].min()


def parts(tiling):
    graph = tiling.tileset.micro.graph
    n, (a, b) = len(graph.pores.centers), graph.edges.T
    return connected_components(coo_array((np.ones(len(a)), (a, b)), (n, n)), directed=False)[0]


@pytest.fixture(scope="module")
def torus(recipe):
    return ScatteredTiling(cells=(3, 2, 4), periodic=True, porosity=0.55, resolution=16).run(
        PlainContext(2), recipe(tunnel_radius=Length(0.07)), None
    )


@pytest.fixture(scope="module")
def box(recipe):
    return ScatteredTiling(cells=(2, 3, 1), cell=Length(4, "mm"), porosity=0.6, resolution=16).run(
        PlainContext(2), recipe(tunnel_radius=Length(0.07)), None
    )


@pytest.fixture(scope="module")
def in_ball(recipe, ball):
    return ScatteredTiling(cell=Length(3.1, "mm")).run(PlainContext(2), recipe(tunnel_radius=Length(0.07)), ball)


@pytest.mark.parametrize("name", ["torus", "box", "in_ball"])
def test_every_block_has_the_pores_of_a_cell_and_all_keep_their_spacing(request, name):
    tiling = request.getfixturevalue(name)
    pores = tiling.tileset.micro.graph.pores
    assert (np.bincount(pores.piece) == 9 + 12).all()  # faces and interior of the recipe
    assert pores.spacing == 0.2
    assert smallest_distance(tiling) >= 0.2


@pytest.mark.parametrize("name", ["torus", "box", "in_ball"])
def test_all_pores_hang_together_by_few_tunnels_each(request, name):
    tiling = request.getfixturevalue(name)
    graph = tiling.tileset.micro.graph
    assert parts(tiling) == 1
    degrees = np.bincount(graph.edges.ravel(), minlength=len(graph.pores.centers))
    assert degrees.min() >= 1
    assert degrees.mean() == pytest.approx(2.2, abs=0.3)
    first, second = graph.pores.piece[graph.edges].T
    across = first != second
    assert 0.2 < across.mean() < 0.8
    start, end = graph.segments()
    assert np.linalg.norm(end - start, axis=1).max() < 1.0


@pytest.mark.parametrize("periodic", [True, False])
def test_degrees_hold_across_blocks(periodic):
    for connector in (BoundedDegreeSubgraph(mode="greedy"), RelativeNeighbors()):
        context = PlainContext(4)
        tiling = scattered(
            DartThrowing(total=50), connector, FIELD, cells=(3, 3, 2), periodic=periodic, context=context
        )
        graph = tiling.tileset.micro.graph
        degrees = np.bincount(graph.edges.ravel(), minlength=len(graph.pores.centers))
        assert degrees.min() >= 3
        assert parts(tiling) == 1
        told = [values.get("pores_over_degree", 0) for values in context.log.values.values()]
        assert (degrees > 5).sum() == max(told, default=0) <= 0.01 * len(degrees)


def test_totals_and_fractions():
    """`mirrored_faces` leaves its share of a total to the interior; a share of the capacity may give a fraction."""
    for sampler in ({"total": 31}, {"count": 31}, {}):
        faces = [MirroredFaces(total=31, share=0.5)] if sampler else []
        darts = DartThrowing(**sampler) if sampler else DartThrowing(spacing=Length(0.24), share=0.5)
        tiling = scattered(*faces, darts, TREE, FIELD, cells=(3, 3, 3), periodic=True)
        counts = np.bincount(tiling.tileset.micro.graph.pores.piece)
        mean = 31 if sampler else 0.5 * 0.7336 / 0.24**3
        assert set(counts.tolist()) == {int(np.floor(mean)), int(np.ceil(mean))}
        assert counts.mean() == pytest.approx(mean, abs=1 / 27)
        if sampler:
            assert smallest_distance(tiling) >= (0.5 * 0.7336 / 31) ** (1 / 3) - 1e-9


def test_the_field_is_the_sum_of_all_kernels_wherever_they_come_from(torus, box):
    for tiling in (torus, box):
        micro, halo = tiling.tileset.micro, tiling.arrays.halo
        every = concatenated(
            micro.pieces[t].shifted(site - float(halo)) for t, site in enumerate(micro.graph.pores.blocks.sites)
        )
        images = (-1, 0, 1) if tiling.periodic else (0,)
        size = np.array(tiling.cells)
        every = concatenated(every.shifted(size * np.array([x, y, z])) for x in images for y in images for z in images)
        grid = Grid((0.03, 0.02, 0.01), (0.19, 0.23, 0.17), (9, 8, 5))
        x, y, z = np.meshgrid(*(grid.axis(axis) for axis in range(3)), indexing="ij")
        exact = exact_sum(every, np.stack([x, y, z], -1).reshape(-1, 3)) - micro.level
        assert np.abs(tiling.sample(grid).ravel() - exact).max() < 1e-3


def test_the_border_of_a_box_is_like_its_middle(recipe):
    """Pores around the box reach into it: the porosity at its sides is that within, but for noise."""
    tiling = ScatteredTiling(cells=(4, 4, 4), porosity=0.6, resolution=16).run(
        PlainContext(0), recipe(tunnel_radius=Length(0.07)), None
    )
    solid = tiling.solid(cell_centers(12, tiling.cells)).astype(float)
    assert 1 - solid.mean() == pytest.approx(0.6, abs=0.01)
    sides = [solid.take(places, axis).mean() for axis in range(3) for places in ([0, 1], [-2, -1])]
    assert np.mean(sides) == pytest.approx(0.4, abs=0.035)


def test_one_void(torus, box, in_ball, ball):
    """No closed pore: on the torus the void is one component, in a box or part together with the air around it."""
    report = phase_report(torus.solid(cell_centers(24, torus.cells)), (True,) * 3, 6, zeros=True)
    assert report.components == 1
    assert all(report.wraps)
    for field in (box, Part(in_ball, ball)):
        void = field.solid(cell_centers(24, field.cells)) == 0
        assert label(np.pad(void, 1, constant_values=True))[1] == 1


def test_the_porosity_is_that_of_the_part_not_of_its_cells(ball):
    """An ellipsoid, that a transposed one would not do for."""
    squeezed = replace(ball, vertices=ball.vertices * [1.0, 0.8, 0.5])
    tiling = scattered(DartThrowing(total=20), TREE, FIELD, cell=Length(2.5), cover=squeezed, porosity=0.5, seed=2)
    part = Part(tiling, squeezed, 0.0, "keep")
    n, cells = 40, part.cells
    grid = Grid((0.5 / n,) * 3, (1 / n,) * 3, (cells[0] * n, cells[1] * n, cells[2] * n))
    inside = part.inside_zyx(grid, 0, grid.shape[2]) != 0
    assert np.mean(part.sample_zyx(grid, 0, grid.shape[2])[inside] >= 0) == pytest.approx(0.5, abs=2e-3)
    assert abs(np.mean(tiling.sample_zyx(grid, 0, grid.shape[2]) >= 0) - 0.5) > 4e-3


@pytest.mark.parametrize("seed", [2, 3])
def test_the_porosity_of_many_cells_is_measured_in_all_of_them(ball, seed):
    """Cells differ by some per cent, so that some of them would not tell what all have."""
    flat = replace(ball, vertices=ball.vertices * [1.0, 0.8, 0.4])
    tiling = scattered(DartThrowing(total=20), TREE, FIELD, cell=Length(1.0), cover=flat, porosity=0.6, seed=seed)
    part = Part(tiling, flat, 0.0, "keep")
    assert (tiling.arrays.surrounded().interior >= 0).sum() > MEASURED_CLOSELY
    n, cells = 16, part.cells
    grid = Grid((0.5 / n,) * 3, (1 / n,) * 3, (cells[0] * n, cells[1] * n, cells[2] * n))
    inside = part.inside_zyx(grid, 0, grid.shape[2]) != 0
    assert np.mean(part.sample_zyx(grid, 0, grid.shape[2])[inside] >= 0) == pytest.approx(0.6, abs=1.5e-3)


def test_cells_around_nothing_are_measured_without_it():
    """The box of a ring is hollow, and a frame of a plate's size should not take its memory."""
    x, y = np.mgrid[:150, :150]
    away = np.hypot(x - 74.5, y - 74.5)
    for there in ((away > 73) & (away < 75), away < 75, x == y, (x + y) % 7 == 0):
        cells = np.argwhere(there[:, :, None]) + np.array([0, 0, 4])
        for spare in (0, 100):
            held = np.zeros((150, 150, 5), np.int64)
            for corner, shape in boxes_of(cells, spare):
                held[tuple(slice(low, low + n) for low, n in zip(corner, shape, strict=True))] += 1
            assert held.max() == 1
            assert (held[tuple(cells.T)] == 1).all()
            assert held.sum() <= max(2, spare) * len(cells)
        assert len(boxes_of(cells, 100)) <= max(1, len(cells) / 4)
    assert len(boxes_of(np.argwhere((away < 75)[:, :, None]), 0)) == 1


def test_so_many_cells_are_measured_with_fewer_samples_each():
    assert [measured_per_edge(cells, 32) for cells in (1, 127, 128, 1016, 8128, 10**6)] == [32, 32, 31, 16, 8, 6]
    assert [measured_per_edge(cells, 8) for cells in (127, 10**6)] == [8, 6]


@pytest.mark.parametrize("name", ["torus", "box"])
def test_slabs_and_threads_change_no_byte(request, name):
    tiling = request.getfixturevalue(name)
    grid = Grid((-0.2, 0.1, -0.1), (0.071, 0.083, 0.019), (30, 30, 66))
    whole = tiling.solid_layers(grid, 0, 66)
    for height, threads in ((1, 1), (7, 2), (64, 3)):
        slabs = [tiling.solid_layers(grid, z, min(z + height, 66), threads) for z in range(0, 66, height)]
        assert np.concatenate(slabs, axis=2).tobytes() == whole.tobytes()


def test_threads_that_throw_and_join_change_no_byte(recipe, box):
    again = ScatteredTiling(cells=(2, 3, 1), cell=Length(4, "mm"), porosity=0.6, resolution=16).run(
        PlainContext(2, threads=3), recipe(tunnel_radius=Length(0.07)), None
    )
    assert again.digest() == box.digest()


def test_millions_of_tunnels_take_few_bytes_and_make_the_same_field(monkeypatch, recipe, torus):
    monkeypatch.setattr("sppm_pipeline.method.nouns.tunnels.NARROW", 1)
    again = ScatteredTiling(cells=(3, 2, 4), periodic=True, porosity=0.55, resolution=16).run(
        PlainContext(2), recipe(tunnel_radius=Length(0.07)), None
    )
    wide, narrow = torus.tileset.micro, again.tileset.micro
    assert (narrow.graph.edges.dtype, narrow.graph.shift.dtype) == (np.int32, np.int8)
    assert np.array_equal(narrow.graph.edges, wide.graph.edges)
    assert np.array_equal(narrow.graph.shift, wide.graph.shift)
    assert narrow.pieces.kernels.ends.tobytes() == wide.pieces.kernels.ends.tobytes()
    assert narrow.level == wide.level


@pytest.mark.parametrize("sampler", [DartThrowing(total=68), Hyperuniform(total=68)])
def test_no_lattice_shows(sampler):
    """The folded solid share, as `check.residual_periodicity` measures it, is flat but for noise.

    Hyperuniform pores that are silenced block by block have 0.35, 0.355, 0.34 and 0.265 at corner, edge, face, center.
    """
    faces, joined = MirroredFaces(total=68, share=0.5), BoundedDegreeSubgraph(degree=(3, 5), mode="greedy")
    field = GaussianField(pore_radius=Length(0.11), tunnel_radius=Length(0.03))
    tiling = ScatteredTiling(cells=(4, 4, 4), periodic=True, porosity=0.7, resolution=24).run(
        PlainContext(3), recipe_of(faces, sampler, joined, field), None
    )
    context = PlainContext()
    CheckResidualPeriodicity(resolution=16).run(context, tiling)
    told = context.reported
    for place, error in (("corner", 0.08), ("edge", 0.035), ("face", 0.02), ("center", 0.02)):
        assert told[f"folded_{place}"] == pytest.approx(0.3, abs=error), place
    assert told["folded_deviation"] <= 1.3 * told["folded_expected"]
    assert abs(told["bragg_share"]) < 0.01


def test_other_stages_take_it(torus, box):
    with pytest.raises(DesignError, match="no rule to check"):
        CheckTiling().run(PlainContext(), box)
    with pytest.raises(DesignError, match="copies of one"):
        UnitCell(resolution=8).run(PlainContext(), torus)
    lone = scattered(DartThrowing(total=20), TREE, FIELD, cells=(1, 1, 1), periodic=True)
    assert len(UnitCell(resolution=8).run(PlainContext(), lone).offsets) == 1


@dataclass(frozen=True, kw_only=True)
class Careful(Sampler):
    """A sampler as somebody else would write it: plain darts that keep away from the obstacles."""

    name: ClassVar[str] = "sample.careful"
    count: int = option(12, help="number of pores")
    reach: float = option(0.3, help="spacing")

    def throw(self, rng, box):
        found = box.obstacles
        if box.periodic:
            raise AssertionError("a lone periodic cell is not asked for here")
        new = []
        while len(new) < self.count:
            dart = rng.random(3)
            if (((found - dart) ** 2).sum(1) >= self.reach**2).all():
                new.append(dart)
                found = np.concatenate([found, dart[None]])
        return np.array(new)


@pytest.mark.parametrize("periodic", [False, True])
def test_anybody_s_sampler_is_called_block_by_block_with_its_neighbors(periodic):
    tiling = scattered(Careful(), TREE, FIELD, cells=(2, 3, 2), periodic=periodic)
    assert (np.bincount(tiling.tileset.micro.graph.pores.piece) == 12).all()
    assert smallest_distance(tiling) >= 0.3
    assert parts(tiling) == 1
    after_faces = scattered(MirroredFaces(count=6, spacing=Length(0.3)), Careful(), TREE, FIELD, cells=(2, 2, 2))
    assert (np.bincount(after_faces.tileset.micro.graph.pores.piece) == 18).all()
    assert smallest_distance(after_faces) >= 0.3


def test_the_compiled_way_throws_what_the_plain_one_throws():
    """Equal spacing, equal quotas: pairs at less than one and a half spacings are equally frequent."""

    def pairs(sampler, seed):
        tiling = scattered(sampler, TREE, FIELD, cells=(3, 3, 3), periodic=True, seed=seed)
        points = in_lattice(tiling)
        return len(cKDTree(points % 3.0, boxsize=3.0).query_pairs(0.42)) / len(points)

    fast = [pairs(DartThrowing(count=14, spacing=Length(0.28)), seed) for seed in range(6)]
    plain = [pairs(Careful(count=14, reach=0.28), seed) for seed in range(6)]
    error = np.hypot(np.std(fast), np.std(plain)) / np.sqrt(5)
    assert abs(np.mean(fast) - np.mean(plain)) < 4 * error + 0.02


def test_what_can_not_be_scattered_is_refused():
    with pytest.raises(ConfigError, match=r"sample\.elimination can't scatter"):
        scattered(Elimination(count=9), TREE, FIELD, cells=(2, 2, 2))
    with pytest.raises(ConfigError, match="Microstructure"):
        scattered(DartThrowing(total=9), cells=(2, 2, 2))
    with pytest.raises(DesignError, match=r"kernels reach 1\.\d+ cell sizes"):
        scattered(DartThrowing(total=3), TREE, replace(FIELD, pore_radius=Length(0.4)), cells=(2, 2, 2))
    with pytest.raises(DesignError, match="block: it holds about"):
        scattered(DartThrowing(total=60, spacing=Length(0.3)), TREE, FIELD, cells=(2, 2, 2))
    with pytest.raises(DesignError, match="at least 2 cells"):
        scattered(Careful(), TREE, FIELD, cells=(1, 2, 2), periodic=True)
    with pytest.raises(ConfigError, match="spacing is missing"):
        scattered(DartThrowing(share=0.5), TREE, FIELD, cells=(2, 2, 2))
    with pytest.raises(ConfigError, match="only a box of cells repeats"):
        ScatteredTiling(periodic=True).check_options()
    palette = Palette(8, (0, 0, 0), blocks=Blocks(np.ones((2, 2, 2), bool), True))
    _, base = start_of(None, None, 8)
    one_each = base.extended(np.full((8, 3), 0.5), np.arange(8, dtype=np.int32))  # by a stage that ignores the blocks
    with pytest.raises(ConfigError, match="without regard to their neighbors"):
        TREE.run(PlainContext(palette=palette), one_each)


def test_a_gap_without_faces_is_told():
    context = PlainContext(1)
    scattered(DartThrowing(total=20, gap=Length(0.1)), TREE, FIELD, cells=(2, 1, 1), context=context)
    assert any("no faces" in message for message in context.warnings)


GRADED = (DartThrowing(total=30, share=0.5), BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
          GaussianField(pore_radius=Length(0.14), tunnel_radius=Length(0.04)))  # fmt: skip


def ramp(name, low, high, cells):
    return TableLaw(name, "", "cell_x", np.array([0.0, cells]), np.array([low, high]), "linear")


def laid(*laws, cells=(4, 1, 1), seed=1, **options):
    context = PlainContext(seed, threads=options.pop("threads", 1))
    stage = ScatteredTiling(cells=cells, cell=Length(4, "mm"), trials=1, **{"resolution": 24} | options)
    tiling = stage.run(context, recipe_of(*GRADED), None, Grading(laws))
    tiling.check()
    tiling.tileset.micro.graph.check()
    return tiling, context


def test_a_porosity_that_rises_is_followed_and_pores_keep_the_mean_of_their_spacings():
    tiling, context = laid(ramp("porosity", 0.35, 0.75, 4))
    report = context.reported
    assert report["error_rms_of_rounds"][-1] < 0.012
    assert report["error_rms_of_rounds"][-1] <= report["error_rms_of_rounds"][0]
    pores = tiling.tileset.micro.graph.pores
    counts = np.bincount(pores.piece)[tiling.arrays.box[:, 0, 0]]
    assert (np.diff(counts) > 0).all()
    assert parts(tiling) == 1
    cells = LatticeCells(tiling, 24)
    assert cells.counted() == pytest.approx(0.4 + 0.1 * np.array(cells.cells)[:, 0], abs=0.03)
    density = pores.blocks.density
    points, nodes = in_lattice(tiling), [np.arange(n) / 4 for n in density.shape]
    spacing = spacing_at_share(30, 0.5) * RegularGridInterpolator(nodes, density ** (-1 / 3))(points)
    i, j = cKDTree(points).query_pairs(1.0, output_type="ndarray").T
    apart = np.linalg.norm(points[i] - points[j], axis=1) / (spacing[i] + spacing[j]) * 2
    assert 1 - 1e-9 <= apart.min() < 1.05


def test_a_scale_changes_sizes_and_numbers_but_not_the_porosity():
    tiling, _ = laid(ramp("scale", 1.0, 0.5, 2), cells=(2, 1, 1), porosity=0.5, resolution=32)
    pores, kernels = tiling.tileset.micro.graph.pores, tiling.tileset.micro.pieces.kernels
    x = np.clip(in_lattice(tiling)[:, 0] - 1, 0, 2)
    assert np.allclose(np.sqrt(np.log(4) / kernels.omega), 0.14 * (1 - x / 4))
    counts = np.bincount(pores.piece)[tiling.arrays.box[:, 0, 0]]
    assert counts[1] / counts[0] == pytest.approx(20 / 7, rel=0.25)  # the mean of scale^-3
    cells = LatticeCells(tiling, 32)
    assert cells.counted() == pytest.approx([0.5, 0.5], abs=0.02)


def test_graded_pores_are_the_same_on_any_number_of_threads_and_for_one_density_as_many_as_asked():
    one, many = (laid(ramp("scale", 1.0, 0.6, 2), cells=(2, 1, 1), threads=n)[0] for n in (1, 3))
    assert one.digest() == many.digest()
    flat, _ = laid(ramp("scale", 1.0, 1.0, 2), cells=(2, 2, 1))
    pores = flat.tileset.micro.graph.pores
    assert (np.bincount(pores.piece) == 30).all()


def test_graded_blocks_that_cannot_be_are_refused():
    with pytest.raises(ConfigError, match="do not repeat"):
        laid(ramp("porosity", 0.4, 0.5, 2), periodic=True)
    with pytest.raises(ConfigError, match="given twice"):
        laid(ramp("porosity", 0.4, 0.5, 2), porosity=0.5)
    with pytest.raises(DesignError, match=r"spacing reaches 1\.\d+ cell sizes"):
        laid(ramp("scale", 5.0, 5.0, 2))


@dataclass(frozen=True, kw_only=True)
class Counted(Careful):
    """As somebody else would write a sampler whose number of pores is that of a cell."""

    name: ClassVar[str] = "sample.counted"
    count: int | None = option(None, help="number of pores in an interior")
    total: int | None = option(20, help="number of pores in a cell")

    def throw(self, rng, box):
        return replace(self, count=self.total - box.face_pores, total=None)._thrown(rng, box)

    def _thrown(self, rng, box):
        return Careful(count=self.count, reach=0.7 * box.spacing if box.spacing else 0.15).throw(rng, box)


def test_samplers_of_others_follow_maps_block_by_block():
    stage = ScatteredTiling(cells=(3, 1, 1), cell=Length(4, "mm"), trials=1, rounds=1, resolution=24)
    context, law = PlainContext(1), ramp("porosity", 0.35, 0.65, 3)
    tiling = stage.run(context, recipe_of(Counted(), *GRADED[1:]), None, Grading((law,)))
    tiling.check()
    counts = np.bincount(tiling.tileset.micro.graph.pores.piece)[tiling.arrays.box[:, 0, 0]]
    assert (np.diff(counts) > 0).all()
    assert context.reported["error_rms_of_rounds"][-1] < 0.04


UPWARDS = ramp("direction_z", 2.0, 2.0, 1)


def unstretched(tiling, stretch):
    """Pores and tunnels with z in units of the stretch."""
    first, second = tiling.tileset.micro.graph.segments()
    return in_lattice(tiling) / (1, 1, stretch), (second - first) / (1, 1, stretch)


@pytest.fixture(scope="module")
def upwards():
    return laid(ramp("stretch", 1.8, 1.8, 2), UPWARDS, cells=(2, 2, 2), porosity=0.5, rounds=1)[0]


def test_stretched_pores_are_round_ones_at_unstretched_places(upwards):
    kernels = upwards.tileset.micro.pieces.kernels
    assert np.allclose(kernels.pore_metric, [1, 1, 1.8**-2, 0, 0, 0])
    assert np.allclose(kernels.tunnel_metric, [1, 1, 1.8**-2, 0, 0, 0])
    bare, _ = laid(ramp("stretch", 1.8, 1.8, 2), UPWARDS, cells=(2, 2, 2))
    pores, tunnels = unstretched(bare, 1.8)
    assert len(pores) == pytest.approx(64 * 30 / 1.8, abs=1)
    spacing = spacing_at_share(30, 0.5)
    apart, _ = cKDTree(pores).query(pores, 2)
    assert 1 - 1e-9 <= apart[:, 1].min() / spacing < 1.02
    i, j = cKDTree(pores).query_pairs(1.3 * spacing, output_type="ndarray").T
    for steps in (tunnels, pores[i] - pores[j]):
        mean = np.sqrt((steps**2).mean(0))
        assert mean[2] / mean[:2] == pytest.approx([1, 1], rel=0.12)  # the box is lower than wide
    degree = np.bincount(upwards.tileset.micro.graph.edges.ravel())
    assert 3 <= degree.min() <= degree.max() <= 5


def test_the_field_of_stretched_pores_is_the_sum_of_all_kernels(upwards):
    micro, halo = upwards.tileset.micro, upwards.arrays.halo
    sites = micro.graph.pores.blocks.sites
    every = concatenated(micro.pieces[t].shifted(site - float(halo)) for t, site in enumerate(sites))
    grid = Grid((0.03, 0.02, 0.51), (0.19, 0.23, 0.17), (9, 8, 5))
    x, y, z = np.meshgrid(*(grid.axis(axis) for axis in range(3)), indexing="ij")
    exact = exact_sum(every, np.stack([x, y, z], -1).reshape(-1, 3)) - micro.level
    assert np.abs(upwards.sample(grid).ravel() - exact).max() < 1e-3
    assert float((upwards.sample(cell_centers(24, (2, 2, 2))) >= 0).mean()) == pytest.approx(0.5, abs=0.02)
    assert micro.reach == pytest.approx(1.8 * np.sqrt(np.log(1e5) / np.log(4)) * 0.14)
    assert micro.finest_radius == pytest.approx(0.04)


def test_a_stretch_that_varies_is_followed_on_any_number_of_threads():
    maps = ramp("stretch", 0.7, 1.6, 2), UPWARDS, ramp("direction_x", 0.0, 2.0, 2)
    one, many = (laid(*maps, cells=(2, 1, 1), threads=n)[0] for n in (1, 3))
    assert one.digest() == many.digest()
    place = np.clip(in_lattice(one)[:, 0] - 1, 0, 2)
    stretch, across = 0.7 + 0.45 * place, place
    unit = np.stack([across, 0 * place, 2 + 0 * place], 1) / np.hypot(across, 2)[:, None]
    wanted = np.eye(3) + (stretch**-2 - 1)[:, None, None] * unit[:, :, None] * unit[:, None, :]
    assert np.allclose(matrices(one.tileset.micro.pieces.kernels.pore_metric), wanted)
    counts = np.bincount(one.tileset.micro.graph.pores.piece)[one.arrays.box[:, 0, 0]]
    assert counts == pytest.approx([30 / 0.925, 30 / 1.375], rel=0.08)
    blocks, points = one.tileset.micro.graph.pores.blocks, in_lattice(one)
    nodes = [np.arange(n) / 4 for n in blocks.density.shape]
    packing = blocks.density / np.sqrt(np.linalg.det(matrices(blocks.metric.reshape(-1, 6)))).reshape(
        blocks.density.shape
    )
    metric = matrices(RegularGridInterpolator(nodes, blocks.metric)(points))
    spacing = spacing_at_share(30, 0.5) * RegularGridInterpolator(nodes, packing)(points) ** (-1 / 3)
    i, j = cKDTree(points).query_pairs(0.6, output_type="ndarray").T
    step = points[i] - points[j]
    apart = np.sqrt(np.einsum("na,nab,nb->n", step, (metric[i] + metric[j]) / 2, step)) / (spacing[i] + spacing[j]) * 2
    assert 1 - 1e-9 <= apart.min() < 1.05


def test_a_spacing_changes_the_number_of_pores_and_not_their_size():
    usual = 4 * spacing_at_share(30, 0.5)
    tiling, _ = laid(ramp("spacing", usual, usual / 2, 2), cells=(2, 1, 1))
    pores, kernels = tiling.tileset.micro.graph.pores, tiling.tileset.micro.pieces.kernels
    assert np.allclose(np.sqrt(np.log(4) / kernels.omega), 0.14)
    points = in_lattice(tiling)
    nearest = cKDTree(points).query(points, 2)[0][:, 1] * 4
    x = np.clip(points[:, 0] - 1, 0, 2)
    assert (nearest / (usual * (1 - x / 4))).min() > 0.9
    counts = np.bincount(pores.piece)[tiling.arrays.box[:, 0, 0]]
    assert counts / 30 == pytest.approx([1.55, 4.3], rel=0.1)  # the means of (1 - x / 4)^-3
    with pytest.raises(ConfigError, match="both the map 'spacing' and a porosity"):
        laid(ramp("spacing", usual, usual, 2), porosity=0.5)


def test_who_knows_nothing_of_stretched_pores_refuses_them(upwards):
    maps = ramp("stretch", 1.5, 1.5, 2), UPWARDS
    with pytest.raises(ConfigError, match="no direction"):
        laid(maps[0])
    with pytest.raises(ConfigError, match="no map `stretch`"):
        laid(UPWARDS)
    with pytest.raises(DesignError, match=r"\(0, 0, 0\) everywhere"):
        laid(maps[0], ramp("direction_x", 0.0, 0.0, 1))
    with pytest.raises(DesignError, match=r"spacing reaches 1\.\d+ cell sizes"):
        laid(ramp("stretch", 5.0, 5.0, 2), UPWARDS)
    stage = ScatteredTiling(cells=(2, 1, 1), cell=Length(4, "mm"), trials=1)
    for recipe, name in (
        ((Counted(), *GRADED[1:]), "sample.counted"),
        ((GRADED[0], RelativeNeighbors(), GRADED[2]), "connect.relative_neighbors"),
    ):
        with pytest.raises(ConfigError, match=f"{name} measures plain distances"):
            stage.run(PlainContext(1), recipe_of(*recipe), None, Grading(maps))
    with pytest.raises(ConfigError, match=r"`tile\.graded`.*'stretch'"):
        GradedTiling(cells=(2, 1, 1), cell=Length(4, "mm")).run(
            PlainContext(1), recipe_of(*GRADED), Grading((ramp("porosity", 0.4, 0.5, 2), *maps)), None
        )
    assert _tiles(upwards.tileset) == []


def test_stretched_pores_are_bent_as_they_are(upwards):
    """Not mapped and made anew as round ones: what was solid in the box is solid in the wall of the tube."""
    bend = WarpCylinder(inner_radius=Length(50, "mm"), around=10.0)
    with pytest.raises(ConfigError, match="has no sizes that could stay"):
        replace(bend, sizes="fixed").run(PlainContext(1), upwards)
    bent, edge = bend.run(PlainContext(1), upwards), upwards.physical_edge()

    def solid(field, points):
        return [field.solid(Grid(tuple(point), (1.0,) * 3, (1, 1, 1))).item() for point in points.tolist()]

    places = np.random.default_rng(4).uniform(0.2, 0.8, (150, 3)) * upwards.cells
    there = (bend.mapped(upwards, places).points - bent.origin_mm) / bent.physical_edge()
    before = solid(upwards, places - np.array(upwards.origin_mm) / edge)
    assert 30 < sum(before) < 120
    assert np.mean(np.array(before) == solid(bent, there)) > 0.98


def test_a_steep_scale_keeps_the_porosity_without_a_map_of_it():
    """From 1 to 1/3 within one cell: the density between nodes is that of the sizes there, not of a chord above it."""
    found = {}
    for name, slope in (("flat", 0.0), ("steep", 2 / 3)):
        cells = []
        for seed in range(2):
            law = FormulaLaw("scale", "", f"1 - {slope:.6f}*clip(x/4 - 1, 0, 1)", (), (), None, None)
            tiling, _ = laid(law, cells=(3, 2, 2), seed=seed)
            cells.append(1 - tiling.solid(20).reshape(3, 20, -1).mean((1, 2)))
        found[name] = np.mean(cells, axis=0)
    assert found["steep"] == pytest.approx([found["flat"].mean()] * 3, abs=0.02)


def test_quotas_are_the_integral_of_a_density_whose_sizes_are_linear():
    size = 1 - np.arange(9) / 12  # two blocks, from 1 to 1/3
    nodes = np.broadcast_to((size**-3.0)[:, None, None], (9, 5, 5))
    exact = 3000 * (size[[4, 8]] ** -2.0 - size[[0, 4]] ** -2.0) / 2 / (1 / 3)
    assert block_quotas(np.ones((2, 1, 1), bool), 3000.0, nodes)[:, 0, 0] == pytest.approx(exact, abs=2)


def test_cells_are_measured_as_far_as_they_lie_in_the_part_and_with_a_map_are_put_right_there(ball):
    context = PlainContext(1)
    stage = ScatteredTiling(cell=Length(4, "mm"), trials=1, resolution=24)
    tiling = stage.run(context, recipe_of(*GRADED), ball, Grading((ramp("porosity", 0.5, 0.6, 4),)))
    part = Part(tiling, ball)
    cells = LatticeCells(part, 24)
    assert (cells.shares < 1).any()
    measured = cells.porosities(cells.cells, lambda done: None)
    counted = cells.counted()
    assert measured == pytest.approx(counted, abs=0.012)
    assert cells.porosities(cells.cells[::2], lambda done: None) == pytest.approx(measured[::2], abs=1e-4)
    assert context.reported["error_rms"] < 0.03
    assert tiling.tileset.micro.graph.pores.blocks.kept is None


class Elsewhere(Maps):
    """Maps of somebody else, who says how pores follow them."""

    scattered_by: ClassVar[str] = f"{__name__}:lone_pores"


def lone_pores(context, maps, wanted):
    assert (wanted.lattice.mask.shape, wanted.mask.shape) == ((2, 1, 1), (4, 3, 3))
    return scattered(DartThrowing(total=4), TREE, FIELD, cells=wanted.lattice.mask.shape) if wanted.rounds else None


def test_anybody_s_maps_are_followed_unless_they_change_nothing():
    recipe = recipe_of(DartThrowing(total=20), TREE, FIELD)
    for rounds, pores in ((0, 20), (1, 4)):
        stage = ScatteredTiling(cells=(2, 1, 1), rounds=rounds)
        tiling = stage.run(PlainContext(1), recipe, None, Elsewhere())
        assert (np.bincount(tiling.tileset.micro.graph.pores.piece) == pores).all()


def constant(name, value):
    return ramp(name, value, value, 1)


def test_two_stretches_and_a_rotation_are_any_affine_shape():
    from sppm_pipeline.features.grading.map_sizes import metric_at
    from sppm_pipeline.services.mesh.rotation import rotation

    axes = rotation((25.0, -40.0, 70.0))
    d, e = axes[:, 2], axes[:, 1]
    # of the second vector only the part across the first one counts
    second = 3 * e + 0.7 * d
    laws = [constant("stretch", 1.5), constant("stretch_across", 0.8)]
    laws += [constant(f"direction_{axis}", 2 * value) for axis, value in zip("xyz", d, strict=True)]
    laws += [constant(f"across_{axis}", value) for axis, value in zip("xyz", second, strict=True)]
    expected = axes @ np.diag([1, 0.8**-2, 1.5**-2]) @ axes.T
    tiling, _ = laid(*laws, cells=(2, 2, 2))
    pieces = tiling.tileset.micro.pieces
    for metric in (pieces.kernels.pore_metric, pieces.kernels.tunnel_metric):
        assert np.allclose(matrices(metric), expected)
    pores = in_lattice(tiling)
    assert len(pores) == pytest.approx(64 * 30 / (1.5 * 0.8), abs=1)
    # lengths in the metric are those of the structure before it was stretched
    plain = pores @ axes / [1, 0.8, 1.5]
    apart, _ = cKDTree(plain).query(plain, 2)
    assert 1 - 1e-9 <= apart[:, 1].min() / spacing_at_share(30, 0.5) < 1.02
    parallel = [constant(f"across_{axis}", value) for axis, value in zip("xyz", d, strict=True)]

    def metrics(*laws):
        return metric_at(Grading(laws).in_cells(4.0, (0.0, 0.0, 0.0)), np.zeros((2, 3)))

    assert np.allclose(metrics(*laws[:5], *parallel), metrics(laws[0], *laws[2:5]))


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("stretch_across",), "no map `stretch`"),
        (("stretch", "direction_x", "stretch_across"), "lacks a map of across_x"),
        (("stretch", "direction_x", "across_x"), "lacks a map `stretch_across`"),
    ],
)
def test_a_second_stretch_needs_a_first_and_a_direction(names, words):
    with pytest.raises(ConfigError, match=words):
        laid(*(constant(name, 1.2) for name in names), cells=(2, 2, 2))


def test_a_box_of_evenly_stretched_pores_repeats():
    laws = [constant("stretch", 1.5), constant("direction_x", 1.0), constant("direction_z", 1.0)]
    tiling, _ = laid(*laws, constant("stretch_across", 1.2), constant("across_y", 1.0), cells=(2, 2, 2), periodic=True,
                     porosity=0.5)  # fmt: skip
    micro, pores = tiling.tileset.micro, in_lattice(tiling)
    metric = matrices(micro.pieces.kernels.pore_metric[:1])[0]
    assert len(pores) == pytest.approx(8 * 30 / (1.5 * 1.2), abs=1)
    images = (pores[:, None] + 2 * np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), -1).reshape(-1, 3)).reshape(-1, 3)
    steps = pores[:, None] - images
    lengths = np.sqrt(np.einsum("ijk,kl,ijl->ij", steps, metric, steps))
    assert 1 - 1e-9 <= np.sort(lengths, axis=1)[:, 1].min() / spacing_at_share(30, 0.5) < 1.05
    # tunnels lead to near pores in the metric, across the border of the box as well
    first, second = micro.graph.segments()
    tunnels = np.sqrt(np.einsum("ik,kl,il->i", second - first, metric, second - first))
    assert tunnels.max() < 2.5 * spacing_at_share(30, 0.5)
    grid = Grid((0.05, 0.05, 0.05), (0.1,) * 3, (20, 20, 20))
    values = tiling.sample(grid)
    assert np.allclose(values, tiling.sample(grid._replace(origin=(2.05, -1.95, 0.05))), atol=1e-5)
    assert (values >= 0).mean() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("law", "words"),
    [(ramp("stretch", 1.2, 1.5, 2), "varies do not repeat"), (ramp("scale", 1, 1, 1), "'scale' do not")],
)
def test_boxes_that_follow_varying_maps_do_not_repeat(law, words):
    with pytest.raises(ConfigError, match=words):
        laid(law, *([constant("direction_x", 1.0)] if law.name == "stretch" else []), cells=(2, 2, 2), periodic=True)
