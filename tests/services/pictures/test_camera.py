"""Cameras: directions, framing, and the order of depths."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.pictures.camera import Camera, framed, projected

CUBE = np.array([[i, j, k] for i in (0.0, 1.0) for j in (0.0, 1.0) for k in (0.0, 1.0)])


@settings(derandomize=True, max_examples=100)
@given(st.floats(-720, 720), st.floats(-90, 90), st.sampled_from([0.0, 5.0, 40.0, 120.0]), st.integers(0, 1000))
def test_points_fill_the_picture_up_to_the_margin(azimuth, elevation, view, seed):
    points = np.random.default_rng(seed).normal(size=(30, 3)) * [1.0, 5.0, 0.2]
    places = projected(framed(Camera(azimuth, elevation, view), points, (400, 300), margin=0.1), points)
    low, high = places.min(axis=0), places.max(axis=0)
    assert low[0] >= 40 - 1e-6
    assert high[0] <= 360 + 1e-6
    assert low[1] >= 30 - 1e-6
    assert high[1] <= 270 + 1e-6
    # One of both directions is filled, and the points stand in the middle.
    assert max((high[0] - low[0]) / 320, (high[1] - low[1]) / 240) == pytest.approx(1.0)
    assert (low + high)[:2] / 2 == pytest.approx([200, 150])


@pytest.mark.parametrize("view", [0.0, 30.0])
def test_z_is_up_x_is_right_y_is_away(view):
    frame = framed(Camera(-60, 20, view), CUBE, (200, 200))
    origin, x, y, z = projected(frame, np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float))
    assert z[1] < origin[1]
    assert x[0] > origin[0]
    assert y[2] < origin[2]
    assert x[2] > origin[2]


def test_axes_are_a_right_handed_frame():
    axes = framed(Camera(33, -47), CUBE, (10, 10)).axes
    assert np.allclose(axes @ axes.T, np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_nearness_is_linear_along_a_line_of_the_picture():
    frame = framed(Camera(-50, 30, 60), CUBE, (500, 500))
    a, b = np.array([0.1, 0.9, 0.2]), np.array([0.9, 0.2, 0.7])
    line = projected(frame, a + np.linspace(0, 1, 9)[:, None] * (b - a))
    share = (line[:, 0] - line[0, 0]) / (line[-1, 0] - line[0, 0])
    assert np.allclose(line[:, 2], line[0, 2] + share * (line[-1, 2] - line[0, 2]))


def test_a_single_point_is_in_the_middle():
    for view in (0.0, 20.0):
        point = np.array([[3.0, 4.0, 5.0]])
        assert projected(framed(Camera(0, 0, view), point, (20, 10)), point)[0, :2] == pytest.approx([10, 5])


@pytest.mark.parametrize(
    ("camera", "size", "word"),
    [
        (Camera(0, 91), (10, 10), "elevation"),
        (Camera(0, float("nan")), (10, 10), "elevation"),
        (Camera(0, 0, 170), (10, 10), "field of view"),
        (Camera(0, 0, -1), (10, 10), "field of view"),
        (Camera(), (0, 10), "0 x 10"),
    ],
)
def test_bad_cameras_are_refused(camera, size, word):
    with pytest.raises(DesignError, match=word):
        framed(camera, CUBE, size)
