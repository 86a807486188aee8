"""Effective conductivity: the assembled matrix, exact cases, bounds, symmetries."""

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

from sppm_pipeline.features.flow.numerics.conduction import SCRATCH_ROWS, ConductionLevel, conductivity, tortuosity
from sppm_pipeline.services.multigrid.hierarchy import Workspace
from sppm_pipeline.services.multigrid.rows import APPLY, BLOCK, RESIDUAL, SMOOTH

TIGHT = {"precision": np.float64, "tolerance": 0.0, "residual": 1e-10}
CORNERS = np.array([(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)])


def assemble(k, edges=(1.0, 1.0, 1.0)):
    """Matrix, (n, 3) flows of the unit gradients, volume times the mean conductivity; by Gauss integration."""
    nz, ny, nx = k.shape
    unit, load = np.zeros((8, 8)), np.zeros((8, 3))
    weight = np.prod(edges) / 8
    for point in (2 * CORNERS - 1) / np.sqrt(3):
        b = np.empty((3, 8))
        for d in range(3):
            others = [e for e in range(3) if e != d]
            b[d] = (2 * CORNERS - 1)[:, d] / 8 * 2 / edges[d]
            b[d] *= np.prod(1 + (2 * CORNERS - 1)[:, others] * point[others], axis=1)
        unit += weight * b.T @ b
        load += weight * b.T
    z, y, x = np.indices(k.shape).reshape(3, -1)
    nodes = np.stack([((z + c) % nz * ny + (y + b) % ny) * nx + (x + a) % nx for a, b, c in CORNERS], axis=1)
    values = k.reshape(-1, 1, 1) * unit
    rows, columns = np.repeat(nodes, 8, axis=1), np.tile(nodes, (1, 8))
    matrix = coo_matrix((values.reshape(-1), (rows.reshape(-1), columns.reshape(-1))), (k.size, k.size)).tocsc()
    flows = np.zeros((k.size, 3))
    np.add.at(flows, nodes, k.reshape(-1, 1, 1) * load)
    return matrix, flows, np.prod(edges) * k.sum() * np.eye(3)


def assembled_conductivity(k, edges=(1.0, 1.0, 1.0)):
    matrix, flows, mean = assemble(k, edges)
    held = matrix.diagonal() > 0
    held[np.flatnonzero(held)[0]] = False
    u = np.zeros_like(flows)
    u[held] = splu(matrix[held][:, held].tocsc()).solve(-flows[held])
    return (mean + flows.T @ u) / (k.size * np.prod(edges))


@pytest.mark.parametrize("shape", [(4, 3, 5), (1, 1, 1), (2, 3, 9), (1, 2, BLOCK), (2, 1, BLOCK + 1)])
@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (1.0, 0.7, 1.9)])
def test_pass_equals_the_assembled_matrix(shape, edges):
    rng = np.random.default_rng(1)
    k = rng.random(shape) * (rng.random(shape) < 0.7)
    matrix, flows, _ = assemble(k, edges)
    level = ConductionLevel(k, edges, np.float64)
    v, r, out = rng.standard_normal((3, k.size))
    level.weight[:] = rng.random(k.size)
    work = Workspace([level], SCRATCH_ROWS)
    f = matrix @ v
    assert level.apply(APPLY, v, r, out, work) == pytest.approx(f @ v, rel=1e-12, abs=1e-12)
    assert out == pytest.approx(f, rel=1e-12, abs=1e-12)
    level.apply(RESIDUAL, v, r, out, work)
    assert out == pytest.approx(r - f, rel=1e-12, abs=1e-12)
    level.apply(SMOOTH, v, r, out, work)
    assert out == pytest.approx(v + level.weight * (r - f), rel=1e-12, abs=1e-12)
    for case in range(3):
        level.forces(np.eye(3)[case], out, work)
        assert out == pytest.approx(flows[:, case], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("shape", [(6, 7, 8), (9, 5, 3), (12, 12, 12)])
@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (0.5, 1.0, 1.3)])
def test_a_direct_solver_agrees(shape, edges):
    k = np.array([1e-3, 1.0, 20.0])[np.random.default_rng(3).integers(0, 3, shape)]
    expected = assembled_conductivity(k, edges)
    assert conductivity(k, edges, **TIGHT).conductivity == pytest.approx(expected, rel=1e-8, abs=1e-9)
    assert conductivity(k, edges).conductivity == pytest.approx(expected, abs=1e-4 * expected.max())


def test_insulators_and_fractions():
    share = np.clip(np.random.default_rng(4).standard_normal((9, 10, 8)) + 0.6, 0, 1)
    expected = assembled_conductivity(share)
    assert conductivity(share, **TIGHT).conductivity == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("axis", range(3))
def test_laminates_are_exact(axis):
    k = np.array([1.0, 0.05, 4.0, 0.4, 3.0])
    shape = [1, 1, 1]
    shape[2 - axis] = 5
    image = np.broadcast_to(k.reshape(shape), [5 if a == 2 - axis else 3 for a in range(3)])
    expected = np.diag([1 / np.mean(1 / k) if a == axis else k.mean() for a in range(3)])
    assert conductivity(image, **TIGHT).conductivity == pytest.approx(expected, abs=1e-9)
    single = conductivity(image, tolerance=0.0, residual=1e-6).conductivity
    assert single == pytest.approx(expected, abs=1e-6 * expected.max())


def test_homogeneous_conductor_and_nothing():
    result = conductivity(np.full((3, 4, 5), 7.0))
    assert result.conductivity == pytest.approx(7 * np.eye(3), rel=1e-6, abs=1e-6)
    assert all(case.iterations == 0 for case in result.solved)
    assert not conductivity(np.zeros((3, 4, 5))).conductivity.any()


def test_islands_conduct_nothing():
    k = np.zeros((8, 9, 10))
    k[2:5, 3:6, 1:7] = 1
    assert not conductivity(k).conductivity.any()
    k[:, 7, 8] = 1
    found = conductivity(k).conductivity
    assert found == pytest.approx(np.diag([0, 0, 1 / 90]), rel=1e-5)
    assert found[0, 0] == found[1, 1] == 0


@pytest.mark.parametrize("seed", range(3))
def test_bounds_of_hashin_and_shtrikman(seed):
    """Of an isotropic mixture; a random one is nearly isotropic on average over the axes."""
    low, high = 0.1, 1.0
    image = np.random.default_rng(seed).random((16, 16, 16)) < 0.4
    share = image.mean()
    found = np.trace(conductivity(np.where(image, high, low), **TIGHT).conductivity) / 3
    lower = low + share / (1 / (high - low) + (1 - share) / (3 * low))
    upper = high + (1 - share) / (1 / (low - high) + share / (3 * high))
    assert lower < found < upper


def test_a_checkerboard_of_columns():
    """Keller and Dykhne: the geometric mean across columns, for squares of many voxels."""
    n = 32
    y, x = np.indices((n, n)) * 2 // n
    columns = np.where((x + y) % 2 == 0, 1.0, 0.25)
    found = conductivity(np.repeat(columns[None], 2, axis=0), **TIGHT).conductivity
    assert found[0, 0] == pytest.approx(0.5, rel=0.02)
    assert found[1, 1] == pytest.approx(found[0, 0])
    assert found[2, 2] == pytest.approx(0.625)


def test_rotated_and_moved_cells():
    k = np.random.default_rng(5).random((7, 8, 9)) ** 3
    first = conductivity(k, **TIGHT).conductivity
    turned = conductivity(k.transpose(1, 2, 0), **TIGHT).conductivity
    assert turned[np.ix_([1, 2, 0], [1, 2, 0])] == pytest.approx(first, abs=1e-9)
    moved = np.roll(k, (2, 3, -4), (0, 1, 2))
    assert conductivity(moved, **TIGHT).conductivity == pytest.approx(first, abs=1e-9)
    assert conductivity(3.0 * k, (2e-3,) * 3, **TIGHT).conductivity == pytest.approx(3 * first, abs=1e-8)


def test_threads_change_no_bit():
    k = (np.random.default_rng(6).random((11, 12, 13)) < 0.6) * 1.0
    found = {conductivity(k, threads=threads).conductivity.tobytes() for threads in (1, 2, 4)}
    assert len(found) == 1


def test_tortuosity():
    assert tortuosity(np.diag([0.25, 0.5, 0.0]), 0.5) == [2.0, 1.0, None]
    assert tortuosity(np.diag([50.0, 50.0, 50.0]), 0.5, 200.0) == [2.0] * 3


@pytest.mark.parametrize("k", [-np.ones((2, 2, 2)), np.full((2, 2, 2), np.nan), np.ones((2, 2))])
def test_nonsense_is_refused(k):
    with pytest.raises(ValueError, match=r"conductivit(y|ies)"):
        conductivity(k)
