"""The shortest spanning subgraph: an integer program, solved by branching or, where that takes too long, by HiGHS.

The relaxation falls short of whole solutions mainly where an odd cycle of edges is taken by halves. One row for each
such cycle, the blossom inequality of J. Edmonds (J. Res. Nat. Bur. Standards 69B, 1965) in its form with bounds on
degrees and 0/1 variables, makes most programs whole, and branching on single edges the others. Whatever was left out is
proven to be no shorter, by weak duality.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting.candidates import candidate_graph, candidates_of_region
from sppm_pipeline.method.connecting.dual_simplex import DualSimplex
from sppm_pipeline.method.connecting.greedy import Edges, all_images, greedy_subgraph, merged_edges
from sppm_pipeline.method.connecting.program import Program
from sppm_pipeline.method.connecting.trees import component_labels, minimum_spanning_tree
from sppm_pipeline.services.arrays import F64, I64, Bools

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
        x, left = _relaxation(program, branch, shortest - slack, left)
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


def _relaxation(program: Program, branch: DualSimplex, enough: float, left: int) -> tuple[F64 | None, int]:
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


PROVEN = 100
"""Most pores whose graph is always proven to be the shortest. For more the proof costs much and gains little: 300 pores
with degrees [3, 5] take three times as long for at most 0.04 % of the length, and 150 with [2, 4] up to minutes for
0.4 %."""

# a relaxed variable this near to 0 or 1 counts as decided
_DECIDED = 1e-6

# reduced costs below this fraction of the mean edge length leave an edge undecided in the first round; the fraction
# falls as _NEARLY_PORES / n, because the work grows steeply with the number of such edges while the loss grows with the
# length
_NEARLY = 0.1
_NEARLY_PORES = 15.0

# rounding of the solver in reduced costs and gap, as a fraction of the total length of the candidates
_SLACK = 1e-9


def exact_subgraph(
    points: F64,
    lower: int,
    upper: int,
    *,
    period: F64,
    k: int,
    loops: bool,
    clearance: float | None,
    metric: F64 | None = None,
) -> Edges:
    """Shortest connected spanning subgraph of the candidate graph, proven up to `PROVEN` pores.

    The edges of the greedy graph are candidates too, so that there is a solution. Only a clearance may leave none: then
    k is doubled once, because to prove that there is none takes the longer the more candidates there are. Raises
    DesignError if no graph with this clearance exists on the widest candidate graph, or the solver gives up.
    """
    if lower <= 1 and clearance is None and not loops and metric is None:
        # the shortest connected graph is the minimum spanning tree, unless the upper bound forbids it
        edges, shifts = minimum_spanning_tree(points, periodic=period.tolist())
        if np.bincount(edges.ravel()).max() <= upper:
            return edges, shifts
    n = len(points)
    # a second, wider attempt only: proving that there is no graph gets much slower with each candidate
    widest = min(2 * k, all_images(n, period))
    k = min(k, widest)
    try:
        greedy = greedy_subgraph(
            points, lower, upper, period=period, k=k, loops=loops, clearance=clearance, metric=metric
        )
    except DesignError as error:
        # the clearance was too much for the greedy search, but may not be for the solver
        greedy, failure = None, error
    while True:
        edges, shifts = candidate_graph(points, k, periodic=period.tolist(), metric=metric)
        incumbent = None
        if greedy is not None:
            # nearly always its edges are candidates already; otherwise they make the program feasible
            edges, shifts, positions = merged_edges(edges, shifts, *greedy)
            incumbent = np.zeros(len(edges), np.bool_)
            incumbent[positions] = True
        program = Program(
            points, edges, shifts, lower, upper, tree=lower <= 1 and not loops, connected=np.zeros(n, np.int64),
            loops=loops, period=period, clearance=clearance, metric=metric,
        )  # fmt: skip
        # the greedy solution bounds the search from the start, and guarantees that there is one
        chosen = _solution(program, incumbent)
        if chosen is not None:
            return edges[chosen], shifts[chosen]
        if greedy is not None:  # the solver takes a program for infeasible that is not
            return greedy
        if k == widest:
            raise failure
        k = min(2 * k, widest)


def exactly_improved(
    points: F64, edges: I64, lower: I64, upper: I64, tree: bool, k: int, metric: F64 | None = None
) -> I64:
    """The shortest edges (m, 2) with degrees within the bounds of each pore that connect what the given ones connect.

    With `tree` no more edges than are given may be used.
    """
    both, chosen = candidates_of_region(points, edges, k, metric)
    incumbent = np.zeros(len(both), np.bool_)
    incumbent[chosen] = True
    program = Program(
        points, both, np.zeros((len(both), 3), np.int64), lower, upper, tree=tree,
        connected=component_labels(len(points), edges), metric=metric,
    )  # fmt: skip
    found = _solution(program, incumbent)
    return edges if found is None else both[found]


def _sparse_rows(program: Program) -> tuple[Any, F64, F64]:
    """The rows as a sparse matrix, and their bounds."""
    from scipy.sparse import csr_array

    columns, counts, low, high = program.rows()
    starts = np.concatenate([[0], np.cumsum(counts)])
    matrix = csr_array((np.ones(len(columns)), columns, starts), shape=(len(counts), len(program.cost)))
    return matrix, low, high


def _relaxed(program: Program) -> tuple[F64, F64] | None:
    """Solution of the linear relaxation and its reduced costs, both (m,); None if there is none.

    Adds the rows that the edges in use violate until there are none.
    """
    from scipy.optimize import linprog
    from scipy.sparse import vstack

    while True:
        rows, low, high = _sparse_rows(program)
        above, below = np.isfinite(high), np.isfinite(low)
        result = linprog(
            program.cost,
            A_ub=vstack([rows[above], -rows[below]]),
            b_ub=np.concatenate([high[above], -low[below]]),
            bounds=np.stack([np.zeros(len(program.cost)), program.allowed], axis=1),
            method="highs",
        )
        if not _solved(program, result):
            return None
        # connection is asked for lazily: there are exponentially many cuts, of which few matter
        if not program.cut_off(result.x > _DECIDED):
            return result.x, result.lower.marginals + result.upper.marginals


def _whole(program: Program, low: F64, high: F64) -> Bools | None:
    """The shortest choice of edges with ``low <= x <= high``, (m,) bool; None if there is none."""
    from scipy.optimize import Bounds, LinearConstraint, milp

    while True:
        rows, least, most = _sparse_rows(program)
        result = milp(
            program.cost,
            constraints=LinearConstraint(rows, least, most),
            integrality=np.ones(len(program.cost)),
            bounds=Bounds(low, high),
            # a gap would make the result depend on the version of the solver
            options={"mip_rel_gap": 0.0},
        )
        if not _solved(program, result):
            return None
        chosen: Bools = result.x > 0.5
        if not program.cut_off(chosen):
            return chosen


def _solved(program: Program, result: Any) -> bool:
    """True if the program is feasible; raises if the solver does not decide it."""
    if result.status in (0, 2):
        return bool(result.status == 0)
    raise DesignError(
        f"the solver found no spanning subgraph on {program.n} pores: {result.message}",
        hint="use the greedy mode, or wider degree bounds",
    )


def _solution(program: Program, incumbent: Bools | None) -> Bools | None:
    """Which edges are chosen, (m,) bool; None if there is no solution.

    Most programs of some hundred pores need no solver, see `shortest_choice`. For the others first only those edges
    stay undecided that the relaxation leaves fractional or nearly as cheap, or on which it differs from the
    `incumbent`, any solution (E. Danna, E. Rothberg, C. Le Pape, Math. Programming 102, 2005). Beyond `PROVEN` pores
    that is all. Otherwise the length of what was found decides the edges whose reduced cost exceeds the gap that is
    left, without loss, and the rest is solved.
    """
    slack = _SLACK * float(program.cost.sum())
    if (chosen := shortest_choice(program, incumbent, slack)) is not None:
        return chosen
    zero, one = np.zeros(len(program.cost)), program.allowed
    relaxation = _relaxed(program)
    if relaxation is None:
        return None
    relaxed, reduced = relaxation
    free = (relaxed > _DECIDED) & (relaxed < 1.0 - _DECIDED)
    if not program.tree:
        # the relaxed tree is all but whole, and its ties are many
        free |= np.abs(reduced) < min(_NEARLY, _NEARLY_PORES / program.n) * program.cost.mean()
    if incumbent is not None:
        free |= incumbent != (relaxed > 0.5)
    decided = np.rint(relaxed)
    found = _whole(program, np.where(free, zero, decided), np.where(free, one, decided))
    if found is None:
        return _whole(program, zero, one)
    if program.n > PROVEN:
        return found
    gap = float(program.cost[found].sum() - relaxed @ program.cost)
    open_ = np.abs(reduced) <= gap + slack
    return _whole(program, np.where(open_, zero, decided), np.where(open_, one, decided))
