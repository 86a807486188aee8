"""The pass over the grid is the assembled matrix, and the energies are its quadratic form."""

import numpy as np
import pytest

from sppm_pipeline.numerics.homogenization.elastic_energy import ENERGY_ROWS, energies, energy_coefficients
from sppm_pipeline.numerics.homogenization.elastic_operator import SCRATCH_ROWS
from sppm_pipeline.numerics.homogenization.elasticity import ElasticLevel, safe_eigenvalue
from sppm_pipeline.numerics.homogenization.multigrid.hierarchy import Workspace
from sppm_pipeline.numerics.homogenization.multigrid.rows import APPLY, BLOCK, RESIDUAL, SMOOTH, STRIDE

SHAPES = [(4, 3, 5), (2, 2, 2), (1, 1, 1), (3, 1, 2), (1, 4, 1), (2, 3, 9), (1, 2, BLOCK), (2, 1, BLOCK + 1)]


def voxels(shape, seed=1):
    rng = np.random.default_rng(seed)
    lam, mu = rng.random(shape), rng.random(shape) + 0.1
    void = rng.random(shape) < 0.3
    lam[void], mu[void] = 0, 0
    return lam, mu


def by_node(v, shape):
    """From components first to the order of the assembled matrix."""
    return v.reshape(3, -1).T.reshape(-1)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (1.0, 0.7, 1.9)])
def test_pass_equals_the_assembled_matrix(assemble, shape, edges):
    lam, mu = voxels(shape)
    matrix, forces, _ = assemble(lam, mu, edges)
    level = ElasticLevel(lam, mu, edges, np.float64)
    rng = np.random.default_rng(2)
    v, r, out = rng.standard_normal((3, 3 * lam.size))
    level.weight[:] = rng.random(lam.size)
    work = Workspace([level], SCRATCH_ROWS)
    f = matrix @ by_node(v, shape)
    assert level.apply(APPLY, v, r, out, work) == pytest.approx(f @ by_node(v, shape), rel=1e-12, abs=1e-12)
    assert by_node(out, shape) == pytest.approx(f, rel=1e-12, abs=1e-12)
    level.apply(RESIDUAL, v, r, out, work)
    assert by_node(out, shape) == pytest.approx(by_node(r, shape) - f, rel=1e-12, abs=1e-12)
    smooth = by_node(v, shape) + np.repeat(level.weight, 3) * (by_node(r, shape) - f)
    assert level.apply(SMOOTH, v, r, out, work) == pytest.approx(smooth @ by_node(r, shape), rel=1e-10, abs=1e-10)
    assert by_node(out, shape) == pytest.approx(smooth, rel=1e-12, abs=1e-12)
    for case in range(6):
        level.forces(np.eye(6)[case], out, work)
        assert by_node(out, shape) == pytest.approx(forces[:, case], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("shape", [(4, 3, 5), (1, 2, 1), (2, 2, BLOCK + 3)])
@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (1.0, 0.7, 1.9)])
def test_energies_are_the_quadratic_form(assemble, shape, edges):
    lam, mu = voxels(shape)
    matrix, forces, mean = assemble(lam, mu, edges)
    level = ElasticLevel(lam, mu, edges, np.float64)
    fields = np.random.default_rng(3).standard_normal((6, 3 * lam.size))
    u = np.array([by_node(field, shape) for field in fields]).T
    expected = u.T @ (matrix @ u) + forces.T @ u + u.T @ forces + mean
    out, scratch = np.zeros((6, 6)), np.zeros(ENERGY_ROWS * STRIDE)
    strains = np.eye(6) * np.sqrt(np.prod(edges))
    for first in range(shape[0]):
        energies(
            fields, level.lam, level.mu, energy_coefficients(edges), strains, level.size, first, first + 1, scratch, out
        )
    assert out == pytest.approx(expected, rel=1e-12, abs=1e-10)


@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (1.0, 0.5, 2.0)])
@pytest.mark.parametrize("poisson", [-0.6, 0.0, 0.3, 0.49])
def test_the_safe_eigenvalue_is_a_bound(assemble, edges, poisson):
    mu = (np.random.default_rng(5).random((4, 4, 4)) < 0.4) * 1.0
    lam = mu * 2 * poisson / (1 - 2 * poisson)
    matrix, _, _ = assemble(lam, mu, edges)
    level = ElasticLevel(lam, mu, edges, np.float64)
    diagonal = np.repeat(level.diagonal, 3)
    assert np.add.reduceat(matrix.diagonal(), np.arange(0, 192, 3)) / 3 == pytest.approx(level.diagonal)
    held = diagonal > 0
    scaled = matrix.toarray()[held][:, held] / np.sqrt(np.outer(diagonal[held], diagonal[held]))
    assert np.linalg.eigvalsh(scaled)[-1] <= safe_eigenvalue(lam, mu, edges) * (1 + 1e-12)
