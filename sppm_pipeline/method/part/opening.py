"""Morphological opening of a solid by a ball, on a grid, to a small fraction of its spacing.

What of a solid some ball of a diameter covers that fits into it: thinner solid goes, sharp edges get the radius of the
ball, and nothing is added. The solid is eroded by the radius of the ball, and what is left grows by the same. Both are
distances from a surface, which is known by the points where grid edges cross it: exact Euclidean distances to these
points, as far as a reach. As squared distances add up along the axes, a pass along each axis gives them, one for points
on edges along x, y and z each (Felzenszwalb and Huttenlocher 2012, "Distance transforms of sampled functions", with a
reach in place of parabolas). Lengths are in spacings here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F32, I32, U8, U16
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.threads import in_bands

PARTS = 254
"""Parts of a grid edge, to which the place of a crossing is rounded: an error of .002 spacings."""

NO_CROSSING = 255

SQUARE = 512.0
"""Squared distances are whole multiples of one over this, in sixteen bits: at a distance of 3 an error of .0002."""

FAR = 32000
"""Squared distance beyond the reach; no sum of it and a square of `MAX_REACH` overflows."""

AROUND = 2
"""The middle of thin solid is looked for so many nodes around each: as a distance falls by one from node to node."""

NEAR_MIDDLE = 1.0
"""Distance, in spacings, from the middle of thin solid within which nodes belong to it: some node is within .87."""

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

    def planes(self, start: int, stop: int) -> Crossed:
        """Some of the planes."""
        return Crossed(*(array[start:stop] for array in self))


def crossed(field: F32, other: F32 | None, threads: int = 1) -> Crossed:
    """The solid where a field, or another one, is negative; fields (n + 1, ny, nx), the result n planes.

    Each field crosses zero where it does linearly between the nodes, whatever its unit.
    """
    n, ny, nx = field.shape
    made = Crossed(*(np.empty((n - 1, ny, nx), np.uint8) for _ in range(4)))
    both = other is not None
    in_bands(lambda a, b: _cross(field, other if both else field, both, a, b, *made), n - 1, threads)
    return made


def core_field(solid: U8, depth: U16, within: U16, below: int, planes: int, radius: float, least: float, threads: int = 1) -> F32:
    """Field of the core, negative inside, (planes, ny, nx) in spacings: the places of the middles of balls.

    Those are where the ball fits into the solid (`depth`, squared distances from its surface) and into the domain
    (`within`, the same from the surface of that); and in solid that is thinner, the middle of it to within `NEAR_MIDDLE`
    spacings, if the largest ball there has at least the radius `least`. `AROUND` planes are needed below and above.
    """
    signed = np.empty(depth.shape, np.float32)
    in_bands(lambda a, b: _sign(solid[a:b].reshape(-1), depth[a:b].reshape(-1), signed[a:b].reshape(-1)), len(signed), threads)
    field = np.empty((planes, *depth.shape[1:]), np.float32)
    in_bands(lambda a, b: _core(signed, within, below, a, b, np.float32(radius), np.float32(least), field), planes, threads)
    return field


def in_planes(crossed: Crossed, reach: int, threads: int = 1) -> U16:
    """Squared distances of nodes from the nearest crossing of the same plane, (n, ny, nx) in parts of `SQUARE`.

    `FAR` where none is within the reach along each axis.
    """
    if not 0 < reach <= MAX_REACH:
        raise ValueError(f"squared distances are known up to {MAX_REACH} spacings, not {reach}")
    flat = np.empty(crossed.solid.shape, np.uint16)
    in_bands(lambda a, b: _in_planes(crossed.x, crossed.y, a, b, reach, flat), len(flat), threads)
    return flat


def across_planes(upright: U8, flat: U16, below: int, planes: int, reach: int, threads: int = 1) -> U16:
    """Squared distances of nodes in some planes from the nearest crossing, from those `in_planes`.

    `upright` are the crossings of edges along z.

    The first of the planes has `below` planes of crossings below it; those within the reach, or to the end of the grid,
    are needed below and above.
    """
    out = np.empty((planes, *flat.shape[1:]), np.uint16)
    in_bands(lambda a, b: _across_planes(flat, upright, below, a, b, reach, out), planes, threads)
    return out


def opened_field(core: U8, squares: U16, radius: float, reach: int, threads: int = 1) -> F32:
    """Field of what balls on a core cover, about a distance in spacings and negative inside, (n, ny, nx).

    `core` are the nodes of the core, `squares` the squared distances from its surface, within the reach.
    """
    field = np.empty(core.shape, np.float32)

    def work(a: int, b: int) -> None:
        some = (array[a:b].reshape(-1) for array in (core, squares, field))
        _field(*some, np.float32(radius), np.float32(reach))

    in_bands(work, len(field), threads)
    return field


@jit
def _cross(field: F32, other: F32, both: bool, start: int, stop: int, solid: U8, cx: U8, cy: U8, cz: U8) -> None:
    _, ny, nx = field.shape
    for k in range(start, stop):
        for j in range(ny):
            for i in range(nx):
                here = field[k, j, i] < 0 or (both and other[k, j, i] < 0)
                solid[k, j, i] = here
                for axis in range(3):
                    codes = cx if axis == 0 else cy if axis == 1 else cz
                    kk, jj, ii = k + (axis == 2), j + (axis == 1), i + (axis == 0)
                    codes[k, j, i] = NO_CROSSING
                    if jj == ny or ii == nx:
                        continue
                    there = field[kk, jj, ii] < 0 or (both and other[kk, jj, ii] < 0)
                    if here == there:
                        continue
                    # the way from the solid node to the void one; a union ends where the last of both does
                    ak, aj, ai, bk, bj, bi = (k, j, i, kk, jj, ii) if here else (kk, jj, ii, k, j, i)
                    share = np.float32(0.0)
                    if field[ak, aj, ai] < 0:
                        share = _share(field[ak, aj, ai], field[bk, bj, bi])
                    if both and other[ak, aj, ai] < 0:
                        share = max(share, _share(other[ak, aj, ai], other[bk, bj, bi]))
                    code = np.uint8(PARTS * share + np.float32(0.5))
                    codes[k, j, i] = code if here else np.uint8(PARTS) - code


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
    signed: F32, within: U16, below: int, start: int, stop: int, radius: np.float32, least: np.float32, field: F32
) -> None:
    _, ny, nx = signed.shape
    plane, rows = np.empty((ny, nx), np.float32), np.empty(nx, np.float32)
    most = np.empty(nx, np.float32)
    for own in range(start, stop):
        k = own + below
        for j in range(ny):
            plane[j] = signed[k, j]
            for other in range(k - AROUND, k + AROUND + 1):
                _raise(plane[j], signed[other, j])
        for j in range(ny):
            rows[:] = plane[j]
            for other in range(max(0, j - AROUND), min(ny, j + AROUND + 1)):
                _raise(rows, plane[other])
            most[:] = rows
            for step in range(1, AROUND + 1):
                _raise(most[step:], rows[: nx - step])
                _raise(most[: nx - step], rows[step:])
            _core_row(signed[k, j], most, within[k, j], radius, least, field[own, j])


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
def _spread_rows(plane: U16, reach: int, out: U16) -> None:
    """The pass along y."""
    ny = plane.shape[0]
    for j in range(ny):
        out[j] = plane[j]
        for other in range(max(0, j - reach), min(ny, j + reach + 1)):
            if other != j:
                _lower(out[j], plane[other], np.uint16(SQUARE * (other - j) * (other - j)))


@jit
def _spread_along(row: U16, reach: int, out: U16) -> None:
    """The pass along x; lowers `out`."""
    n = row.size
    _lower(out, row, np.uint16(0))
    for step in range(1, min(reach, n - 1) + 1):
        plus = np.uint16(SQUARE * step * step)
        _lower(out[step:], row[: n - step], plus)
        _lower(out[: n - step], row[step:], plus)


@jit
def _in_planes(cx: U8, cy: U8, start: int, stop: int, reach: int, flat: U16) -> None:
    """Squared distances from the crossings of the same plane."""
    _, ny, nx = cx.shape
    along, across = np.empty((ny, nx), np.uint16), np.empty((ny, nx), np.uint16)
    distance, row = np.empty(nx, np.int32), np.empty(nx, np.uint16)
    for k in range(start, stop):
        for j in range(ny):
            _row(cx[k, j], distance)
            _squares(distance, along[j])
        _spread_rows(along, reach, flat[k])
        distance[:] = 1 << 14
        for j in range(ny):
            if j:
                _step(cy[k, j - 1], True, distance)
            _squares(distance, across[j])
        distance[:] = 1 << 14
        for j in range(ny - 1, -1, -1):
            _step(cy[k, j], False, distance)
            _squares(distance, row)
            _lower(across[j], row, np.uint16(0))
        for j in range(ny):
            _spread_along(across[j], reach, flat[k, j])


@jit
def _across_planes(flat: U16, cz: U8, below: int, start: int, stop: int, reach: int, out: U16) -> None:
    """Squared distances from those in planes, and from crossings between planes."""
    n, ny, nx = flat.shape
    upright, spread = np.empty((ny, nx), np.uint16), np.empty((ny, nx), np.uint16)
    distance, row = np.empty(nx, np.int32), np.empty(nx, np.uint16)
    for own in range(start, stop):
        k = own + below
        for j in range(ny):
            distance[:] = 1 << 14
            for other in range(max(0, k - reach - 1), k):
                _step(cz[other, j], True, distance)
            _squares(distance, upright[j])
            distance[:] = 1 << 14
            for other in range(min(n - 1, k + reach), k - 1, -1):
                _step(cz[other, j], False, distance)
            _squares(distance, row)
            _lower(upright[j], row, np.uint16(0))
        _spread_rows(upright, reach, spread)
        for j in range(ny):
            target = out[own, j]
            target[:] = flat[k, j]
            for other in range(max(0, k - reach), min(n, k + reach + 1)):
                if other != k:
                    _lower(target, flat[other, j], np.uint16(SQUARE * (other - k) * (other - k)))
            _spread_along(spread[j], reach, target)


@inline_jit
def _field(core: U8, squares: U16, field: F32, radius: np.float32, reach: np.float32) -> None:
    for i in range(field.size):
        d = min(np.sqrt(np.float32(squares[i]) * np.float32(1 / SQUARE)), reach)
        field[i] = (-d if core[i] else d) - radius
