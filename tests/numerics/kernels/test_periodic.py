import numpy as np
import pytest

from sppm_pipeline.numerics.kernels.bounds import cutoff_bound
from sppm_pipeline.numerics.kernels.exact import exact_sum
from sppm_pipeline.numerics.kernels.kernels import Kernels, concatenated, empty_kernels
from sppm_pipeline.numerics.kernels.periodic import periodic_images, sample_periodic


def cell(seed: int, squared: bool = False) -> Kernels:
    rng = np.random.default_rng(seed)
    starts = rng.random((20, 3))
    return Kernels(
        rng.random((12, 3)),
        rng.uniform(60.0, 300.0, 12),
        starts,
        starts + rng.normal(size=(20, 3)) * 0.2,
        rng.uniform(30.0, 90.0, 20),
        squared,
    )


def all_images(kernels: Kernels, reach: int) -> Kernels:
    steps = range(-reach, reach + 1)
    return concatenated(kernels.shifted(np.array([x, y, z], float)) for x in steps for y in steps for z in steps)


@pytest.mark.parametrize("squared", [False, True])
def test_images_hold_every_kernel_that_matters(squared: bool) -> None:
    kernels = cell(1, squared)
    points = np.random.default_rng(0).random((300, 3))
    images = periodic_images(kernels, cutoff=1e-9)
    everything = all_images(kernels, 2)
    assert len(images.starts) < len(everything.starts) / 3
    assert exact_sum(images, points) == pytest.approx(exact_sum(everything, points), abs=1e-6)


def test_images_of_a_box_elsewhere() -> None:
    kernels = cell(2)
    lower, upper = np.array([7.2, -3.5, 0.1]), np.array([9.0, -3.4, 0.2])
    points = lower + np.random.default_rng(1).random((50, 3)) * (upper - lower)
    there = exact_sum(periodic_images(kernels, lower, upper, 1e-10), points)
    assert there == pytest.approx(exact_sum(all_images(kernels, 2), points % 1.0), abs=1e-7)


@pytest.mark.parametrize("n", [16, 21])
@pytest.mark.parametrize("squared", [False, True])
def test_field_within_the_bound_of_the_infinite_sum(n: int, squared: bool) -> None:
    kernels = cell(3, squared)
    images = periodic_images(kernels, cutoff=1e-12)
    x = (np.arange(n) + 0.5) / n
    points = np.stack(np.meshgrid(x, x, x, indexing="ij")[::-1], axis=-1).reshape(-1, 3)
    error = np.abs(sample_periodic(kernels, n).ravel() - exact_sum(images, points))
    assert error.max() <= cutoff_bound(images, np.zeros(3), np.ones(3))


def test_opposite_faces_agree_to_the_last_bit() -> None:
    field = sample_periodic(cell(4), 19, "nodes")
    assert field.shape == (20, 20, 20)
    for axis in range(3):
        assert np.take(field, 0, axis).tobytes() == np.take(field, -1, axis).tobytes()
    inner = sample_periodic(cell(4), 38, "nodes")[::2, ::2, ::2]
    assert inner == pytest.approx(field, abs=1e-4)


def test_moving_the_cell_by_a_voxel_moves_the_field() -> None:
    kernels, n = cell(5), 16
    moved = sample_periodic(kernels.shifted(np.array([3.0, 0.0, -2.0]) / n), n)
    assert moved == pytest.approx(np.roll(sample_periodic(kernels, n), (-2, 3), (0, 2)), abs=1e-4)


def test_threads_and_nothing() -> None:
    kernels = cell(6)
    for at in ("centers", "nodes"):
        one, three = (sample_periodic(kernels, 24, at, threads=t) for t in (1, 3))  # type: ignore[arg-type]
        assert one.tobytes() == three.tobytes()
    assert not sample_periodic(empty_kernels(), 5).any()


def test_bad_arguments() -> None:
    with pytest.raises(ValueError, match="at least one voxel"):
        sample_periodic(cell(0), 0)
    with pytest.raises(ValueError, match="'centers' or 'nodes'"):
        sample_periodic(cell(0), 4, "corners")  # type: ignore[arg-type]


def test_the_bound_shrinks_with_the_cutoff_and_with_blocks() -> None:
    images = periodic_images(cell(7), cutoff=1e-12)
    bounds = [cutoff_bound(images, np.zeros(3), np.ones(3), cutoff) for cutoff in (1e-2, 1e-3, 1e-4)]
    assert bounds[0] > 3 * bounds[1] > 9 * bounds[2] > 0.0
    coarse, fine = (cutoff_bound(images, np.zeros(3), np.ones(3), 1e-3, blocks) for blocks in (2, 12))
    assert fine < coarse
    assert cutoff_bound(empty_kernels(), np.zeros(3), np.ones(3)) == 0.0
