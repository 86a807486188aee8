"""The intersection of two solids: vertices on the zero of the field that cuts, whatever the sizes of the fields."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.meshcheck.measures import edge_counts, volume
from sppm_pipeline.numerics.surface.closing import capped_marching_cubes
from sppm_pipeline.numerics.surface.intersection import on_both_fields


def fields(n, steepness):
    """A ball of radius .8 and the half-space z < .3, whose field is `steepness` times the distance."""
    h = 2.0 / n
    grid = Grid((-1.0, -1.0, -1.0), (h, h, h), (n + 1, n + 1, n + 1))
    x, y, z = (grid.axis(a) for a in range(3))
    r = np.sqrt(x[None, None, :] ** 2 + y[None, :, None] ** 2 + z[:, None, None] ** 2)
    ball = (r - 0.8).astype(np.float32)
    plane = np.broadcast_to((steepness * (z - 0.3)).astype(np.float32)[:, None, None], ball.shape).copy()
    return ball, plane, grid


def surface(n, steepness):
    ball, plane, grid = fields(n, steepness)
    vertices, faces = capped_marching_cubes(np.maximum(ball, plane), 0.0, grid.origin, grid.spacing)
    return on_both_fields(vertices, ball, plane, grid), faces, grid


@pytest.mark.parametrize("steepness", [0.01, 1.0, 100.0])
def test_vertices_lie_on_the_zero_of_one_of_the_fields(steepness):
    vertices, _, grid = surface(31, steepness)
    off_ball = np.abs(np.sqrt((vertices**2).sum(1)) - 0.8)
    off_plane = np.abs(vertices[:, 2] - 0.3)
    assert np.minimum(off_ball, off_plane).max() < 0.05 * grid.spacing[0]


def test_the_size_of_a_field_does_not_matter():
    gentle, steep = (surface(24, s)[0] for s in (0.02, 50.0))
    np.testing.assert_allclose(gentle, steep, atol=1e-6)


def test_the_maximum_alone_would_be_wrong():
    ball, plane, grid = fields(31, 0.01)
    vertices, _ = capped_marching_cubes(np.maximum(ball, plane), 0.0, grid.origin, grid.spacing)
    off = np.minimum(np.abs(np.sqrt((vertices**2).sum(1)) - 0.8), np.abs(vertices[:, 2] - 0.3))
    assert off.max() > 0.3 * grid.spacing[0]


def test_closed_and_of_the_right_volume():
    cap = np.pi * 0.5**2 * (3 * 0.8 - 0.5) / 3
    exact = 4 / 3 * np.pi * 0.8**3 - cap
    errors = []
    for n in (21, 42):
        vertices, faces, _ = surface(n, 1.0)
        assert edge_counts(faces).closed
        errors.append(abs(volume(vertices, faces) - exact) / exact)
    assert errors[1] < errors[0] / 2
    assert errors[1] < 0.01


def test_vertices_on_caps_stay():
    _, _, grid = fields(10, 1.0)
    inside = np.full((11, 11, 11), -1.0, np.float32)
    vertices, _ = capped_marching_cubes(inside, 0.0, grid.origin, grid.spacing)
    np.testing.assert_array_equal(on_both_fields(vertices, inside, inside, grid), vertices)


@pytest.mark.parametrize("steepness", [0.01, 1.0, 100.0])
def test_a_third_solid_is_united_with_the_first(steepness):
    """A ball and a slab, whose fields differ in size, together cut by a half-space."""
    ball, plane, grid = fields(31, 1.0)
    x, _, z = (grid.axis(a) for a in range(3))
    slab = np.broadcast_to((steepness * (np.abs(x) - 0.2)).astype(np.float32), ball.shape).copy()
    values = np.maximum(np.minimum(ball, slab), plane)
    vertices, faces = capped_marching_cubes(values, 0.0, grid.origin, grid.spacing)
    capped = (np.abs(vertices) > 1 - 1e-3).any(1)  # of these, the ones within a cap stay
    moved = on_both_fields(vertices, ball, plane, grid, 0, slab)
    off = [
        np.abs(np.sqrt((moved**2).sum(1)) - 0.8),
        np.abs(np.abs(moved[:, 0]) - 0.2),
        np.abs(moved[:, 2] - 0.3),
    ]
    assert np.minimum.reduce(off)[~capped].max() < 0.05 * grid.spacing[0]
    assert np.array_equal(moved[capped].round(), vertices[capped].round())
    assert edge_counts(faces).closed
    assert moved[:, 2].max() < 0.3 + 1e-3
    assert z.max() > 0.9


def test_planes_of_a_slab_are_enough():
    ball, plane, grid = fields(24, 3.0)
    vertices, _ = capped_marching_cubes(np.maximum(ball, plane), 0.0, grid.origin, grid.spacing)
    whole = on_both_fields(vertices, ball, plane, grid)
    place = (vertices[:, 2] - grid.origin[2]) / grid.spacing[2]
    within = (place > 6) & (place < 11)
    part = on_both_fields(vertices, ball[6:12], plane[6:12], grid, 6)
    assert np.array_equal(part[within], whole[within])
    beyond = (place < 5) | (place > 12)
    assert np.array_equal(part[beyond], vertices[beyond])
