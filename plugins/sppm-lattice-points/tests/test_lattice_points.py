"""Lattices: the right points, the right distances, and no jitter beyond its bound."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from sppm_lattice_points.lattice_points import BASES, NEAREST, LatticePoints

from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.stage import Stage
from sppm_pipeline.testing.contracts import SamplerContract
from sppm_pipeline.testing.plain_context import PlainContext

NEIGHBORS = {"simple": 6, "body_centered": 8, "face_centered": 12, "diamond": 4}


class TestLatticePoints(SamplerContract):
    def stages(self) -> Sequence[Stage]:
        return [LatticePoints(), LatticePoints(lattice="diamond", repeat=1, jitter=0.5)]


class TestCrystal(SamplerContract):
    random = False

    def stages(self) -> Sequence[Stage]:
        return [LatticePoints(lattice="simple", jitter=0.0)]


def periodic_distances(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of every point to every other one and to all images next door, (n, 27 n), without itself."""
    shifts = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), -1).reshape(-1, 3)
    images = (points[None] + shifts[:, None]).reshape(-1, 3)
    distances = np.linalg.norm(points[:, None] - images[None], axis=-1)
    return np.sort(distances, axis=1)[:, 1:]


@pytest.mark.parametrize("lattice", BASES)
@pytest.mark.parametrize("repeat", [1, 2, 3])
def test_every_pore_of_a_crystal_has_the_neighbors_of_its_lattice(lattice: str, repeat: int) -> None:
    context = PlainContext()
    pores = LatticePoints(lattice=lattice, repeat=repeat, jitter=0.0).run(context, None)
    assert len(pores.centers) == len(BASES[lattice]) * repeat**3
    distances = periodic_distances(pores.centers)
    nearest = NEAREST[lattice] / repeat
    np.testing.assert_allclose(distances.min(axis=1), nearest)
    assert (np.isclose(distances, nearest).sum(axis=1) == NEIGHBORS[lattice]).all()
    assert context.reported["smallest_distance"] == pytest.approx(nearest)


@pytest.mark.parametrize("lattice", BASES)
@pytest.mark.parametrize("jitter", [0.1, 0.35])
def test_jitter_bounds_moves_and_distances_across_the_faces_of_the_cell(lattice: str, jitter: float) -> None:
    crystal = LatticePoints(lattice=lattice, repeat=2, jitter=0.0).run(PlainContext(), None).centers
    context = PlainContext(3)
    pores = LatticePoints(lattice=lattice, repeat=2, jitter=jitter).run(context, None)
    moves = pores.centers - crystal
    moves = np.linalg.norm(moves - np.round(moves), axis=1)
    nearest = NEAREST[lattice] / 2
    assert moves.max() <= jitter * nearest * (1 + 1e-9)
    assert moves.max() > 0.5 * jitter * nearest
    closest = periodic_distances(pores.centers).min()
    assert closest >= (1 - 2 * jitter) * nearest * (1 - 1e-9)
    assert context.reported["smallest_distance"] == pytest.approx(closest)


def test_between_face_pores_the_lattice_is_fitted_into_the_box() -> None:
    faces = PoreSet(
        cell=Cell(),
        centers=np.array([[0.0, 0.5, 0.5]]),
        piece=np.array([2], np.int32),
        interiors=2,
        colors=(1, 0, 0),
        spacing=0.2,
    )
    stage = LatticePoints(lattice="diamond", repeat=2, jitter=0.5)
    context = PlainContext(1, palette=Palette(interiors=2))
    pores = stage.run(context, faces)
    assert not np.array_equal(pores.of_piece(0), pores.of_piece(1))
    for t in range(2):
        interior = pores.of_piece(t)
        assert len(interior) == 64
        assert interior.min() >= 0.2
        assert interior.max() <= 0.8
    assert 0 < context.reported["smallest_distance"] < 0.3 * NEAREST["diamond"]


def test_a_lone_pore_between_faces_has_no_distance_to_report() -> None:
    faces = PoreSet(cell=Cell(), centers=np.array([[0.0, 0.5, 0.5]]), piece=np.array([1], np.int32), colors=(1, 0, 0))
    context = PlainContext()
    LatticePoints(lattice="simple", repeat=1).run(context, faces)
    assert "smallest_distance" not in context.reported
