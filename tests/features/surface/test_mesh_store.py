"""A mesh put together in memory or in files: the same arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sppm_pipeline.features.surface.stages.extract_marching_cubes import MeshStore
from sppm_pipeline.services.paging import blocks, mapping_of, release

Pieces = list[tuple[np.ndarray, np.ndarray]]


@pytest.fixture
def pieces() -> Pieces:
    rng = np.random.default_rng(1)
    made, total = [], 0
    for count in (5, 0, 40, 3):
        total += count
        faces = rng.integers(-7, total, (2 * count, 3)).astype(np.int32)  # negative numbers are points on rims
        made.append((rng.random((count, 3)), faces))
    return made


def stored(pieces: Pieces, limit: int, folder: Path, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    store = MeshStore(limit, folder, (48, 96))
    for vertices, faces in pieces:
        store.add(vertices, faces)
    return store.finish(points)


@pytest.mark.parametrize("rims", [0, 7])
def test_files_hold_what_memory_holds(pieces: Pieces, tmp_path: Path, rims: int) -> None:
    points = np.arange(3.0 * rims).reshape(-1, 3)
    given = [(v, np.where(f < 0, f if rims else 0, f).astype(np.int32)) for v, f in pieces]
    obvious = np.concatenate([f for _, f in given])
    obvious = np.where(obvious < 0, 48 - 1 - obvious, obvious)
    for limit in (10**6, 600, 0):  # in memory, in files from the third piece on, in files from the first on
        vertices, faces = stored(given, limit, tmp_path, points)
        assert (mapping_of(vertices) is None) == (limit == 10**6)
        assert np.array_equal(vertices, np.concatenate([*(v for v, _ in given), points]))
        assert faces.dtype == np.int32
        assert np.array_equal(faces, obvious)
        release(vertices, faces)  # they can still be read
        assert np.array_equal(faces, obvious)
    assert list(tmp_path.iterdir()) == []


def test_blocks_cover_all_rows(tmp_path: Path) -> None:
    rows = 2**18 + 5
    store = MeshStore(0, tmp_path)
    store.add(np.zeros((rows, 3)), np.zeros((1, 3), np.int32))
    vertices, faces = store.finish(np.empty((0, 3)))
    assert [(s.start, s.stop) for s in blocks(rows, vertices)] == [(0, 2**18), (2**18, rows)]
    assert [(s.start, s.stop) for s in blocks(rows, np.zeros((rows, 3)))] == [(0, rows)]
    assert len(faces) == 1
