"""Stealthy pores: no structure factor at long waves, yet no crystal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from sppm_lattice_points.hyperuniform import TOLERANCE, Hyperuniform
from sppm_lattice_points.structure_factor import stealthy, structure_factor, wave_vectors

from sppm_pipeline.data.length import Cell
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.pores import PoreSet
from sppm_pipeline.errors import DesignError
from sppm_pipeline.stage import Stage
from sppm_pipeline.testing.contracts import SamplerContract
from sppm_pipeline.testing.plain_context import PlainContext


class TestHyperuniform(SamplerContract):
    def stages(self) -> Sequence[Stage]:
        return [Hyperuniform(count=20), Hyperuniform(count=40, stealth=0.3)]


def all_waves(reach: int) -> np.ndarray:
    k = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3), -1).reshape(-1, 3)
    return k[(k != 0).any(1)].astype(float)


@pytest.mark.parametrize(("count", "stealth"), [(30, 0.2), (60, 0.4), (100, 0.45)])
def test_no_structure_factor_up_to_the_shortest_silenced_wave(count: int, stealth: float) -> None:
    context = PlainContext(2, palette=Palette(interiors=2))
    pores = Hyperuniform(count=count, stealth=stealth).run(context, None)
    k = all_waves(8)
    radius = np.linalg.norm(k, axis=1)
    silent = radius <= 1 / context.reported["shortest_wave"] * (1 + 1e-12)
    assert silent.sum() == context.reported["waves"] <= 2 * stealth * 3 * (count - 1)
    for t in range(2):
        # the obvious way, with one sum for each wave
        s = np.array([abs(np.exp(-2j * np.pi * (pores.of_piece(t) @ q)).sum()) ** 2 for q in k]) / count
        assert s[silent].max() <= 2 * TOLERANCE
        # beyond, waves are as loud as those of a disordered set; a crystal would be silent but for a few peaks
        assert 0.5 < s[~silent].mean() < 1.5
        assert np.median(s[~silent]) > 0.2


def test_independent_pores_are_loud_at_the_same_waves() -> None:
    points = np.random.default_rng(0).random((60, 3))
    assert structure_factor(points, wave_vectors(60, 0.4)).mean() > 0.5


def test_the_number_of_pores_in_large_balls_varies_less_than_for_independent_pores() -> None:
    rng = np.random.default_rng(4)
    waves = wave_vectors(150, 0.45)
    evened = stealthy(rng.random((150, 3)), waves, tolerance=TOLERANCE, steps=20_000)
    independent = rng.random((150, 3))
    centers = rng.random((400, 3))

    def variance(points: np.ndarray) -> float:
        d = points[None] - centers[:, None]
        return float((np.linalg.norm(d - np.round(d), axis=-1) < 0.3).sum(1).var())

    assert variance(evened) < 0.35 * variance(independent)


def test_waves_come_in_whole_shells_without_their_negatives() -> None:
    waves = wave_vectors(60, 0.4)
    length2 = (waves**2).sum(1)
    both = np.concatenate([waves, -waves])
    assert len(np.unique(both, axis=0)) == 2 * len(waves)
    k = all_waves(8)
    assert ((k**2).sum(1) <= length2.max()).sum() == 2 * len(waves)
    assert (np.diff(length2) >= 0).all()


def test_too_few_pores_are_refused_with_the_least_number() -> None:
    with pytest.raises(DesignError, match="bind no wave") as error:
        Hyperuniform(count=4, stealth=0.2).run(PlainContext(), None)
    assert "at least 6 pores" in str(error.value.hint)
    Hyperuniform(count=6, stealth=0.2).run(PlainContext(), None)


def test_steps_that_do_not_suffice_are_told() -> None:
    with pytest.raises(DesignError, match="after 3 steps"):
        stealthy(np.random.default_rng(0).random((60, 3)), wave_vectors(60, 0.5), tolerance=TOLERANCE, steps=3)


def test_with_face_pores_the_box_is_hyperuniform_and_the_user_is_told() -> None:
    faces = PoreSet(
        cell=Cell(), centers=np.array([[0.0, 0.5, 0.5]]), piece=np.array([1], np.int32), colors=(1, 0, 0), spacing=0.1
    )
    context = PlainContext(1)
    interior = Hyperuniform(count=40).run(context, faces).of_piece(0)
    assert "only the box" in context.warnings[0]
    assert structure_factor((interior - 0.1) / 0.8, wave_vectors(40, 0.4)).max() <= 2 * TOLERANCE
