"""Measures of a mesh that comes in pieces: those of the whole, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.features.surface.mesh_stream import PieceWindow
from sppm_pipeline.features.surface.numerics.rim_points import number_points
from sppm_pipeline.features.surface.stages.extract_marching_cubes import StreamedMeasures
from sppm_pipeline.services.mesh.marching_cubes import marching_cubes_slabs
from sppm_pipeline.services.mesh.measures import balanced_edges, box_and_volume

SCALE, ORIGIN = 7.5, np.array([0.3, -2.0, 11.0])


def pieces(planes: int) -> list[tuple[np.ndarray, np.ndarray]]:
    axis = np.linspace(-0.5, 0.5, 17, dtype=np.float32)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    field = np.sqrt(x * x + y * y + z * z) - np.float32(0.4)
    return list(marching_cubes_slabs([field[k : k + planes] for k in range(0, 17, planes)]))


def with_rims(made: list[tuple[np.ndarray, np.ndarray]]) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """The center of every second triangle of a piece as a point on a rim, and three triangles around it."""
    points, split = np.empty((0, 3)), []
    vertices = np.concatenate([v for v, _ in made])
    for some, faces in made:
        cut = faces[::2]
        numbers = (-1 - len(points) - np.arange(len(cut))).astype(np.int32)
        points = np.concatenate([points, vertices[cut].mean(axis=1)])
        fans = [np.stack([numbers, cut[:, c], cut[:, (c + 1) % 3]], axis=1) for c in range(3)]
        split.append((some, np.ascontiguousarray(np.concatenate([*fans, faces[1::2]]))))
    return split, points


@pytest.mark.parametrize("planes", [1, 3, 17])
@pytest.mark.parametrize("rims", [False, True])
@pytest.mark.parametrize("hole", [False, True])
def test_pieces_measure_what_the_whole_does(planes: int, rims: bool, hole: bool) -> None:
    made, points = with_rims(pieces(planes)) if rims else (pieces(planes), np.empty((0, 3)))
    if hole:
        middle = len(made) // 2
        made[middle] = made[middle][0], made[middle][1][1:]
    measures, window = StreamedMeasures(SCALE, ORIGIN), PieceWindow(SCALE, ORIGIN)
    for vertices, faces in made:
        measures.add(window.push(vertices), window.base, faces, points)
    vertices = np.concatenate([v for v, _ in made])
    faces = np.concatenate([f for _, f in made])
    number_points(faces, len(vertices))
    vertices = np.concatenate([vertices, points]) * SCALE + ORIGIN
    low, high, volume = box_and_volume(vertices, faces)
    assert measures.balanced == balanced_edges(faces) == (not hole)
    assert all(np.array_equal(a, b) for a, b in zip(measures.box_and_volume, (low, high, volume), strict=True))


def test_nothing_bounds_no_solid() -> None:
    measures = StreamedMeasures(1.0, np.zeros(3))
    assert not measures.balanced
    measures.add(np.zeros((2, 3)), 0, np.empty((0, 3), np.int32))
    assert not measures.balanced
