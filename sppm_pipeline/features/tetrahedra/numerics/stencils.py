"""The stencils of isosurface stuffing (Labelle and Shewchuk, 2007).

A quadrilateral between two solid corners p, q of a face and the points where the surface cuts the edges from p and q
to the third corner is split by a diagonal. It ends at the point on the longer of the two edges. If they are equally
long, the *parity rule* decides: it ends at the point on the edge from that solid corner which exceeds the third corner
in an even number of coordinates. Both rules look at the undeformed face alone, so that both tetrahedra at it agree, and
so do copies on opposite faces of a periodic box.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import jit


def cut_tetrahedra(
    signs: NDArray[np.int8],
    slot_of: NDArray[np.int32],
    starts: NDArray[np.int64],
    incident: NDArray[np.int64],
    slots: NDArray[np.int32],
    periodic: bool,
) -> NDArray[np.int64]:
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
def _cut_point(
    u: NDArray[np.int64], v: NDArray[np.int64], top: NDArray[np.int64], slot_of: NDArray[np.int32],
    starts: NDArray[np.int64], incident: NDArray[np.int64], slots: NDArray[np.int32], periodic: bool,
) -> int:  # fmt: skip
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
def _ends_at(third: NDArray[np.int64], p: NDArray[np.int64], q: NDArray[np.int64]) -> bool:
    """Test whether the diagonal of the quadrilateral below `third` ends at the cut point from p, not at that from q."""
    longer, parity = int(np.int64(0)), int(np.int64(0))
    for axis in range(3):
        longer += (p[axis] - third[axis]) ** 2 - (q[axis] - third[axis]) ** 2
        parity += p[axis] > third[axis]
    return longer > 0 or (longer == 0 and parity % 2 == 0)


@jit
def _emit(tets: NDArray[np.int64], n: int, flip: bool, a: int, b: int, c: int, d: int) -> None:
    tets[n, 0], tets[n, 1] = a, b
    tets[n, 2], tets[n, 3] = (d, c) if flip else (c, d)


@jit
def _sort_by_sign(at: NDArray[np.int64], sign: NDArray[np.int64]) -> bool:
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
def _pillars(
    at: NDArray[np.int64], solid: int, void: int, names: NDArray[np.int64], cuts: NDArray[np.int64],
    low: NDArray[np.int64], high: NDArray[np.int64], wins: NDArray[np.int64],
) -> None:  # fmt: skip
    """Solid part of a tetrahedron with two or three corners in the solid, as a prism: its three pillars.

    `wins` counts for each pillar the diagonals that end at its high end. A pyramid is a prism with a pillar of no
    length.
    """
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
    at: NDArray[np.int64], signs: NDArray[np.int8], slot_of: NDArray[np.int32], starts: NDArray[np.int64],
    incident: NDArray[np.int64], slots: NDArray[np.int32], periodic: bool, top: NDArray[np.int64],
    sign: NDArray[np.int64], names: NDArray[np.int64], cuts: NDArray[np.int64], low: NDArray[np.int64],
    high: NDArray[np.int64], wins: NDArray[np.int64], tets: NDArray[np.int64], n: int, fill: bool,
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
    signs: NDArray[np.int8], slot_of: NDArray[np.int32], starts: NDArray[np.int64], incident: NDArray[np.int64],
    slots: NDArray[np.int32], periodic: bool, tets: NDArray[np.int64], fill: bool,
) -> int:  # fmt: skip
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
