"""Bodies that several tests share."""

import numpy as np
import pytest
from sppm_crushing.numerics import element
from sppm_crushing.numerics.body import body_of
from sppm_crushing.numerics.march import Load, March
from sppm_crushing.numerics.material import Material, constants

PLASTIC = Material(1.0, 0.35, ((0.0, 0.02), (1.0, 0.03)))


def gyroid(n, cells):
    """As `benchmarks.crushing` makes it."""
    c = 2 * np.pi * cells * (np.arange(n) + 0.5) / n
    z, y, x = np.meshgrid(c, c, c, indexing="ij")
    field = np.abs(np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x))
    return (field < np.quantile(field, 0.3)).astype(np.uint8)


class Elements:
    """Forces of the elements of a body that has never yielded, without march."""

    def __init__(self, image, materials):
        self.body = body_of(image)
        self.table = constants(materials)

    def __call__(self, x):
        """Forces at node positions (nodes, 3), and the energy that is stored."""
        body = self.body
        state = np.zeros((len(body.lanes), element.STATE, element.LANES))
        state[:, :3] = state[:, 8:] = 1
        f, sums = np.zeros_like(x), np.zeros((len(body.slabs) - 1, element.SUMS))
        for odd in (0, 1):
            element.forces(
                np.ascontiguousarray(x), body.blocked(body.corners, -1), body.phases[body.lanes[:, 0]].astype(np.int32),
                body.slabs, odd, len(sums), self.table, state, np.full(body.lanes.shape, -1, np.int32),
                np.zeros(0, np.uint8), np.zeros((0, 8, 3)), np.zeros(element.ROWS * element.LANES), f, sums,
                np.zeros((0, 3)), np.zeros((0, 4, element.LANES)),
            )  # fmt: skip
        return f, sums[:, :2].sum()


@pytest.fixture
def elements():
    return Elements


@pytest.fixture(scope="session")
def crushed():
    """A plastic gyroid of 16 voxels, one cell, crushed to 60 % by one thread."""
    march = March(body_of(gyroid(16, 1)), (PLASTIC,), Load(0.6, 0.005))
    march.to(1)
    return march


@pytest.fixture(scope="session")
def untouched():
    """The same to 24 %, its walls pass through each other."""
    body = body_of(gyroid(16, 1))
    march = March(body._replace(carried=np.zeros_like(body.carried)), (PLASTIC,), Load(0.24, 0.005))
    march.to(1)
    return march


@pytest.fixture(scope="session")
def plastic():
    return PLASTIC


@pytest.fixture(scope="session")
def cell():
    return gyroid(16, 1)


@pytest.fixture
def small_cell():
    return gyroid(8, 1)
