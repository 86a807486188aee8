"""The candidate graph: each pore and its k nearest neighbors, made connected by the shortest bridging edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.method.connecting.buckets import (
    Buckets,
    bucket_of,
    last_ring,
    ring_distance,
    sorted_into_buckets,
    wrapped_bucket,
)
from sppm_pipeline.method.connecting.trees import (
    Indices,
    Periodic,
    as_points,
    canonical_edges,
    component_labels,
    periods,
    wrapped,
)
from sppm_pipeline.services.arrays import F64, I64, Bools, distinct
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.metric import determinants, lengths_in, semi_axes


def bridging_edges(points: F64, edges: Indices, period: F64, skipped: Bools | None = None) -> tuple[I64, I64]:
    """The shortest edges (b, 2), with shifts (b, 3), that join the components of a graph; none if it is connected.

    Each component but the largest is joined to the pore nearest to it that lies outside of it, then the components that
    result, until one is left (O. Boruvka 1926). Every edge is the shortest that leaves some component, hence an edge of
    the shortest graph that joins them. Of equally short ones the one with the lower pores is taken. No edge may end in
    pores `skipped`; at least one pore of each component must be left. `period` (3,) as in `trees.periods`.
    """
    labels = component_labels(len(points), edges)
    found_edges, found_shifts = [np.zeros((0, 2), np.int64)], [np.zeros((0, 3), np.int64)]
    if labels.max(initial=0) > 0:
        inside, cells = wrapped(points, period)
        buckets = sorted_into_buckets(inside, period)
        if skipped is None:
            # Numba compiles one version for a mask, not a second one for None
            skipped = np.zeros(len(points), np.bool_)
        while (parts := int(labels.max()) + 1) > 1:
            size = np.bincount(labels, minlength=parts)
            largest = int(np.argmax(size))
            members = np.argsort(labels, kind="stable")
            ends, turns = _nearest_outside(buckets, labels, skipped, members, np.cumsum(size) - size, size, largest)
            bridges, shifts = canonical_edges(ends, turns + cells[ends[:, 0]] - cells[ends[:, 1]])
            found_edges.append(bridges)
            found_shifts.append(shifts)
            # the components are the vertices of a small graph: only their labels are merged
            labels = component_labels(parts, labels[bridges])[labels]
    return canonical_edges(np.concatenate(found_edges), np.concatenate(found_shifts))


@jit
def _nearest_outside(
    cells: Buckets, labels: I64, skipped: Bools, members: I64, start: I64, size: I64, largest: int
) -> tuple[I64, I64]:
    """For each component but the largest the shortest edge that leaves it, and its shift between the wrapped pores."""
    parts = len(size)
    ends = np.zeros((parts - 1, 2), np.int64)
    turns = np.zeros((parts - 1, 3), np.int64)
    here = np.zeros(3, np.int64)
    turn = np.zeros(3, np.int64)
    row = int(np.int64(0))
    for part in range(parts):
        if part == largest:
            continue
        best = np.inf
        for m in range(start[part], start[part] + size[part]):
            i = members[m]
            if skipped[i]:
                continue
            bucket_of(cells, i, here)
            for ring in range(last_ring(cells, here) + 1):
                if ring_distance(cells, here, i, ring) ** 2 > best:
                    break
                for dx in range(-ring, ring + 1):
                    for dy in range(-ring, ring + 1):
                        on_side = abs(dx) == ring or abs(dy) == ring
                        for dz in range(-ring, ring + 1, 1 if on_side else max(2 * ring, 1)):
                            bucket = wrapped_bucket(cells, here, dx, dy, dz, turn)
                            if bucket < 0:
                                continue
                            for s in range(cells.start[bucket], cells.start[bucket + 1]):
                                j = cells.order[s]
                                if labels[j] == part or skipped[j]:
                                    continue
                                d = 0.0
                                for a in range(3):
                                    d += (cells.points[j, a] + turn[a] - cells.points[i, a]) ** 2
                                low, high = min(i, j), max(i, j)
                                if d < best or (d == best and (low, high) < (ends[row, 0], ends[row, 1])):
                                    best = d
                                    ends[row, 0], ends[row, 1] = low, high
                                    for a in range(3):
                                        turns[row, a] = turn[a] if i < j else -turn[a]
        row += 1
    return ends, turns


def candidate_graph(
    points: ArrayLike, k: int = 10, *, periodic: Periodic = False, metric: F64 | None = None
) -> tuple[I64, I64]:
    """Edges from each pore to its k nearest neighbors, in both senses, plus the shortest edges that connect them.

    On periodic axes every image of a pore counts as a neighbor of its own, as long as the edge is not longer than the
    period of that axis; so two pores may be joined several times when there are few of them. A pore is never joined to
    an image of itself. Equally near neighbors are taken by index, then by shift. If the graph falls apart, its
    components are joined as in Boruvka's algorithm, twice: the second time by edges that avoid the ends of the first,
    so that a bounded degree or a second path is not ruled out.

    Distances are measured in the mean of the metrics (n, 6) of the pores, if given.
    Returns edges and shifts as `spanning_subgraph` does.
    """
    points = as_points(points)
    period = periods(periodic)
    n = len(points)
    if n < 2:
        return np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64)
    inside, cells = wrapped(points, period)
    # at most 27 images of each other pore can be a neighbor; more slots would only stay empty
    slots = min(k, (n - 1) * 27)
    # both ends may find an edge: as one number its twins are found by sorting
    keys = distinct(_keys_near(inside, period, slots, metric))
    keys = keys[keys >= 0]
    edges, turns = edges_of_keys(keys, n)
    shifts = turns * period.astype(np.int64)
    shifts += cells[edges[:, 0]] - cells[edges[:, 1]]
    # the nearest neighbors of clusters lie within the clusters: without bridges no graph would connect them
    first, first_shifts = bridging_edges(points, edges, period)
    if not len(first):
        return edges, shifts
    used = np.zeros(n, np.bool_)
    used[first] = True
    labels = component_labels(n, edges)
    alone = np.bincount(labels, weights=~used)[labels] == 0
    # a second bridge at other pores, as one that every solution must use could break a degree bound
    second, second_shifts = bridging_edges(points, edges, period, used & ~alone)
    return canonical_edges(
        np.concatenate([edges, first, second]), np.concatenate([shifts, first_shifts, second_shifts])
    )


def _keys_near(inside: F64, period: F64, k: int, metric: F64 | None) -> I64:
    """`nearest_keys` of all pores, by their distances in the metric: of those that are near enough plainly.

    A ball of the metric with k pores lies within a plain one that holds as many times more pores as its volume is
    larger, where both have the density of the whole.
    """
    n = len(inside)
    if metric is None:
        return nearest_keys(sorted_into_buckets(inside, period), np.arange(n), k)
    longest = semi_axes(metric)[:, 0]
    # the plain ball that is sure to hold the k nearest in the metric, at the density of the whole
    wide = int(min(np.ceil(k * float((longest**3 * np.sqrt(determinants(metric))).max())), max(n - 1, 1)))
    keys = nearest_keys(sorted_into_buckets(inside, period), np.arange(n), wide)
    edges, turns = edges_of_keys(np.maximum(keys, 0).ravel(), n)
    steps = inside[edges[:, 1]] + turns * period - inside[edges[:, 0]]
    length = lengths_in((metric[edges[:, 0]] + metric[edges[:, 1]]) / 2, steps).reshape(keys.shape)
    order = np.argsort(np.where(keys < 0, np.inf, length), axis=1, kind="stable")[:, :k]
    return np.take_along_axis(keys, order, axis=1)


def edges_of_keys(keys: I64, n: int) -> tuple[I64, I64]:
    """Pairs i < j, (m, 2), and the periods by which the image of j is moved, (m, 3), of keys of edges."""
    pairs, image = np.divmod(keys, 27)
    edges = np.stack(np.divmod(pairs, n), axis=1)
    return edges, np.stack([image // 9 - 1, image // 3 % 3 - 1, image % 3 - 1], axis=1)


@jit
def nearest_keys(cells: Buckets, pores: I64, k: int) -> I64:
    """The k nearest images around each of the pores as edges (p, k): ``(i n + j) 27 + image code`` with i < j.

    Empty slots hold -1. The keys are sorted as the edges are: by i, j and the image of j.
    """
    n = cells.points.shape[0]
    keys = np.full((len(pores), k), -1, np.int64)
    best = np.empty(k)
    who = np.empty(k, np.int64)
    how = np.empty(k, np.int64)
    here = np.zeros(3, np.int64)
    turn = np.zeros(3, np.int64)
    for row in range(len(pores)):
        i = pores[row]
        bucket_of(cells, i, here)
        count = int(np.int64(0))
        for ring in range(last_ring(cells, here) + 1):
            if count == k and ring_distance(cells, here, i, ring) ** 2 > best[k - 1]:
                break
            for dx in range(-ring, ring + 1):
                for dy in range(-ring, ring + 1):
                    on_side = abs(dx) == ring or abs(dy) == ring
                    for dz in range(-ring, ring + 1, 1 if on_side else max(2 * ring, 1)):
                        bucket = wrapped_bucket(cells, here, dx, dy, dz, turn)
                        if bucket >= 0:
                            count = _insert_bucket(cells, i, bucket, turn, best, who, how, count)
        for s in range(count):
            # seen from the other end the image lies the other way
            keys[row, s] = (i * n + who[s]) * 27 + how[s] if i < who[s] else (who[s] * n + i) * 27 + 26 - how[s]
    return keys


@jit
def _insert_bucket(cells: Buckets, i: int, bucket: int, turn: I64, best: F64, who: I64, how: I64, count: int) -> int:
    """Sort the pores of a bucket, moved by `turn`, into the list of the nearest; returns its new length."""
    k = len(best)
    code = int(np.int64(0))
    for a in range(3):
        code = 3 * code + 1 + (0 if turn[a] == 0 else 1 if turn[a] > 0 else -1)
    for s in range(cells.start[bucket], cells.start[bucket + 1]):
        j = int(cells.order[s])
        if j == i:
            continue
        d = 0.0
        beyond = False
        for a in range(3):
            step = cells.points[j, a] + turn[a] - cells.points[i, a]
            beyond |= cells.period[a] > 0 and abs(step) > cells.period[a]
            d += step * step
        if beyond:
            continue
        if count < k:
            slot = count
            count += 1
        elif d < best[k - 1] or (d == best[k - 1] and (j, code) < (who[k - 1], how[k - 1])):
            slot = k - 1
        else:
            continue
        while slot > 0 and (d < best[slot - 1] or (d == best[slot - 1] and (j, code) < (who[slot - 1], how[slot - 1]))):
            best[slot], who[slot], how[slot] = best[slot - 1], who[slot - 1], how[slot - 1]
            slot -= 1
        best[slot], who[slot], how[slot] = d, j, code
    return count


def candidates_of_region(points: F64, chosen: I64, k: int, metric: F64 | None = None) -> tuple[I64, I64]:
    """Edges to the k nearest pores and those chosen, (m, 2), by (i, j), and the positions of those chosen."""
    n = len(points)
    near = _keys_near(points, np.zeros(3), k, metric).ravel()
    # without periodic axes the image code is that of no shift
    keys = (chosen[:, 0] * n + chosen[:, 1]) * 27 + 13
    together = np.unique(np.concatenate([near[near >= 0], keys]))
    return edges_of_keys(together, n)[0], np.searchsorted(together, keys)
