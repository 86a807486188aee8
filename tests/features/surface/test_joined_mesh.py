"""Pieces of a mesh put together."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.services.mesh.marching_cubes import joined_mesh


def pieces():
    rng = np.random.default_rng(1)
    return [(rng.random((n, 3)), rng.integers(0, 99, (m, 3)).astype(np.int32)) for n, m in ((3, 0), (0, 5), (400, 700))]


@pytest.mark.parametrize("expected", [(0, 0), (3, 5), (403, 705), (10_000, 10_000)])
def test_as_concatenated_whatever_was_expected(expected):
    vertices, faces = joined_mesh(iter(pieces()), lambda: expected)
    np.testing.assert_array_equal(vertices, np.concatenate([v for v, _ in pieces()]))
    np.testing.assert_array_equal(faces, np.concatenate([f for _, f in pieces()]))
    assert vertices.dtype == np.float64
    assert faces.dtype == np.int32
    assert vertices.flags.owndata
    assert faces.flags.owndata


def test_no_pieces():
    vertices, faces = joined_mesh(iter([]))
    assert vertices.shape == faces.shape == (0, 3)
