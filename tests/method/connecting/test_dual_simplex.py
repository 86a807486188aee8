"""The dual simplex method against HiGHS, and its proofs against what they claim."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from sppm_pipeline.method.connecting.dual_simplex import DualSimplex


def random_program(seed: int, rows: int, variables: int):
    rng = np.random.default_rng(seed)
    matrix = (rng.random((rows, variables)) < 0.3).astype(float)
    low = rng.integers(0, 3, rows).astype(float)
    high = np.where(rng.random(rows) < 0.5, low + rng.integers(0, 3, rows), np.inf)
    low[rng.random(rows) < 0.2] = -np.inf
    return rng.random(variables), matrix, low, high


def reference(cost, matrix, low, high, bounds):
    above, below = np.isfinite(high), np.isfinite(low)
    a = np.concatenate([matrix[above], -matrix[below]])
    return linprog(cost, A_ub=a, b_ub=np.concatenate([high[above], -low[below]]), bounds=bounds, method="highs")


@pytest.mark.parametrize("seed", range(30))
def test_solutions_are_those_of_highs_and_proven_whatever_is_added_later(seed):
    cost, matrix, low, high = random_program(seed, 12, 25)
    program = DualSimplex(cost, np.ones(25))
    bounds = np.stack([np.zeros(25), np.ones(25)], axis=1)
    for first, last in ((0, 7), (7, 12)):
        program.add(matrix[first:last], low[first:last], high[first:last])
        x, known = program.solution(1000), reference(cost, matrix[:last], low[:last], high[:last], bounds)
        if known.status == 2:
            assert x is None
            assert program.is_infeasible()
            return
        assert x is not None
        assert cost @ x == pytest.approx(known.fun, abs=1e-9)
        assert program.lower_bound() == pytest.approx(known.fun, abs=1e-9)
        sums = matrix[:last] @ x
        assert (sums >= low[:last] - 1e-7).all()
        assert (sums <= high[:last] + 1e-7).all()
    between = np.flatnonzero((x > 1e-6) & (x < 1 - 1e-6))
    for value in (0.0, 1.0) if len(between) else ():
        branch = program.copy()
        branch.fix(int(between[0]), value)
        bounds[between[0]] = value
        x, known = branch.solution(1000), reference(cost, matrix, low, high, bounds)
        assert (x is None) == (known.status == 2)
        if x is not None:
            assert x[between[0]] == value
            assert branch.lower_bound() == pytest.approx(known.fun, abs=1e-9)
    assert program.solution(1000) is not None
    assert (program.lower == 0).all()


def test_some_of_these_programs_can_not_be_satisfied_and_some_have_values_between_the_bounds():
    status, halves = [], 0
    for seed in range(30):
        cost, matrix, low, high = random_program(seed, 12, 25)
        known = reference(cost, matrix, low, high, (0, 1))
        status.append(known.status)
        halves += known.status == 0 and bool(((known.x > 1e-6) & (known.x < 1 - 1e-6)).any())
    assert 3 <= status.count(2) <= 20
    assert halves >= 5


@pytest.mark.parametrize("free", [0.0, 0.4])
def test_whatever_is_fixed_takes_its_value_even_where_it_was_at_a_bound_and_costs_nothing(free):
    moved = 0
    for seed in range(6):
        cost, matrix, low, high = random_program(seed, 8, 15)
        cost[np.random.default_rng(seed).random(15) < free] = 0.0
        program = DualSimplex(cost, np.ones(15))
        program.add(matrix, low, high)
        if (x := program.solution(1000)) is None:
            continue
        for variable, value in np.ndindex(15, 2):
            bounds = np.stack([np.zeros(15), np.ones(15)], axis=1)
            bounds[variable] = value
            branch = program.copy()
            branch.fix(variable, float(value))
            own, known = branch.solution(1000), reference(cost, matrix, low, high, bounds)
            assert (own is None) == (known.status == 2)
            if own is not None:
                assert own[variable] == pytest.approx(value, abs=1e-9)
                assert cost @ own == pytest.approx(known.fun, abs=1e-9)
                assert branch.lower_bound() == pytest.approx(known.fun, abs=1e-9)
                moved += x[variable] == 1 - value
    assert moved > 20


def test_too_few_pivots_prove_nothing_wrong():
    cost, matrix = random_program(1, 12, 25)[:2]
    low, high = np.full(12, 1.0), np.full(12, 3.0)
    program = DualSimplex(cost, np.ones(25))
    program.add(matrix, low, high)
    best = reference(cost, matrix, low, high, (0, 1)).fun
    for pivots in range(4):
        branch = program.copy()
        assert branch.solution(pivots) is None
        assert not branch.is_infeasible()
        assert branch.lower_bound() <= best + 1e-9
