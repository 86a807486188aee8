"""Solid on a grid as a union of balls of one size: thinner solid goes or is thickened, and sharp edges get round.

An opening keeps what of a solid some ball covers that fits into it: the solid is eroded by the radius of the ball, and
what is left, the *core*, grows by the same. A strut that is a little thinner would be gone; so the core also has the
middle of thin solid, which then comes out as thick as the ball.

Erosion and growth are distances from a surface, which is known by the points where grid edges cross it: exact Euclidean
distances to these points, as far as a reach. Squared distances add up along the axes, so a pass along each axis gives
them, one for points on edges along x, y and z each (as in Felzenszwalb and Huttenlocher 2012, "Distance transforms of
sampled functions"). Lengths are in spacings here. Of a row of nodes only a span is worked on; beside it there is
neither solid nor crossing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sppm_pipeline.method.kernels.profiles import MIN_SUM
from sppm_pipeline.services.arrays import F32, I16, I32, U8, U16
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.threads import in_bands

if TYPE_CHECKING:
    from sppm_pipeline.method.part.crossings import Crossings

PARTS = 254
"""Parts of a grid edge, to which the place of a crossing is rounded: an error of 0.002 spacings."""

NO_CROSSING = 255

SQUARE = 512.0
"""Squared distances are whole multiples of one over this, in sixteen bits: at a distance of 3 an error of 0.0002."""

FAR = 32000
"""Squared distance beyond the reach; no sum of it and a square of `MAX_REACH` overflows."""

AROUND = 2
"""The middle of thin solid is looked for so many nodes around each: as a distance falls by one from node to node."""

NEAR_MIDDLE = 1.0
"""Distance, in spacings, from the middle of thin solid within which nodes belong to it: some node is within 0.87."""

UNIT = 2048
"""Parts of a spacing that distances are whole multiples of: they lie within 14 spacings."""

MAX_REACH = 7
"""Largest reach, spacings, whose squares are below `FAR`."""


class Crossed(NamedTuple):
    """A solid on a grid, (n, ny, nx) uint8 each: nodes that are solid, and crossings of edges that begin at nodes.

    Crossings are counted in `PARTS` of the edge along x, y or z; `NO_CROSSING` where both nodes are of one kind.
    """

    solid: U8
    x: U8
    y: U8
    z: U8


def crossed(field: F32, other: F32 | None, spans: I32, threads: int = 1, level: float = 0.0) -> Crossed:
    """The solid where a field, or another one, is negative; fields (n + 1, ny, nx), the result n planes.

    Each field crosses zero where it does linearly between the nodes, whatever its unit; with a level C, the first is a
    sum of kernels less that, and its logarithm does. `spans` (n, ny, 2) are the first node of each row, and the one
    after the last.
    """
    n, ny, nx = field.shape
    solid = np.empty(field.shape, np.uint8)
    codes = [np.full((n - 1, ny, nx), NO_CROSSING, np.uint8) for _ in range(3)]
    both = other is not None
    second = field if other is None else other
    in_bands(lambda a, b: _signs(field, second, both, a, b, solid), n, threads)
    sums = np.float32(level)
    in_bands(lambda a, b: _cross(field, second, both, solid, spans, sums, a, b, *codes), n - 1, threads)
    return Crossed(solid[:-1], *codes)


def place_crossings(crossed: Crossed, found: Crossings, start: int) -> None:
    """Move crossings with a domain to where edges pierce its triangles, which begins at plane `start`; in place."""
    n, ny, nx = crossed.solid.shape
    node = found.edge // 3 - start * ny * nx
    own = (node >= 0) & (node < n * ny * nx)
    codes = np.rint(PARTS * found.share).astype(np.uint8)
    for axis, placed in enumerate((crossed.x, crossed.y, crossed.z)):
        some = own & (found.edge % 3 == axis)
        flat, at = placed.reshape(-1), node[some]
        changes = flat[at] != NO_CROSSING
        flat[at[changes]] = codes[some][changes]


def in_planes(crossed: Crossed, spans: I32, reach: int, threads: int = 1) -> U16:
    """Squared distances of nodes from the nearest crossing of the same plane, (n, ny, nx) in parts of `SQUARE`.

    `FAR` where none is within the reach along each axis.
    """
    flat = np.full(crossed.solid.shape, FAR, np.uint16)
    in_bands(lambda a, b: _in_planes(crossed.x, crossed.y, spans, a, b, reach, flat), len(flat), threads)
    return flat


def across_planes(upright: U8, flat: U16, spans: I32, below: int, reach: int, threads: int = 1) -> U16:
    """Squared distances of nodes in some planes from the nearest crossing, from those `in_planes`.

    `upright` are the crossings of edges along z, `spans` (planes, ny, 2) those of the result. The first of its planes
    has `below` planes of crossings below it; those within the reach are needed below and above.
    """
    out = np.full((len(spans), *flat.shape[1:]), FAR, np.uint16)
    in_bands(lambda a, b: _across_planes(flat, upright, spans, below, a, b, reach, out), len(spans), threads)
    return out


def core_field(solid: U8, depth: U16, within: U16, spans: I32, radius: float, least: float, threads: int = 1) -> F32:
    """Field of the core, negative inside, (planes, ny, nx) in spacings: the places of the middles of balls.

    Those are where the ball fits into the solid (`depth`, squared distances from its surface) and into the domain
    (`within`, the same from the surface of that, 0 outside); and in solid that is thinner the middle of it, to within
    `NEAR_MIDDLE` spacings, if the largest ball there has at least the radius `least`. The arrays have `AROUND` planes
    more below and above than the result, whose `spans` are given.
    """
    n, ny, nx = depth.shape
    signed = np.empty(depth.shape, np.float32)

    def sign(a: int, b: int) -> None:
        _sign(solid[a:b].reshape(-1), depth[a:b].reshape(-1), signed[a:b].reshape(-1))

    in_bands(sign, n, threads)
    field = np.full((len(spans), ny, nx), radius, np.float32)
    sizes = np.float32(radius), np.float32(least)
    in_bands(lambda a, b: _core(signed, within, spans, a, b, *sizes, field), len(spans), threads)
    return field


def grown_field(core: U8, squares: U16, radius: float, reach: int, threads: int = 1) -> I16:
    """Field of what balls on a core cover, about a distance in spacings times `UNIT`, negative inside, (n, ny, nx).

    `core` are the nodes of the core, `squares` the squared distances from its surface, within the reach.
    """
    field = np.empty(core.shape, np.int16)

    def grow(a: int, b: int) -> None:
        nodes, away, made = core[a:b].reshape(-1), squares[a:b].reshape(-1), field[a:b].reshape(-1)
        _grow(nodes, away, made, np.float32(radius), np.float32(reach))

    in_bands(grow, len(field), threads)
    return field


@jit
def widened(spans: I32, above: int, beside: int, nx: int) -> I32:
    """Spans that hold those of planes up to `above` above and below, of rows `beside` them, and as many nodes beside.

    The spans (n, ny, 2) are of `above` planes more at both ends than the result.
    """
    planes, ny = spans.shape[0] - 2 * above, spans.shape[1]
    tall = np.empty((planes, ny, 2), np.int32)
    out = np.zeros((planes, ny, 2), np.int32)
    for k in range(planes):
        for j in range(ny):
            tall[k, j] = nx, 0
            for other in range(k, k + 2 * above + 1):
                if spans[other, j, 0] < spans[other, j, 1]:
                    tall[k, j, 0] = min(tall[k, j, 0], spans[other, j, 0])
                    tall[k, j, 1] = max(tall[k, j, 1], spans[other, j, 1])
        for j in range(ny):
            low, high = nx, 0
            for other in range(max(0, j - beside), min(ny, j + beside + 1)):
                low, high = min(low, tall[k, other, 0]), max(high, tall[k, other, 1])
            if low < high:
                out[k, j] = max(0, low - beside), min(nx, high + beside)
    return out


@inline_jit
def _negative(field: F32, solid: U8) -> None:
    for i in range(field.size):
        solid[i] = np.uint8(field[i] < 0)


@inline_jit
def _either_negative(field: F32, other: F32, solid: U8) -> None:
    for i in range(field.size):
        solid[i] = np.uint8(field[i] < 0) | np.uint8(other[i] < 0)


@jit
def _signs(field: F32, other: F32, both: bool, start: int, stop: int, solid: U8) -> None:
    for k in range(start, stop):
        for j in range(field.shape[1]):
            if both:
                _either_negative(field[k, j], other[k, j], solid[k, j])
            else:
                _negative(field[k, j], solid[k, j])


@jit
def _cross(
    field: F32, other: F32, both: bool, solid: U8, spans: I32, level: np.float32, start: int, stop: int, cx: U8,
    cy: U8, cz: U8,
) -> None:  # fmt: skip
    _, ny, nx = field.shape
    for k in range(start, stop):
        for j in range(ny):
            first, last = spans[k, j]
            here = solid[k, j]
            for axis in range(3):
                codes = cx if axis == 0 else cy if axis == 1 else cz
                kk, jj, di = k + (axis == 2), j + (axis == 1), int(axis == 0)
                if jj == ny:
                    continue
                there = solid[kk, jj]
                for i in range(first, min(last, nx - di)):
                    if here[i] == there[i + di]:
                        continue
                    # the way from the solid node to the void one; a union ends where the last of both does
                    if here[i]:
                        ak, aj, ai, bk, bj, bi = k, j, i, kk, jj, i + di
                    else:
                        ak, aj, ai, bk, bj, bi = kk, jj, i + di, k, j, i
                    share = np.float32(0.0)
                    if field[ak, aj, ai] < 0:
                        a, b = field[ak, aj, ai], field[bk, bj, bi]
                        if level > 0:  # as `log_of_sums`, but only of the few nodes at the surface
                            least = np.float32(MIN_SUM) / level - np.float32(1)
                            a, b = np.log1p(max(a / level, least)), np.log1p(b / level)
                        share = _share(a, b)
                    if both and other[ak, aj, ai] < 0:
                        share = max(share, _share(other[ak, aj, ai], other[bk, bj, bi]))
                    code = np.uint8(np.float32(PARTS) * share + np.float32(0.5))
                    codes[k, j, i] = code if here[i] else np.uint8(PARTS) - code


@jit
def _share(inside: np.float32, outside: np.float32) -> np.float32:
    return np.float32(inside / (inside - outside))


@inline_jit
def _sign(solid: U8, squares: U16, signed: F32) -> None:
    for i in range(signed.size):
        d = np.sqrt(np.float32(squares[i]) * np.float32(1 / SQUARE))
        signed[i] = d if solid[i] else -d


@inline_jit
def _raise(target: F32, other: F32) -> None:
    for i in range(target.size):
        target[i] = max(target[i], other[i])


@inline_jit
def _core_row(depth: F32, most: F32, within: U16, radius: np.float32, least: np.float32, field: F32) -> None:
    for i in range(field.size):
        needed = max(min(radius, most[i] - np.float32(NEAR_MIDDLE)), least)
        inner = np.sqrt(np.float32(within[i]) * np.float32(1 / SQUARE))
        field[i] = max(needed - depth[i], radius - inner)


@jit
def _core(
    signed: F32, within: U16, spans: I32, start: int, stop: int, radius: np.float32, least: np.float32, field: F32
) -> None:
    _, ny, nx = signed.shape
    plane, rows = np.empty((ny, nx), np.float32), np.empty(nx, np.float32)
    most = np.empty(nx, np.float32)
    for own in range(start, stop):
        k = own + AROUND
        for j in range(ny):
            plane[j] = signed[k, j]
            for other in range(k - AROUND, k + AROUND + 1):
                _raise(plane[j], signed[other, j])
        for j in range(ny):
            first, last = spans[own, j]
            if first >= last:
                continue
            a, b = max(0, first - AROUND), min(nx, last + AROUND)
            rows[a:b] = plane[j, a:b]
            for other in range(max(0, j - AROUND), min(ny, j + AROUND + 1)):
                _raise(rows[a:b], plane[other, a:b])
            most[a:b] = rows[a:b]
            for step in range(1, AROUND + 1):
                _raise(most[a + step : b], rows[a : b - step])
                _raise(most[a : b - step], rows[a + step : b])
            _core_row(
                signed[k, j, first:last], most[first:last], within[k, j, first:last], radius, least,
                field[own, j, first:last],
            )  # fmt: skip


@inline_jit
def _lower(target: U16, other: U16, plus: np.uint16) -> None:
    for i in range(target.size):
        target[i] = min(target[i], np.uint16(other[i] + plus))


@inline_jit
def _squares(distance: I32, out: U16) -> None:
    """Squares of distances in parts of an edge."""
    for i in range(out.size):
        d = np.float32(distance[i]) * np.float32(1 / PARTS)
        out[i] = np.uint16(min(d * d * np.float32(SQUARE) + np.float32(0.5), np.float32(FAR)))


@inline_jit
def _step(codes: U8, flipped: bool, distance: I32) -> None:
    """From the distances at one row of nodes from crossings behind it to those at the next; in place."""
    for i in range(distance.size):
        on = np.int32(PARTS) - np.int32(codes[i]) if flipped else np.int32(codes[i])
        distance[i] = on if codes[i] != NO_CROSSING else min(distance[i] + np.int32(PARTS), np.int32(1 << 14))


@jit
def _row(codes: U8, distance: I32) -> None:
    """Distances along a row from its crossings."""
    n = codes.size
    far = np.int32(1 << 14)
    d = far
    for i in range(n):
        if i and codes[i - 1] != NO_CROSSING:
            d = np.int32(PARTS) - np.int32(codes[i - 1])
        elif i:
            d = min(d + np.int32(PARTS), far)
        distance[i] = d
    d = far
    for i in range(n - 1, -1, -1):
        d = np.int32(codes[i]) if codes[i] != NO_CROSSING else min(d + np.int32(PARTS), far)
        distance[i] = min(distance[i], d)


@jit
def _spread_rows(plane: U16, spans: I32, reach: int, out: U16) -> None:
    """The pass along y; `out` is overwritten within the spans."""
    ny = plane.shape[0]
    for j in range(ny):
        first, last = spans[j]
        if first >= last:
            continue
        out[j, first:last] = plane[j, first:last]
        for other in range(max(0, j - reach), min(ny, j + reach + 1)):
            if other != j:
                plus = np.uint16(SQUARE * (other - j) * (other - j))
                _lower(out[j, first:last], plane[other, first:last], plus)


@jit
def _spread_along(row: U16, first: int, last: int, reach: int, out: U16) -> None:
    """The pass along x: lowers `out` in a span, from a row that goes on beside it."""
    _lower(out[first:last], row[first:last], np.uint16(0))
    for step in range(1, reach + 1):
        plus = np.uint16(SQUARE * step * step)
        a, b = max(first, step), min(last, row.size - step)
        _lower(out[a:last], row[a - step : last - step], plus)
        _lower(out[first:b], row[first + step : b + step], plus)


@jit
def _in_planes(cx: U8, cy: U8, spans: I32, start: int, stop: int, reach: int, flat: U16) -> None:
    """Squared distances from the crossings of the same plane."""
    _, ny, nx = cx.shape
    along, across = np.empty((ny, nx), np.uint16), np.empty((ny, nx), np.uint16)
    distance, row = np.empty(nx, np.int32), np.empty(nx, np.uint16)
    for k in range(start, stop):
        along[:] = FAR
        for j in range(ny):
            first, last = spans[k, j]
            if first < last:
                _row(cx[k, j, first:last], distance[first:last])
                _squares(distance[first:last], along[j, first:last])
        _spread_rows(along, spans[k], reach, flat[k])
        distance[:] = 1 << 14
        across[:] = FAR
        for j in range(ny):
            if j:
                _step(cy[k, j - 1], True, distance)
            first, last = spans[k, j]
            _squares(distance[first:last], across[j, first:last])
        distance[:] = 1 << 14
        for j in range(ny - 1, -1, -1):
            _step(cy[k, j], False, distance)
            first, last = spans[k, j]
            _squares(distance[first:last], row[first:last])
            _lower(across[j, first:last], row[first:last], np.uint16(0))
        for j in range(ny):
            first, last = spans[k, j]
            if first < last:
                _spread_along(across[j], first, last, reach, flat[k, j])


@jit
def _across_planes(flat: U16, cz: U8, spans: I32, below: int, start: int, stop: int, reach: int, out: U16) -> None:
    """Squared distances from those in planes, and from crossings between planes."""
    n, ny, nx = flat.shape
    upright, spread = np.empty((ny, nx), np.uint16), np.empty((ny, nx), np.uint16)
    distance, row = np.empty(nx, np.int32), np.empty(nx, np.uint16)
    wide = np.empty((ny, 2), np.int32)
    for own in range(start, stop):
        k = own + below
        for j in range(ny):
            # rows and nodes that are within the reach of what is wanted
            low, high = nx, 0
            for other in range(max(0, j - reach), min(ny, j + reach + 1)):
                if spans[own, other, 0] < spans[own, other, 1]:
                    low, high = min(low, spans[own, other, 0]), max(high, spans[own, other, 1])
            first, last = max(0, low - reach), min(nx, high + reach)
            wide[j] = first, last
            if first >= last:
                wide[j] = 0
                continue
            near = distance[first:last]
            near[:] = 1 << 14
            for other in range(max(0, k - reach - 1), k):
                _step(cz[other, j, first:last], True, near)
            _squares(near, upright[j, first:last])
            near[:] = 1 << 14
            for other in range(min(n - 1, k + reach), k - 1, -1):
                _step(cz[other, j, first:last], False, near)
            _squares(near, row[first:last])
            _lower(upright[j, first:last], row[first:last], np.uint16(0))
        for j in range(ny):
            first, last = spans[own, j]
            if first >= last:
                continue
            a, b = max(0, first - reach), min(nx, last + reach)
            spread[j, a:b] = upright[j, a:b]
            for other in range(max(0, j - reach), min(ny, j + reach + 1)):
                if other != j:
                    plus = np.uint16(SQUARE * (other - j) * (other - j))
                    _lower(spread[j, a:b], upright[other, a:b], plus)
            target = out[own, j, first:last]
            target[:] = flat[k, j, first:last]
            for other in range(max(0, k - reach), min(n, k + reach + 1)):
                if other != k:
                    plus = np.uint16(SQUARE * (other - k) * (other - k))
                    _lower(target, flat[other, j, first:last], plus)
            _spread_along(spread[j, a:b], first - a, last - a, reach, out[own, j, a:b])


@inline_jit
def _grow(core: U8, squares: U16, field: I16, radius: np.float32, reach: np.float32) -> None:
    for i in range(field.size):
        d = min(np.sqrt(np.float32(squares[i]) * np.float32(1 / SQUARE)), reach)
        field[i] = np.int16(np.float32(UNIT) * ((-d if core[i] else d) - radius))
