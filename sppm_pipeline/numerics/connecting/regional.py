"""Degree-bounded subgraphs on any number of pores: the spanning tree, filled up and improved region by region.

A pass cuts the box into regions that share no pore; each replaces the edges among its own pores by shorter ones, and
leaves those that lead out of it as they are: they count for the degrees. What the edges of a region connect before,
they connect afterwards; so a connected graph stays connected whatever the other regions do in the meantime, and
neither their order nor their number at a time matters. The regions of the next pass are moved by half an edge along
every axis, across the periodic border, too, so that what was a border comes to lie inside.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.numerics.connecting.buckets import sorted_into_buckets
from sppm_pipeline.numerics.connecting.candidates import edges_of_keys, nearest_keys
from sppm_pipeline.numerics.connecting.exchange import (
    CHOSEN,
    DEGREE,
    edge_table,
    fill,
    improve,
    insert_all,
    lower_degrees,
    node_table,
    raise_degrees,
)
from sppm_pipeline.numerics.connecting.relative_degrees import (
    REACH,
    Network,
    as_tunnels,
    connected_neighbors,
    degrees_of,
    tree_of,
)
from sppm_pipeline.numerics.connecting.trees import component_labels, edge_lengths, wrapped
from sppm_pipeline.numerics.threads import ordered_map

WHOLE = 2000
"""Most pores that are joined by one search, and that a region of the exact modes holds: the time of an integer program
grows steeply beyond."""

GREEDY_REGION = 12_000
"""Pores of a region in greedy mode, a choice: the larger, the fewer pores lie at a border, and the more memory a region
takes."""

PASSES = (0.0, 0.5)
"""Places of the regions in fractions of their edge."""

BORDER = 1.5
"""Mean distances from the borders of the pass before within which pores are tried again: a choice, as far as the tenth
neighbor of evenly spread pores lies (a ball of eleven has the radius 1.4)."""

DETOUR = 300
"""Pores among which a way round a tunnel is looked for. With degrees [2, 3], where loops are long, graphs on 500 pores
come out 3 % longer with 30, and the same with 3000."""

Turns = NDArray[np.int8]


class Region(NamedTuple):
    """The pores of a region, the edges among them, and what the edges that lead out leave of the degrees.

    Attributes
    ----------
    points : (n, 3) float64
        In one piece: images of the pores where the region lies across a periodic border.
    edges : (m, 2) int64
        Pairs i < j among them.
    lower, upper : (n,) int64
        Bounds of the degrees within the region.
    waiting : (n,) bool
        Where shorter edges are looked for first.
    """

    points: NDArray[np.float64]
    edges: NDArray[np.int64]
    lower: NDArray[np.int64]
    upper: NDArray[np.int64]
    waiting: NDArray[np.bool_]


class Cut(NamedTuple):
    """How the box is cut into regions of equal size.

    Attributes
    ----------
    origin, edge : (3,) float64
        Of the lattice of regions.
    regions : (3,) int64
        Regions along each axis before they are moved.
    offset : float
        Fraction of an edge by which they are moved.
    """

    origin: NDArray[np.float64]
    edge: NDArray[np.float64]
    regions: NDArray[np.int64]
    offset: float

    def places(self, points: NDArray[np.float64], period: NDArray[np.float64]) -> tuple[NDArray[np.int64], Turns]:
        """Number of the region of each pore, (n,), and the periods by which its image there is moved, (n, 3)."""
        number = np.zeros(len(points), np.int64)
        turns = np.zeros((len(points), 3), np.int8)
        for a in range(3):
            repeats = period[a] > 0
            count = self.regions[a] + (self.offset > 0 and not repeats)
            index = np.floor(
                (points[:, a] - self.origin[a]) / self.edge[a] + (-self.offset if repeats else self.offset)
            )
            if repeats:
                turns[:, a] = index < 0
                index += self.regions[a] * turns[:, a]
            number = number * count + np.clip(index.astype(np.int64), 0, count - 1)
        return number, turns

    def near_border(self, points: NDArray[np.float64], period: NDArray[np.float64], margin: float) -> NDArray[np.bool_]:
        """Which points lie at most `margin` from the border of a region."""
        place = (points - self.origin) / self.edge + np.where(period > 0, -self.offset, self.offset)
        return np.asarray((np.abs(place - np.rint(place)) * self.edge <= margin).any(axis=1))


def regional_subgraph(
    points: NDArray[np.float64],
    period: NDArray[np.float64],
    degree: tuple[int, int],
    *,
    spacing: float,
    mode: str,
    k: int,
    threads: int = 1,
    progress: Callable[[float, float], None] = lambda done, total: None,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Short connected graph on any number of pores with all degrees in [A, B], the same for any number of threads.

    Parameters
    ----------
    points : (n, 3) float64
        Pore centers.
    period : (3,) float64
        Whole cells after which each axis repeats, 0 for never.
    degree : (int, int)
        Bounds A and B.
    spacing : float
        Mean distance of pores, which sizes regions and searches.
    mode : {"exact", "lp_fix", "greedy"}
        How a region is made shorter: see `numerics.connecting.bounded.spanning_subgraph`. The exact modes start from
        what greedy has found.
    k : int
        Candidate neighbors of each pore.
    threads : int
        Regions that are worked on at a time.
    progress : callable
        Told the regions done, and their number.

    Returns
    -------
    edges : (m, 2) int32
        Pairs i < j, sorted by (i, j, shift).
    shifts : (m, 3) int32
        The tunnel runs from ``points[i]`` to ``points[j] + shift``.

    Raises
    ------
    DesignError
        If some pores can't be brought into the bounds.
    """
    lower, upper = degree
    n = len(points)
    inside, _ = wrapped(points, period)
    network = connected_neighbors(points, period, reach=REACH * spacing, threads=threads)
    # with A = 1 the shortest connected graph is the tree, unless the upper bound forbids it
    network = tree_of(points, period, network)
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
        network = _pass(inside, period, network, degree, cut, waiting, how, k, threads)
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


def _cut(inside: NDArray[np.float64], period: NDArray[np.float64], most: int, offset: float) -> Cut:
    """Regions of about `most` pores, as nearly cubes as the box allows."""
    origin = np.where(period > 0, 0.0, inside.min(axis=0))
    extent = np.where(period > 0, period, inside.max(axis=0) - origin)
    extent = np.maximum(extent, 1e-9 * extent.max())
    edge = float(np.prod(extent / extent.max()) * most / len(inside)) ** (1 / 3) * extent.max()
    count = np.maximum(np.rint(extent / edge), 1).astype(np.int64)
    return Cut(origin, extent / count, count, offset)


def _pass(
    inside: NDArray[np.float64],
    period: NDArray[np.float64],
    network: Network,
    degree: tuple[int, int],
    cut: Cut,
    waiting: NDArray[np.bool_],
    how: str,
    k: int,
    threads: int,
) -> Network:
    """The network after every region was improved once."""
    n = len(inside)
    number, turns = cut.places(inside, period)
    total = degrees_of(n, network.edges)
    pores = np.argsort(number, kind="stable").astype(np.int32)
    first = np.concatenate([[0], np.cumsum(np.bincount(number))])
    place = np.empty(n, np.int32)
    place[pores] = np.arange(n) - first[number[pores]]
    region = number[network.edges[:, 0]]
    leads_out = region != number[network.edges[:, 1]]
    leads_out |= (turns[network.edges[:, 1]] - turns[network.edges[:, 0]] != network.turns).any(axis=1)
    region[leads_out] = -1
    within = np.argsort(region, kind="stable").astype(np.int32)
    start = np.searchsorted(region[within], np.arange(len(first)))

    def improved(r: int) -> NDArray[np.int32]:
        own = pores[first[r] : first[r + 1]]
        ends = place[network.edges[within[start[r] : start[r + 1]]]].astype(np.int64)
        outside = total[own] - np.bincount(ends.ravel(), minlength=len(own))
        piece = Region(
            inside[own] + turns[own] * period,
            ends,
            np.maximum(degree[0] - outside, 0),
            np.maximum(degree[1] - outside, 0),
            waiting[own],
        )
        if how == "greedy" or not len(ends):
            return own[greedily_improved(piece, k)]
        from sppm_pipeline.numerics.connecting.exact import exactly_improved

        return own[exactly_improved(piece.points, ends, piece.lower, piece.upper, degree[0] <= 1, k, how == "lp_fix")]

    busy = [r for r in range(len(first) - 1) if first[r + 1] - first[r] > 1]
    found = [network.edges[leads_out], *ordered_map(improved, busy, threads)]
    images = [network.turns[leads_out], *(turns[e[:, 1]] - turns[e[:, 0]] for e in found[1:])]
    return Network(np.concatenate(found), np.concatenate(images))


def greedily_improved(region: Region, k: int) -> NDArray[np.int64]:
    """The edges of a region after missing ones were added, superfluous ones turned away, and long ones exchanged."""
    n = len(region.points)
    edges, chosen = candidates_of_region(region.points, region.edges, k)
    length = edge_lengths(region.points, edges, np.zeros((1, 3), np.int64))
    edge, conflict, near, order = edge_table(edges, length, np.zeros((0, 2), np.int64))
    slots = int(max(np.bincount(region.edges.ravel()).max(initial=0), region.upper.max(initial=0)))
    node = node_table(n, edges, region.lower, region.upper, slots, DETOUR)
    insert_all(edge, node, chosen)
    waiting = region.waiting | (node[:n, DEGREE] < region.lower) | (node[:n, DEGREE] > region.upper)
    lower_degrees(edge, node, length, near)
    fill(edge, node, order)
    raise_degrees(edge, node, length, near)
    improve(edge, node, conflict, length, near, waiting, False)
    kept: NDArray[np.int64] = edges[edge[:, CHOSEN] == 1]
    return kept


def candidates_of_region(
    points: NDArray[np.float64], chosen: NDArray[np.int64], k: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Edges to the k nearest pores and those chosen, (m, 2), by (i, j), and the positions of those chosen."""
    n = len(points)
    near = nearest_keys(sorted_into_buckets(points, np.zeros(3)), np.arange(n), k).ravel()
    # without periodic axes the image code is that of no shift
    keys = (chosen[:, 0] * n + chosen[:, 1]) * 27 + 13
    together = np.unique(np.concatenate([near[near >= 0], keys]))
    return edges_of_keys(together, n)[0], np.searchsorted(together, keys)
