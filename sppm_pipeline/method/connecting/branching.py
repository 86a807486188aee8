"""Whole solutions of the program of a spanning subgraph, by its relaxation, rows of parity, and branching.

The relaxation falls short of whole solutions mainly where an odd cycle of edges is taken by halves. One row for each
such cycle, the blossom inequality of J. Edmonds (J. Res. Nat. Bur. Standards 69B, 1965) in its form with bounds
on degrees and 0/1 variables, makes most programs whole, and branching on single edges the others. Whatever was
left out is proven to be no shorter, by weak duality.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.method.connecting.dual_simplex import DualSimplex
from sppm_pipeline.method.connecting.program import Program
from sppm_pipeline.method.connecting.trees import component_labels
from sppm_pipeline.services.arrays import F64, Bools

# a relaxed variable this near to 0 or 1 counts as whole
_WHOLE = 1e-6

# larger tableaus, in numbers, are for a solver that keeps them sparse: some two hundred pores with their neighbors
_LARGEST = 300_000

# linear programs that are solved: nearly all searches that end do so within twenty, and what takes more is for a solver
# with more means
_PROGRAMS = 60


def shortest_choice(program: Program, incumbent: Bools | None, slack: float) -> Bools | None:
    """The shortest choice of edges (m,) bool, proven to be within `slack` of any other; None if that is not reached.

    Rows that the search has found are left in the program: they hold for every solution. `incumbent` (m,) is one to
    start from.
    """
    if len(program.cost) * (len(program.rows().counts) + program.n) > _LARGEST:
        return None
    best = incumbent
    shortest = np.inf if best is None else float(program.cost[best].sum())
    # depth first: of the branches that are kept, the last one is solved next
    first = DualSimplex(program.cost, program.allowed)
    branches, left = [first], _PROGRAMS
    while branches:
        branch = branches.pop()
        x, left = _relaxed(program, branch, shortest - slack, left)
        if left < 0:
            return None
        if x is None:
            # an abandoned linear program proves nothing, so that the search has to give up
            if branch.is_infeasible() or branch.lower_bound() >= shortest - slack:
                continue
            return None
        # prune: no solution of this branch is shorter than the best one by more than rounding
        bound = branch.lower_bound()
        if bound >= shortest - slack:
            continue
        undecided = np.minimum(x, 1.0 - x)
        if undecided.max() <= _WHOLE:
            choice = x > 0.5
            length = float(program.cost[choice].sum())
            if length > bound + slack:
                return None
            best, shortest = choice, length
            continue
        # one that is undecided even where all of these cost nothing, as edges between pores at one place
        edge = int(np.argmax(np.where(undecided > _WHOLE, undecided * program.cost, -1.0)))
        # the likelier value goes last onto the stack: good solutions come early, and prune the rest
        likely = float(x[edge] > 0.5)
        for value in (1.0 - likely, likely):
            branches.append(branch.copy())
            branches[-1].fix(edge, value)
    return best


def _relaxed(program: Program, branch: DualSimplex, enough: float, left: int) -> tuple[F64 | None, int]:
    """The relaxed solution (m,) that violates no row that can be found, or one that is longer than `enough`.

    None if there is none, or none was found. Also returns how many of the `left` programs are left then; -1 if they
    were too few.
    """
    while left > 0:
        left -= 1
        _take_new_rows(program, branch)
        x = branch.solution(pivots=1000 + 20 * len(branch.rows))
        if x is None or branch.lower_bound() >= enough:
            return x, left
        # one after the other: rows of parity are looked for in what is connected
        if not (program.cut_off(x > _WHOLE) or _add_parity(program, x)):
            return x, left
    return None, -1


def _take_new_rows(program: Program, branch: DualSimplex) -> None:
    """Give a branch the rows that it does not know."""
    columns, counts, low, high = program.rows()
    known = len(branch.rows)
    owner = np.repeat(np.arange(len(counts)), counts)
    fresh = owner >= known
    rows = np.zeros((len(counts) - known, len(program.cost)))
    rows[owner[fresh] - known, columns[fresh]] = 1.0
    branch.add(rows, low[known:], high[known:])


def _add_parity(program: Program, x: F64) -> bool:
    """Add the rows of parity that a relaxed solution (m,) violates around its undecided edges; whether there are any.

    The degrees of pores W add up to twice the edges within W and once those that leave. If they are at least a each,
    and a |W| less the edges F that leave and are taken is odd, half of it is no whole number: at least the next one
    are within W or leave without being in F. With the upper bounds it is the other way round.
    """
    undecided = np.abs(x - np.rint(x)) > _WHOLE
    labels = component_labels(program.n, program.edges[undecided])
    found = False
    for part in np.flatnonzero(np.bincount(labels) > 1):
        member = (labels == part)[program.edges]
        inside, leaving = member.all(axis=1), member[:, 0] != member[:, 1]
        taken = leaving & (x > 0.5)
        least = program.lower[labels == part].sum() - np.count_nonzero(taken)
        most = program.upper[labels == part].sum() + np.count_nonzero(taken)
        if least % 2 == 1:
            row = inside | (leaving & ~taken)
            if x[row].sum() < (least + 1) / 2 - _WHOLE:
                program.add(np.flatnonzero(row), (least + 1) / 2, np.inf)
                found = True
        if most % 2 == 1:
            row = inside | taken
            if x[row].sum() > (most - 1) / 2 + _WHOLE:
                program.add(np.flatnonzero(row), -np.inf, (most - 1) / 2)
                found = True
    return found
