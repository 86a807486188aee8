"""The seven-point operator against its matrix, transfers against each other, the symmetry of the cycle."""

import numpy as np
import pytest
from scipy.sparse import coo_matrix

from sppm_pipeline.features.flow.numerics.seven_point import SCRATCH_ROWS, CellTransfer, SevenPointLevel, hierarchy_of
from sppm_pipeline.services.multigrid.hierarchy import Workspace
from sppm_pipeline.services.multigrid.rows import APPLY, BLOCK, RESIDUAL, SMOOTH


def random_level(shape, seed=1):
    rng = np.random.default_rng(seed)
    walls = (rng.random(shape) * (rng.random(shape) < 0.3)).astype(np.float32)
    weights = tuple((rng.random(shape) * (rng.random(shape) < 0.6)).astype(np.float32) for _ in range(3))
    return walls, weights


def matrix_of(walls, weights):
    numbers = np.arange(walls.size).reshape(walls.shape)
    rows, columns, values = [numbers.ravel()], [numbers.ravel()], [walls.ravel()]
    for d, w in enumerate(weights):
        before = np.roll(numbers, 1, 2 - d)
        for a, b, sign in ((numbers, numbers, 1), (before, before, 1), (numbers, before, -1), (before, numbers, -1)):
            rows.append(a.ravel())
            columns.append(b.ravel())
            values.append(sign * w.ravel())
    parts = (np.concatenate(part) for part in (rows, columns))
    return coo_matrix((np.concatenate(values).astype(float), tuple(parts)), (walls.size,) * 2).tocsr()


@pytest.mark.parametrize("shape", [(4, 3, 5), (1, 1, 1), (2, 1, BLOCK + 1)])
def test_the_pass_equals_the_matrix(shape):
    level = SevenPointLevel(*random_level(shape))
    matrix = matrix_of(*random_level(shape))
    rng = np.random.default_rng(2)
    v, r, out = rng.standard_normal((3, int(np.prod(shape)))).astype(np.float32)
    level.weight[:] = rng.random(v.size)
    work, f = Workspace([level], SCRATCH_ROWS), matrix @ v
    if min(shape) > 1:  # else an unknown is its own neighbor, which the diagonal need not know
        assert level.diagonal == pytest.approx(matrix.diagonal(), rel=1e-6)
    assert level.apply(APPLY, v, r, out, work) == pytest.approx(f @ v, rel=1e-4, abs=1e-4)
    assert out == pytest.approx(f, rel=1e-4, abs=1e-5)
    level.apply(RESIDUAL, v, r, out, work)
    assert out == pytest.approx(r - f, rel=1e-4, abs=1e-5)
    smooth = v + level.weight * (r - f)
    assert level.apply(SMOOTH, v, r, out, work) == pytest.approx(r @ smooth, rel=1e-4, abs=1e-4)
    assert out == pytest.approx(smooth, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("shape", [(6, 4, 8), (5, 7, 1)])
def test_transfers_and_cycles_are_symmetric(shape):
    grids = hierarchy_of(*random_level(shape))
    fine, coarse = grids.levels[:2]
    assert coarse.shape == tuple(-(-n // 2) for n in shape)
    rng = np.random.default_rng(3)
    work = grids.workspace()
    f, g = (rng.standard_normal(fine.weight.size).astype(np.float32) * (fine.weight > 0) for _ in range(2))
    c = rng.standard_normal(coarse.weight.size).astype(np.float32) * (coarse.weight > 0)
    down, up = np.zeros_like(c), np.zeros_like(f)
    transfer = grids.transfers[0]
    transfer.restrict(f, down, work.line)
    transfer.interpolate_add(c, up, work.line)
    assert down @ c == pytest.approx(f @ up, rel=1e-5)
    assert (up[fine.weight == 0] == 0).all()
    # constants are kept where nothing is masked
    one = CellTransfer(SevenPointLevel(*_full(fine.shape)), SevenPointLevel(*_full(coarse.shape)))
    one.fine.weight[:] = 1
    up[:] = 0
    one.interpolate_add(np.ones_like(c), up, work.line)
    assert up == pytest.approx(1)
    first = grids.cycle(f, work)[0].copy()
    second = grids.cycle(g, work)[0].copy()
    assert first @ g == pytest.approx(f @ second, rel=1e-4)
    assert first @ f > 0
    assert second @ g > 0


def _full(shape):
    return np.ones(shape, np.float32), (np.ones(shape, np.float32),) * 3
