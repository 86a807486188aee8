"""Vertices moved outwards: piece by piece as all at once, and by what flat triangles cut off."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sppm_pipeline.features.surface.numerics.bulging import Bulging
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.mesh.marching_cubes import marching_cubes_slabs
from sppm_pipeline.services.mesh.measures import volume

NO_POINTS, NO_KINDS = np.empty((0, 3)), np.empty(0, np.uint8)
N, RADIUS = 25, 0.4
GRID = Grid((-0.5,) * 3, (1 / (N - 1),) * 3, (N,) * 3)


def ball_pieces(planes: int, noise: float = 0.0) -> list[tuple[np.ndarray, np.ndarray]]:
    axis = np.linspace(-0.5, 0.5, N, dtype=np.float32)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    field = np.sqrt(x * x + y * y + z * z) - np.float32(RADIUS)
    field += noise * np.random.default_rng(3).standard_normal(field.shape).astype(np.float32)
    slabs = [field[k : k + planes] for k in range(0, N, planes)]
    return list(marching_cubes_slabs(slabs, 0.0, GRID.origin, GRID.spacing))


def bulged(pieces: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    bulging, done = Bulging(GRID), [NO_POINTS]
    for vertices, faces in pieces:
        done += [rows.copy() for rows in bulging.push(vertices, faces, NO_KINDS, NO_POINTS)]
    done += [rows.copy() for rows in bulging.finish(NO_POINTS)]
    return np.concatenate(done)


@pytest.mark.parametrize("noise", [0.0, 0.02])  # smooth, and with vertices that can't go where they should
def test_pieces_give_the_same_bytes_as_the_whole(noise: float) -> None:
    whole = bulged(ball_pieces(N, noise))
    for planes in (1, 2, 7):
        assert np.array_equal(whole, bulged(ball_pieces(planes, noise)))


def test_a_ball_gets_the_volume_that_flat_triangles_cut_off() -> None:
    pieces = ball_pieces(4)
    for vertices, _ in pieces:  # onto the ball, along their edges of the grid
        axis = np.abs((vertices + 0.5) * (N - 1) % 1 - 0.5).argmin(axis=1)
        rows = np.arange(len(vertices))
        along = RADIUS**2 - (vertices**2).sum(axis=1) + vertices[rows, axis] ** 2
        vertices[rows, axis] = np.sign(vertices[rows, axis]) * np.sqrt(along)
    flat, faces = np.concatenate([v for v, _ in pieces]), np.concatenate([f for _, f in pieces])
    exact = 4 / 3 * math.pi * RADIUS**3
    before, after = volume(flat, faces) / exact - 1, volume(bulged(pieces), faces) / exact - 1
    assert before < -4e-3
    assert abs(after) < 0.1 * abs(before)


def test_nothing_makes_nothing() -> None:
    assert len(bulged([])) == 0
