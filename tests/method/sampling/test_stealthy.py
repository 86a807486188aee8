"""Stealthy points: no structure factor at long waves, yet no crystal; and the spacing is kept."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.capacity import min_spacing
from sppm_pipeline.method.sampling.stealthy import FREE, TOLERANCE, _Landscape, stealthy_waves, throw_stealthy
from sppm_pipeline.method.sampling.structure_factor import longest_waves, structure_factor


def all_waves(reach: int) -> NDArray[np.float64]:
    k = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3), -1).reshape(-1, 3)
    return k[(k != 0).any(1)].astype(float)


def obvious(points: NDArray[np.float64], waves: NDArray[np.float64]) -> NDArray[np.float64]:
    """The structure factor, one sum for each wave."""
    return np.array([abs(np.exp(-2j * np.pi * (points @ k)).sum()) ** 2 for k in waves]) / len(points)


@pytest.mark.parametrize(("count", "stealth", "apart"), [(30, 0.2, 0.0), (95, 0.5, 0.0), (95, 0.4, 0.9)])
def test_no_structure_factor_up_to_the_shortest_silenced_wave(count: int, stealth: float, apart: float) -> None:
    waves = stealthy_waves(count, stealth)
    spacing = apart * count ** (-1 / 3)
    points = throw_stealthy(np.random.default_rng(3), count, waves, spacing)
    assert points.shape == (count, 3)
    assert 0 <= points.min() <= points.max() < 1
    k = all_waves(8)
    length = np.linalg.norm(k, axis=1)
    silent = length <= waves.radius * (1 + 1e-12)
    assert silent.sum() == 2 * waves.number <= 2 * stealth * 3 * (count - 1)
    s = obvious(points, k)
    assert s[silent].max() <= 1e-10
    # beyond, waves are as loud as those of a disordered set; a crystal would be silent but for a few peaks
    assert 0.5 < s[~silent].mean() < 1.5
    assert np.median(s[~silent]) > 0.2
    assert min_spacing(points) >= spacing
    independent = np.random.default_rng(3).random((count, 3))
    assert obvious(independent, k[silent]).mean() > 0.5


def test_the_number_of_pores_in_large_balls_varies_less_than_for_independent_pores() -> None:
    rng = np.random.default_rng(4)
    evened, independent = throw_stealthy(rng, 150, stealthy_waves(150, 0.45)), rng.random((150, 3))
    centers = rng.random((400, 3))

    def variance(points: NDArray[np.float64]) -> float:
        d = points[None] - centers[:, None]
        return float((np.linalg.norm(d - np.round(d), axis=-1) < 0.3).sum(1).var())

    assert variance(evened) < 0.35 * variance(independent)


@pytest.mark.parametrize("most", [1, 3, 20, 141])
def test_waves_come_in_whole_shells_without_their_negatives(most: int) -> None:
    waves = longest_waves(most)
    vectors = waves.vectors().reshape(-1, 3)
    assert len(vectors) == waves.number <= most
    assert len(np.unique(np.concatenate([vectors, -vectors]), axis=0)) == 2 * waves.number
    squared = (all_waves(8) ** 2).sum(1)
    assert (squared <= waves.radius**2 + 1e-9).sum() == 2 * waves.number
    next_shell = int((squared == squared[squared > waves.radius**2 + 1e-9].min()).sum())
    assert waves.number + next_shell // 2 > most


def test_the_fast_structure_factor_is_the_obvious_one() -> None:
    points, waves = np.random.default_rng(0).random((40, 3)), longest_waves(200)
    expected = obvious(points, waves.vectors().astype(float))
    np.testing.assert_allclose(structure_factor(points, waves), expected, atol=1e-12)
    # a lattice is seen by its reciprocal lattice only, and there by all points
    cubic = np.stack(np.meshgrid(*[np.arange(3) / 3] * 3), -1).reshape(-1, 3)
    peaks = (waves.vectors() % 3 == 0).all(1)
    np.testing.assert_allclose(structure_factor(cubic, waves), np.where(peaks, 27.0, 0.0), atol=1e-12)
    halves = structure_factor(np.concatenate([points, points]), waves, np.full(80, 0.5))
    np.testing.assert_allclose(halves, expected, atol=1e-12)


@pytest.mark.parametrize("periodic", [True, False])
def test_the_gradient_is_that_of_the_energy(periodic: bool) -> None:
    rng = np.random.default_rng(1)
    around = FREE._replace(
        lower=np.full(3, 0.1), upper=np.full(3, 0.9), periodic=periodic,
        fixed=rng.random((5, 3)), weight=rng.random(5), obstacles=rng.random((4, 3)),
    )  # fmt: skip
    energy = _Landscape(20, stealthy_waves(20, 0.4), 0.3, around, 25.0)
    points, direction = rng.random((20, 3)), rng.standard_normal((20, 3))
    slope = (energy(points)[1] * direction).sum()
    step = 1e-5
    ahead, behind = energy(points + step * direction)[0], energy(points - step * direction)[0]
    assert (ahead - behind) / (2 * step) == pytest.approx(slope, rel=1e-5)


def test_points_that_stay_are_counted_and_the_box_is_kept() -> None:
    rng = np.random.default_rng(5)
    plane = np.column_stack([np.zeros(9), rng.random((9, 2))])
    twins = np.concatenate([plane, plane + np.eye(3)[0]])
    around = FREE._replace(
        lower=np.full(3, 0.05), upper=np.full(3, 0.95), periodic=False, fixed=plane, weight=np.ones(9), obstacles=twins
    )
    waves = stealthy_waves(60, 0.2)
    points = throw_stealthy(rng, 60, waves, 0.15, around)
    assert points.min() >= 0.05
    assert points.max() <= 0.95
    assert structure_factor(np.concatenate([plane, points]), waves).max() <= 2 * TOLERANCE
    assert np.linalg.norm(points[:, None] - twins[None], axis=-1).min() >= 0.15


def test_a_plane_with_too_many_of_the_points_is_refused_before_any_work() -> None:
    # K + 1 planes with as many points each are the most that hide K waves; here 40 of 60 lie in one
    plane = np.column_stack([np.zeros(40), np.random.default_rng(0).random((40, 2))])
    around = FREE._replace(fixed=plane, weight=np.ones(40))
    with pytest.raises(DesignError, match="40 of 60 pores lie on one face"):
        throw_stealthy(np.random.default_rng(0), 20, stealthy_waves(20, 0.2), 0.0, around)


def test_a_spacing_that_no_packing_has_is_an_error_that_names_the_ways_out() -> None:
    with pytest.raises(DesignError, match="can't be hidden") as error:
        throw_stealthy(np.random.default_rng(0), 8, stealthy_waves(8, 0.2), 0.9)
    assert "smaller `spacing`" in str(error.value.hint)


def test_too_few_points_are_refused_with_the_least_number() -> None:
    with pytest.raises(DesignError, match="no wave at all") as error:
        stealthy_waves(4, 0.2)
    assert "at least 6 pores" in str(error.value.hint)
    assert stealthy_waves(6, 0.2).number == 3


def test_the_number_of_threads_changes_no_byte() -> None:
    code = (
        "import numpy as np, hashlib; from sppm_pipeline.method.sampling.stealthy import *;"
        "p = throw_stealthy(np.random.default_rng(0), 95, stealthy_waves(95, .45), .16);"
        "print(hashlib.sha256(p.tobytes()).hexdigest())"
    )
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    digests = {
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | dict.fromkeys(names, threads),
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    }
    assert len(digests) == 1
