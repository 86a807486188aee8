"""The surface of the union of overlapping shells: pieces of triangles that have the solid on one side only.

Slicers unite shells that overlap, and so do signed scanlines: solid is where the winding number is at least one. But a
triangle of one shell within another has solid on both sides, so it is no surface, and what measures distances from it
finds a border that is not there. Triangles that others cross are cut along them, by a random autopartition (Paterson
and Yao 1990, "Efficient binary space partitions for hidden-surface removal and solid modeling"); then no piece changes
from surface to interior, and the winding numbers on both sides of its middle decide. The pieces need not fit together
to the last bit, as signs come from the scanlines.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I32, I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.adjacency import adjacency
from sppm_pipeline.services.mesh.box_tree import DEPTH, BoxTree, box_tree
from sppm_pipeline.services.mesh.measures import balanced_edges, components
from sppm_pipeline.services.mesh.rays import layers_around
from sppm_pipeline.services.mesh.winding_number import dipoles, winding_numbers

COINCIDENT = 1e-6
"""Surfaces nearer than this fraction of the mesh's diagonal are taken for one, so that shells that touch are united.

Above the rounding of coordinates stored in single precision (6e-8 each), and far below what a printer resolves.
"""

SNAP = COINCIDENT / 4
"""Lengths below this fraction of the diagonal count as zero where triangles are cut."""


class OuterSurface(NamedTuple):
    """The result of `outer_surface`."""

    triangles: F64  # (k, 3, 3) corners of the pieces
    owners: I64  # (k,), the triangle of the mesh that each is a piece of
    volume: float  # of the union; not a number for a mesh that bounds no solid


def outer_surface(vertices: F64, faces: I32) -> OuterSurface | None:
    """Find the surface of what a mesh, wound outwards, encloses at least once.

    Of a mesh that bounds no solid, pieces are left out whose winding numbers in front and behind are both above one
    half, or both below. None if all triangles are surface: those of one shell that does not meet itself.
    """
    corners = np.ascontiguousarray(vertices, np.float64)[faces]
    tree = box_tree(corners)
    diagonal = float(np.linalg.norm(tree.boxes[0, 3:] - tree.boxes[0, :3]))
    cut, starts, partners = _meeting(tree, SNAP * diagonal)
    if not len(cut) and components(faces)[0] == 1:
        return None
    closed = balanced_edges(faces)
    whole = np.ones(len(faces), np.bool_)
    whole[cut] = False
    rest = np.flatnonzero(whole)
    pieces = [
        _pieces(corners[i], corners[partners[a:b]], SNAP * diagonal)
        for i, a, b in zip(cut, starts, starts[1:], strict=False)
    ]
    owners = np.concatenate([rest, np.repeat(cut, [len(piece) for piece in pieces])])
    triangles = np.concatenate([corners[rest], *pieces])
    patch = np.arange(len(owners))
    if closed and len(rest):
        # Triangles that are connected without a cut have the same winding numbers in front and behind, so one of them
        # speaks for all. Edges of three or more triangles do not connect: shells that touch meet in them.
        opposite = adjacency(faces).opposite
        sides = np.flatnonzero((opposite >= 0) & whole.repeat(3))
        links = np.stack([sides // 3, opposite[sides] // 3], axis=1)
        links = np.concatenate([links[whole[links[:, 1]]], np.stack([rest, rest], axis=1)])
        _, label = components(links[:, [0, 1, 1]])
        patch[: len(rest)] = label[-len(rest) :]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    twice = np.linalg.norm(normals, axis=1)
    # the middle of the largest triangle of each patch is farthest from what is lost to rounding
    order = np.lexsort((-twice, patch))
    probes = order[np.diff(patch[order], prepend=-1) > 0]
    # off the surface by as much as surfaces may be apart that count as one
    steps = normals[probes] / np.maximum(twice[probes], 1e-300)[:, None] * (COINCIDENT * diagonal)
    middles = triangles[probes].mean(axis=1)
    front, behind = (_numbers_at(tree, points, closed) for points in (middles + steps, middles - steps))
    of_patch = np.searchsorted(patch[probes], patch)
    exposed = ((front > 0.5) != (behind > 0.5))[of_patch]
    # sheets that lie on each other are all kept, and each counts for a part of the volume
    sheets = np.maximum(1.0, np.round(np.abs(behind - front)))[of_patch]
    offsets = triangles - (tree.boxes[0, :3] + tree.boxes[0, 3:]) / 2
    sixths = np.einsum("ij,ij->i", offsets[:, 0], np.cross(offsets[:, 1], offsets[:, 2])) / 6
    volume = float((sixths / sheets)[exposed].sum()) if closed else float("nan")
    return OuterSurface(np.ascontiguousarray(triangles[exposed]), owners[exposed], volume)


def _numbers_at(tree: BoxTree, points: F64, closed: bool) -> F64:
    """Winding numbers, exact ones if the mesh is closed."""
    if not closed:
        return winding_numbers(dipoles(tree), points)
    labels, none = np.zeros(len(tree.order), np.int32), np.full(len(points), -1, np.int32)
    return layers_around(tree, labels, points, none).astype(np.float64)


def _meeting(tree: BoxTree, tolerance: float) -> tuple[I64, I64, I64]:
    """Triangles that meet others beyond shared corners and edges, starts, and these others, in random order.

    Those of triangle meeting[i] are partners[starts[i] : starts[i + 1]].
    """
    pairs = np.empty((1024, 2), np.int64)
    while (found := int(_find_pairs(tree.triangles, tree.boxes, tree.starts, tolerance, pairs))) > len(pairs):
        pairs = np.empty((found, 2), np.int64)
    mine, other = tree.order[pairs[:found, 0]], tree.order[pairs[:found, 1]]
    # the number of pieces is only small if the order of the cuts is random; a fixed seed makes it the same each time
    order = np.lexsort((np.random.default_rng(0).permutation(found), mine))
    meeting, starts = np.unique(mine[order], return_index=True)
    return meeting, np.append(starts, found), other[order]


@jit
def _find_pairs(triangles: F64, boxes: F64, starts: I64, tolerance: float, pairs: I64) -> int:
    """Number of pairs, each counted from both sides; as many as there is room for are written, as places of the tree.

    Rounded arithmetic with a tolerance: a pair that is missed by a hair has a cut too short to matter.
    """
    leaves = starts.size - 1
    waiting = np.empty(DEPTH, np.int64)
    frame, corners, others, segments = np.empty((3, 3)), np.empty((3, 2)), np.empty((3, 2)), np.empty((3, 4))
    low, high = np.empty(3), np.empty(3)
    n = 0
    for i in range(triangles.shape[0]):
        t = triangles[i]
        if not _frame(t, tolerance, frame, corners):
            continue  # without an area it neither hides nor bounds anything
        for a in range(3):
            low[a] = min(t[0, a], t[1, a], t[2, a]) - tolerance
            high[a] = max(t[0, a], t[1, a], t[2, a]) + tolerance
        waiting[0] = 0
        left = 1
        while left > 0:
            left -= 1
            node = waiting[left]
            box = boxes[node]
            if box[0] > high[0] or box[3] < low[0] or box[1] > high[1]:
                continue
            if box[4] < low[1] or box[2] > high[2] or box[5] < low[2]:
                continue
            if node < leaves - 1:
                waiting[left], waiting[left + 1] = 2 * node + 2, 2 * node + 1
                left += 2
                continue
            leaf = node - leaves + 1
            for j in range(starts[leaf], starts[leaf + 1]):
                u = triangles[j]
                if i == j or _boxes_apart(u, low, high):
                    continue
                count = _segments_in(t, u, frame, tolerance, others, segments)
                if count == 0:
                    continue
                shared = 0
                for c in range(3):
                    for d in range(3):
                        shared += t[c, 0] == u[d, 0] and t[c, 1] == u[d, 1] and t[c, 2] == u[d, 2]
                if count == 3:  # in one plane: they overlap if no edge of either separates them
                    meets = shared == 3
                    meets |= _overlap(corners, others, tolerance) and _overlap(others, corners, tolerance)
                else:  # neighbors meet in the edge or corner they share
                    margin = tolerance if shared == 0 else -tolerance
                    meets = shared < 2 and _length_within(corners, segments[0], margin) > 4 * tolerance
                if meets:
                    if n < pairs.shape[0]:
                        pairs[n, 0], pairs[n, 1] = i, j
                    n += 1
    return n


@jit
def _boxes_apart(u: F64, low: F64, high: F64) -> bool:
    apart = False
    for a in range(3):
        apart |= min(u[0, a], u[1, a], u[2, a]) > high[a] or max(u[0, a], u[1, a], u[2, a]) < low[a]
    return apart


@jit
def _frame(t: F64, tolerance: float, frame: F64, corners: F64) -> bool:
    """Orthonormal frame of a triangle, its normal last, and the corners in it; False if it has no area."""
    length = 0.0
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        frame[0, a] = t[1, a] - t[0, a]
        frame[2, a] = (t[1, b] - t[0, b]) * (t[2, c] - t[0, c]) - (t[1, c] - t[0, c]) * (t[2, b] - t[0, b])
        length += frame[0, a] * frame[0, a]
    length = np.sqrt(length)
    twice = np.sqrt(frame[2, 0] ** 2 + frame[2, 1] ** 2 + frame[2, 2] ** 2)
    if not twice > tolerance * length or not length > tolerance:
        return False
    for a in range(3):
        frame[0, a] /= length
        frame[2, a] /= twice
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        frame[1, a] = frame[2, b] * frame[0, c] - frame[2, c] * frame[0, b]
    for k in range(3):
        for e in range(2):
            corners[k, e] = 0.0
            for a in range(3):
                corners[k, e] += frame[e, a] * (t[k, a] - t[0, a])
    return True


@jit
def _segments_in(t: F64, u: F64, frame: F64, tolerance: float, others: F64, segments: F64) -> int:
    """Segments (x, y, x, y) that triangle u has in the plane of t: none, one, or its three edges if it lies in it."""
    h0, h1, h2 = 0.0, 0.0, 0.0
    for a in range(3):
        h0 += frame[2, a] * (u[0, a] - t[0, a])
        h1 += frame[2, a] * (u[1, a] - t[0, a])
        h2 += frame[2, a] * (u[2, a] - t[0, a])
    if min(h0, h1, h2) > tolerance or max(h0, h1, h2) < -tolerance:
        return 0
    heights = (h0, h1, h2)
    for k in range(3):
        for e in range(2):
            others[k, e] = 0.0
            for a in range(3):
                others[k, e] += frame[e, a] * (u[k, a] - t[0, a])
    ends = 0
    flat = 0
    for k in range(3):
        flat += abs(heights[k]) <= tolerance
    for k in range(3):
        one, two = k, (k + 1) % 3
        if flat == 3:
            segments[k, 0], segments[k, 1] = others[one, 0], others[one, 1]
            segments[k, 2], segments[k, 3] = others[two, 0], others[two, 1]
        elif abs(heights[one]) <= tolerance:
            if ends < 2:
                segments[0, 2 * ends], segments[0, 2 * ends + 1] = others[one, 0], others[one, 1]
            ends += 1
        elif abs(heights[two]) > tolerance and (heights[one] > 0.0) != (heights[two] > 0.0):
            share = heights[one] / (heights[one] - heights[two])
            if ends < 2:
                for e in range(2):
                    segments[0, 2 * ends + e] = others[one, e] + share * (others[two, e] - others[one, e])
            ends += 1
    if flat == 3:
        return 3
    return 1 if ends == 2 else 0


@jit
def _overlap(p: F64, q: F64, tolerance: float) -> bool:
    """False if an edge of triangle p, in the plane, has all of triangle q on its outer side."""
    turn = (p[1, 0] - p[0, 0]) * (p[2, 1] - p[0, 1]) - (p[1, 1] - p[0, 1]) * (p[2, 0] - p[0, 0])
    sign = 1.0 if turn > 0.0 else -1.0
    for e in range(3):
        ux, uy = p[(e + 1) % 3, 0] - p[e, 0], p[(e + 1) % 3, 1] - p[e, 1]
        length = np.sqrt(ux * ux + uy * uy)
        deepest = -np.inf
        for k in range(3):
            deepest = max(deepest, sign * (ux * (q[k, 1] - p[e, 1]) - uy * (q[k, 0] - p[e, 0])))
        if not deepest > 4 * tolerance * length:
            return False
    return True


@jit
def _length_within(corners: F64, segment: F64, margin: float) -> float:
    """Length of a segment within a counterclockwise triangle that is wider by a margin (Cyrus and Beck 1978)."""
    vx, vy = segment[2] - segment[0], segment[3] - segment[1]
    first, last = 0.0, 1.0
    for e in range(3):
        a, b = corners[e], corners[(e + 1) % 3]
        ux, uy = b[0] - a[0], b[1] - a[1]
        at = ux * (segment[1] - a[1]) - uy * (segment[0] - a[0]) + margin * np.sqrt(ux * ux + uy * uy)
        slope = ux * vy - uy * vx
        if slope > 0.0:
            first = max(first, -at / slope)
        elif slope < 0.0:
            last = min(last, -at / slope)
        elif at < 0.0:
            return 0.0
    return float(max(0.0, last - first) * np.sqrt(vx * vx + vy * vy))


@jit
def _divides(piece: F64, segment: F64, tolerance: float, sides: F64) -> bool:
    """True if a segment crosses the inside of a triangle; `sides` gets how far its corners are off the line."""
    vx, vy = segment[2] - segment[0], segment[3] - segment[1]
    length = np.sqrt(vx * vx + vy * vy)
    if not length > tolerance:
        return False
    for k in range(3):
        side = (vx * (piece[k, 1] - segment[1]) - vy * (piece[k, 0] - segment[0])) / length
        sides[k] = side if abs(side) > tolerance else 0.0
    if not (min(sides[0], sides[1], sides[2]) < 0.0 < max(sides[0], sides[1], sides[2])):
        return False
    return _length_within(piece, segment, -tolerance) > tolerance


@jit
def _dividing(piece: F64, segments: F64, candidates: I64, tolerance: float) -> I64:
    """Those of some segments that cross the inside of a triangle, in their order."""
    found, sides, n = np.empty(candidates.size, np.int64), np.empty(3), 0
    for s in candidates:
        if _divides(piece, segments[s], tolerance, sides):
            found[n] = s
            n += 1
    return found[:n]


@jit
def _split(piece: F64, sides: F64, parts: F64) -> int:
    """Cut a triangle along a line, given by the distances of its corners; returns the number of triangles it makes."""
    on = -1
    for k in range(3):
        if sides[k] == 0.0:
            on = k
    # the corner that is alone on its side, or on the line
    tip = on
    if on < 0:
        for k in range(3):
            if (sides[k] > 0.0) != (sides[(k + 1) % 3] > 0.0) and (sides[k] > 0.0) != (sides[(k + 2) % 3] > 0.0):
                tip = k
    one, two = (tip + 1) % 3, (tip + 2) % 3
    for e in range(2):
        z, a, b = piece[tip, e], piece[one, e], piece[two, e]
        if on >= 0:
            x = a + (b - a) * (sides[one] / (sides[one] - sides[two]))
            parts[0, 0, e], parts[0, 1, e], parts[0, 2, e] = z, a, x
            parts[1, 0, e], parts[1, 1, e], parts[1, 2, e] = z, x, b
        else:
            x = z + (a - z) * (sides[tip] / (sides[tip] - sides[one]))
            y = z + (b - z) * (sides[tip] / (sides[tip] - sides[two]))
            parts[0, 0, e], parts[0, 1, e], parts[0, 2, e] = z, x, y
            parts[1, 0, e], parts[1, 1, e], parts[1, 2, e] = x, a, b
            parts[2, 0, e], parts[2, 1, e], parts[2, 2, e] = x, b, y
    return 2 if on >= 0 else 3


@jit
def _pieces(t: F64, partners: F64, tolerance: float) -> F64:
    """Triangles (n, 3, 3) that make up a triangle and are crossed by none of its partners (k, 3, 3)."""
    frame, corners, others, found = np.empty((3, 3)), np.empty((3, 2)), np.empty((3, 2)), np.empty((3, 4))
    segments = np.empty((3 * partners.shape[0], 4))
    _frame(t, tolerance, frame, corners)
    n = 0
    for p in range(partners.shape[0]):
        for s in range(_segments_in(t, partners[p], frame, tolerance, others, found)):
            for e in range(4):
                segments[n, e] = found[s, e]
            n += 1
    parts, sides, done = np.empty((3, 3, 2)), np.empty(3), [corners]
    done.pop()  # only the type of the list was wanted
    # triangles that are still to be cut, each with the segments that divide it
    waiting = [(corners, _dividing(corners, segments, np.arange(n), tolerance))]
    while len(waiting) > 0:
        piece, dividing = waiting.pop()
        if dividing.size == 0:
            done.append(piece)
            continue
        _divides(piece, segments[dividing[0]], tolerance, sides)
        for k in range(_split(piece, sides, parts)):
            part = parts[k].copy()
            # a segment that misses a part divides no piece of it either
            waiting.append((part, _dividing(part, segments, dividing[1:], tolerance)))
    pieces = np.empty((len(done), 3, 3))
    for p in range(len(done)):
        for k in range(3):
            for a in range(3):
                pieces[p, k, a] = t[0, a] + done[p][k, 0] * frame[0, a] + done[p][k, 1] * frame[1, a]
    return pieces
