"""The intersection of two solids: vertices on the zero of the field that cuts, whatever the sizes of the fields."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.features.surface.numerics.placing import (
    _AT_ONCE,
    DOMAIN,
    FIELD,
    SKIN,
    Samples,
    _cubic_zeros,
    place_vertices,
)
from sppm_pipeline.method.kernels.profiles import log_of_sums
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.mesh.closing import capped_marching_cubes
from sppm_pipeline.services.mesh.measures import edge_counts, volume


def fields(n, steepness):
    """A ball of radius .8 and the half-space z < .3, whose field is `steepness` times the distance."""
    h = 2.0 / n
    grid = Grid((-1.0, -1.0, -1.0), (h, h, h), (n + 1, n + 1, n + 1))
    x, y, z = (grid.axis(a) for a in range(3))
    r = np.sqrt(x[None, None, :] ** 2 + y[None, :, None] ** 2 + z[:, None, None] ** 2)
    ball = (r - 0.8).astype(np.float32)
    plane = np.broadcast_to((steepness * (z - 0.3)).astype(np.float32)[:, None, None], ball.shape).copy()
    return ball, plane, grid


NOTHING = np.empty((0, 0, 0), np.float32)


def on_both_fields(vertices, first, second, grid, start=0, third=NOTHING):
    return place_vertices(vertices.copy(), Samples(grid, start, first, second, third)).vertices


def surface(n, steepness):
    ball, plane, grid = fields(n, steepness)
    vertices, faces = capped_marching_cubes(np.maximum(ball, plane), 0.0, grid.origin, grid.spacing)
    return on_both_fields(vertices, ball, plane, grid), faces, grid


@pytest.mark.parametrize("steepness", [0.01, 1.0, 100.0])
def test_vertices_lie_on_the_zero_of_one_of_the_fields(steepness):
    vertices, _, grid = surface(31, steepness)
    off_ball = np.abs(np.sqrt((vertices**2).sum(1)) - 0.8)
    off_plane = np.abs(vertices[:, 2] - 0.3)
    assert np.minimum(off_ball, off_plane).max() < 0.005 * grid.spacing[0]


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
    part = on_both_fields(vertices, ball[5:13], plane[5:13], grid, 5)  # a plane more for the cubic
    assert np.array_equal(part[within], whole[within])
    beyond = (place < 4) | (place > 13)
    assert np.array_equal(part[beyond], vertices[beyond])


def test_vertices_know_what_they_lie_on():
    ball, plane, grid = fields(24, 3.0)
    x = grid.axis(0)
    slab = np.broadcast_to((np.abs(x) - 0.2).astype(np.float32), ball.shape).copy()
    vertices, _ = capped_marching_cubes(np.maximum(np.minimum(ball, slab), plane), 0.0, grid.origin, grid.spacing)
    placed = place_vertices(vertices, Samples(grid, 0, ball, plane, slab))
    off = {
        FIELD: np.abs(np.linalg.norm(vertices, axis=1) - 0.8),
        DOMAIN: np.abs(vertices[:, 2] - 0.3),
        SKIN: np.abs(np.abs(vertices[:, 0]) - 0.2),
    }
    for kind, distance in off.items():
        assert (placed.on == kind).sum() > 50
        assert distance[placed.on == kind].max() < 0.01 * grid.spacing[0]
    axis = placed.edge[placed.edge >= 0] % 3
    place = ((vertices - grid.origin) / grid.spacing)[placed.edge >= 0]
    assert np.array_equal(np.abs(place - place.round()).argmax(1), axis)


def test_the_cubic_through_logarithms_of_a_gaussian_is_exact():
    """A Gaussian two voxels wide: its logarithm is a parabola, which the cubic is equal to."""
    ball, _, grid = fields(12, 1.0)
    r2 = (ball + 0.8) ** 2
    sums = np.exp(-2.0 * r2).astype(np.float32)
    level = float(np.exp(-2.0 * 0.6**2))
    linear, _ = capped_marching_cubes(level - sums, 0.0, grid.origin, grid.spacing)
    smooth = -log_of_sums(sums - np.float32(level), level)
    vertices, _ = capped_marching_cubes(smooth, 0.0, grid.origin, grid.spacing)
    place_vertices(vertices, Samples(grid, 0, smooth, NOTHING, NOTHING))
    errors = [np.abs(np.linalg.norm(v, axis=1) - 0.6).max() / grid.spacing[0] for v in (linear, vertices)]
    assert errors[0] > 0.02
    assert errors[1] < 1e-3


def test_logarithms_have_the_signs_of_what_they_are_of():
    values = np.array([-0.25, -0.2499, -1e-9, -0.0, 0.0, 1e-9, 3.0], np.float32)
    found = log_of_sums(values.copy(), 0.25)
    assert np.isfinite(found).all()
    assert np.array_equal(found < 0, values < 0)


def one_zero(a, b, c, d):
    """Newton's method for one cubic, kept between the signs."""
    t = b / (b - c)
    if not (np.isfinite(a) and np.isfinite(d) and np.isfinite(t)):
        return t
    third, second, first = (d - a) / 6 + (b - c) / 2, (a + c) / 2 - b, c - b / 2 - a / 3 - d / 6
    low, high = 0.0, 1.0
    for _ in range(40):
        value = b + t * (first + t * (second + t * third))
        if value == 0:
            break
        if (value < 0) == (b < 0):
            low = t
        else:
            high = t
        slope = first + t * (2 * second + t * (3 * third))
        last, t = t, t - value / slope if slope != 0 else low
        if not low < t < high:
            t = (low + high) / 2
        if abs(t - last) < 1e-5:
            break
    return t


@pytest.mark.parametrize("count", [1, 7, _AT_ONCE])
def test_zeros_side_by_side_are_those_one_by_one(count):
    rng = np.random.default_rng(count)
    for _ in range(20):
        a, b, c, d = rng.standard_normal((4, count)) * 10.0 ** rng.integers(-3, 4, (4, count))
        b, c = -np.abs(b), np.where(rng.random(count) < 0.1, 0.0, np.abs(c))
        turned = rng.random(count) < 0.5
        b, c = np.where(turned, c, b), np.where(turned, b, c)
        a[rng.random(count) < 0.1], d[rng.random(count) < 0.1] = np.inf, -np.inf
        b[(rng.random(count) < 0.1) & turned] = np.inf
        work = np.full((11, _AT_ONCE), np.nan)
        work[:4, :count] = a, b, c, d
        with np.errstate(all="ignore"):
            wanted = [one_zero(*(np.float64(v) for v in values)) for values in zip(a, b, c, d, strict=True)]
        _cubic_zeros(work.reshape(-1), count)
        assert np.array_equal(work[4, :count], wanted, equal_nan=True)
