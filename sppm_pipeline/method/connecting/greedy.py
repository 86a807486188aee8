"""The greedy spanning subgraph: a bounded tree, filled up, closed to loops, then improved by exchange; no solver."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting.candidates import candidate_graph
from sppm_pipeline.method.connecting.clearance import close_pairs
from sppm_pipeline.method.connecting.exchange import connect_and_fill, improve, make_loops
from sppm_pipeline.method.connecting.moves import CHOSEN, edge_table, insert_all, node_table
from sppm_pipeline.method.connecting.trees import canonical_edges, edge_lengths, minimum_spanning_tree, nearest_turns
from sppm_pipeline.services.arrays import F64, I64


def feasible_degrees(n: int, lower: int, upper: int, *, images: int = 1, two_edge_connected: bool = False) -> None:
    """Raise DesignError unless a connected graph on n pores with all degrees in [lower, upper] exists.

    Two pores may share `images` tunnels: 1, or `images_per_pair` on periodic axes. If every tunnel must lie on a loop,
    the lower bound is at least 2.
    """
    if n < 1:
        raise DesignError(f"{n} pores can't be connected", hint="at least 1 pore is needed")
    if lower < 0 or upper < lower:
        raise DesignError(
            f"degree bounds [{lower}, {upper}] are not a range", hint="give 0 <= lower <= upper, for example [3, 5]"
        )
    most = images * (n - 1)
    if lower > most:
        raise DesignError(
            f"{n} pores can't have {lower} tunnels each: a pore has at most {most}",
            hint=f"lower the bound to {most}, or place at least {-(-lower // images) + 1} pores",
        )
    if n == 1:
        return
    loops = " and every tunnel on a loop" if two_edge_connected else ""
    needed = 2 if n > 2 or two_edge_connected else 1
    if upper < needed:
        raise DesignError(
            f"{n} pores can't be connected with at most {upper} tunnels each{loops}",
            hint=f"the upper bound must be at least {needed}",
        )
    if two_edge_connected and most < 2:
        raise DesignError(
            f"{n} pores joined by one tunnel have no loop", hint="place at least 3 pores, or allow single tunnels"
        )
    if lower == upper and n * lower % 2:
        raise DesignError(
            f"{n} pores can't have exactly {lower} tunnels each: {n} x {lower} tunnel ends don't make pairs",
            hint=f"set the upper bound to {upper + 1}, or use an even number of pores",
        )


def clamped_degrees(n: int, lower: int, upper: int, *, images: int = 1) -> tuple[int, int, bool]:
    """Degree bounds relaxed to what n pores allow, for faces that hold only a few pores, and whether they differ.

    The lower bound becomes min(lower, images * (n - 1)); the upper bound is raised by one where equal bounds would need
    an odd number of tunnel ends.
    """
    low = min(lower, images * max(n - 1, 0))
    high = upper + 1 if low == upper and n * low % 2 else upper
    return low, high, (low, high) != (lower, upper)


def harary_edges(n: int, degree: int) -> I64:
    """Pairs (m, 2) of a graph in which every degree is `degree`, but one is a step higher if n * degree is odd.

    The pairs join positions on a ring: Harary's graph, `degree`-edge-connected for degree >= 2 (F. Harary, The maximum
    connectivity of a graph, PNAS 48, 1962). A pair occurs q + 1 or q times if degree = q (n - 1) + r. Degree 1 on an
    odd ring gives one path of three.
    """
    i = np.arange(n, dtype=np.int64)
    full, rest = divmod(degree, n - 1)
    rings = [np.stack(np.triu_indices(n, 1), axis=1).astype(np.int64)] * full
    rings += [np.stack([i, (i + step) % n], axis=1) for step in range(1, rest // 2 + 1)]
    if rest % 2:
        half = n // 2
        across = i[:half] if n % 2 == 0 else i[: half + 1]
        rings.append(np.stack([across, (across + half) % n], axis=1))
    pairs = np.concatenate(rings) if rings else np.zeros((0, 2), np.int64)
    return np.sort(pairs, axis=1)


Edges = tuple[I64, I64]

# beyond this many neighbors per pore a graph that can't be completed is replaced by a ring graph
_MAX_NEIGHBORS = 40


def greedy_subgraph(
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
    """Short connected spanning subgraph with degrees in [lower, upper]; the bounds must be feasible.

    Clearance is not looked at while the graph is built; the exchange then takes out the tunnels that are too close. If
    the k-nearest graph is too sparse for the bounds or the clearance, k is doubled; at last the search starts from
    Harary's ring graph along the minimum spanning tree, which always satisfies the bounds. Raises DesignError if no
    graph with this clearance was found.
    """
    n = len(points)
    most = all_images(n, period)
    k = min(k, most)
    while True:
        edges, shifts = candidate_graph(points, k, periodic=period.tolist(), metric=metric)
        conflicts = _conflicts(points, edges, shifts, period, clearance)
        length = edge_lengths(points, edges, shifts, metric)
        edge, conflict, near, order = edge_table(edges, length, conflicts)
        node = node_table(n, edges, lower, upper, slots=upper, detour=n)
        # more neighbors seldom help a search that failed with these, but make it slow
        last = k >= min(most, _MAX_NEIGHBORS)
        complete = connect_and_fill(edge, node, length, near, order)
        if complete and loops:
            complete = make_loops(edge, node, length, near)
        # Harary's graph meets any feasible bounds: the exchange then shortens it with the candidates' help
        if not complete and last:
            ring_edges, ring_shifts = _ring_graph(points, period, max(lower, 2) if n > 2 else lower)
            edges, shifts, ring = merged_edges(edges, shifts, ring_edges, ring_shifts)
            conflicts = _conflicts(points, edges, shifts, period, clearance)
            length = edge_lengths(points, edges, shifts, metric)
            edge, conflict, near, order = edge_table(edges, length, conflicts)
            node = node_table(n, edges, lower, upper, slots=upper, detour=n)
            insert_all(edge, node, ring)
            complete = True
        if complete:
            improve(edge, node, conflict, length, near, np.ones(n, np.bool_), loops)
            chosen = edge[:, CHOSEN] == 1
            if not chosen[conflicts].all(axis=1).any():
                return edges[chosen], shifts[chosen]
            if last:
                raise _clearance_error(points, edges[chosen], shifts[chosen], period, clearance or 0.0)
        k = min(2 * k, most)


def all_images(n: int, period: F64) -> int:
    """More neighbors than a pore among n can have: every image of every other pore."""
    return max((n - 1) * int(3 ** np.count_nonzero(period)), 1)


def _clearance_error(points: F64, edges: I64, shifts: I64, period: F64, clearance: float) -> DesignError:
    """The error for a clearance that can't be held, with the figures of the graph that came nearest to it."""
    _, distances = close_pairs(points, edges, shifts, clearance, periodic=period.tolist())
    return DesignError(
        f"no tunnel graph found in which tunnels without a common pore stay {clearance:g} apart: the best one has "
        f"{len(distances)} pairs that come closer and meets a clearance of {distances.min():.4g}",
        hint="use thinner tunnels (a smaller clearance), a larger spacing of the pores, or wider degree bounds",
    )


def _conflicts(points: F64, edges: I64, shifts: I64, period: F64, clearance: float | None) -> I64:
    """The pairs (c, 2) of edges that exclude each other; an edge too close to its own image excludes itself."""
    if clearance is None:
        return np.zeros((0, 2), np.int64)
    return close_pairs(points, edges, shifts, clearance, periodic=period.tolist())[0]


def merged_edges(edges: I64, shifts: I64, more_edges: I64, more_shifts: I64) -> tuple[I64, I64, I64]:
    """The union of two sets of edges in canonical order, and the positions of the second set in it."""
    edges, shifts = canonical_edges(np.concatenate([edges, more_edges]), np.concatenate([shifts, more_shifts]))
    position = {tuple(row): e for e, row in enumerate(np.concatenate([edges, shifts], axis=1).tolist())}
    rows = np.concatenate([more_edges, more_shifts], axis=1).tolist()
    return edges, shifts, np.array([position[tuple(row)] for row in rows], dtype=np.int64)


def _ring_graph(points: F64, period: F64, degree: int) -> Edges:
    """Harary's graph on the pores in the order of a walk round their minimum spanning tree; pairs i < j."""
    n = len(points)
    ring = _walk(n, minimum_spanning_tree(points, periodic=period.tolist())[0])
    pairs = np.sort(ring[harary_edges(n, degree)], axis=1)
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    shifts = np.empty((len(pairs), 3), np.int64)
    copy = 0
    for e, (i, j) in enumerate(pairs.tolist()):
        # the q-th copy of a pair takes its q-th nearest image
        copy = copy + 1 if e > 0 and (pairs[e] == pairs[e - 1]).all() else 0
        shifts[e] = _image(points, i, j, copy, period)
    return pairs, shifts


def _walk(n: int, tree: I64) -> I64:
    """The vertices of a tree in depth-first order: neighbors on the walk are near each other."""
    around: list[list[int]] = [[] for _ in range(n)]
    for i, j in tree.tolist():
        around[i].append(j)
        around[j].append(i)
    order: list[int] = []
    seen = [False] * n
    stack = [0]
    while stack:
        v = stack.pop()
        if not seen[v]:
            seen[v] = True
            order.append(v)
            stack.extend(w for w in reversed(around[v]) if not seen[w])
    return np.array(order, dtype=np.int64)


def _image(points: F64, i: int, j: int, rank: int, period: F64) -> I64:
    """Shift to the rank-th nearest image of j seen from i."""
    reach = [np.arange(-1, 2) * p if p else np.zeros(1) for p in period]
    grid = np.stack(np.meshgrid(*reach, indexing="ij"), axis=-1).reshape(-1, 3)
    shifts = grid + nearest_turns(points[j] - points[i], period)
    order = np.argsort(((points[j] + shifts - points[i]) ** 2).sum(axis=1), kind="stable")
    chosen: I64 = shifts[order[rank]].astype(np.int64)
    return chosen
