"""Vertices of marching cubes put where the fields that make the surface have their zeros.

Marching cubes finds the topology and puts vertices where linear interpolation has the zero. A sum G of exponentials is
far from linear over a voxel; its logarithm is smooth (that of a single pore or squared tunnel is a parabola), and the
cubic through four samples along the grid edge has its zero nearer to the true one.

The intersection of two fields is their maximum, which mixes, at the two ends of a grid edge, values of fields of
different size. Here every vertex is put where, going from the solid end, the first of the two fields reaches its zero.
With a third solid, the skin, united with the first one beforehand, that is where the last of the two has its zero. The
zero of the domain is where the grid edge pierces its triangles, if it does (`Crossings`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.method.part.crossings import NO_CROSSINGS, Crossings
from sppm_pipeline.services.arrays import F32, F64, I32, I64, U8
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_cubes import EDGE_MARGIN

FIELD, DOMAIN, SKIN, BORDER = 0, 1, 2, 3
"""Surface that a vertex or triangle lies on: that of the microstructure, of the domain, of the skin, or a cap."""

_AT_ONCE = 64
"""Vertices whose zeros are looked for side by side."""

_NOWHERE, _EVERYWHERE = -1, -2
"""Solid on a grid edge that takes no cubic to know: not even at the end that is solid, or at both ends."""


class Samples(NamedTuple):
    """Consecutive planes of the fields that make a surface."""

    grid: Grid  # all planes
    start: int  # number of the first plane in the arrays
    field: F32  # (planes, ny, nx), the microstructure, negative in the solid
    domain: F32  # as field or empty: distance, negative inside, in the unit of the grid
    skin: F32  # as domain
    crossings: Crossings = NO_CROSSINGS  # of the domain with the edges between these planes


class Placed(NamedTuple):
    """Places of vertices."""

    vertices: F64  # (n, 3)
    edge: I64  # (n,), the grid edge, numbered as in `Crossings`; -1 for vertices of caps
    on: U8  # (n,), FIELD, DOMAIN, SKIN or BORDER
    triangle: I32  # (n,), of the domain; -1 where the vertex lies on none


def place_vertices(vertices: F64, samples: Samples) -> Placed:
    """Move vertices (n, 3) of marching cubes, in place, along their grid edges to the zeros of the fields.

    They are those for the field, for ``max(field, domain)``, or with a skin for ``max(min(field, skin), domain)``.
    Those on caps at the border, or beyond the planes of the samples, stay.
    """
    n = len(vertices)
    placed = Placed(vertices, np.full(n, -1, np.int64), np.full(n, BORDER, np.uint8), np.full(n, -1, np.int32))
    grid, crossings = samples.grid, samples.crossings
    _place(
        *placed, samples.field, samples.domain, samples.skin, np.array(grid.origin), np.array(grid.spacing),
        np.array([*grid.shape, samples.start]), crossings.edge, crossings.share, crossings.triangle,
    )  # fmt: skip
    return placed


@jit
def first_place(keys: I64, key: int) -> int:
    """The first place in sorted keys that is not below one; NumPy's compiles for half a second."""
    low, high = int(np.int64(0)), len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@jit
def cubic(a: float, b: float, c: float, d: float, t: float) -> float:
    """The polynomial that has the values a, b, c, d at -1, 0, 1, 2."""
    return (b * ((t + 1.0) * (t - 1.0) * (t - 2.0)) - c * ((t + 1.0) * t * (t - 2.0))) * 0.5 + (
        d * ((t + 1.0) * t * (t - 1.0)) - a * (t * (t - 1.0) * (t - 2.0))
    ) / 6.0


@jit
def sample_line(values: F32, k: int, j: int, i: int, axis: int, line: F64) -> None:
    """Four samples in a row, from one before (k, j, i); at the border a parabola is continued."""
    at = (i, j, k)[axis]
    n = values.shape[2 - axis]
    for s in range(4):
        place = min(max(at + s - 1, 0), n - 1)
        if axis == 0:
            line[s] = values[k, j, place]
        elif axis == 1:
            line[s] = values[k, place, i]
        else:
            line[s] = values[place, j, i]
    if at == 0:
        line[0] = 3.0 * line[1] - 3.0 * line[2] + line[3] if n > 2 else 2.0 * line[1] - line[2]
    if at + 2 >= n:
        line[3] = 3.0 * line[2] - 3.0 * line[1] + line[0] if n > 2 else 2.0 * line[2] - line[1]


@jit
def _cubic_zeros(work: F64, n: int) -> None:
    """Zeros of cubics that have the values a, b, c, d at -1, 0, 1, 2, between b and c, which differ in sign.

    `work` holds a, b, c and d of up to `_AT_ONCE` cubics, one row behind the other, and gets the zeros in the row that
    follows; three more rows are for coefficients, and two for the ends between which a zero lies. Cubics are worked on
    side by side, as the steps towards one zero have to wait for each other.
    """
    steps = int(np.int64(0))
    for i in range(n):
        a, b, c, d = work[i], work[_AT_ONCE + i], work[2 * _AT_ONCE + i], work[3 * _AT_ONCE + i]
        t = b / (b - c)
        work[4 * _AT_ONCE + i] = t
        work[5 * _AT_ONCE + i] = c - b / 2.0 - a / 3.0 - d / 6.0
        work[6 * _AT_ONCE + i] = (a + c) / 2.0 - b
        work[7 * _AT_ONCE + i] = (d - a) / 6.0 + (b - c) / 2.0
        work[8 * _AT_ONCE + i] = 0.0
        work[9 * _AT_ONCE + i] = 1.0
        work[10 * _AT_ONCE + i] = 1.0 if np.isfinite(a) and np.isfinite(d) and np.isfinite(t) else 0.0
    while steps < 40:  # Newton's method, kept between the signs
        steps += 1
        left = 0
        for i in range(n):
            b, t = work[_AT_ONCE + i], work[4 * _AT_ONCE + i]
            first, second, third = work[5 * _AT_ONCE + i], work[6 * _AT_ONCE + i], work[7 * _AT_ONCE + i]
            low, high, open_ = work[8 * _AT_ONCE + i], work[9 * _AT_ONCE + i], work[10 * _AT_ONCE + i]
            value = b + t * (first + t * (second + t * third))
            on_solid = (value < 0.0) == (b < 0.0)
            low = t if on_solid else low
            high = high if on_solid else t
            slope = first + t * (2.0 * second + t * (3.0 * third))
            new = t - value / slope
            new = new if slope != 0.0 else low
            # a step of Newton that leaves the bracket is replaced by bisection, so that it always converges
            new = new if low < new and new < high else 0.5 * (low + high)
            found = value == 0.0
            new = t if found or open_ == 0.0 else new
            open_ = 0.0 if found or abs(new - t) < 1e-5 else open_
            work[4 * _AT_ONCE + i], work[8 * _AT_ONCE + i], work[9 * _AT_ONCE + i] = new, low, high
            work[10 * _AT_ONCE + i] = open_
            left |= int(open_ != 0.0)
        if left == 0:
            break


@jit
def _look_up(
    vertices: F64, first: int, stop: int, field: F32, flat: F32, domain: F32, skin: F32, origin: F64, a_node: F64,
    steps: I64, start: int, held: I64, work: F64,
) -> int:  # fmt: skip
    """Find the grid edges of some vertices, and the cubics along them; returns how many of these there are.

    A row of `held` gets the node at the lower end of the edge, counted from the first plane, its axis, whether the void
    is at that node, and the number of the cubic in `work`, or what stands for it. The axis is -1 if the vertex is to
    stay.
    """
    cubics = int(np.int64(0))
    for v in range(first, stop):
        row = v - first
        axis, inside = int(np.int64(0)), 0
        for a in range(3):
            place = (vertices[v, a] - origin[a]) * a_node[a]
            whole = np.floor(place + 0.5)
            # vertices keep EDGE_MARGIN from the ends of their edge; the bevels of caps lie at half of it
            if abs(place - whole) > 0.75 * EDGE_MARGIN:
                axis = a
                inside += 1
                whole = np.floor(place)
            held[row, a] = np.int64(whole)
        held[row, 2] -= start
        i, j, k = held[row, 0], held[row, 1], held[row, 2]
        kk, jj, ii = k + (axis == 2), j + (axis == 1), i + (axis == 0)
        known = min(k, j, i) >= 0 and kk < field.shape[0] and jj < field.shape[1] and ii < field.shape[2]
        held[row, 3] = -1
        if inside != 1 or not known:
            continue
        f0, f1 = np.float64(field[k, j, i]), np.float64(field[kk, jj, ii])
        turned = not f0 < 0.0
        if domain.size > 0:
            turned = not (domain[k, j, i] < 0.0 and (f0 < 0.0 or (skin.size > 0 and skin[k, j, i] < 0.0)))
        held[row, 3], held[row, 4] = axis, turned
        at_solid, at_void = (f1, f0) if turned else (f0, f1)
        if not at_solid < 0.0:
            held[row, 5] = _NOWHERE
        elif at_void < 0.0:
            held[row, 5] = _EVERYWHERE
        else:
            held[row, 5] = cubics
            # at the border a parabola is continued
            n, along, step = field.shape[2 - axis], held[row, axis], steps[axis]
            at = k * steps[2] + j * steps[1] + i
            before = np.float64(flat[at - step]) if along > 0 else f0
            behind = np.float64(flat[at + 2 * step]) if along + 2 < n else f1
            if along == 0:
                before = 3.0 * f0 - 3.0 * f1 + behind if n > 2 else 2.0 * f0 - f1
            if along + 2 >= n:
                behind = 3.0 * f1 - 3.0 * f0 + before if n > 2 else 2.0 * f1 - f0
            work[cubics], work[_AT_ONCE + cubics] = before, f0
            work[2 * _AT_ONCE + cubics], work[3 * _AT_ONCE + cubics] = f1, behind
            cubics += 1
    return cubics


@jit
def _place(
    vertices: F64, edge: I64, on: U8, triangle: I32, field: F32, domain: F32, skin: F32, origin: F64, spacing: F64,
    shape: I64, crossed: I64, shares: F64, owners: I32,
) -> None:  # fmt: skip
    flat, steps = field.ravel(), np.array([1, field.shape[2], field.shape[2] * field.shape[1]])
    work, held, a_node = np.empty(11 * _AT_ONCE), np.empty((_AT_ONCE, 6), np.int64), 1.0 / spacing
    for first in range(0, vertices.shape[0], _AT_ONCE):
        stop = min(first + _AT_ONCE, vertices.shape[0])
        cubics = _look_up(
            vertices, first, stop, field, flat, domain, skin, origin, a_node, steps, shape[3], held, work
        )  # fmt: skip
        _cubic_zeros(work, cubics)
        for v in range(first, stop):
            row = v - first
            axis, turned, lane = held[row, 3], held[row, 4] != 0, held[row, 5]
            if axis < 0:
                continue
            # shares from the solid end: -1 where a field is not solid there, 2 where it stays solid
            share = -1.0 if lane == _NOWHERE else 2.0
            if lane >= 0:
                share = work[4 * _AT_ONCE + lane]
                share = 1.0 - share if turned else share
            i, j, k = held[row, 0], held[row, 1], held[row, 2]
            kk, jj, ii = k + (axis == 2), j + (axis == 1), i + (axis == 0)
            key = 3 * (((k + shape[3]) * shape[1] + j) * shape[0] + i) + axis
            kind = FIELD
            if skin.size > 0:
                s0, s1 = np.float64(skin[k, j, i]), np.float64(skin[kk, jj, ii])
                at_solid, at_void = (s1, s0) if turned else (s0, s1)
                if at_solid < 0.0:
                    own = 2.0 if at_void < 0.0 else at_solid / (at_solid - at_void)
                    if own > share:
                        share, kind = own, SKIN
            if domain.size > 0:
                d0, d1 = np.float64(domain[k, j, i]), np.float64(domain[kk, jj, ii])
                at_solid, at_void = (d1, d0) if turned else (d0, d1)
                if not at_void < 0.0:
                    own = at_solid / (at_solid - at_void)
                    owner = -1
                    r = first_place(crossed, key)
                    while r < crossed.size and crossed[r] == key:
                        # the last one from the solid end: the end of all shells that overlap
                        place = 1.0 - shares[r] if turned else shares[r]
                        if owner < 0 or place > own:
                            own, owner = place, owners[r]
                        r += 1
                    if own < share:
                        share, kind = own, DOMAIN
                        triangle[v] = owner
            share = min(max(share, EDGE_MARGIN), 1.0 - EDGE_MARGIN)
            node = held[row, axis] + (shape[3] if axis == 2 else 0)
            edge[v] = key
            on[v] = kind
            vertices[v, axis] = origin[axis] + (node + (1.0 - share if turned else share)) * spacing[axis]


@jit
def put_rescaled(vertices: F64, scale: float, origin: F64, out: F64) -> None:
    """``vertices * scale + origin`` into `out`, both (n, 3), without the memory of a step between."""
    for v in range(vertices.shape[0]):
        for axis in range(3):
            out[v, axis] = vertices[v, axis] * scale + origin[axis]
