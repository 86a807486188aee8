"""``tune.tensor``: waves of the level, derivatives of the stiffness, cells that become isotropic or meet a design."""

import math

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.stiffness.numerics.elasticity import ElasticBody, stiffness
from sppm_pipeline.features.stiffness.numerics.sensitivity import brick_stiffness
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.features.stiffness.stages.tune_tensor import Search, TuneTensor
from sppm_pipeline.features.stiffness.waved_field import WavedField, wave_values, waves_up_to
from sppm_pipeline.method.nouns.stiffness_design import StiffnessDesign
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_elimination import Elimination
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.elastic.loaded import brick_strains
from sppm_pipeline.services.elastic.voigt import isotropic, lame, mandel, rotated
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

pytestmark = pytest.mark.filterwarnings("ignore:homogenize.voxel")  # coarse grids
QUICK = {"resolution": 24, "periods": 1, "evaluations": 6, "trials": 1}


def thick():
    """A cell of few pores, which 24 voxels resolve."""
    return recipe_of(
        Elimination(count=10), BoundedDegreeSubgraph(mode="greedy"),
        GaussianField(pore_radius=Length(0.13), tunnel_radius=Length(0.05), level=0.5), name="thick",
    )  # fmt: skip


@pytest.fixture(scope="module")
def field():
    return thick().run(PlainContext(3))


def wanted(target, options=(), rotation=None, stretch=(1.0, 1.0, 1.0), porosity=0.5, recipe="thick", **solid):
    zero = np.zeros((6, 6))
    return StiffnessDesign(
        recipe=recipe, options=options, porosity=porosity, stretch=np.array(stretch),
        rotation=np.eye(3) if rotation is None else rotation,
        stiffness=target, target=target, mean_error=zero, draw_error=zero, distance=0.0, floor=0.0, grid_error=0.0,
        draws=3, **solid,
    )  # fmt: skip


@pytest.mark.parametrize("order", [1, 2])
def test_waves_are_the_sum_they_say(field, order):
    rng = np.random.default_rng(order)
    amplitudes = rng.normal(size=2 * len(waves_up_to(order)))
    made = WavedField(field, 0.3, order, amplitudes)
    grid = Grid((0.11, 0.23, -0.4), (0.13, 0.17, 0.21), (5, 4, 6))
    places = np.stack(np.meshgrid(*(grid.origin[k] + grid.spacing[k] * np.arange(grid.shape[k]) for k in range(3)),
                                  indexing="ij"), -1)  # fmt: skip
    waves = (amplitudes @ wave_values(order, places.reshape(-1, 3))).reshape(grid.shape)
    np.testing.assert_allclose(made.sample(grid), field.sample(grid) - 0.3 - waves, atol=2e-5)
    # a sample depends on its place alone, and the sum has the period of the cell
    assert np.array_equal(made.sample_layers(grid, 2, 4, 2), made.sample(grid)[:, :, 2:4])
    moved = grid._replace(origin=(1.11, -0.77, 1.6))
    np.testing.assert_allclose(made.sample(moved), made.sample(grid), atol=2e-5)
    made.check()
    assert made.cut_at(0.2).value == 0.5


def test_waves_have_a_mean_square_of_one_and_none_is_there_twice():
    places = np.stack(np.meshgrid(*[np.arange(8) / 8] * 3, indexing="ij"), -1).reshape(-1, 3)
    values = wave_values(2, places)
    np.testing.assert_allclose(values @ values.T / len(places), np.eye(len(values)), atol=1e-12)
    assert len(values) == 5**3 - 1


@pytest.mark.parametrize("amplitudes", [np.zeros(3), np.full(26, np.nan)])
def test_amplitudes_are_as_many_as_waves(field, amplitudes):
    with pytest.raises(ValueError, match="amplitudes"):
        WavedField(field, 0.0, 1, amplitudes).check()


def test_linear_displacements_have_constant_strains():
    edges = (0.5, 0.8, 1.0)
    corners = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]) * edges
    gradient = np.array([[0.1, 0.4, -0.2], [0.3, -0.5, 0.7], [0.6, 0.2, 0.9]])
    strains = brick_strains(edges)[0] @ (corners @ gradient.T).ravel()
    g = gradient
    np.testing.assert_allclose(
        strains[0], [g[0, 0], g[1, 1], g[2, 2], g[1, 2] + g[2, 1], g[0, 2] + g[2, 0], g[0, 1] + g[1, 0]], atol=1e-12
    )
    np.testing.assert_allclose(strains[1:], 0, atol=1e-12)  # what varies over the brick


def test_energies_of_bricks_are_the_derivatives_of_the_stiffness():
    rng = np.random.default_rng(5)
    shape, edges = (6, 5, 8), (1.0, 0.9, 0.8)
    share = rng.uniform(0.2, 1, shape)
    lam, mu = lame(1.0, 0.3)
    body = ElasticBody.of(lam * share, mu * share, edges, np.float64)
    found = body.stiffness(tolerance=1e-8, fields=True)
    energies = brick_stiffness(found, shape, edges, isotropic(1.0, 0.3), np.arange(share.size))
    own = np.einsum("m,mij->ij", share.ravel(), energies) / share.size
    np.testing.assert_allclose(own, found.stiffness, atol=1e-6)
    change = rng.normal(size=shape) * 1e-3
    both = [
        stiffness(lam * one, mu * one, edges, tolerance=1e-9, precision=np.float64).stiffness
        for one in (share + change, share - change)
    ]
    np.testing.assert_allclose(
        np.einsum("m,mij->ij", change.ravel(), energies) / share.size, (both[0] - both[1]) / 2, atol=2e-8
    )


def test_slopes_of_the_search_are_those_of_differences(field):
    """At constant porosity, with all four solutions that the limit of fine grids takes."""
    stage = TuneTensor(**QUICK)
    solver = HomogenizeVoxel(resolution=24, stretch=(0.9, 1.0, 1.2), solver_tolerance=1e-4)
    target = isotropic(0.2, 0.25)
    search = Search(stage, solver, lambda dials: field, target, 0.3, PlainContext(1))
    state = search.start(wanted(target))
    search._prepare(state)
    slopes = search._slopes(state)
    rng = np.random.default_rng(2)
    step = rng.normal(size=slopes.shape[1])
    step *= 0.02 * search._unit / np.linalg.norm(step)
    both = [search._moved(state, sign * step).off for sign in (1, -1)]
    found = (both[0] - both[1]) / 2
    # fractions of voxels have creases where the surface passes a corner of a part of them
    assert np.linalg.norm(found - slopes @ step) < 0.15 * np.linalg.norm(found)


def test_a_cell_becomes_isotropic_at_the_same_porosity():
    contexts = [PlainContext(3), PlainContext(3)]
    made, again = (TuneTensor(**QUICK).run(context, thick()) for context in contexts)
    told = contexts[0].reported
    assert told["distance"] < 0.4 * told["distance_before"]
    grid = 40
    assert np.mean(made.sample(grid) < 0) == pytest.approx(
        np.mean(thick().run(PlainContext(3)).sample(grid) < 0), abs=2e-3
    )
    assert made.sample(grid).tobytes() == again.sample(grid).tobytes()
    assert told == contexts[1].reported
    measured = HomogenizeVoxel(resolution=36).run(PlainContext(1), made).stiffness
    np.testing.assert_allclose(np.array(told["stiffness"]), measured, rtol=1e-3, atol=1e-4)


def test_the_solid_is_that_of_the_design_unless_it_is_given():
    design = wanted(np.eye(6), young=100.0, poisson=0.35)
    assert TuneTensor()._solid(design) == (100.0, 0.35)
    assert TuneTensor(young=7.0, poisson=0.0)._solid(design) == (7.0, 0.0)
    assert TuneTensor()._solid(None) == (1.0, 0.3)
    design.check()
    with pytest.raises(ValueError, match="Young's modulus"):
        wanted(np.eye(6), young=0.0).check()


def test_a_cell_meets_the_tensor_of_another_draw_stretched_and_turned():
    """A target with no symmetry at all, which the mean of draws does not have."""
    turn = np.array([[math.cos(0.4), -math.sin(0.4), 0], [math.sin(0.4), math.cos(0.4), 0], [0, 0, 1]])
    stretch = (0.8, 1.0, 1.25)
    cell = thick().run(PlainContext(11))
    porosity = float(np.mean(cell.sample(64) >= 0))
    target = rotated(HomogenizeVoxel(resolution=36, stretch=stretch).run(PlainContext(1), cell).stiffness, turn)
    context = PlainContext(3)
    stage = TuneTensor(**(QUICK | {"evaluations": 9}))
    made = stage.run(context, thick(), wanted(100 * target, (), turn, stretch, porosity, young=100.0))
    told = context.reported
    assert told["distance"] < 0.5 * told["distance_before"]
    assert told["distance"] < 0.06
    assert np.mean(made.sample(96) >= 0) == pytest.approx(porosity, abs=5e-4)
    off = np.linalg.norm(mandel(np.array(told["stiffness"]) / 100 - target)) / np.linalg.norm(mandel(target))
    assert off == pytest.approx(told["distance"], rel=1e-6)


def test_dials_are_changed_with_the_waves():
    """A target stiffer than the cell is met by thinner tunnels, whose radius the design calls a dial."""
    target = 1.15 * HomogenizeVoxel(resolution=24).run(PlainContext(1), thick().run(PlainContext(3))).stiffness
    context = PlainContext(3)
    stage = TuneTensor(**QUICK, low=(0.03,), high=(0.08,), max_distance=1.0)
    design = wanted(target, (("field.gaussian.tunnel_radius", 0.05),), porosity=0.41)
    stage.run(context, thick(), design)
    assert context.reported["distance"] < 0.75 * context.reported["distance_before"]


def test_what_can_not_be_is_refused():
    design = wanted(isotropic(0.1, 0.3), recipe="other")
    with pytest.raises(ConfigError, match="'other'"):
        TuneTensor(**QUICK).run(PlainContext(3), thick(), design)
    with pytest.raises(ConfigError, match="dials"):
        TuneTensor(**QUICK, low=(0.0, 1.0), high=(1.0, 2.0)).run(
            PlainContext(3), thick(), wanted(isotropic(0.1, 0.3), (("field.gaussian.level", 0.5),))
        )
    with pytest.raises(ConfigError, match="makes a"):
        TuneTensor(**QUICK).run(PlainContext(3), recipe_of(DartThrowing(count=9, spacing=Length(0.2))))
    with pytest.raises(DesignError, match="came within"):
        TuneTensor(**(QUICK | {"evaluations": 3})).run(PlainContext(3), thick(), wanted(isotropic(2.0, 0.3)))
