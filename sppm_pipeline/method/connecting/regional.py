"""Degree-bounded subgraphs on any number of pores: the spanning tree, filled up and improved region by region.

A pass cuts the box into regions that share no pore; each replaces the edges among its own pores by shorter ones, and
leaves those that lead out of it as they are: they count for the degrees. An edge may go if its ends stay connected, be
it by a way through the pores around the region: with A = 2 loops are long, and few lie in one region. So regions that
touch are never worked on at a time; they have colors, and all of one color see what those before have left. Neither the
order nor the number of regions at a time within a color matters. The regions of the next pass are moved by half an edge
along every axis, across the periodic border, too, so that what was a border comes to lie inside.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting.candidates import candidate_graph, candidates_of_region
from sppm_pipeline.method.connecting.exchange import fill, improve, lower_degrees, raise_degrees
from sppm_pipeline.method.connecting.moves import CHOSEN, DEGREE, edge_table, insert_all, node_table
from sppm_pipeline.method.connecting.relative_degrees import (
    REACH,
    Network,
    as_tunnels,
    connected_neighbors,
    degrees_of,
    ends_by_pore,
    tree_of,
)
from sppm_pipeline.method.connecting.trees import component_labels, edge_lengths, wrapped
from sppm_pipeline.services.arrays import F64, I8, I32, I64, Bools
from sppm_pipeline.services.threads import ordered_map

WHOLE = 2000
"""Most pores that are joined by one search, and that a region of the exact mode holds: the time of an integer program
grows steeply beyond."""

GREEDY_REGION = 6000
"""Pores of a region in greedy mode (heuristic): larger regions have relatively fewer pores around them that are joined
twice, smaller ones keep more threads busy. It changes which of the equally good graphs is found."""

AROUND = 5.0
"""Mean distances of pores within which ways around a region are looked for. With 9 graphs of degrees [2, 3] come out
the same within 0.2 %."""

FIXED = -1e6
"""Length, mean distances of pores, of edges that stay as they are: taking one out never gains."""

PASSES = (0.0, 0.5)
"""Places of the regions in fractions of their edge."""

BORDER = 1.5
"""Mean distances from the borders of the pass before within which pores are tried again (heuristic): as far as the
tenth neighbor of evenly spread pores lies (a ball of eleven has the radius 1.4)."""

DETOUR, DETOUR_OF_TREE = 3000, 300
"""Pores among which a way round a tunnel is looked for. With degrees [2, 3] there is a loop to about 25 pores, and most
are long: 4000 pores in regions of 700 come out 3.8, 1.6 and 0.4 % longer than joined at once with 300, 1000 and
3000. In trees, where most searches end in vain, 3000 takes three times as long as 300 for 0.04 %."""

Turns = I8
Ends = tuple[I32, I64]
"""Result of `ends_by_pore`."""


class Region(NamedTuple):
    """The pores of a region, the edges among them, and those that stay."""

    # (n, 3) in one piece: images of the pores where the region lies across a periodic border
    points: F64
    edges: I64  # (m, 2) pairs i < j among them
    # (f, 2) edges that lead out, and those among the pores around it, which have numbers from n on
    fixed: I64
    lower: I64  # (n,) bounds of the degrees, less the edges that are not listed here
    upper: I64  # (n,), likewise
    waiting: Bools  # (n,) where shorter edges are looked for first
    metric: F64 | None = None  # (n, 6)


class Cut(NamedTuple):
    """Division of the box into regions of equal size."""

    origin: F64  # (3,) of the lattice of regions
    edge: F64  # (3,)
    regions: I64  # (3,) along each axis before they are moved
    offset: float  # fraction of an edge by which they are moved

    def shape(self, period: F64) -> I64:
        """Regions along each axis; where nothing repeats, moved ones are one more."""
        return np.asarray(self.regions + ((self.offset > 0) & (period <= 0)))

    def in_regions(self, points: F64, period: F64) -> F64:
        """Positions (n, 3) in edges of a region; region (i, j, k) lies between i and i + 1, and so on."""
        return (points - self.origin) / self.edge + np.where(period > 0, -self.offset, self.offset)

    def places(self, points: F64, period: F64) -> tuple[I64, Turns]:
        """Number of the region of each pore, (n,), and the periods by which its image there is moved, (n, 3)."""
        index = np.floor(self.in_regions(points, period)).astype(np.int64)
        turns = ((index < 0) & (period > 0)).astype(np.int8)
        shape = self.shape(period)
        index = np.clip(index + self.regions * turns, 0, shape - 1)
        return np.ravel_multi_index(tuple(index.T), tuple(shape)), turns

    def colors(self, period: F64) -> I64:
        """Colors of all regions: two that touch have different ones."""
        parity = [np.arange(count) % 2 for count in self.shape(period)]
        for axis in np.flatnonzero((period > 0) & (self.regions % 2 == 1) & (self.regions > 1)):
            parity[axis][-1] = 2
        color: I64 = np.ravel_multi_index(np.meshgrid(*parity, indexing="ij"), (3, 3, 3)).ravel()
        return color

    def around(self, region: int, period: F64) -> I64:
        """The regions that touch one, without itself."""
        shape = self.shape(period)
        index = np.array(np.unravel_index(region, shape)) + np.argwhere(np.ones((3, 3, 3), bool)) - 1
        index = np.where(period > 0, index % shape, index)
        index = index[((index >= 0) & (index < shape)).all(axis=1)]
        beside: I64 = np.setdiff1d(np.ravel_multi_index(tuple(index.T), tuple(shape)), region)
        return beside

    def near_border(self, points: F64, period: F64, margin: float) -> Bools:
        """Which points lie at most `margin` from the border of a region."""
        place = self.in_regions(points, period)
        return np.asarray((np.abs(place - np.rint(place)) * self.edge <= margin).any(axis=1))


def regional_subgraph(
    points: F64,
    period: F64,
    degree: tuple[int, int],
    *,
    spacing: float,
    mode: str,
    k: int,
    threads: int = 1,
    progress: Callable[[float, float], None] = lambda done, total: None,
    metric: F64 | None = None,
) -> tuple[I32, I32]:
    """Short connected graph on any number of pores with all degrees in [A, B], the same for any number of threads.

    `period` (3,) as in `trees.periods`; `spacing` is the mean distance of pores, which sizes regions and searches. How
    a region is made shorter says the mode of `bounded.spanning_subgraph`; exact starts from what greedy has found.
    `progress` is called with the number of regions done, and of all. A `metric` (n, 6), where no axis repeats, measures
    tunnels by the mean of the metrics of their ends. Returns edges and shifts as `spanning_subgraph` does; raises
    DesignError if some pores can't be brought into the bounds.
    """
    lower, upper = degree
    n = len(points)
    inside, _ = wrapped(points, period)
    if metric is None:
        network = connected_neighbors(points, period, reach=REACH * spacing, threads=threads)
    else:
        near, shifts = candidate_graph(points, k, metric=metric)
        network = Network(near.astype(np.int32), shifts.astype(np.int8))
    # with A = 1 the shortest connected graph is the tree, unless the upper bound forbids it
    network = tree_of(points, period, network, metric)
    if _misfits(network, n, degree) == 0:
        return as_tunnels(points, period, network)
    plan = [(offset, GREEDY_REGION, "greedy") for offset in PASSES]
    if mode != "greedy":
        plan += [(offset, WHOLE, mode) for offset in PASSES]
    before: Cut | None = None
    repair = [(offset, GREEDY_REGION, "greedy") for offset in (0.25, 0.75)]
    for step, (offset, most, how) in enumerate([*plan, *repair]):
        if step >= len(plan) and _misfits(network, n, degree) == 0:
            break
        cut = _cut(inside, period, most, offset)
        margin = BORDER * spacing
        waiting = np.ones(n, np.bool_) if before is None else before.near_border(inside, period, margin)
        before = cut if how == "greedy" else None
        network = _pass(inside, period, network, degree, cut, waiting, how, k, AROUND * spacing, threads, metric)
        progress(step + 1, max(step + 1, len(plan)))
    misfits = _misfits(network, n, degree)
    if misfits:
        raise DesignError(
            f"{misfits} of {n} pores can't be given {lower} to {upper} tunnels by changes near them",
            hint="widen the degree bounds, for example to [3, 5]",
        )
    if component_labels(n, network.edges).max(initial=0) > 0:
        raise RuntimeError("a pass over the regions has cut the graph")
    return as_tunnels(points, period, network)


def _misfits(network: Network, n: int, degree: tuple[int, int]) -> int:
    """Pores with too few or too many tunnels."""
    found = degrees_of(n, network.edges)
    return int(((found < degree[0]) | (found > degree[1])).sum())


def _cut(inside: F64, period: F64, most: int, offset: float) -> Cut:
    """Regions of about `most` pores, as nearly cubes as the box allows."""
    origin = np.where(period > 0, 0.0, inside.min(axis=0))
    extent = np.where(period > 0, period, inside.max(axis=0) - origin)
    extent = np.maximum(extent, 1e-9 * extent.max())
    edge = float(np.prod(extent / extent.max()) * most / len(inside)) ** (1 / 3) * extent.max()
    count = np.maximum(np.rint(extent / edge), 1).astype(np.int64)
    return Cut(origin, extent / count, count, offset)


class Sorted(NamedTuple):
    """Pores by region: those of region r are ``pores[first[r] : first[r + 1]]``; `turns` are those of `Cut.places`."""

    inside: F64
    period: F64
    cut: Cut
    turns: Turns
    pores: I32
    first: I64

    def own(self, region: int) -> I32:
        """The pores of a region, ascending."""
        return self.pores[self.first[region] : self.first[region + 1]]

    def near(self, region: int, margin: float) -> I32:
        """The pores of the regions around one that lie at most `margin` away from it along each axis."""
        beside = np.concatenate([self.pores[:0], *(self.own(b) for b in self.cut.around(region, self.period))])
        middle = np.array(np.unravel_index(region, self.cut.shape(self.period))) + 0.5
        off = self.cut.in_regions(self.inside[beside], self.period) - middle
        off -= np.where(self.period > 0, np.rint(off / self.cut.regions) * self.cut.regions, 0)
        kept: I32 = beside[((np.abs(off) - 0.5) * self.cut.edge <= margin).all(axis=1)]
        return kept

    def is_within(self, edges: I32, turns: Turns) -> Bools:
        """Mask of the edges between pores of one region that lead to the images of these in the region."""
        return np.asarray((self.turns[edges[:, 1]] - self.turns[edges[:, 0]] == turns).all(axis=1))


def _pass(
    inside: F64,
    period: F64,
    network: Network,
    degree: tuple[int, int],
    cut: Cut,
    waiting: Bools,
    how: str,
    k: int,
    margin: float,
    threads: int,
    metric: F64 | None,
) -> Network:
    """The network after every region was improved once, color after color."""
    number, turns = cut.places(inside, period)
    count = np.bincount(number, minlength=int(cut.shape(period).prod()))
    first = np.concatenate([[0], np.cumsum(count)])
    pores = Sorted(inside, period, cut, turns, np.argsort(number, kind="stable").astype(np.int32), first)
    colors = np.where(count > 1, cut.colors(period), -1)
    for color in np.unique(colors[colors >= 0]):
        before = network
        total = degrees_of(len(inside), before.edges)
        ends = ends_by_pore(before.edges, total)

        def improved(r: int, before: Network = before, total: I32 = total, ends: Ends = ends) -> tuple[I64, I32]:
            """Edges of the network that a region replaces, and those that take their place."""
            own = pores.own(r)
            # the exact mode knows of no way around
            known = np.concatenate([own, pores.near(r, margin)]) if how == "greedy" else own
            which, local = _edges_among(known, before.edges, ends)
            free = (local < len(own)).all(axis=1) & pores.is_within(before.edges[which], before.turns[which])
            fixed = local[~free] if how == "greedy" else local[:0]
            listed = np.bincount(np.concatenate([local[free], fixed]).ravel(), minlength=len(known))
            beyond = total[own] - listed[: len(own)]
            low, high = (np.maximum(bound - beyond, 0) for bound in degree)
            points = inside[own] + turns[own] * period
            metrics = None if metric is None else metric[own]
            if how == "greedy" or not free.any():
                region = Region(points, np.sort(local[free], axis=1), fixed, low, high, waiting[own], metrics)
                made = greedily_improved(region, k, DETOUR if degree[0] > 1 else DETOUR_OF_TREE)
            else:
                from sppm_pipeline.method.connecting.exact import exactly_improved

                inner = np.sort(local[free], axis=1)
                made = exactly_improved(points, inner, low, high, degree[0] <= 1, k, metrics)
            return which[free], own[made]

        kept = np.ones(len(before.edges), np.bool_)
        found, images = [], []
        for gone, made in ordered_map(improved, np.flatnonzero(colors == color).tolist(), threads):
            kept[gone] = False
            found.append(made)
            images.append(turns[made[:, 1]] - turns[made[:, 0]])
        network = Network(np.concatenate([before.edges[kept], *found]), np.concatenate([before.turns[kept], *images]))
    return network


def _edges_among(known: I32, edges: I32, ends: Ends) -> tuple[I64, I64]:
    """Ascending indices of the edges that join two of the known pores, and their ends (m, 2) as places in `known`."""
    around, start = ends
    count = start[known + 1] - start[known]
    at = np.repeat(start[known] - np.cumsum(count) + count, count) + np.arange(count.sum())
    which, times = np.unique(around[at] // 2, return_counts=True)
    which = which[times == 2]
    order = np.argsort(known)
    return which, order[np.searchsorted(known, edges[which], sorter=order)]


def greedily_improved(region: Region, k: int, detour: int) -> I64:
    """The edges of a region after missing ones were added, superfluous ones turned away, and long ones exchanged."""
    n = len(region.points)
    own, chosen = candidates_of_region(region.points, region.edges, k, region.metric)
    length = edge_lengths(region.points, own, np.zeros((1, 3), np.int64), region.metric)
    # in the middle of a fixed edge among the region's own pores lies one more vertex, as only vertices hold edges
    inner = region.fixed[(region.fixed < n).all(axis=1)]
    outer = region.fixed[(region.fixed >= n).any(axis=1)]
    vertices = max(n, int(region.fixed.max(initial=-1)) + 1)
    middle = vertices + np.arange(len(inner))
    fixed = np.concatenate([outer, *(np.stack([inner[:, end], middle], axis=1) for end in range(2))])
    vertices += len(inner)
    edges = np.concatenate([own, fixed])
    length = np.concatenate([length, np.full(len(fixed), FIXED * length.max(initial=1.0))])
    edge, conflict, near, order = edge_table(edges, length, np.zeros((0, 2), np.int64))
    chosen = np.concatenate([chosen, np.arange(len(own), len(edges))])
    # no edge may go from a vertex at its lower bound
    lower, upper = (
        np.concatenate([bound, np.full(vertices - n, len(edges))]) for bound in (region.lower, region.upper)
    )
    slots = int(max(np.bincount(edges[chosen].ravel(), minlength=1).max(), region.upper.max(initial=0)))
    node = node_table(vertices, edges, lower, upper, slots, detour)
    insert_all(edge, node, chosen)
    degree = node[:n, DEGREE]
    waiting = np.zeros(vertices, np.bool_)
    waiting[:n] = region.waiting | (degree < region.lower) | (degree > region.upper)
    lower_degrees(edge, node, length, near)
    fill(edge, node, order)
    raise_degrees(edge, node, length, near)
    improve(edge, node, conflict, length, near, waiting, False)
    kept: I64 = own[edge[: len(own), CHOSEN] == 1]
    return kept
