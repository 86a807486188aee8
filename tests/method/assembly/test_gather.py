from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.assembly import gather
from sppm_pipeline.method.assembly.contents import Pieces, TilingArrays, check_tiling, lone_periodic_cell
from sppm_pipeline.method.assembly.gather import kernels_in_box as _kernels_in_box
from sppm_pipeline.method.assembly.gather import make_catalog, sample_exact
from sppm_pipeline.method.assembly.overlap_add import assemble
from sppm_pipeline.method.assembly.patches import build_bank
from sppm_pipeline.method.kernels.kernels import Kernels, concatenated, empty_kernels
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.testing.exact_sum import cutoff_bound, exact_sum


def kernels_in_box(pieces, tiling, lower, upper, cutoff=1e-5) -> Kernels:
    return _kernels_in_box(make_catalog(pieces, cutoff), tiling, np.asarray(lower, float), np.asarray(upper, float))


def points_of(grid: Grid) -> np.ndarray:
    x, y, z = np.meshgrid(*(grid.axis(axis) for axis in range(3)), indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    shape=st.tuples(*[st.integers(1, 4)] * 3),
    periodic=st.booleans(),
    profile=st.sampled_from(["linear", "squared"]),
    corner=st.tuples(*[st.floats(-1.5, 4.5)] * 3),
    size=st.tuples(*[st.floats(0.0, 2.0)] * 3),
)
def test_no_kernel_of_the_box_is_missed(sets, seed, shape, periodic, profile, corner, size) -> None:
    pieces = sets.pieces(seed, profile=profile)
    tiling = sets.tiling(seed, shape, pieces, periodic)
    lower = np.array(corner)
    points = lower + np.random.default_rng(seed).random((30, 3)) * size
    gathered = kernels_in_box(pieces, tiling, lower, lower + size, 1e-11)
    everything = sets.every_kernel(pieces, tiling, images=1 if periodic else 0)
    wrapped = points % np.array(shape) if periodic else points
    assert exact_sum(gathered, points) == pytest.approx(exact_sum(everything, wrapped), abs=1e-8)


def test_each_kernel_once(sets) -> None:
    pieces = sets.pieces(3)
    tiling = sets.tiling(4, (3, 2, 2), pieces)
    gathered = kernels_in_box(pieces, tiling, (-9, -9, -9), (9, 9, 9))
    everything = sets.every_kernel(pieces, tiling)

    def rows(kernels: Kernels) -> list[tuple[float, ...]]:
        tunnels = np.column_stack([kernels.starts, kernels.ends, kernels.mu]).round(12).tolist()
        return sorted(map(tuple, np.column_stack([kernels.centers, kernels.omega]).round(12).tolist() + tunnels))

    assert rows(gathered) == rows(everything)


def test_the_order_does_not_depend_on_the_box(sets) -> None:
    pieces = sets.pieces(5)
    tiling = sets.tiling(6, (3, 3, 3), pieces)
    everything = kernels_in_box(pieces, tiling, (-9, -9, -9), (9, 9, 9))
    part = kernels_in_box(pieces, tiling, (1.2, 0.7, 1.1), (1.4, 2.0, 1.2))
    place = {tuple(row): i for i, row in enumerate(everything.centers)}
    order = [place[tuple(row)] for row in part.centers]
    assert len(order) > 10
    assert order == sorted(order)


def test_a_far_box_of_a_huge_tiling(sets) -> None:
    pieces = sets.pieces(7)
    size = (120, 120, 120)
    interior = np.zeros(size, dtype=np.int32)
    faces = [np.ones(tuple(s + (a == axis) for a, s in enumerate(size)), dtype=np.int32) for axis in range(3)]
    tiling = TilingArrays(interior, (faces[0], faces[1], faces[2]), False)
    small = tiling._replace(
        interior=interior[:5, :5, :5], faces=(faces[0][:6, :5, :5], faces[1][:5, :6, :5], faces[2][:5, :5, :6])
    )
    points = np.random.default_rng(0).random((20, 3)) * 0.5 + 2.2
    there = exact_sum(kernels_in_box(pieces, tiling, np.full(3, 82.2), np.full(3, 82.7), 1e-9), points + 80.0)
    assert there == pytest.approx(
        exact_sum(kernels_in_box(pieces, small, np.full(3, 2.2), np.full(3, 2.7), 1e-9), points)
    )


@pytest.mark.parametrize("profile", ["linear", "squared"])
def test_sample_exact_on_a_grid_that_does_not_fit_the_cells(sets, profile: str) -> None:
    pieces = sets.pieces(8, profile=profile)
    tiling = sets.tiling(9, (3, 2, 2), pieces)
    grid = Grid((-0.31, -0.2, -0.4), (0.083, 0.0713, 0.127), (47, 41, 25))
    field = sample_exact(pieces, tiling, grid)
    everything = sets.every_kernel(pieces, tiling)
    error = np.abs(field.ravel() - exact_sum(everything, points_of(grid)))
    lower = np.array(grid.origin)
    upper = lower + np.array(grid.spacing) * (np.array(grid.shape) - 1)
    assert error.max() <= cutoff_bound(everything, lower, upper)


def test_bands_threads_and_slabs_give_the_same_bytes(sets) -> None:
    pieces = sets.pieces(10)
    tiling = sets.tiling(11, (2, 2, 2), pieces, periodic=True)
    grid = Grid((-3.0, -2.0, 0.0), (0.5, 0.03, 0.04), (150, 120, 40))
    whole = sample_exact(pieces, tiling, grid)
    assert sample_exact(pieces, tiling, grid, threads=3).tobytes() == whole.tobytes()
    for start, stop in ((0, 1), (3, 20), (20, 40), (7, 7)):
        part = sample_exact(pieces, tiling, grid, layer_start=start, layer_stop=stop)
        assert part.tobytes() == whole[:, :, start:stop].tobytes()
    with pytest.raises(ValueError, match="layers"):
        sample_exact(pieces, tiling, grid, layer_start=3, layer_stop=41)


def test_kept_lists_of_kernels_serve_their_own_tiling_grid_and_layers_alone(sets, monkeypatch) -> None:
    pieces = sets.pieces(10)
    tilings = [sets.tiling(seed, (2, 2, 2), pieces, periodic=False) for seed in (11, 12)]
    grid = Grid((0.2, 0.1, 0.0), (0.05, 0.05, 0.04), (30, 40, 40))
    grids = [grid, grid._replace(origin=(0.3, 0.1, 0.0)), grid._replace(spacing=(0.04, 0.05, 0.04))]
    grids += [grid._replace(shape=(31, 40, 40)), grid._replace(shape=(30, 41, 40))]
    spans = [(0, 3), (3, 20), (20, 40)]
    catalog, gathered = make_catalog(pieces, 1e-5), []
    listed = gather.kernels_in_box
    monkeypatch.setattr(gather, "kernels_in_box", lambda *args: gathered.append(args) or listed(*args))
    for tiling in tilings:
        for grid in grids:
            alone = sample_exact(pieces, tiling, grid, 1e-5).tobytes()
            gathered.clear()
            parts = [sample_exact(pieces, tiling, grid, 1e-5, 1, *span, catalog=catalog) for span in spans]
            assert np.concatenate(parts, axis=2).tobytes() == alone
            assert len(gathered) == 1  # of two cells of layers
    assert len(catalog.kept) == len(tilings) * len(grids)
    monkeypatch.setattr(gather, "_KEPT", 0)
    sample_exact(pieces, tilings[0], Grid((0.0,) * 3, (0.1,) * 3, (9, 9, 9)), 1e-5, catalog=catalog)
    assert not catalog.kept


def test_a_lone_cell_is_the_periodic_cell(sets) -> None:
    pieces = sets.pieces(12, share=1.0)
    tiling = lone_periodic_cell(1, (0, 1, 1))
    members = sets.lone(pieces, 1, (0, 1, 1))
    field = sample_exact(pieces, tiling, cell_centers(20))
    steps = [np.array(step, float) for step in np.ndindex(5, 5, 5)]
    images = concatenated(members.shifted(step - 2.0) for step in steps)
    assert field.ravel() == pytest.approx(exact_sum(images, points_of(cell_centers(20))), abs=2e-4)


def test_cells_of_the_halo_count_but_are_not_of_the_box(sets) -> None:
    pieces = sets.pieces(14)
    whole = sets.tiling(15, (5, 4, 6), pieces)
    inner = whole._replace(halo=1)
    check_tiling(inner, pieces)
    assert inner.shape == (3, 2, 4)
    assert (inner.box == whole.interior[1:-1, 1:-1, 1:-1]).all()
    grid = Grid((-0.7, 0.1, -0.3), (0.11, 0.13, 0.17), (40, 12, 25))
    moved = grid._replace(origin=(0.3, 1.1, 0.7))
    assert sample_exact(pieces, inner, grid) == pytest.approx(sample_exact(pieces, whole, moved), abs=1e-5)
    bank = build_bank(pieces, 8)
    there, here = assemble(bank, inner, -8, 30, -3, 20, 0, 9), assemble(bank, whole, 0, 38, 5, 28, 8, 17)
    assert there.tobytes() == here.tobytes()
    with pytest.raises(ValueError, match="no halo"):
        check_tiling(whole._replace(halo=2))


def test_moving_a_lone_cell_by_a_voxel_moves_the_field(sets) -> None:
    pieces, n = sets.pieces(13), 16
    offset = np.array([3.0, 0.0, -2.0]) / n
    moved = replace(pieces, kernels=pieces.kernels.shifted(offset))
    there, here = (sample_exact(p, lone_periodic_cell(), cell_centers(n)) for p in (moved, pieces))
    assert there == pytest.approx(np.roll(here, (3, -2), (0, 2)), abs=1e-4)


def test_nothing_anywhere(sets) -> None:
    pieces = sets.pieces(0)
    tiling = sets.tiling(0, (2, 2, 2), pieces, holes=1.0)
    assert len(kernels_in_box(pieces, tiling, (0, 0, 0), (2, 2, 2)).centers) == 0
    assert not sample_exact(pieces, tiling, cell_centers(4, (2, 2, 2))).any()
    bare = Pieces.of([empty_kernels()], [[empty_kernels()]] * 3)
    assert not sample_exact(bare, lone_periodic_cell(), cell_centers(4)).any()
