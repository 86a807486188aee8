"""The shortest edges that make one graph of many parts, found ring by ring in a bucket grid."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.method.connecting.buckets import (
    Buckets,
    bucket_of,
    last_ring,
    ring_distance,
    sorted_into_buckets,
    wrapped_bucket,
)
from sppm_pipeline.method.connecting.trees import Indices, canonical_edges, component_labels, wrapped
from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.services.jit.compiled import jit


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
