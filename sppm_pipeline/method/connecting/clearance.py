"""Distances between tunnels, periodic images included, and connectors that keep a clearance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting.trees import Periodic, as_points, periods, segments, wrapped
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import jit


def close_pairs(
    points: F64, edges: I64, shifts: I64, clearance: float, *, periodic: Periodic = False
) -> tuple[I64, F64]:
    """Pairs of tunnels without a common end whose axes come closer than `clearance`, and their least distances (c,).

    Tunnels that share a pore are exempt: they meet there by intent. On periodic axes every image of the second tunnel
    counts, and a pore is shared only if it is the same image; so a tunnel may come too close to an image of itself.
    Pairs (c, 2) are indices a <= b, sorted; a == b for a tunnel too close to its own image.
    """
    period = periods(periodic)
    inside, cells = wrapped(points, period)
    edges = np.ascontiguousarray(edges)
    turns = shifts + cells[edges[:, 1]] - cells[edges[:, 0]]
    starts, ends = segments(inside, edges, turns)
    # a guess: if there are more close pairs, the second pass knows their number
    room = 4 * len(edges) + 64
    while True:
        pairs, distances = np.empty((room, 2), np.int64), np.empty(room)
        count = _close_pairs(starts, ends, edges, turns, period, float(clearance), pairs, distances)
        if count <= room:
            return pairs[:count], distances[:count]
        room = count


@jit
def segment_distance(a: F64, b: F64, c: F64, d: F64, moved: F64) -> float:
    """Least distance of the segment a-b from the segment c-d moved by the vector `moved`.

    Clamped closest points (C. Ericson, Real-Time Collision Detection, section 5.1.9).
    """
    uu = vv = uv = uw = vw = 0.0
    for k in range(3):
        u = b[k] - a[k]
        v = d[k] - c[k]
        w = a[k] - c[k] - moved[k]
        uu += u * u
        vv += v * v
        uv += u * v
        uw += u * w
        vw += v * w
    determinant = uu * vv - uv * uv
    s = 0.0
    # parallel segments keep s = 0: any start is as good, and the clamping below finds the true minimum
    if determinant > 1e-14 * uu * vv:
        s = min(max((uv * vw - vv * uw) / determinant, 0.0), 1.0)
    t = (uv * s + vw) / vv if vv > 0.0 else 0.0
    if t < 0.0 or t > 1.0 or vv == 0.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((uv * t - uw) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    total = 0.0
    for k in range(3):
        gap = a[k] + s * (b[k] - a[k]) - c[k] - t * (d[k] - c[k]) - moved[k]
        total += gap * gap
    return float(np.sqrt(total))


@jit
def _close_pairs(
    starts: F64, ends: F64, edges: I64, turns: I64, period: F64, clearance: float, pairs: I64, distances: F64
) -> int:
    """Fill `pairs` and `distances` as far as there is room; returns the number of close pairs."""
    m = starts.shape[0]
    middle = np.empty((m, 3))
    reach = np.empty((m, 3))
    for e in range(m):
        for a in range(3):
            middle[e, a] = 0.5 * (starts[e, a] + ends[e, a])
            reach[e, a] = 0.5 * abs(ends[e, a] - starts[e, a])
    count = 0
    first = np.zeros(3, np.int64)
    last = np.zeros(3, np.int64)
    moved = np.zeros(3)
    for e in range(m):
        for f in range(e, m):
            apart = False
            for a in range(3):
                gap = middle[f, a] - middle[e, a]
                if period[a]:
                    gap -= period[a] * np.rint(gap / period[a])
                if abs(gap) > reach[e, a] + reach[f, a] + clearance:
                    apart = True
                    break
            if apart:
                continue
            for a in range(3):
                first[a] = last[a] = 0
                if period[a]:
                    gap = middle[e, a] - middle[f, a]
                    span = reach[e, a] + reach[f, a] + clearance
                    first[a] = np.int64(np.ceil((gap - span) / period[a]))
                    last[a] = np.int64(np.floor((gap + span) / period[a]))
            # several images may be within reach where a tunnel is longer than half a period
            least = np.inf
            for x in range(first[0], last[0] + 1):
                for y in range(first[1], last[1] + 1):
                    for z in range(first[2], last[2] + 1):
                        moved[0], moved[1], moved[2] = x * period[0], y * period[1], z * period[2]
                        if not _share_end(edges, turns, e, f, moved):
                            least = min(least, segment_distance(starts[e], ends[e], starts[f], ends[f], moved))
            if least < clearance:
                if count < len(distances):
                    pairs[count, 0], pairs[count, 1] = e, f
                    distances[count] = least
                count += 1
    return count


@jit
def _share_end(edges: I64, turns: I64, e: int, f: int, moved: F64) -> bool:
    """True if e and the moved f end in the same image of a pore, or are the same tunnel."""
    for p in range(2):
        for q in range(2):
            if edges[e, p] == edges[f, q]:
                same = True
                for a in range(3):
                    here = turns[e, a] if p == 1 else 0
                    there = turns[f, a] if q == 1 else 0
                    if here != there + moved[a]:
                        same = False
                if same:
                    return True
    return False


def nearest_connectors(face_points: ArrayLike, interior_points: ArrayLike, *, clearance: float) -> I64:
    """The interior pore that each face pore is joined to, (f,): the nearest, or the second nearest if that is free.

    Face pores are served in their order. The second nearest interior pore is taken if the tunnel to the nearest would
    come closer than `clearance` (usually twice the tunnel radius; 0 always takes the nearest) to a connector chosen
    before, and the tunnel to the second would not; if both are too close, it stays the nearest. Connectors that end in
    the same interior pore meet there and never count as close. Of equally near pores the one with the lower index is
    nearer. Raises DesignError if there are face pores but no interior pore.
    """
    face, interior = as_points(face_points), as_points(interior_points)
    if len(face) and not len(interior):
        raise DesignError(
            f"{len(face)} face pores have no interior pore to connect to",
            hint="place at least one pore in the interior (a smaller spacing or gap leaves more room)",
        )
    return np.asarray(_connect(face, interior, float(clearance)), dtype=np.int64)


@jit
def _connect(face: F64, interior: F64, clearance: float) -> I64:
    f, n = face.shape[0], interior.shape[0]
    joined = np.empty(f, np.int64)
    unmoved = np.zeros(3)
    rank = np.empty(2, np.int64)
    for i in range(f):
        near = np.inf
        next_near = np.inf
        rank[:] = -1
        for j in range(n):
            d = 0.0
            for a in range(3):
                d += (interior[j, a] - face[i, a]) ** 2
            if d < near:
                near, next_near = d, near
                rank[1] = rank[0]
                rank[0] = j
            elif d < next_near:
                next_near = d
                rank[1] = j
        joined[i] = rank[0]
        for choice in rank:
            if choice < 0:
                continue
            free = True
            for e in range(i):
                if joined[e] != choice:
                    gap = segment_distance(face[i], interior[choice], face[e], interior[joined[e]], unmoved)
                    if gap < clearance:
                        free = False
                        break
            if free:
                joined[i] = choice
                break
    return joined
