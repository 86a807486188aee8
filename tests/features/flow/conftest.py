"""Fields whose flow is known, and a cell of gyroid."""

import numpy as np
import pytest

from sppm_pipeline.features.flow.numerics.faces import faces_of_field, percolating
from sppm_pipeline.features.flow.numerics.stokes import stokes_flow


def sampled(field):
    """A function of coordinates as `faces_of_field` takes it, (nz, ny, nx)."""

    def sample(grid):
        x, y, z = (grid.axis(axis) for axis in range(3))
        return np.broadcast_to(field(x, y[:, None], z[:, None, None]), grid.shape[::-1]).astype(np.float32)

    return sample


def _spheres(centers, share):
    """Outside of equal spheres that fill a share of the cell."""
    radius = (3 * share / 4 / np.pi / len(centers)) ** (1 / 3)

    def field(x, y, z):
        squares = [sum(((v - c + 0.5) % 1 - 0.5) ** 2 for v, c in zip((x, y, z), p, strict=True)) for p in centers]
        return np.sqrt(np.min(squares, axis=0)) - radius

    return field, radius


def _flow(field, n, **options):
    faces = faces_of_field(sampled(field), (n, n, n), 1 / n)
    way = percolating(faces)
    return stokes_flow(way.faces, faces.porosity, way.wraps, **options)


@pytest.fixture(scope="session")
def flow():
    """The flow outside of the solid of a field on n^3 voxels, lengths in voxels."""
    return _flow


@pytest.fixture(scope="session")
def spheres():
    return _spheres


@pytest.fixture(scope="session")
def gyroid():
    """A gyroid, made longer along x by a second wave so that its axes differ."""
    t = 2 * np.pi

    def field(x, y, z):
        wave = np.sin(t * x) * np.cos(t * y) + np.sin(t * y) * np.cos(t * z) + np.sin(t * z) * np.cos(t * x)
        return wave + 0.4 * np.sin(t * (y + z)) + 0.3

    return field


@pytest.fixture(scope="session")
def blobs():
    """A piece of random blobs, which is no periodic cell, as a scan is none."""
    from scipy.ndimage import gaussian_filter

    image = gaussian_filter(np.random.default_rng(0).standard_normal((64,) * 3), 2)[20:-20, 20:-20, 20:-20]
    return image > np.quantile(image, 0.6)
