"""The spanning subgraph as an integer program, solved by HiGHS with cuts added where a solution violates them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.numerics.connecting.candidates import candidate_graph, candidates_of_region
from sppm_pipeline.numerics.connecting.clearance import close_pairs
from sppm_pipeline.numerics.connecting.greedy import Edges, all_images, greedy_subgraph, merged_edges
from sppm_pipeline.numerics.connecting.trees import (
    bridge_mask,
    component_labels,
    edge_lengths,
    kruskal,
    minimum_spanning_tree,
)

# a relaxed variable this near to 0 or 1 counts as decided
_DECIDED = 1e-6

# reduced costs below this fraction of the mean edge length leave an edge undecided in the first round; the fraction
# falls as _NEARLY_PORES / n, because the work grows steeply with the number of such edges while the loss grows with the
# length
_NEARLY = 0.1
_NEARLY_PORES = 15.0

# rounding of the solver in reduced costs and gap, as a fraction of the total length of the candidates
_SLACK = 1e-9

# clusters of the spanning tree up to this size get a row at once; larger ones only if a solution violates it
_CLUSTER = 60


def exact_subgraph(
    points: NDArray[np.float64],
    lower: int,
    upper: int,
    *,
    period: NDArray[np.float64],
    k: int,
    loops: bool,
    clearance: float | None,
    fix: bool,
    metric: NDArray[np.float64] | None = None,
) -> Edges:
    """Shortest connected spanning subgraph of the candidate graph; `fix` keeps what the linear relaxation decides.

    The edges of the greedy graph are candidates too, so that there is a solution. Only a clearance may leave none: then
    k is doubled once, because to prove that there is none takes the longer the more candidates there are.

    Raises
    ------
    DesignError
        If no graph with this clearance exists on the widest candidate graph, or the solver gives up.
    """
    if lower <= 1 and clearance is None and not loops and metric is None:
        # the shortest connected graph is the minimum spanning tree, unless the upper bound forbids it
        edges, shifts = minimum_spanning_tree(points, periodic=period.tolist())
        if np.bincount(edges.ravel()).max() <= upper:
            return edges, shifts
    n = len(points)
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
        program = _Program(
            points,
            edges,
            shifts,
            lower,
            upper,
            tree=lower <= 1 and not loops,
            connected=np.zeros(n, np.int64),
            loops=loops,
            period=period,
            clearance=clearance,
            metric=metric,
        )
        chosen = program.solution(incumbent, fix)
        if chosen is not None:
            return edges[chosen], shifts[chosen]
        if k == widest:
            raise failure
        k = min(2 * k, widest)


def exactly_improved(
    points: NDArray[np.float64],
    edges: NDArray[np.int64],
    lower: NDArray[np.int64],
    upper: NDArray[np.int64],
    tree: bool,
    k: int,
    fix: bool,
    metric: NDArray[np.float64] | None = None,
) -> NDArray[np.int64]:
    """The shortest edges (m, 2) with degrees within the bounds of each pore that connect what the given ones connect.

    With `tree` no more edges than are given may be used.
    """
    both, chosen = candidates_of_region(points, edges, k, metric)
    incumbent = np.zeros(len(both), np.bool_)
    incumbent[chosen] = True
    program = _Program(
        points,
        both,
        np.zeros((len(both), 3), np.int64),
        lower,
        upper,
        tree=tree,
        connected=component_labels(len(points), edges),
        metric=metric,
    )
    found = program.solution(incumbent, fix)
    return edges if found is None else both[found]


class _Program:
    """Rows ``low <= sum of x over some edges <= high`` on 0/1 variables, one per candidate edge."""

    def __init__(
        self,
        points: NDArray[np.float64],
        edges: NDArray[np.int64],
        shifts: NDArray[np.int64],
        lower: int | NDArray[np.int64],
        upper: int | NDArray[np.int64],
        *,
        tree: bool,
        connected: NDArray[np.int64],
        loops: bool = False,
        period: NDArray[np.float64] | None = None,
        clearance: float | None = None,
        metric: NDArray[np.float64] | None = None,
    ) -> None:
        """`connected` are labels (n,): pores of one label are connected in every solution, others need not be."""
        n, m = len(points), len(edges)
        parts = int(connected.max()) + 1
        self.n = n
        self.edges = edges
        self.cost = edge_lengths(points, edges, shifts, metric)
        self.loops = loops
        self.tree = tree
        self.connected = connected
        self.allowed = np.ones(m)
        self.conflicts = np.zeros((0, 2), np.int64)
        if clearance is not None and period is not None:
            pairs, _ = close_pairs(points, edges, shifts, clearance, periodic=period.tolist())
            own = pairs[:, 0] == pairs[:, 1]
            self.allowed[pairs[own, 0]] = 0.0
            self.conflicts = pairs[~own]
        self.conflict_added = np.zeros(len(self.conflicts), np.bool_)
        # degrees: row v holds the edges at v
        self.columns = [np.argsort(edges.ravel(), kind="stable") // 2]
        self.counts = [np.bincount(edges.ravel(), minlength=n)]
        self.low = [np.broadcast_to(np.asarray(lower, np.float64), n)]
        self.high = [np.broadcast_to(np.asarray(upper, np.float64), n)]
        # with odd n * lower the sum of the degrees is odd nowhere: half an edge that the relaxation would miss
        minimum = max(-(-int(self.low[0].sum()) // 2), n if loops else n - parts)
        self._add(np.arange(m), minimum, n - parts if self.tree else np.inf)
        if self.tree:
            self._add_clusters()

    def _add(self, columns: NDArray[np.int64], low: float, high: float) -> None:
        self.columns.append(columns)
        self.counts.append(np.array([len(columns)]))
        self.low.append(np.array([float(low)]))
        self.high.append(np.array([float(high)]))

    def _add_clusters(self) -> None:
        """No cluster of Kruskal's algorithm holds a loop: these rows alone make the relaxation of the tree exact."""
        members = {v: [v] for v in range(self.n)}
        name = np.arange(self.n)
        for e in kruskal(self.n, self.edges, np.argsort(self.cost, kind="stable")).tolist():
            a, b = sorted(int(name[v]) for v in self.edges[e])
            members[a] += members.pop(b)
            if len(members[a]) <= _CLUSTER:
                self._add_loop_free(np.isin(np.arange(self.n), members[a]))
            name[members[a]] = a

    def _add_loop_free(self, part: NDArray[np.bool_]) -> None:
        within = np.flatnonzero(part[self.edges].all(axis=1))
        if len(within) >= part.sum():
            self._add(within, -np.inf, float(part.sum() - 1))

    def _add_cut(self, part: NDArray[np.bool_]) -> None:
        crossing = np.flatnonzero(part[self.edges[:, 0]] != part[self.edges[:, 1]])
        self._add(crossing, 2.0 if self.loops else 1.0, np.inf)

    def _rows(self) -> tuple[Any, NDArray[np.float64], NDArray[np.float64]]:
        """The rows as a sparse matrix, and their bounds."""
        from scipy.sparse import csr_array

        counts = np.concatenate(self.counts)
        starts = np.concatenate([[0], np.cumsum(counts)])
        columns = np.concatenate(self.columns)
        rows = csr_array((np.ones(len(columns)), columns, starts), shape=(len(counts), len(self.cost)))
        return rows, np.concatenate(self.low), np.concatenate(self.high)

    def _relaxed(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Solution of the linear relaxation and its reduced costs, both (m,); None if there is none.

        Adds the rows that the edges in use violate until there are none.
        """
        from scipy.optimize import linprog
        from scipy.sparse import vstack

        while True:
            rows, low, high = self._rows()
            above, below = np.isfinite(high), np.isfinite(low)
            result = linprog(
                self.cost,
                A_ub=vstack([rows[above], -rows[below]]),
                b_ub=np.concatenate([high[above], -low[below]]),
                bounds=np.stack([np.zeros(len(self.cost)), self.allowed], axis=1),
                method="highs",
            )
            if not self._solved(result):
                return None
            if not self._cut_off(result.x > _DECIDED):
                return result.x, result.lower.marginals + result.upper.marginals

    def _whole(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_] | None:
        """The shortest choice of edges with ``low <= x <= high``, (m,) bool; None if there is none."""
        from scipy.optimize import Bounds, LinearConstraint, milp

        while True:
            rows, least, most = self._rows()
            result = milp(
                self.cost,
                constraints=LinearConstraint(rows, least, most),
                integrality=np.ones(len(self.cost)),
                bounds=Bounds(low, high),
                options={"mip_rel_gap": 0.0},
            )
            if not self._solved(result):
                return None
            chosen: NDArray[np.bool_] = result.x > 0.5
            if not self._cut_off(chosen):
                return chosen

    def _solved(self, result: Any) -> bool:
        """Whether there is a solution; raises if the solver does not decide it."""
        if result.status in (0, 2):
            return bool(result.status == 0)
        raise DesignError(
            f"the solver found no spanning subgraph on {self.n} pores: {result.message}",
            hint="use the greedy mode, or wider degree bounds",
        )

    def _cut_off(self, chosen: NDArray[np.bool_]) -> bool:
        """Add the rows that the chosen edges violate; False if there are none."""
        picked = self.edges[chosen]
        labels = component_labels(self.n, picked)
        parts = int(labels.max()) + 1
        # parts that hold some, but not all, of what is to be connected
        pieces = np.unique(np.stack([self.connected, labels], axis=1), axis=0)
        torn = np.unique(pieces[np.bincount(pieces[:, 0])[pieces[:, 0]] > 1, 1])
        # two parts have one and the same border
        for part in torn if parts > 2 else torn[:1]:
            inside = labels == part
            self._add_cut(inside)
            if self.tree:
                self._add_loop_free(inside)
        if self.loops and parts == 1:
            found = self._cut_bridges(picked)
        else:
            found = len(torn) > 0
        hit = chosen[self.conflicts].all(axis=1)
        if hit.any():
            # all that excludes a tunnel in such a pair: its next best neighbor would often conflict as well
            involved = np.zeros(len(chosen), np.bool_)
            involved[self.conflicts[hit]] = True
            fresh = involved[self.conflicts].any(axis=1) & ~self.conflict_added
            for pair in self.conflicts[fresh]:
                self._add(pair, -np.inf, 1.0)
            self.conflict_added |= fresh
            # a relaxed solution may use both tunnels of a pair by halves, and then violates no row
            found |= bool(fresh.any())
        return found

    def _cut_bridges(self, picked: NDArray[np.int64]) -> bool:
        bridges = np.flatnonzero(bridge_mask(self.n, picked))
        for e in bridges.tolist():
            self._add_cut(component_labels(self.n, np.delete(picked, e, axis=0)) == 0)
        return len(bridges) > 0

    def solution(self, incumbent: NDArray[np.bool_] | None, fix: bool) -> NDArray[np.bool_] | None:
        """Which edges are chosen, (m,) bool; None if there is no solution.

        First only those edges stay undecided that the relaxation leaves fractional or nearly as cheap, or on which it
        differs from the `incumbent`, any solution (E. Danna, E. Rothberg, C. Le Pape, Math. Programming 102, 2005).
        With `fix` that is all. Otherwise the length of what was found decides the edges whose reduced cost exceeds
        the gap that is left, without loss, and the rest is solved.
        """
        zero, one = np.zeros(len(self.cost)), self.allowed
        relaxation = self._relaxed()
        if relaxation is None:
            return None
        relaxed, reduced = relaxation
        free = (relaxed > _DECIDED) & (relaxed < 1.0 - _DECIDED)
        if not self.tree:
            # the relaxed tree is all but whole, and its ties are many
            free |= np.abs(reduced) < min(_NEARLY, _NEARLY_PORES / self.n) * self.cost.mean()
        if incumbent is not None:
            free |= incumbent != (relaxed > 0.5)
        decided = np.rint(relaxed)
        found = self._whole(np.where(free, zero, decided), np.where(free, one, decided))
        if found is None:
            return self._whole(zero, one)
        if fix:
            return found
        gap = float(self.cost[found].sum() - relaxed @ self.cost)
        open_ = np.abs(reduced) <= gap + _SLACK * self.cost.sum()
        return self._whole(np.where(open_, zero, decided), np.where(open_, one, decided))
