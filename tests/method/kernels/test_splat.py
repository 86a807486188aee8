import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.kernels.kernels import Kernels, concatenated, empty_kernels
from sppm_pipeline.method.kernels.splat import add_kernels
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.testing.exact_sum import cutoff_bound, exact_sum


def random_kernels(seed: int, pores: int, tunnels: int, profile: str = "linear", spread: float = 1.6) -> Kernels:
    """Kernels of many sizes in and around the unit cube, with short, long, axis-parallel and degenerate tunnels."""
    rng = np.random.default_rng(seed)
    starts = (rng.random((tunnels, 3)) - 0.5) * spread + 0.5
    ends = starts + rng.normal(size=(tunnels, 3)) * rng.choice([1e-9, 1e-4, 0.1, 0.5], (tunnels, 1))
    along_axis = rng.random(tunnels) < 0.3
    keep = rng.integers(0, 3, tunnels)
    for axis in range(3):
        ends[along_axis & (keep != axis), axis] = starts[along_axis & (keep != axis), axis]
    return Kernels(
        (rng.random((pores, 3)) - 0.5) * spread + 0.5,
        np.exp(rng.uniform(np.log(20.0), np.log(2000.0), pores)),
        starts,
        ends,
        np.exp(rng.uniform(np.log(10.0), np.log(300.0), tunnels)),
        profile,
    )


def points_of(grid: Grid) -> np.ndarray:
    z, y, x = np.meshgrid(grid.axis(2), grid.axis(1), grid.axis(0), indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def splat(grid: Grid, kernels: Kernels, **options: float) -> np.ndarray:
    out = np.zeros(grid.shape[::-1], dtype=np.float32)
    add_kernels(out, grid, kernels, **options)
    return out


def bound_on(grid: Grid, kernels: Kernels, cutoff: float) -> float:
    lower = np.array(grid.origin)
    return cutoff_bound(kernels, lower, lower + np.array(grid.spacing) * (np.array(grid.shape) - 1), cutoff)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    pores=st.integers(0, 12),
    tunnels=st.integers(0, 12),
    profile=st.sampled_from(["linear", "squared"]),
    shape=st.tuples(st.integers(1, 40), st.integers(1, 20), st.integers(1, 12)),
    spacing=st.tuples(*[st.floats(0.004, 0.2)] * 3),
    origin=st.tuples(*[st.floats(-0.3, 0.6)] * 3),
    cutoff=st.sampled_from([1e-2, 1e-4, 1e-5, 1e-8]),
)
def test_within_the_stated_bound_of_the_exact_sum(
    seed, pores, tunnels, profile, shape, spacing, origin, cutoff
) -> None:
    grid, kernels = Grid(origin, spacing, shape), random_kernels(seed, pores, tunnels, profile)
    error = np.abs(splat(grid, kernels, cutoff=cutoff).ravel() - exact_sum(kernels, points_of(grid)))
    assert error.max() <= bound_on(grid, kernels, cutoff)


@pytest.mark.parametrize("profile", ["linear", "squared"])
def test_a_dense_cell(profile: str) -> None:
    kernels = random_kernels(5, 150, 500, profile, spread=1.3)
    grid = cell_centers(24)
    exact = exact_sum(kernels, points_of(grid))
    error = np.abs(splat(grid, kernels, cutoff=1e-6).ravel() - exact)
    assert error.max() <= min(bound_on(grid, kernels, 1e-6), 2e-4)
    assert exact.max() > 3.0


@pytest.mark.parametrize("end", [(0.5, 0.5, 0.5), (0.8, 0.5, 0.5), (0.5, 0.8, 0.5), (0.5, 0.5, 0.8), (0.8, 0.8, 0.2)])
@pytest.mark.parametrize("turn", [1, -1])
def test_one_tunnel(end: tuple[float, float, float], turn: int) -> None:
    ends = [np.array([[0.5, 0.5, 0.5]]), np.array([end])][::turn]
    kernels = empty_kernels()._replace(starts=ends[0], ends=ends[1], mu=np.array([40.0]))
    grid = cell_centers(25)
    assert splat(grid, kernels, cutoff=1e-7).ravel() == pytest.approx(exact_sum(kernels, points_of(grid)), abs=1e-5)


def test_a_single_kernel_is_missing_only_below_the_cutoff() -> None:
    kernels = empty_kernels()._replace(centers=np.array([[0.4, 0.55, 0.5]]), omega=np.array([60.0]))
    grid = cell_centers(40)
    field, exact = splat(grid, kernels, cutoff=1e-3).ravel(), exact_sum(kernels, points_of(grid))
    assert (field[exact > 1.001e-3] > 0.0).all()
    assert (field == 0.0).mean() > 0.5
    assert exact[field == 0.0].max() <= 1.001e-3


def test_far_from_the_origin_nothing_is_lost() -> None:
    kernels = random_kernels(8, 10, 20)
    far = np.array([1000.0, 700.0, -900.0])
    near = splat(cell_centers(20), kernels)
    shifted = splat(Grid(tuple(far + 0.025), (0.05,) * 3, (20,) * 3), kernels.shifted(far))
    assert shifted == pytest.approx(near, abs=3e-5)


def test_what_was_there_stays() -> None:
    kernels, grid = random_kernels(1, 3, 3), cell_centers(17)
    out = np.full((17, 17, 17), 2.0, dtype=np.float32)
    add_kernels(out, grid, kernels)
    assert out - 2.0 == pytest.approx(splat(grid, kernels), abs=1e-5)


def test_same_bytes_for_any_number_of_threads_and_any_slab() -> None:
    kernels = random_kernels(2, 30, 60)
    for grid in (cell_centers(32), cell_centers(27), Grid((0.1, -0.2, 0.03), (0.011, 0.07, 0.013), (50, 20, 61))):
        whole = splat(grid, kernels)
        for threads in (2, 3):
            assert splat(grid, kernels, threads=threads).tobytes() == whole.tobytes()
        for start, stop in ((0, 1), (5, 19), (19, 27)):
            part = np.zeros((stop - start, *whole.shape[1:]), dtype=np.float32)
            add_kernels(part, grid, kernels, first_layer=start)
            assert part.tobytes() == whole[start:stop].tobytes()


def test_kernels_out_of_reach_add_nothing() -> None:
    kernels = random_kernels(4, 5, 5)
    assert not splat(cell_centers(16), kernels.shifted(np.array([50.0, 0.0, 0.0]))).any()
    assert not splat(cell_centers(16), empty_kernels()).any()


def test_the_order_of_separate_calls_is_the_sum() -> None:
    first, second = random_kernels(6, 4, 0), random_kernels(7, 0, 9)
    grid = cell_centers(16)
    out = np.zeros((16, 16, 16), dtype=np.float32)
    add_kernels(out, grid, first)
    add_kernels(out, grid, second)
    assert out.tobytes() == splat(grid, concatenated([first, second])).tobytes()


def test_bad_arguments() -> None:
    kernels, grid = random_kernels(0, 2, 2), cell_centers(8)
    good = np.zeros((8, 8, 8), dtype=np.float32)
    with pytest.raises(ValueError, match="float32"):
        add_kernels(good.astype(np.float64), grid, kernels)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="C-contiguous"):
        add_kernels(good[:, :, ::-1], grid, kernels)
    with pytest.raises(ValueError, match="layers"):
        add_kernels(good, grid, kernels, first_layer=1)
    with pytest.raises(ValueError, match="positive"):
        add_kernels(good, grid, kernels._replace(omega=-kernels.omega))
    with pytest.raises(ValueError, match="finite"):
        add_kernels(good, grid, kernels._replace(starts=np.full((2, 3), np.nan)))
