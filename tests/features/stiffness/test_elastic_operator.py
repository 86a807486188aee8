"""The pass over the grid is the assembled matrix, and the energies are its quadratic form."""

import numpy as np
import pytest

from sppm_pipeline.features.stiffness.numerics.elasticity import MutualEnergies
from sppm_pipeline.services.elastic.elastic_level import ElasticLevel, Moduli, largest_eigenvalue
from sppm_pipeline.services.elastic.elastic_operator import SCRATCH_ROWS
from sppm_pipeline.services.multigrid.hierarchy import Hierarchy, Workspace
from sppm_pipeline.services.multigrid.rows import APPLY, BLOCK, RESIDUAL, SMOOTH
from sppm_pipeline.services.multigrid.transfer import NodalTransfer
from sppm_pipeline.services.multigrid.vectors import dot, pack

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
    level = ElasticLevel(Moduli.of(lam, mu), edges, np.float64)
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


def level_of(lam, mu, edges, ratio):
    """With one Poisson's ratio, of which only mu is stored, or with many."""
    level = ElasticLevel(Moduli.of(lam, mu), edges, np.float64)
    assert (level.lam is level.mu) == (ratio is not None or lam.size == 1)
    level.weight[:] = np.random.default_rng(6).random(lam.size)
    return level


def planar_workspace(level, coarse):
    below = ElasticLevel(Moduli.of(*np.ones((2, *coarse))), level.edges, np.float64)
    return Workspace([level, below], SCRATCH_ROWS, True)


@pytest.mark.parametrize("ratio", [None, 0.7])
@pytest.mark.parametrize("shape", [(4, 3, 5), (1, 2, 1), (2, 2, BLOCK + 3)])
@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (1.0, 0.7, 1.9)])
def test_energies_are_the_quadratic_form(assemble, shape, edges, ratio):
    """Of load cases that are measured one after the other, whatever their displacements; 16 bits are those of them."""
    lam, mu = voxels(shape)
    if ratio is not None:
        lam = ratio * mu
    matrix, forces, mean = assemble(lam, mu, edges)
    level = level_of(lam, mu, edges, ratio)
    # multiples of what 16 bits resolve
    fields = np.random.default_rng(3).integers(-32767, 32768, (6, 3 * lam.size)) / 32767.0
    fields[:, 0] = 1
    measure = MutualEnergies(Hierarchy([level], [], np.zeros((0, 0)), SCRATCH_ROWS, False))
    work = Workspace([level], SCRATCH_ROWS)
    for case, field in enumerate(fields):
        measure.keep(case, field)
        measure.record(case, field, np.empty_like(field), work)
    u = np.array([by_node(field, shape) for field in fields]).T
    volume = lam.size * np.prod(edges)
    expected = (u.T @ (matrix @ u) + forces.T @ u + u.T @ forces + mean) / volume
    assert measure.energies(1) == pytest.approx(expected, rel=1e-11, abs=1e-10)
    assert measure.held == pytest.approx((u.T @ forces + mean) / volume, rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("shape", [*SHAPES[:-1], (3, 3, BLOCK + 3)])
@pytest.mark.parametrize("ratio", [None, -0.2])
def test_planar_passes_are_those_with_whole_vectors(shape, ratio):
    lam, mu = voxels(shape)
    if ratio is not None:
        lam = ratio * mu
    level = level_of(lam, mu, (1.0, 0.7, 1.9), ratio)
    coarse = tuple(-(-n // 2) for n in shape)
    work, rng = planar_workspace(level, coarse), np.random.default_rng(7)
    transfer = NodalTransfer.between(shape, coarse)
    r, p, z = rng.standard_normal((3, 3 * lam.size))
    down, correction = np.empty(3 * np.prod(coarse)), rng.standard_normal(3 * np.prod(coarse))
    expected, rest, found = np.empty_like(down), np.empty_like(r), np.empty_like(r)
    weighted = np.tile(level.weight, 3) * r
    level.apply(RESIDUAL, weighted, r, rest, work)
    transfer.restrict(rest, expected, work.line)
    level.descend(r, down, transfer, work)
    assert down == pytest.approx(expected, rel=1e-12, abs=1e-12)
    transfer.interpolate_add(correction, weighted, work.line)
    product = level.apply(SMOOTH, weighted, r, rest, work)
    assert level.ascend(r, correction, transfer, found, work) == pytest.approx(product, rel=1e-11)
    assert found == pytest.approx(rest, rel=1e-12, abs=1e-12)
    turned = z + 0.3 * p
    product = level.apply(APPLY, turned, turned, rest, work)
    assert level.turn_apply(z, 0.3, p, work) == pytest.approx(product, rel=1e-12)
    assert p == pytest.approx(turned, rel=1e-14, abs=1e-14)
    assert z == pytest.approx(rest, rel=1e-12, abs=1e-12)
    # a residual may take the place of the right-hand side
    level.apply(RESIDUAL, turned, r, rest, work)
    level.apply(RESIDUAL, turned, r, r, work)
    assert (r == rest).all()


def test_packed_vectors_are_within_half_a_step():
    a, b = np.random.default_rng(8).standard_normal((2, 10_000)).astype(np.float32)
    packed = np.empty(a.size, np.int16)
    step = pack(a, packed)
    assert step == pytest.approx(np.abs(a).max() / 32767)
    assert np.abs(step * packed - a).max() <= 0.51 * step
    assert step * dot(packed, b) == pytest.approx(step * (packed.astype(float) @ b.astype(float)), rel=1e-12)
    assert pack(np.zeros(10_000, np.float32), packed) == 0
    assert not packed.any()


@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (1.0, 0.5, 2.0)])
@pytest.mark.parametrize("poisson", [-0.6, 0.0, 0.3, 0.49])
def test_the_largest_eigenvalue_has_a_bound(assemble, edges, poisson):
    mu = (np.random.default_rng(5).random((4, 4, 4)) < 0.4) * 1.0
    lam = mu * 2 * poisson / (1 - 2 * poisson)
    matrix, _, _ = assemble(lam, mu, edges)
    level = ElasticLevel(Moduli.of(lam, mu), edges, np.float64)
    diagonal = np.repeat(level.diagonal, 3)
    assert np.add.reduceat(matrix.diagonal(), np.arange(0, 192, 3)) / 3 == pytest.approx(level.diagonal)
    held = diagonal > 0
    scaled = matrix.toarray()[held][:, held] / np.sqrt(np.outer(diagonal[held], diagonal[held]))
    assert np.linalg.eigvalsh(scaled)[-1] <= largest_eigenvalue(Moduli.of(lam, mu), edges) * (1 + 1e-12)
