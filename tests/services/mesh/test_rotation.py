"""Rotations against an independent implementation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sppm_pipeline.services.mesh.rotation import rotated, rotation, upright

angles = st.one_of(st.floats(-360, 360), st.integers(-4, 4).map(lambda k: 90.0 * k))


@settings(derandomize=True, deadline=None)
@given(degrees=st.tuples(angles, angles, angles))
def test_turns_about_x_then_y_then_z(degrees: tuple[float, float, float]) -> None:
    matrix = rotation(degrees)
    assert np.allclose(matrix, Rotation.from_euler("xyz", degrees, degrees=True).as_matrix(), atol=1e-12)
    points = np.random.default_rng(0).normal(size=(20, 3))
    assert np.allclose(rotated(points, matrix), points @ matrix.T, atol=1e-12)
    if all(angle % 90 == 0 for angle in degrees):
        assert set(np.abs(matrix).reshape(-1).tolist()) == {0.0, 1.0}


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_the_upward_axis_becomes_z(up: str) -> None:
    matrix = upright(up)
    assert np.array_equal(matrix[:, "xyz".index(up)], [0, 0, 1])
    assert np.linalg.det(matrix) == pytest.approx(1)
    assert np.array_equal(matrix @ matrix.T, np.eye(3))
