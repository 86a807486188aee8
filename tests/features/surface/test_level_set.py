"""The native extractor, fed from samples."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest

from sppm_pipeline.features.surface.solids import (
    _minus_value_at,
    lattice_bytes,
    lattice_samples,
    run_level_set,
)
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.mesh.measures import measure_surface


def half_grid(shape, function, low=(-1.0, -0.7, -0.4), spacing=0.1):
    """Samples of a function on half the spacing, for a lattice of so many cubes."""
    axes = [low[a] + spacing / 2 * np.arange(2 * shape[a] + 1) for a in range(3)]
    return function(axes[0][None, None, :], axes[1][None, :, None], axes[2][:, None, None]).astype(np.float32)


def ball(x, y, z):
    return np.sqrt(x**2 + y**2 + z**2) - 0.35 + 0 * (x + y + z)


def test_the_lattice_is_where_the_samples_are():
    """Every value that is asked for is a sample, so that nothing is interpolated."""
    asked = []

    def ask(x, y, z):
        asked.append((x, y, z))
        return 0.35 - (x**2 + y**2 + z**2) ** 0.5

    shape, low, h = (20, 14, 9), np.array([-1.0, -0.7, -0.4]), 0.1
    box = [*low, *(low + np.array(shape) * h)]
    manifold3d.Manifold.level_set(ask, box, h * (1 - 1e-9))
    places = (np.array(asked) - low) / (h / 2)
    assert np.abs(places - places.round()).max() < 1e-9
    assert len(asked) == lattice_samples(Grid(tuple(low), (h,) * 3, tuple(n + 1 for n in shape)))


def test_the_interpolant():
    values = np.random.default_rng(1).integers(-99, 99, (4, 5, 6)).astype(np.float32)
    at = lambda x, y, z: -_minus_value_at(values, 1.0, 2.0, 3.0, 2.0, x, y, z)  # noqa: E731
    assert at(1.5, 2.0, 4.5) == values[3, 0, 1]
    assert at(1.5 - 1e-9, 2.5 + 1e-9, 4.0) == values[2, 1, 1]
    assert at(1.25, 2.5, 3.5) == pytest.approx(values[1, 1, :2].mean())
    assert at(1.25, 2.25, 3.25) == pytest.approx(values[:2, :2, :2].mean())
    assert at(-9.0, 2.0, 99.0) == values[3, 0, 0]
    assert at(99.0, 99.0, -9.0) == values[0, 4, 5]
    tilted = np.add.outer(np.add.outer(3 * np.arange(4.0), 2 * np.arange(5.0)), np.arange(6.0)).astype(np.float32)
    x, y, z = np.random.default_rng(2).random((3, 50)) * np.array([[2.5], [2.0], [1.5]])
    found = [-_minus_value_at(tilted, 0.0, 0.0, 0.0, 2.0, *p) for p in zip(x, y, z, strict=True)]
    assert found == pytest.approx(2 * (x + 2 * y + 3 * z))


@pytest.mark.parametrize("tolerance", [None, 1e-4])
def test_a_ball_converges_at_second_order(tolerance):
    errors = []
    for n in (1, 2, 4):
        samples = half_grid((20 * n, 14 * n, 9 * n), ball, spacing=0.1 / n)
        mesh, status = run_level_set(samples, (-1.0, -0.7, -0.4), 0.1 / n, tolerance)
        found = measure_surface(*mesh)
        assert status == "NoError"
        assert (found.genus, found.components, found.edges.closed) == (0, 1, True)
        errors.append(abs(found.volume - 4 / 3 * np.pi * 0.35**3))
    assert errors[1] < errors[0] / 3
    assert errors[2] < errors[1] / 3


def test_the_box_closes_the_solid():
    errors = []
    for n in (1, 2, 4):
        samples = half_grid((8 * n, 7 * n, 6 * n), lambda x, y, z: x + 0 * y + 0 * z + 0.55, spacing=0.1 / n)
        mesh, _ = run_level_set(samples, (-1.0, -0.7, -0.4), 0.1 / n)
        found = measure_surface(*mesh)
        assert found.edges.closed
        assert found.low == pytest.approx((-1.0, -0.7, -0.4))
        assert found.high == pytest.approx((-0.55, 0.0, 0.2))
        errors.append(abs(found.volume / (0.45 * 0.7 * 0.6) - 1))
    assert errors[0] < 0.03  # the plane passes through centers of cubes, and its edges are bevelled
    assert max(errors[1:]) < 1e-9  # it passes through corners


def test_nothing_inside():
    (vertices, faces), status = run_level_set(np.ones((5, 5, 5), np.float32), (0.0, 0.0, 0.0), 1.0)
    assert (vertices.shape, faces.shape, status) == ((0, 3), (0, 3), "NoError")


def test_bytes_grow_in_steps_of_two():
    grid = Grid((0.0,) * 3, (1.0,) * 3, (100, 62, 62))
    more = grid._replace(shape=(100, 61, 62))
    assert lattice_bytes(grid) == 8 * 103 * 2 ** (1 + 7 + 7)
    assert lattice_bytes(more) < lattice_bytes(grid)
