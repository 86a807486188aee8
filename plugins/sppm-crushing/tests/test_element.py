"""Bricks at large strains: their tangent at rest, their energy, and that rotations do nothing."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sppm_crushing.numerics.material import Material

from sppm_pipeline.services.elastic.elastic_level import ElasticLevel, Moduli
from sppm_pipeline.services.elastic.elastic_operator import SCRATCH_ROWS
from sppm_pipeline.services.multigrid.hierarchy import Workspace
from sppm_pipeline.services.multigrid.rows import APPLY

MATERIALS = (Material(1.0, 0.35), Material(0.4, 0.2))


@pytest.fixture
def image():
    """Two phases with holes in 4 x 4 x 4 voxels, of which the last layers are void."""
    rng = np.random.default_rng(3)
    image = np.zeros((4, 4, 4), np.uint8)
    image[:3, :3, :3] = rng.integers(0, 3, (3, 3, 3))
    return image


def test_tangent_at_rest_is_that_of_homogenization(elements, image):
    body = elements(image, MATERIALS)
    lam, mu = (np.array([0.0, *(m.lame[i] for m in MATERIALS)])[image] for i in (0, 1))
    level = ElasticLevel(Moduli.of(lam, mu), (1.0, 1.0, 1.0), np.float64)
    nodes = body.body.nodes
    at = nodes[:, 0] + 4 * (nodes[:, 1] + 4 * nodes[:, 2])
    u = np.random.default_rng(4).standard_normal(nodes.shape)
    v, out = np.zeros((2, 3, 64))
    v[:, at] = u.T
    out = np.zeros(3 * 64)
    level.apply(APPLY, v.reshape(-1), np.zeros(3 * 64), out, Workspace([level], SCRATCH_ROWS))
    small = 1e-5
    tangent = (body(nodes - small * u)[0] - body(nodes + small * u)[0]) / (2 * small)
    assert tangent == pytest.approx(out.reshape(3, 64)[:, at].T, rel=1e-9, abs=1e-9)


def test_forces_are_the_slope_of_the_energy(elements, image):
    body = elements(image, MATERIALS)
    rng = np.random.default_rng(5)
    nodes = body.body.nodes
    bent = nodes @ (np.eye(3) + 0.2 * rng.standard_normal((3, 3))) + 0.1 * rng.standard_normal(nodes.shape)
    f = body(bent)[0]
    for _ in range(4):
        way = rng.standard_normal(nodes.shape)
        small = 1e-5
        slope = (body(bent + small * way)[1] - body(bent - small * way)[1]) / (2 * small)
        assert -np.sum(f * way) == pytest.approx(slope, rel=1e-8)


def test_turned_bodies_have_turned_forces(elements, image):
    body = elements(image, MATERIALS)
    rng = np.random.default_rng(6)
    bent = body.body.nodes + 0.15 * rng.standard_normal(body.body.nodes.shape)
    turn = Rotation.random(random_state=7).as_matrix()
    f, energy = body(bent)
    turned, same = body(bent @ turn.T + [3.0, -2.0, 7.0])
    assert turned == pytest.approx(f @ turn.T, abs=1e-12)
    assert same == pytest.approx(energy, rel=1e-12)
    assert body(body.body.nodes @ turn.T)[0] == pytest.approx(0, abs=1e-13)
