"""Lattices of known functions and of noise."""

import numpy as np
import pytest
from sppm_tetrahedra.numerics.lattice import doubled_grid


def lattice_of(function, n, periodic=True):
    """A function of x, y, z in [0, 1]^3, sampled at n cubes an edge."""
    a, c, e = np.arange(n + 1) / n, (np.arange(n) + 0.5) / n, np.array([0.0, 1.0])

    def at(z, y, x):
        x, y, z = np.broadcast_arrays(x[None, None, :], y[None, :, None], z[:, None, None])
        return np.asarray(function(x, y, z), np.float32)

    return doubled_grid(at(a, a, a), at(c, c, c), (at(c, c, e), at(c, e, c), at(e, c, c)), periodic)


def noise_of(n, seed, periodic=True, solid=0.5, spread=0.5):
    """Independent values, their sizes spread over so many decades."""
    rng = np.random.default_rng(seed)

    def draw(*shape):
        size = 10 ** rng.uniform(-spread, 0, shape)
        return np.where(rng.random(shape) < solid, -size, size).astype(np.float32)

    faces = draw(n, n, 2), draw(n, 2, n), draw(2, n, n)
    return doubled_grid(draw(n + 1, n + 1, n + 1), draw(n, n, n), faces, periodic)


@pytest.fixture(scope="session")
def lattice():
    return lattice_of


@pytest.fixture(scope="session")
def noise():
    return noise_of
