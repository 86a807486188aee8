"""`field.sheet` in a cell, scattered, stretched, tuned and homogenized, and the preset `open`."""

from dataclasses import replace

import numpy as np
import pytest

from sppm_pipeline import Pipeline
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.flow.stages.homogenize_permeability import HomogenizePermeability
from sppm_pipeline.features.sheet.stages.field_sheet import SheetStage
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.method.connectivity.components import phase_report
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_scattered import ScatteredTiling
from sppm_pipeline.method.stages.tileset_wang_3color import WangTileSet
from sppm_pipeline.method.stages.tune_porosity import TunePorosity
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


def recipe(total=60, **options):
    return recipe_of(DartThrowing(total=total), SheetStage(**options))


def made(seed=1, **options):
    context = PlainContext(seed)
    field = recipe(**options).run(context)
    field.check()
    return field, context.log.values["recipe.field.sheet"]


@pytest.fixture(scope="module")
def cell():
    return made(balance=0.6)


def test_the_cell_has_the_density_and_two_networks_of_the_shares_asked_for(cell):
    field, report = cell
    solid = field.solid(64)
    assert solid.mean() == pytest.approx(0.3, abs=0.004)
    assert sum(report["void_shares"]) == pytest.approx(0.7, abs=0.01)
    middle = field.cut_at(1e-9 - field.half_width)
    assert middle.solid(32).mean() == 0
    sides = field.evaluate(*(np.linspace(0, 1, 32, endpoint=False),) * 3)
    assert sides.shape == (32, 32, 32)
    values = np.count_nonzero(signed(field) > 0) / 64**3
    assert values == pytest.approx(0.6, abs=0.01)
    assert report["own_neighbors"] == pytest.approx(0.42, abs=0.05)
    assert report["period"] == pytest.approx(1.52 * 60 ** (-1 / 3))


def signed(field):
    from sppm_pipeline.features.sheet.numerics.waves import sum_of_waves

    axis = np.arange(64) / 64
    return sum_of_waves(field.waves, axis, axis, axis) - field.middle


def test_both_networks_percolate_and_touch_nowhere(cell):
    field, _ = cell
    for side in (1, -1):
        void = phase_report((side * signed(field) > field.half_width).view(np.uint8))
        assert void.wraps == (True, True, True)
        assert void.largest_share > 0.99
    assert phase_report(field.solid(64).T).components == 1


def test_samples_repeat_with_the_cell_and_do_not_depend_on_the_grid(cell):
    field, _ = cell
    grid = Grid((-0.37, 0.2, 1.1), (0.031, 0.05, 0.07), (9, 8, 7))
    values = field.sample(grid)
    assert np.array_equal(values, field.sample(Grid((0.63, 1.2, 0.1), grid.spacing, grid.shape)))
    assert np.array_equal(values[:, :, 3:5], field.sample_layers(grid, 3, 5, threads=2))


def test_tuning_changes_the_thickness_alone(cell):
    field, _ = cell
    tuned = TunePorosity(target=0.55).run(PlainContext(1), recipe(balance=0.6))
    assert 1 - tuned.solid(97).mean() == pytest.approx(0.55, abs=1e-3)
    assert (tuned.middle, tuned.slope) == (field.middle, field.slope)
    assert np.array_equal(tuned.waves.real, field.waves.real)
    assert tuned.thinnest_wall > field.thinnest_wall


def test_the_same_seed_makes_the_same_waves(cell):
    again, _ = made(balance=0.6)
    assert again.digest() == cell[0].digest()
    assert made(seed=2, balance=0.6)[0].digest() != again.digest()


def test_the_walls_are_as_thick_as_stated(cell):
    from sppm_pipeline.services.local_thickness import local_thickness

    field, _ = cell
    solid = field.solid(96)
    thick = local_thickness(np.ascontiguousarray(solid.T), (True, True, True))[solid.T > 0] / 96
    # voxels make thin walls thinner by up to one
    assert np.quantile(thick, 0.1) == pytest.approx(field.thinnest_wall, abs=0.015)


def test_the_preset_is_stiff_open_and_isotropic():
    pipeline = Pipeline(
        [
            {"stage": "tune.porosity", "recipe": "open", "target": 0.7, "resolution": 32, "tolerance": 0.005},
            {"stage": "homogenize.voxel", "id": "elastic", "resolution": 56},
            {"stage": "homogenize.permeability", "id": "flow", "resolution": 56},
        ],
        seed=3,
    )
    run = pipeline.run()
    elastic, flow = run["elastic"].summary(), run["flow"]
    assert elastic["isotropic"]["E"] > 0.11
    assert elastic["universal_anisotropy"] < 0.05
    assert flow.k_mean * flow.surface**2 > 0.052
    assert flow.wraps == (True, True, True)


@pytest.fixture(scope="module")
def scattered():
    return ScatteredTiling(cells=(2, 2, 2), periodic=True, porosity=0.7).run(PlainContext(2), recipe(), None)


def test_scattered_pores_have_two_networks_as_well(scattered):
    scattered.check()
    grid = cell_centers(40, (2, 2, 2))
    assert 1 - scattered.solid(grid).mean() == pytest.approx(0.7, abs=0.003)
    micro = scattered.tileset.micro
    sides = micro.laid_differences(scattered.arrays, grid, 0, 80) - micro.middle
    for side in (sides, -sides):
        void = phase_report((side > micro.level).view(np.uint8))
        assert void.wraps == (True, True, True)
        assert void.largest_share > 0.99


def test_a_scattered_sheet_is_the_balance_of_its_kernels(scattered):
    micro = scattered.tileset.micro
    kernels, sites = micro.pieces.kernels, micro.graph.pores.blocks.sites[micro.graph.pores.piece]
    rng = np.random.default_rng(0)
    for x, y, z in rng.random((20, 3)) * 2:
        step = kernels.centers + sites - [x, y, z]
        step -= 2 * np.round(step / 2)
        terms = micro.colors_of_pores * np.exp(-kernels.omega * (step**2).sum(1))
        value = scattered.sample(Grid((x, y, z), (1.0,) * 3, (1, 1, 1)))[0, 0, 0]
        assert value == pytest.approx(abs(terms.sum() - micro.middle) - micro.level, abs=2e-4)


def test_scattered_sheets_follow_maps_of_stretch_and_local_porosity():
    pipeline = Pipeline(
        [
            {"stage": "grade.formula", "of": "stretch", "formula": "1.6"},
            {"stage": "grade.formula", "of": "direction_z", "formula": "1"},
            {"stage": "tile.scattered", "recipe": "cell", "cells": [2, 2, 2], "cell": "1 mm"},
            {"stage": "grade.formula", "of": "porosity", "formula": "0.55 + 0.1 * z"},
            {"stage": "tune.local_porosity", "id": "tuned"},
        ],
        recipes={"cell": [{"stage": "sample.dart_throwing", "total": 250}, {"stage": "field.sheet"}]},
        seed=1,
    )
    values = pipeline.run()["tuned"].sample(Grid((0.0125,) * 3, (0.025,) * 3, (80, 80, 80)))
    for layer in (20, 60):
        part = values[:, :, layer - 12 : layer + 12]
        assert (part >= 0).mean() == pytest.approx(0.55 + 0.1 * layer / 40, abs=0.02)
    steep = [np.abs(np.diff(values, axis=axis)).mean() for axis in range(3)]
    assert steep[0] / steep[2] == pytest.approx(1.6, rel=0.15)


def test_a_map_of_porosity_is_left_to_the_level():
    pipeline = Pipeline(
        [
            {"stage": "grade.formula", "of": "porosity", "formula": "0.7"},
            {"stage": "tile.scattered", "recipe": "cell", "cells": [2, 2, 2], "cell": "1 mm"},
        ],
        recipes={"cell": [{"stage": "sample.dart_throwing", "total": 60}, {"stage": "field.sheet"}]},
    )
    with pytest.raises(ConfigError, match="does not follow from its number of pores"):
        pipeline.run()


def test_what_is_refused_says_why():
    with pytest.raises(DesignError, match="5 pores are too few for two networks; 8"):
        recipe(total=5).run(PlainContext(0))
    for period in (0.05, 2.0):
        with pytest.raises(ConfigError, match="allowed"):
            recipe(period=Length(period)).run(PlainContext(0))
    tiles = recipe_of(
        MirroredFaces(count=9, spacing=Length(0.2)), DartThrowing(count=20, spacing=Length(0.2)), SheetStage()
    )
    with pytest.raises(ConfigError, match="one periodic cell"):
        WangTileSet().run(PlainContext(0), tiles)
    with pytest.raises(DesignError, match="network does not lead through the cell"):
        recipe(density=0.9, balance=0.25).run(PlainContext(0))


def test_a_check_refuses_pores_without_a_color(scattered):
    micro = scattered.tileset.micro
    with pytest.raises(ValueError, match="every pore of a sheet"):
        replace(micro, colors_of_pores=micro.colors_of_pores[1:]).check()


def test_the_limit_and_permeability_agree_with_coarser_grids(cell):
    field, _ = cell
    stiff = [HomogenizeVoxel(resolution=n).run(PlainContext(0), field).summary()["isotropic"]["E"] for n in (32, 48)]
    flow = [HomogenizePermeability(resolution=n).run(PlainContext(0), field).k_mean for n in (32, 48)]
    assert stiff[0] == pytest.approx(stiff[1], rel=0.03)
    assert flow[0] == pytest.approx(flow[1], rel=0.05)


def test_a_stretched_and_turned_sheet_is_stiff_along_its_longest_axis():
    def moduli(**options):
        report = HomogenizeVoxel(resolution=40).run(PlainContext(0), made(total=130, **options)[0]).summary()
        return np.array([report["C"][axis][axis] for axis in range(3)])

    x, y, z = moduli(stretch=(1.0, 2.0))
    assert z > 1.5 * max(x, y)
    assert x == pytest.approx(y, rel=0.25)
    # a quarter turn about x takes z to -y
    turned = moduli(stretch=(1.0, 2.0), turn=(90.0, 0.0, 0.0))
    assert turned[1] > 1.5 * max(turned[0], turned[2])
    x, y, z = moduli(stretch=(1.6, 2.5))
    assert z > 1.1 * y > 1.1 * 1.1 * x
