"""The spanning subgraph as a program: rows on 0/1 variables, one per candidate edge, to which cuts are added."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.method.connecting.clearance import close_pairs
from sppm_pipeline.method.connecting.trees import bridge_mask, component_labels, edge_lengths, kruskal
from sppm_pipeline.services.arrays import F64, I64, Bools

# clusters of the spanning tree up to this size get a row at once; larger ones only if a solution violates it
_CLUSTER = 60


class Rows(NamedTuple):
    """Rows ``low <= sum of x over some edges <= high``."""

    columns: I64  # (c,) edges of the first row, then those of the second, and so on
    counts: I64  # (r,) edges of each row
    low: F64  # (r,), infinite where there is no bound
    high: F64  # (r,), likewise


class Program:
    """Rows ``low <= sum of x over some edges <= high`` on 0/1 variables, one per candidate edge."""

    def __init__(
        self,
        points: F64,
        edges: I64,
        shifts: I64,
        lower: int | I64,
        upper: int | I64,
        *,
        tree: bool,
        connected: I64,
        loops: bool = False,
        period: F64 | None = None,
        clearance: float | None = None,
        metric: F64 | None = None,
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
        # a variable with the upper bound 0 is an edge that conflicts with itself: too close to its own image
        self.allowed = np.ones(m)
        self.conflicts = np.zeros((0, 2), np.int64)
        if clearance is not None and period is not None:
            pairs, _ = close_pairs(points, edges, shifts, clearance, periodic=period.tolist())
            own = pairs[:, 0] == pairs[:, 1]
            self.allowed[pairs[own, 0]] = 0.0
            self.conflicts = pairs[~own]
        self.conflict_added = np.zeros(len(self.conflicts), np.bool_)
        # degrees: row v holds the edges at v
        self.lower = np.broadcast_to(np.asarray(lower, np.float64), n)
        self.upper = np.broadcast_to(np.asarray(upper, np.float64), n)
        self._columns = [np.argsort(edges.ravel(), kind="stable") // 2]
        self._counts = [np.bincount(edges.ravel(), minlength=n)]
        self._low, self._high = [self.lower], [self.upper]
        # with odd n * lower the sum of the degrees is odd nowhere: half an edge that the relaxation would miss
        minimum = max(-(-int(self.lower.sum()) // 2), n if loops else n - parts)
        self.add(np.arange(m), minimum, n - parts if self.tree else np.inf)
        # exactly n - parts edges; without the upper bound the shortest graph may have loops
        if self.tree:
            self._add_clusters()

    def add(self, columns: I64, low: float, high: float) -> None:
        """Add the row of the edges `columns`."""
        self._columns.append(columns)
        self._counts.append(np.array([len(columns)]))
        self._low.append(np.array([float(low)]))
        self._high.append(np.array([float(high)]))

    def rows(self) -> Rows:
        """All rows so far; those of the degrees come first."""
        return Rows(
            np.concatenate(self._columns),
            np.concatenate(self._counts),
            np.concatenate(self._low),
            np.concatenate(self._high),
        )

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

    def _add_loop_free(self, part: Bools) -> None:
        within = np.flatnonzero(part[self.edges].all(axis=1))
        if len(within) >= part.sum():
            self.add(within, -np.inf, float(part.sum() - 1))

    def _add_cut(self, part: Bools) -> None:
        crossing = np.flatnonzero(part[self.edges[:, 0]] != part[self.edges[:, 1]])
        self.add(crossing, 2.0 if self.loops else 1.0, np.inf)

    def cut_off(self, chosen: Bools) -> bool:
        """Add rows that the chosen edges (m,) bool violate; False if there are none."""
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
                self.add(pair, -np.inf, 1.0)
            self.conflict_added |= fresh
            # a relaxed solution may use both tunnels of a pair by halves, and then violates no row
            found |= bool(fresh.any())
        return found

    def _cut_bridges(self, picked: I64) -> bool:
        bridges = np.flatnonzero(bridge_mask(self.n, picked))
        for e in bridges.tolist():
            self._add_cut(component_labels(self.n, np.delete(picked, e, axis=0)) == 0)
        return len(bridges) > 0
