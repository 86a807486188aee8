"""Fine grids interpolated from coarse sums: near the direct sum, and a sample depends on its position alone."""

import math
import threading
from dataclasses import replace

import numpy as np
import pytest

from sppm_pipeline.method.assembly import overlap_add
from sppm_pipeline.method.fields import fine_sampler, kernel_sum
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.slicing import sampled_slices
from sppm_pipeline.method.slicing.sampled_slices import FieldSlices
from sppm_pipeline.method.stages.tile_free_faces import FreeFacesTiling
from sppm_pipeline.method.stages.tile_fresh import FreshTiling
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.method.stages.tileset_free_faces import FreeFacesTileSet
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid, cell_centers, cell_nodes
from sppm_pipeline.testing.plain_context import PlainContext
from tests.conftest import small_recipe

FINE = Grid((0.203, -0.05, 0.4), (0.0115, 0.0135, 0.0155), (95, 80, 65))
"""Neither fits the cells nor has cubes for voxels; reaches beyond the lattice."""


@pytest.fixture(scope="module")
def fresh():
    """2 x 2 x 2 cells, each of its own."""
    return FreshTiling(cells=(2, 2, 2), cell=Length(4, "mm")).run(PlainContext(8), small_recipe(), None)


@pytest.fixture(scope="module")
def fields(cell, wang_tiling, free_tiling, fresh):
    periodic = PeriodicTiling(cells=(2, 1, 1)).run(PlainContext(), cell, None)
    return {"cell": cell, "wang": wang_tiling, "free": free_tiling, "fresh": fresh, "periodic": periodic}


def interpolates(field, grid):
    return field._fine(grid, 1) is not None


@pytest.mark.parametrize("name", ["cell", "wang", "free", "fresh", "periodic"])
def test_few_samples_change_sides_and_none_far_from_the_surface(fields, name):
    field = fields[name]
    assert interpolates(field, FINE)
    assert not interpolates(field.exactly(), FINE)
    exact = field.exactly().sample(FINE)
    values = field.sample(FINE)
    changed = (values < 0) != (exact < 0)
    assert changed.mean() < 2e-4  # thick tunnels beside small pores are the hardest case
    assert abs((values < 0).mean() - (exact < 0).mean()) < 5e-5
    assert np.abs(exact[changed]).max(initial=0) < 5e-3
    near = np.abs(exact) < 0.1
    assert np.abs(values - exact)[near].max() < 0.02


@pytest.mark.parametrize("name", ["cell", "wang", "free", "fresh", "periodic"])
def test_slabs_threads_and_windows_change_no_bit(fields, name, monkeypatch):
    field = fields[name]
    values, solid = field.sample(FINE), field.solid(FINE)
    assert np.array_equal(solid, values < 0)
    assert field.sample(FINE, threads=2).tobytes() == values.tobytes()
    nz = FINE.shape[2]
    for height in (1, 7, 64):
        parts = [field.solid_layers(FINE, k, min(k + height, nz)) for k in range(0, nz, height)]
        assert np.concatenate(parts, axis=2).tobytes() == solid.tobytes()
    (x, y, z), (hx, hy, hz), _ = FINE
    window = Grid((x + 17 * hx, y + 11 * hy, z + 9 * hz), FINE.spacing, (40, 33, 20))
    assert field.sample(window).tobytes() == values[17:57, 11:44, 9:29].tobytes()
    monkeypatch.setattr(fine_sampler, "MAX_SAMPLES", 1)
    monkeypatch.setattr(fine_sampler, "BAND_SAMPLES", 1000)
    other = Grid(FINE.origin, FINE.spacing, (*FINE.shape[:2], 60))  # another grid, or what is kept would serve it
    assert field.sample(other).tobytes() == values[:, :, :60].tobytes()


def test_some_rows_of_wide_sheets_are_sampled_at_a_time(fresh, wedge, monkeypatch):
    part = Part(fresh, wedge)
    grid = Grid((0.01, 0.02, 0.01), (0.014, 0.0145, 0.0155), (137, 124, 105))
    whole = part.solid_bits(grid, 3, 40)
    stack = FieldSlices(source=part, grid=grid, pitch=(1, 1, 1), lower=(0, 0, 0), islands="keep")
    coated = replace(stack, source=replace(part, skin_mm=0.3))
    assert stack.height == coated.height == sampled_slices.SLAB_PIXELS // (137 * 124)
    monkeypatch.setattr(kernel_sum, "WIDE", 137 * 124 - 1)
    monkeypatch.setattr(kernel_sum, "BAND", 137 * 30)
    sampled = []
    made = fine_sampler.FineSampler.__init__
    monkeypatch.setattr(
        fine_sampler.FineSampler, "__init__", lambda self, *args: sampled.append(args[1].shape) or made(self, *args)
    )
    assert part.solid_bits(grid, 3, 40).tobytes() == whole.tobytes()
    assert {(137, 30, 105), (137, 4, 105)} <= set(sampled)
    assert stack.height == sampled_slices.WIDE_SLAB
    # what is decided by bytes, or not interpolated, has no more sheets in memory than others
    for other in (coated, replace(stack, source=part.exactly()), replace(stack, subsamples=2)):
        assert other.height == sampled_slices.SLAB_PIXELS // math.prod(other.samples.shape[:2])


def test_a_part_asks_for_some_cells_of_a_layer_only(fresh, wedge, monkeypatch):
    part = Part(fresh, wedge)
    grid = Grid((0.01, 0.02, 0.01), (0.014, 0.0145, 0.0155), (137, 124, 105))
    assert interpolates(fresh, grid)
    whole = part.solid(grid)
    sliced = np.concatenate([part.solid_layers(grid, k, k + 1) for k in range(105)], axis=2)
    assert whole.tobytes() == sliced.tobytes()
    field, inside = fresh.solid(grid), part._in_domain(grid).inside(0, 105)
    assert 0.05 < inside.mean() < 0.5
    assert np.array_equal(whole, field & inside.T)
    asked, sums = [], type(fresh).kernel_sums

    def counted(self, *arguments, wanted):
        asked.append(np.maximum(wanted[..., 1] - wanted[..., 0], 0).mean() / arguments[0].shape[0])
        return sums(self, *arguments, wanted=wanted)

    monkeypatch.setattr(type(fresh), "kernel_sums", counted)
    part.solid_layers(grid, 101, 102)
    assert 0 < sum(asked) < 0.25  # blocks of cells, of which the wedge has a corner there


@pytest.mark.parametrize("nearby", [0, 4])
@pytest.mark.parametrize("height", [1, 5, 90])
def test_a_part_has_patches_added_where_it_is(many, wedge, height, nearby, monkeypatch):
    monkeypatch.setattr(fine_sampler, "NEARBY", nearby)
    grid = Grid((0.01, 0.02, 0.01), (0.0135, 0.0145, 0.0165), (200, 138, 90))
    assert many.has_patches(many._fine(grid, 1)._n, 0.0)
    part = Part(replace(many), wedge)  # whose sampler has kept nothing
    inside = part._in_domain(grid).inside(0, 90).T
    assert 0.05 < inside.mean() < 0.6
    expected = many.solid(grid) & inside
    added, assemble = [], overlap_add.assemble

    def counted(*arguments):
        wanted = arguments[-1]
        added.append(np.maximum(wanted[:, 1] - wanted[:, 0], 0).mean() / (arguments[5] - arguments[4]))
        return assemble(*arguments)

    monkeypatch.setattr(overlap_add, "assemble", counted)
    parts = [part.solid_layers(grid, k, min(k + height, 90), 2) for k in range(0, 90, height)]
    assert np.array_equal(np.concatenate(parts, axis=2), expected)
    assert np.mean(added) < 0.8


def test_what_is_not_wanted_any_more_is_not_added_up(many, monkeypatch):
    grid = Grid((0.01, 0.02, 0.01), (0.0135, 0.0145, 0.0165), (200, 138, 90))
    field, added, assemble = replace(many), [], overlap_add.assemble
    expected = many.solid(grid)

    def counted(*arguments):
        added.append(np.maximum(arguments[-1][:, 1] - arguments[-1][:, 0], 0))
        return assemble(*arguments)

    monkeypatch.setattr(overlap_add, "assemble", counted)
    for rows in (slice(0, 20), slice(110, 138)):  # the second ones are far from the first
        wanted = np.zeros((1, 138, 2), np.int32)
        wanted[:, rows] = 120, 140
        solid = field.solid_layers(grid, 0, 1, 1, wanted)
        assert np.array_equal(solid[120:140, rows], expected[120:140, rows, :1])
    first, second = added
    assert not ((first > 0) & (second > 0)).any()


@pytest.fixture(scope="module")
def many():
    """So many cells for each interior that patches pay."""
    made = FreeFacesTileSet(colors=2, interiors=3, resolution=16).run(PlainContext(6), small_recipe())
    return FreeFacesTiling(cells=(3, 3, 2), cell=Length(4, "mm")).run(PlainContext(7), made, None)


def test_coarse_grids_are_summed_as_they_are(cell, free_tiling):
    for field in (cell, free_tiling):
        grid = cell_centers(24, field.cells)
        assert not interpolates(field, grid)
        assert field.sample(grid).tobytes() == field.exactly().sample(grid).tobytes()


def test_opposite_faces_of_a_fine_periodic_cell_are_equal_to_the_last_bit(cell):
    grid = cell_nodes(72)
    assert interpolates(cell, grid)
    values = cell.sample(grid)
    for axis in range(3):
        assert np.array_equal(np.take(values, 0, axis), np.take(values, -1, axis))


def test_a_level_too_near_the_cut_off_or_above_every_tunnel_is_summed(cell):
    assert cell.with_level(5e-4).coarse_pitch is None
    assert cell.with_level(1.5).coarse_pitch is None
    assert cell.with_level(0.05).coarse_pitch == cell.coarse_pitch  # lower levels make kernels no smoother
    assert cell.with_level(0.5).coarse_pitch < cell.coarse_pitch


def test_a_field_may_be_asked_again_after_an_interrupt(fresh, monkeypatch):
    field = replace(fresh)
    expected, stretch = field.solid(FINE), fine_sampler.stretch
    calls = []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        stretch(*arguments)

    monkeypatch.setattr(fine_sampler, "stretch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        field.solid(FINE)
    assert np.array_equal(field.solid(FINE), expected)


def test_threads_that_ask_at_once_take_turns(fresh, monkeypatch):
    """The coarse planes of one reader must not become those of another before they are interpolated."""
    field = replace(fresh)
    expected, interpolate, other = field.solid(FINE), fine_sampler.interpolate_layers, []

    def top():
        other.append(field.solid_layers(FINE, 50, 65))

    second = threading.Thread(target=top)

    def interrupted(*arguments):
        if second.ident is None:
            second.start()
            second.join(0.5)
        interpolate(*arguments)

    monkeypatch.setattr(fine_sampler, "interpolate_layers", interrupted)
    assert np.array_equal(field.solid_layers(FINE, 0, 10), expected[:, :, :10])
    second.join()
    assert np.array_equal(other[0], expected[:, :, 50:])
