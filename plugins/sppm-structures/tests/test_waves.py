"""``field.spinodoid`` and ``field.stochastic_gyroid``: sums of waves, directions, statistics, tuning."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sppm_structures.spinodoid import Spinodoid, wave_vectors
from sppm_structures.stochastic_gyroid import StochasticGyroid
from sppm_structures.tpms import Tpms
from sppm_structures.waves import half_space, sum_of_waves, waves_of

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.method.stages.tune_porosity import TunePorosity
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid, cell_centers, cell_nodes
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


def made(stage, seed=1):
    stage.check_options()
    return stage.run(PlainContext(seed))


class TestSpinodoidContract(StageContract):
    def stages(self):
        return [Spinodoid(), Spinodoid(cones=(30.0, 30.0, 0.0), waves=20, wavenumber=4.0, edge=Length(3.0), repeat=2)]


class TestGyroidContract(StageContract):
    def stages(self):
        return [StochasticGyroid(), StochasticGyroid(closed=0.0, repeat=1, edge=Length(3.0))]


@settings(deadline=None, derandomize=True, max_examples=20)
@given(st.integers(0, 2**32), st.integers(1, 40))
def test_sums_are_those_wave_by_wave(seed, count):
    rng = np.random.default_rng(seed)
    vectors, phases, sizes = rng.integers(-6, 7, (count, 3)), rng.random(count) * 7, rng.random(count)
    x, y, z = rng.random(5), rng.random(4), rng.random(3)
    expected = sum(
        size * np.cos(2 * np.pi * (k[0] * x[:, None, None] + k[1] * y[:, None] + k[2] * z) + phase)
        for k, phase, size in zip(vectors, phases, sizes, strict=True)
    )
    assert sum_of_waves(waves_of(vectors, phases, sizes), x, y, z) == pytest.approx(expected, abs=1e-11)


def test_of_opposite_waves_one_is_kept():
    axis = np.arange(-2, 3)
    every = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    kept = half_space(every)
    assert len(kept) == (125 - 1) / 2
    assert len(np.unique(np.concatenate([kept, -kept]), axis=0)) == 124


def test_wave_vectors_lie_in_the_shell_and_the_cones():
    every = wave_vectors(6.0, 0.5, (90.0, 0.0, 0.0))
    lengths = np.linalg.norm(every, axis=1)
    assert lengths.min() >= 5.5
    assert lengths.max() <= 6.5
    assert len(every) == pytest.approx(4 / 3 * np.pi * (6.5**3 - 5.5**3) / 2, rel=0.05)
    narrow = wave_vectors(6.0, 0.5, (0.0, 20.0, 0.0))
    assert (np.abs(narrow[:, 1]) >= np.cos(np.radians(20)) * np.linalg.norm(narrow, axis=1) - 1e-9).all()
    both = wave_vectors(6.0, 0.5, (20.0, 20.0, 0.0))
    assert len(both) == 2 * len(narrow)


def test_the_field_has_variance_one_and_the_expected_density():
    field = made(Spinodoid(wavenumber=8.0, density=0.3))
    values = field.sample(cell_centers(48))
    assert values.std() == pytest.approx(1, abs=1e-3)  # waves are orthogonal on the grid
    assert (values < 0).mean() == pytest.approx(0.3, abs=0.02)


def test_cones_make_layers_and_columns():
    """Mean squared slope along each axis: waves run across layers."""

    def slopes(cones):
        values = made(Spinodoid(cones=cones)).sample(cell_centers(40))
        return [float(((np.roll(values, 1, axis) - values) ** 2).mean()) for axis in range(3)]

    x, y, z = slopes((30.0, 0.0, 0.0))
    assert x > 5 * max(y, z)
    x, y, z = slopes((30.0, 30.0, 0.0))
    assert min(x, y) > 3 * z
    x, y, z = slopes((90.0, 0.0, 0.0))
    assert max(x, y, z) < 1.3 * min(x, y, z)


def test_a_gyroid_without_randomness_is_the_gyroid():
    plain = made(StochasticGyroid(bend=0.0, uneven=0.0, closed=0.0, repeat=2, half_width=0.3))
    other = made(Tpms(form="sheet", half_width=0.3, repeat=2))
    assert plain.sample(cell_centers(20)) == pytest.approx(other.sample(cell_centers(20)), abs=1e-6)


def test_lids_close_the_share_asked_for():
    """A lid that is high enough makes one labyrinth solid there; elsewhere nothing changes."""
    open_field, closed = (made(StochasticGyroid(closed=share)) for share in (0.0, 0.2))
    before, after = (field.sample(cell_centers(48)) for field in (open_field, closed))
    assert (after <= before).all()
    assert (after < before).mean() == pytest.approx(0.1, abs=0.05)  # of a fifth of the volume one side
    assert (after < 0).mean() > (before < 0).mean() + 0.02


def test_random_functions_have_the_deviation_asked_for():
    field = made(StochasticGyroid(bend=0.1, uneven=0.3, half_width=0.5))
    x, y, z = (cell_centers(24).axis(a) for a in range(3))
    for bend in field.bends:
        assert sum_of_waves(bend, x, y, z).std() == pytest.approx(0.1 * 2 * np.pi)
    assert sum_of_waves(field.walls, x, y, z).std() == pytest.approx(0.15)
    assert sum_of_waves(field.closing, x, y, z).std() == pytest.approx(1)


def test_folded_cells_are_warned_of():
    """The derivative of the shift, against differences."""
    context = PlainContext(1)
    field = StochasticGyroid(bend=0.2).run(context)
    x = (np.arange(64) + 0.5) / 64
    h = 1e-6
    steep = [
        (sum_of_waves(bend, *ahead) - sum_of_waves(bend, *back)).std() / (2 * h)
        for bend, ahead, back in zip(
            field.bends,
            [(x + h, x, x), (x, x + h, x), (x, x, x + h)],
            [(x - h, x, x), (x, x - h, x), (x, x, x - h)],
            strict=True,
        )
    ]
    assert context.reported["cell_length_variation"] == pytest.approx(max(steep) / (2 * np.pi * 3), rel=1e-5)
    assert "folded back" in context.warnings[0]
    context = PlainContext(1)
    StochasticGyroid().run(context)
    assert not context.warnings


STAGES = [
    Spinodoid(edge=Length(5.0)),
    Spinodoid(edge=Length(5.0), cones=(30.0, 30.0, 30.0)),
    StochasticGyroid(edge=Length(5.0)),
]


@pytest.mark.parametrize("stage", STAGES)
def test_opposite_faces_are_equal_to_the_last_bit(stage):
    values = made(stage).sample(cell_nodes(19))
    for axis in range(3):
        assert (np.take(values, 0, axis) == np.take(values, -1, axis)).all()


@pytest.mark.parametrize("stage", STAGES)
def test_layers_threads_and_cuts_give_the_same_bytes(stage):
    field, grid = made(stage), Grid((0.013, 0.2, 0.07), (1 / 37,) * 3, (90, 70, 60))
    whole = field.sample(grid)
    assert (field.sample(grid, 2) == whole).all()
    assert (field.sample_layers(grid, 11, 29) == whole[:, :, 11:29]).all()
    exact = field.sample(Grid((0.125, 0.25, 0.5), (1 / 64,) * 3, (63, 48, 40)))
    part = field.sample(Grid((0.125 + 9 / 64, 0.25 + 10 / 64, 0.5 + 5 / 64), (1 / 64,) * 3, (31, 20, 10)))
    assert (exact[9:40, 10:30, 5:15] == part).all()


@pytest.mark.parametrize("stage", STAGES)
def test_density_is_reached_and_solid_and_void_run_through(stage):
    tuned = TunePorosity(target=0.6).run(PlainContext(), recipe_of(stage))
    n = 101
    grid = Grid((0.31 / n, 0.72 / n, 0.17 / n), (1 / n,) * 3, (n,) * 3)
    assert float((tuned.sample(grid) >= 0).mean()) == pytest.approx(0.6, abs=0.001)
    CheckConnectivity(bicontinuous=True).run(PlainContext(), tuned)
    tiling = PeriodicTiling(cells=(2, 1, 1)).run(PlainContext(), tuned, None)
    assert MarchingCubes(resolution=24).run(PlainContext(), tiling).bounds_solid


def test_designs_that_make_no_sense():
    with pytest.raises(ConfigError, match="empty"):
        made(Spinodoid(cones=(0.0, 0.0, 0.0)))
    with pytest.raises(ConfigError, match="separate layers"):
        made(Spinodoid(cones=(10.0, 0.0, 0.0)))
    with pytest.raises(DesignError, match="different waves"):
        made(Spinodoid(waves=10_000))
    with pytest.raises(DesignError, match="in the cones"):
        made(Spinodoid(wavenumber=1.5, shell=0.01))
