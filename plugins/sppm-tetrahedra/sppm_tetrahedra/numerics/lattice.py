"""The lattice that isosurface stuffing cuts: body-centered cubic inside a box, closed by the faces of the box.

Corners of the cubes of a grid and their centers form a body-centered cubic lattice. Its tetrahedra have an edge of a
cube and the two centers on either side of a face as corners, so those at the border stick halfway out of the box. There
the edge between the centers is cut at the center of the cube's face: the box is filled exactly, by halves of
tetrahedra at its border.

All points have whole coordinates in a grid of half the spacing (the *doubled grid*): corners are even in x, y and z,
centers odd, centers of faces even along the normal of the face and odd in its plane.

The stencils of isosurface stuffing (Labelle and Shewchuk, 2007).

A quadrilateral between two solid corners p, q of a face and the points where the surface cuts the edges from p and q
to the third corner is split by a diagonal. It ends at the point on the longer of the two edges. If they are equally
long, the *parity rule* decides: it ends at the point on the edge from that solid corner which exceeds the third corner
in an even number of coordinates. Both rules look at the undeformed face alone, so that both tetrahedra at it agree, and
so do copies on opposite faces of a periodic box.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import F32, I32, I64, jit


def cut_tetrahedra(
    signs: NDArray[np.int8], slot_of: I32, starts: I64, incident: I64, slots: I32, periodic: bool
) -> I64:
    """The tetrahedra that fill the solid, (m, 4).

    `signs`, (2 nz + 1, 2 ny + 1, 2 nx + 1), are 1 for points of the lattice in the solid, -1 in the void, 0 on the
    surface; the other arrays are those of `Crossings`. Corners are the index of a point in the raveled doubled grid;
    or, from its size on, 8 times the number of the cut edge plus, for a copy of that edge in high faces of the box, 1,
    2, 4 for x, y, z.
    """
    count = int(_cut(signs, slot_of.reshape(-1), starts, incident, slots, periodic, np.empty((0, 4), np.int64), False))
    tets = np.empty((count, 4), np.int64)
    _cut(signs, slot_of.reshape(-1), starts, incident, slots, periodic, tets, True)
    return tets


@jit
def _cut_point(u: I64, v: I64, top: I64, slot_of: I32, starts: I64, incident: I64, slots: I32, periodic: bool) -> int:
    """The number of the cut point between two corners."""
    first, second, copy = int(np.int64(0)), int(np.int64(0)), int(np.int64(0))
    size = int(np.int64(1))
    for axis in range(3):
        a, b = u[axis], v[axis]
        if periodic and a == top[axis] and b == top[axis]:
            copy += 1 << axis
        if not periodic or a != top[axis]:
            first += size * a
        if not periodic or b != top[axis]:
            second += size * b
        size *= top[axis] + 1
    s, t = slot_of[first], slot_of[second]
    found = int(np.int64(-1))
    for p in range(starts[s], starts[s + 1]):
        e = incident[p]
        if slots[e, 0] == t or slots[e, 1] == t:
            found = size + 8 * e + copy
    return found


@jit
def _ends_at(third: I64, p: I64, q: I64) -> bool:
    """Test whether the diagonal of the quadrilateral below `third` ends at the cut point from p, not at that from q."""
    longer, parity = int(np.int64(0)), int(np.int64(0))
    for axis in range(3):
        longer += (p[axis] - third[axis]) ** 2 - (q[axis] - third[axis]) ** 2
        parity += p[axis] > third[axis]
    return longer > 0 or (longer == 0 and parity % 2 == 0)


@jit
def _emit(tets: I64, n: int, flip: bool, a: int, b: int, c: int, d: int) -> None:
    tets[n, 0], tets[n, 1] = a, b
    tets[n, 2], tets[n, 3] = (d, c) if flip else (c, d)


@jit
def _sort_by_sign(at: I64, sign: I64) -> bool:
    """Corners in the solid first, those in the void last; returns whether that mirrors the tetrahedron."""
    flip = False
    for i in range(1, 4):
        for j in range(i, 0, -1):
            if sign[j] > sign[j - 1]:
                flip = not flip
                sign[j], sign[j - 1] = sign[j - 1], sign[j]
                for axis in range(3):
                    at[j, axis], at[j - 1, axis] = at[j - 1, axis], at[j, axis]
    return flip


@jit
def _pillars(at: I64, solid: int, void: int, names: I64, cuts: I64, low: I64, high: I64, wins: I64) -> None:
    """The three pillars of a solid part, a prism (of a pyramid one has no length); `wins`: diagonals at high ends."""
    if solid == 2 and void == 2:
        # the edge in the solid, and for each corner in the void the line between its cut points
        low[0], high[0] = names[0], names[1]
        wins[0], wins[1], wins[2] = 0, 0, 0
        for i in range(1, 3):
            low[i], high[i] = cuts[0, i + 1], cuts[1, i + 1]
            wins[0 if _ends_at(at[i + 1], at[0], at[1]) else i] += 1
        # the third diagonal lies in the surface and is free, unless the other two would make it go round in a circle
        wins[2 if wins[2] > wins[1] else 1] += 1
        return
    for i in range(3):
        wins[i] = 0
        low[i] = names[i]
        high[i] = cuts[i, 3] if i < solid else names[i]
    for i in range(3):
        j = (i + 1) % 3
        if solid == 2 and (i == 2 or j == 2):
            wins[i + j - 2] += 1
        else:
            wins[i if _ends_at(at[3], at[i], at[j]) else j] += 1


@jit
def _cut_one(
    at: I64, signs: NDArray[np.int8], slot_of: I32, starts: I64, incident: I64, slots: I32, periodic: bool, top: I64,
    sign: I64, names: I64, cuts: I64, low: I64, high: I64, wins: I64, tets: I64, n: int, fill: bool,
) -> int:  # fmt: skip
    """Cut one tetrahedron with corners `at`; returns the number of tetrahedra so far."""
    solid, void = int(np.int64(0)), int(np.int64(0))
    for i in range(4):
        sign[i] = signs[at[i, 2], at[i, 1], at[i, 0]]
        solid += sign[i] > 0
        void += sign[i] < 0
    if solid == 0:
        return n
    # one piece for a corner or a whole, two for a pyramid, three for a prism
    pieces = 1 if void == 0 or solid == 1 else solid + void - 1 if solid == 2 else 3
    if not fill:
        return n + pieces
    flip = _sort_by_sign(at, sign)
    for i in range(4):
        names[i] = (at[i, 2] * (top[1] + 1) + at[i, 1]) * (top[0] + 1) + at[i, 0]
    for i in range(solid):
        for j in range(4 - void, 4):
            cuts[i, j] = _cut_point(at[i], at[j], top, slot_of, starts, incident, slots, periodic)
    if pieces == 1:
        for j in range(4 - void, 4):
            names[j] = cuts[0, j]
        _emit(tets, n, flip, names[0], names[1], names[2], names[3])
        return n + 1
    _pillars(at, solid, void, names, cuts, low, high, wins)
    # pillars by falling wins, so that one way to cut a prism into tetrahedra serves all diagonals
    i, j, k = 0, 1, 2
    if wins[j] > wins[i]:
        i, j, flip = j, i, not flip
    if wins[k] > wins[j]:
        j, k, flip = k, j, not flip
    if wins[j] > wins[i]:
        i, j, flip = j, i, not flip
    _emit(tets, n, flip, low[i], low[j], low[k], high[i])
    _emit(tets, n + 1, flip, high[i], low[j], low[k], high[j])
    if pieces == 3:
        _emit(tets, n + 2, flip, high[i], high[j], low[k], high[k])
    return n + pieces


@jit
def _cut(
    signs: NDArray[np.int8], slot_of: I32, starts: I64, incident: I64, slots: I32, periodic: bool, tets: I64, fill: bool
) -> int:
    """Count the pieces of all tetrahedra of the lattice, or write them down."""
    top, center = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        top[axis] = signs.shape[2 - axis] - 1
    at = np.empty((4, 3), np.int64)
    sign, names, wins = np.empty(4, np.int64), np.empty(4, np.int64), np.empty(3, np.int64)
    cuts, low, high = np.empty((4, 4), np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    n = int(np.int64(0))
    for z in range(1, top[2], 2):
        for y in range(1, top[1], 2):
            for x in range(1, top[0], 2):
                center[0], center[1], center[2] = x, y, z
                # faces of the cube: those on the high side, and those in a low face of the box
                for side in range(6):
                    a = side % 3
                    if side >= 3 and center[a] != 1:
                        continue
                    b, c = (a + 1) % 3, (a + 2) % 3
                    face = center[a] + (1 if side < 3 else -1)
                    before = face if side >= 3 else center[a]
                    after = center[a] if side >= 3 else min(center[a] + 2, top[a])
                    for quarter in range(4):
                        for i in range(4):
                            for axis in range(3):
                                at[i, axis] = center[axis]
                        # two corners of the square, counterclockwise seen from high a
                        for i in range(2):
                            q = (quarter + i) % 4
                            at[i, a] = face
                            at[i, b] += 1 if q == 1 or q == 2 else -1
                            at[i, c] += 1 if q >= 2 else -1
                        at[2, a], at[3, a] = before, after
                        n = _cut_one(
                            at, signs, slot_of, starts, incident, slots, periodic, top, sign, names, cuts, low, high,
                            wins, tets, n, fill,
                        )  # fmt: skip
    return n


CORNERS_OF_CUBE = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.int64)
"""From the center of a cube to its corners, x, y, z."""


class Crossings(NamedTuple):
    """The edges of the lattice that the surface crosses, and which of them meet in a point.

    On a periodic box a point and its copies on opposite faces are one, its *representative* the one on the low side; an
    edge in a high face is left out for its copy.
    """

    ends: I32  # (e, 2, 3), where the edges begin and end in the doubled grid, x, y, z; both in the box
    slots: I32  # (e, 2), the two points as numbers from 0 of all points at such edges
    # (s,), index of each point, as its representative, in the raveled doubled grid; ascending
    points: I64
    starts: I64  # (s + 1,), where the edges of each point begin in `incident`
    incident: I64  # (2 e,), edges by point, ascending at each
    # (2 nz + 1, 2 ny + 1, 2 nx + 1), number of the point; -1 for those at no such edge, and for copies
    slot_of: I32


def doubled_grid(corners: F32, centers: F32, faces: tuple[F32, F32, F32], periodic: bool) -> F32:
    """Samples at the points of the lattice, laid into the doubled grid (2 nz + 1, 2 ny + 1, 2 nx + 1).

    `corners`, (nz + 1, ny + 1, nx + 1), and `centers`, (nz, ny, nx), are those of the cubes; `faces`, (nz, ny, 2), (nz,
    2, nx), (2, ny, nx), lie at the centers of the squares in the low and the high face of the box, across x, y, z. If
    the box is periodic, samples in the high faces are replaced by those in the low ones. 1 where there is no point of
    the lattice; NaN counts as void.
    """
    nz, ny, nx = centers.shape
    grid = np.ones((2 * nz + 1, 2 * ny + 1, 2 * nx + 1), np.float32)
    grid[::2, ::2, ::2] = corners
    grid[1::2, 1::2, 1::2] = centers
    across_x, across_y, across_z = faces
    for side, last in ((0, 0), (1, -1)):
        grid[1::2, 1::2, last] = across_x[:, :, side]
        grid[1::2, last, 1::2] = across_y[:, side, :]
        grid[last, 1::2, 1::2] = across_z[side]
    if periodic:
        repeat_low_faces(grid)
    np.copyto(grid, 1, where=np.isnan(grid))
    return grid


def repeat_low_faces(grid: NDArray[np.generic]) -> None:
    """Write what stands in the low faces of an array over its high faces."""
    grid[:, :, -1] = grid[:, :, 0]
    grid[:, -1, :] = grid[:, 0, :]
    grid[-1, :, :] = grid[0, :, :]


def find_crossings(values: F32, periodic: bool) -> Crossings:
    """The edges of the lattice between a negative and a positive sample, as `doubled_grid` lays them."""
    # counted first, so that the memory is exactly that of the edges
    count = _crossing_edges(values, periodic, np.empty((0, 2, 3), np.int32), False)
    ends = np.empty((count, 2, 3), np.int32)
    _crossing_edges(values, periodic, ends, True)
    wrapped = ends.astype(np.int64)
    if periodic:
        wrapped %= np.array(values.shape[::-1]) - 1
    index = (wrapped[..., 2] * values.shape[1] + wrapped[..., 1]) * values.shape[2] + wrapped[..., 0]
    order = np.argsort(index.ravel(), kind="stable")
    sorted_ = index.ravel()[order]
    first = np.flatnonzero(np.diff(sorted_, prepend=-1))
    points = sorted_[first]
    slot_of = np.full(values.size, -1, np.int32)
    slot_of[points] = np.arange(len(points), dtype=np.int32)
    return Crossings(
        ends, slot_of[index], points, np.append(first, len(sorted_)), order // 2, slot_of.reshape(values.shape)
    )


@jit
def _crossing_edges(values: F32, periodic: bool, ends: I32, fill: bool) -> int:
    """Count the edges between samples of opposite sign, or write them down; each once."""
    top = np.empty(3, np.int64)
    for axis in range(3):
        top[axis] = values.shape[2 - axis] - 1
    at, to = np.empty(3, np.int64), np.empty(3, np.int64)
    count = 0
    for z in range(values.shape[0]):
        for y in range(values.shape[1]):
            for x in range(values.shape[2]):
                odd = (x & 1) + (y & 1) + (z & 1)
                if odd == 1:
                    continue
                at[0], at[1], at[2] = x, y, z
                here = values[z, y, x]
                normal = -1
                if odd == 2:
                    normal = 0 if x & 1 == 0 else (1 if y & 1 == 0 else 2)
                    if at[normal] != 0 and (at[normal] != top[normal] or periodic):
                        continue
                # 0-7: center to corners, or center of a face to the corners of its square;
                # 8-10: to the next point along an axis; 11-13: from a center to the low face of the box
                for way in range(14):
                    for axis in range(3):
                        to[axis] = at[axis]
                    if way < 8:
                        if odd == 0:
                            continue
                        if odd == 2 and CORNERS_OF_CUBE[way, normal] < 0:
                            continue
                        for axis in range(3):
                            if axis != normal:
                                to[axis] += CORNERS_OF_CUBE[way, axis]
                    elif way < 11:
                        axis = way - 8
                        if odd == 2:
                            continue
                        to[axis] += 2
                        if odd == 0:
                            if to[axis] > top[axis]:
                                continue
                            b, c = (axis + 1) % 3, (axis + 2) % 3
                            if periodic and (at[b] == top[b] or at[c] == top[c]):
                                continue
                        elif to[axis] > top[axis]:
                            to[axis] = top[axis]
                    else:
                        axis = way - 11
                        if odd != 3 or at[axis] != 1:
                            continue
                        to[axis] = 0
                    there = values[to[2], to[1], to[0]]
                    if (here < 0 and there > 0) or (here > 0 and there < 0):
                        if fill:
                            for axis in range(3):
                                ends[count, 0, axis] = at[axis]
                                ends[count, 1, axis] = to[axis]
                        count += 1
    return count
