"""Small linear programs with bounded variables by the dual simplex method, to which rows can be added.

Made for programs that are solved in a millisecond and again after each few rows, where it takes longer to load a large
solver, and to hand it the program, than to solve it. The tableau is dense. Callers should prove the result by
`lower_bound`: weak duality needs no trust in any pivot.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import jit

# a basic variable may miss its bounds by this much
_FEASIBLE = 1e-9

# entries of the tableau below this are rounding, and no pivots
_PIVOT = 1e-9

# a contradiction smaller than this fraction of its terms may be rounding
_PROVEN = 1e-7


class DualSimplex:
    """Minimize ``cost @ x`` for ``lower <= x <= upper`` and ``low <= rows @ x <= high``, with costs of at least 0.

    `cost`, `lower` and `upper` are (m,), `rows` (r, m), `low` and `high` (r,), infinite where there is no bound.
    """

    def __init__(self, cost: F64, upper: F64) -> None:
        m = len(cost)
        self.cost = np.asarray(cost, np.float64)
        self.lower, self.upper = np.zeros(m), np.array(upper, np.float64)
        self.rows = np.zeros((0, m))
        self.low, self.high = np.zeros(0), np.zeros(0)
        # basic = tableau @ nonbasic; first come the numbers of the variables, then those of the rows' sums
        self._tableau = np.zeros((0, m))
        self._basic = np.zeros(0, np.int64)
        self._nonbasic = np.arange(m)
        self._at = np.zeros(m)  # the bound at which each that is not basic is
        self._reduced = self.cost.copy()  # of those that are not basic: no sum is left without rows, and all x are 0
        self._stuck = -1

    def copy(self) -> DualSimplex:
        """One that goes on from here by itself."""
        twin = copy(self)
        for name in ("lower", "upper", "_tableau", "_basic", "_nonbasic", "_at", "_reduced"):
            setattr(twin, name, getattr(self, name).copy())
        return twin

    def add(self, rows: F64, low: F64, high: F64) -> None:
        """Add rows (a, m) with their bounds (a,)."""
        m, known = len(self.cost), len(self.rows)
        self.rows = np.concatenate([self.rows, rows])
        self.low, self.high = np.concatenate([self.low, low]), np.concatenate([self.high, high])
        padded = np.concatenate([rows, np.zeros((len(rows), known))], axis=1)
        fresh = padded[:, self._nonbasic] + padded[:, self._basic] @ self._tableau
        self._tableau = np.concatenate([self._tableau, fresh])
        self._basic = np.concatenate([self._basic, m + known + np.arange(len(rows))])

    def fix(self, variable: int, value: float) -> None:
        """Give a variable a value, wherever it was in the last solution."""
        self.lower[variable] = self.upper[variable] = value
        # one that is not basic stays where it is put, as what is fixed never enters, and its price may have any sign;
        # one that is basic leaves when the bounds that it misses are kept
        self._at[self._nonbasic == variable] = value

    def solution(self, pivots: int) -> F64 | None:
        """The solution (m,); None if there is none, see `is_infeasible`, or not after so many pivots."""
        m = len(self.cost)
        low, high = np.concatenate([self.lower, self.low]), np.concatenate([self.upper, self.high])
        values = self._tableau @ self._at
        state = (self._tableau, self._basic, self._nonbasic, self._at, values, self._reduced)
        found, self._stuck = _solve(*state, low, high, pivots)
        if not found:
            return None
        x = np.zeros(m + len(self.rows))
        x[self._nonbasic] = self._at
        x[self._basic] = self._tableau @ self._at
        solution: F64 = x[:m]
        return solution

    def is_infeasible(self) -> bool:
        """True if infeasibility is proven, after `solution` returned None."""
        if self._stuck < 0:
            return False
        m = len(self.cost)
        # the row that can't be satisfied: this combination of x and the rows' sums is zero for every x
        weight = np.zeros(m + len(self.rows))
        weight[self._nonbasic] = self._tableau[self._stuck]
        weight[self._basic[self._stuck]] = -1.0
        of_rows = np.where(np.abs(weight[m:]) > _PIVOT, weight[m:], 0.0)
        # feasible x would have to be able to make it zero from both sides
        least = max(self._least(sign * of_rows, -sign * (of_rows @ self.rows)) for sign in (1.0, -1.0))
        return least > _PROVEN * float(np.abs(of_rows).sum())

    def lower_bound(self) -> float:
        """Lower bound of all solutions, by weak duality: computed from the rows as they were given.

        Any prices of the rows prove a bound; those of the last solution prove the best one, up to rounding.
        """
        m = len(self.cost)
        price = np.zeros(len(self.rows))
        of_rows = self._nonbasic >= m
        price[self._nonbasic[of_rows] - m] = self._reduced[of_rows]
        price[~np.isfinite(np.where(price > 0, self.low, self.high))] = 0.0  # rounding: no bound, no price
        return self._least(price, self.cost - price @ self.rows)

    def _least(self, of_rows: F64, of_variables: F64) -> float:
        """The least of these multiples of the rows' sums and the variables, added up, within all bounds."""
        used = of_rows != 0.0
        bound = np.where(of_rows > 0, self.low, self.high)[used]
        ends = np.minimum(of_variables * self.lower, of_variables * self.upper)
        return float(of_rows[used] @ bound + ends.sum())


@jit
def _solve(
    tableau: F64, basic: I64, nonbasic: I64, at: F64, values: F64, reduced: F64, low: F64, high: F64, pivots: int
) -> tuple[bool, int]:
    """Pivot until all basic variables keep their bounds: whether they do, and else the row that none can satisfy.

    The row is -1 after so many pivots.
    """
    r, m = tableau.shape
    column = np.empty(r)
    for _ in range(pivots):
        # the basic variable that is farthest out leaves
        leaving, worst, target = -1, _FEASIBLE, 0.0
        for i in range(r):
            v = basic[i]
            below, above = low[v] - values[i], values[i] - high[v]
            if below > worst:
                leaving, worst, target = i, below, low[v]
            if above > worst:
                leaving, worst, target = i, above, high[v]
        if leaving < 0:
            return True, -1
        # the price that first changes its sign enters; of equal ones the largest pivot
        direction = 1.0 if values[leaving] < target else -1.0
        entering, smallest, size = -1, np.inf, 0.0
        for j in range(m):
            a = direction * tableau[leaving, j]
            v = nonbasic[j]
            if abs(a) <= _PIVOT or low[v] == high[v] or (a > 0.0) == (at[j] == high[v]):
                continue
            ratio = abs(reduced[j] / a)
            if ratio < smallest or (ratio == smallest and abs(a) > size):
                entering, smallest, size = j, ratio, abs(a)
        if entering < 0:
            return False, leaving
        pivot = tableau[leaving, entering]
        step = (target - values[leaving]) / pivot
        for i in range(r):
            column[i] = tableau[i, entering]
            values[i] += column[i] * step
        entered = at[entering] + step
        row = tableau[leaving]
        for j in range(m):
            row[j] = -row[j] / pivot
        row[entering] = 1.0 / pivot
        for i in range(r):
            factor = column[i]
            if i == leaving or factor == 0.0:
                continue
            tableau[i, entering] = 0.0
            for j in range(m):
                tableau[i, j] += factor * row[j]
        factor = reduced[entering]
        reduced[entering] = 0.0
        for j in range(m):
            reduced[j] += factor * row[j]
        basic[leaving], nonbasic[entering] = nonbasic[entering], basic[leaving]
        values[leaving], at[entering] = entered, target
    return False, -1
