"""Rays through sampled fields within triangles that bound a part: the kernels.

Each pixel has a list of the triangles that it may see (an A-buffer; Carpenter 1984, "The A-buffer, an antialiased
hidden surface method"). A ray is inside the part between those that it pierces, and marches there through the samples.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F32, F64, I32, I64, U8
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.pictures.mesh_view import normal_on

STEP = 0.6
"""Steps along a ray near the solid, in spacings of the samples: they miss only what is thinner than a voxel. Half of it
doubles the time."""

_BEHIND = 0.25  # spacings behind a surface at which its owner is looked up
_PAST = 1e-4  # spacings by which a ray enters the next block, so that rounding does not keep it where it is
_FIELD, _DOMAIN, _SKIN, _SECTION = 0, 1, 2, 3


class RayScene(NamedTuple):
    """All that a ray needs; lengths in spacings of the samples, measured from the first one."""

    field: F32
    skin: F32
    outer: F32
    void: U8
    vertices: F64
    faces: I64
    normals: F64
    places: F64
    starts: I64
    owners: I32
    axes: F64
    # target (3), distance, scale, column and row of the frame, then two planes: normal (3), place of each; how many of
    # them there are, and the width of the picture
    numbers: F64
    colors: U8


@jit
def list_overlaps(places: F64, faces: I64, width: int, height: int, starts: I64, owners: I32) -> None:
    """List for each pixel the triangles that may cover some of it; with no room for owners, count them only.

    `starts` holds at p + 1 the number of triangles of pixel p, or where the list of pixel p has its next free place,
    which is in the end where the list of pixel p + 1 begins.
    """
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay = places[a, 0], places[a, 1]
        bx, by = places[b, 0], places[b, 1]
        cx, cy = places[c, 0], places[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        if area < 0.0:
            bx, by, cx, cy = cx, cy, bx, by
        first_column, last_column = max(math.floor(min(ax, bx, cx)), 0), min(math.floor(max(ax, bx, cx)), width - 1)
        first_row, last_row = max(math.floor(min(ay, by, cy)), 0), min(math.floor(max(ay, by, cy)), height - 1)
        # twice the areas to the left of the sides, at most, in a pixel whose middle has the value without the last term
        pu, pv = -(by - ay), bx - ax
        qu, qv = -(cy - by), cx - bx
        ru, rv = -(ay - cy), ax - cx
        p0 = -pu * ax - pv * ay + 0.5 * (abs(pu) + abs(pv))
        q0 = -qu * bx - qv * by + 0.5 * (abs(qu) + abs(qv))
        r0 = -ru * cx - rv * cy + 0.5 * (abs(ru) + abs(rv))
        for row in range(first_row, last_row + 1):
            y = row + 0.5
            for column in range(first_column, last_column + 1):
                x = column + 0.5
                if p0 + pu * x + pv * y >= 0.0 and q0 + qu * x + qv * y >= 0.0 and r0 + ru * x + rv * y >= 0.0:
                    pixel = row * width + column
                    if owners.size > 0:
                        owners[starts[pixel + 1]] = f
                    starts[pixel + 1] += 1


@jit
def _left(places: F64, tail: int, head: int, x: float, y: float) -> bool:
    """Test whether a point is to the left of an edge; the triangles at both sides of it get the same answer."""
    low, high = min(tail, head), max(tail, head)
    ax, ay = places[low, 0], places[low, 1]
    left: bool = (places[high, 0] - ax) * (y - ay) - (places[high, 1] - ay) * (x - ax) >= 0.0
    return left == (tail < head)


@jit
def _weights(places: F64, a: int, b: int, c: int, x: float, y: float) -> tuple[float, float]:
    """Weights of the second and third corner of a triangle at a point of the picture."""
    ax, ay = places[a, 0], places[a, 1]
    bx, by = places[b, 0] - ax, places[b, 1] - ay
    cx, cy = places[c, 0] - ax, places[c, 1] - ay
    area = bx * cy - by * cx
    return ((x - ax) * cy - (y - ay) * cx) / area, ((y - ay) * bx - (x - ax) * by) / area


@jit
def _trilinear(values: F32, x: float, y: float, z: float) -> float:
    """Interpolated sample; the border is continued."""
    nz, ny, nx = values.shape
    x, y, z = min(max(x, 0.0), nx - 1.0), min(max(y, 0.0), ny - 1.0), min(max(z, 0.0), nz - 1.0)
    i, j, k = min(int(x), nx - 2), min(int(y), ny - 2), min(int(z), nz - 2)
    x, y, z = x - i, y - j, z - k
    a = values[k, j, i] + x * (values[k, j, i + 1] - values[k, j, i])
    b = values[k, j + 1, i] + x * (values[k, j + 1, i + 1] - values[k, j + 1, i])
    c = values[k + 1, j, i] + x * (values[k + 1, j, i + 1] - values[k + 1, j, i])
    d = values[k + 1, j + 1, i] + x * (values[k + 1, j + 1, i + 1] - values[k + 1, j + 1, i])
    a += y * (b - a)
    c += y * (d - c)
    value: float = a + z * (c - a)
    return value


@jit
def _value(field: F32, skin: F32, outer: F32, x: float, y: float, z: float) -> float:
    """Negative in the solid."""
    value = _trilinear(field, x, y, z)
    if skin.size > 0:
        value = min(value, _trilinear(skin, x, y, z))
    if outer.size > 0:
        value = max(value, _trilinear(outer, x, y, z))
    return value


@jit
def _march(field: F32, skin: F32, outer: F32, void: U8, line: F64, begin: float, end: float) -> float:
    """The d at which the line `line[:3] + d * line[3:]` enters the solid, back from `begin` to `end`; -inf if nowhere.

    Blocks without any solid are crossed at once.
    """
    nz, ny, nx = void.shape
    x, y, z, u, v, w = line[0], line[1], line[2], line[3], line[4], line[5]
    # d is measured along the view, the step along the ray
    step = STEP / math.sqrt(u * u + v * v + w * w)
    d, last, at_last = begin, begin, -1.0
    while True:
        px, py, pz = x + d * u, y + d * v, z + d * w
        i = min(max(int(0.5 * px), 0), nx - 1)
        j = min(max(int(0.5 * py), 0), ny - 1)
        k = min(max(int(0.5 * pz), 0), nz - 1)
        reach = void[k, j, i]
        if reach > 0:
            d -= max(min(_way_out(px, u, i, reach), _way_out(py, v, j, reach), _way_out(pz, w, k, reach)), 0.0) + _PAST
            at_last = -1.0
            if d < end:
                return -np.inf
            continue
        value = _value(field, skin, outer, px, py, pz)
        if value < 0.0:
            if at_last < 0.0:  # at the beginning, or where a block of void ends
                return d
            low, at_low = d, value
            for _ in range(4):  # regula falsi, Illinois
                d = low + (last - low) * at_low / (at_low - at_last)
                value = _value(field, skin, outer, x + d * u, y + d * v, z + d * w)
                if value < 0.0:
                    low, at_low = d, value
                    at_last *= 0.5
                else:
                    last, at_last = d, value
                    at_low *= 0.5
            return d
        if d == end:
            return -np.inf
        last, at_last = d, value
        d = max(d - step, end)


@jit
def _way_out(x: float, along: float, i: int, reach: int) -> float:
    """Distance that a line going back needs to leave the blocks less than `reach` away from block i, on one axis."""
    if along > 0.0:
        return (x - 2 * (i - reach + 1)) / along
    return (x - 2 * (i + reach)) / along if along < 0.0 else np.inf


@jit
def _slope(values: F32, x: float, y: float, z: float, out: F64) -> None:
    """Unit normal of a level set, from differences over two spacings."""
    out[0] = _trilinear(values, x + 1.0, y, z) - _trilinear(values, x - 1.0, y, z)
    out[1] = _trilinear(values, x, y + 1.0, z) - _trilinear(values, x, y - 1.0, z)
    out[2] = _trilinear(values, x, y, z + 1.0) - _trilinear(values, x, y, z - 1.0)
    length = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    if length > 0.0:
        for axis in range(3):
            out[axis] /= length


@jit
def _crossings(
    places: F64, faces: I64, owners: I32, first: int, last: int, x: float, y: float, depths: F64, found: I64
) -> int:
    """The listed triangles that a ray pierces, the nearest one first; those that face away are found as -1 - f."""
    n = 0
    for place in range(first, last):
        f = np.int64(owners[place])
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        side = _left(places, a, b, x, y)
        if _left(places, b, c, x, y) != side or _left(places, c, a, x, y) != side:
            continue
        wb, wc = _weights(places, a, b, c, x, y)
        near = places[a, 2] + wb * (places[b, 2] - places[a, 2]) + wc * (places[c, 2] - places[a, 2])
        s = n
        while s > 0 and depths[s - 1] < near:
            depths[s], found[s] = depths[s - 1], found[s - 1]
            s -= 1
        # rows count downwards, so what is wound to the left in space turns to the right
        depths[s], found[s] = near, -1 - f if side else f
        n += 1
    return n


@jit
def trace(
    scene: RayScene, pixels: I64, offsets: F64, depth: F32, normal: F32, color: U8, start: int, stop: int
) -> None:
    """Surfaces hit by rays through places of each pixel; depth, normal and color are (pixels, places) as in `Seen`."""
    field, skin, outer, void, vertices, faces, normals, places, starts, owners, axes, numbers, colors = scene
    distance, scale = numbers[3], numbers[4]
    depths, found, line = np.empty(owners.size), np.empty(owners.size, np.int64), np.empty(6)
    flat, mean = np.zeros(3), np.zeros(3)
    width, planes = np.int64(numbers[16]), np.int64(numbers[15])
    for p in range(start, stop):
        pixel = pixels[p]
        for place in range(offsets.shape[0]):
            x, y = pixel % width + offsets[place, 0], pixel // width + offsets[place, 1]
            n = _crossings(places, faces, owners, starts[pixel], starts[pixel + 1], x, y, depths, found)
            if n < 2:
                continue
            # the point at depth d is line[:3] + d * line[3:]
            right, up = (x - numbers[5]) / scale, (numbers[6] - y) / scale
            toward, ahead, other, beyond = 0.0, numbers[10], 0.0, numbers[14]
            for axis in range(3):
                aside = right * axes[0, axis] + up * axes[1, axis]
                line[axis] = numbers[axis] + aside
                line[3 + axis] = axes[2, axis] - (aside / distance if distance > 0.0 else 0.0)
                toward += numbers[7 + axis] * line[3 + axis]
                ahead -= numbers[7 + axis] * line[axis]
                other += numbers[11 + axis] * line[3 + axis]
                beyond -= numbers[11 + axis] * line[axis]
            # the section keeps the depths between these
            front = ahead / toward if toward > 0.0 else np.inf
            back = ahead / toward if toward < 0.0 else -np.inf
            cut = 7
            if planes == 2:  # what is beyond both is left out, and both face the viewer
                first_end = front if toward > 0.0 else np.inf if ahead >= 0.0 else -np.inf
                second_end = beyond / other if other > 0.0 else np.inf if beyond >= 0.0 else -np.inf
                front, back = max(first_end, second_end), -np.inf
                cut = 7 if first_end > second_end else 11
            if front == -np.inf or (planes == 1 and toward == 0.0 and ahead < 0.0):
                continue
            winding, entry, f = 0, 0.0, int(np.int64(0))
            for s in range(n - 1):
                before = winding
                winding += 1 if found[s] >= 0 else -1
                if winding <= 0:
                    continue
                d, end = depths[s], depths[s + 1]
                if distance > 0.0:
                    d, end = distance - 1.0 / d, distance - 1.0 / end
                if before <= 0:
                    entry, f = d, int(found[s])
                end = max(end, back)
                if end >= min(d, front):
                    continue
                # shells may overlap: what begins within one is its microstructure, unless they begin together
                kind = _DOMAIN if d > entry - _PAST else _FIELD
                if d > front:
                    d, kind = front, _SECTION
                begin, d = d, _march(field, skin, outer, void, line, d, end)
                if d == -np.inf:
                    continue
                if d != begin:
                    kind = _FIELD
                px, py, pz = line[0] + d * line[3], line[1] + d * line[4], line[2] + d * line[5]
                shown = kind
                if skin.size > 0:
                    # a little behind the surface, as the skin's field and the other one have different units
                    qx, qy, qz = px - _BEHIND * line[3], py - _BEHIND * line[4], pz - _BEHIND * line[5]
                    at_most = min(_trilinear(field, qx, qy, qz), 0.0) if kind == _FIELD else 0.0
                    if _trilinear(skin, qx, qy, qz) < at_most:
                        shown = _SKIN
                if kind == _SECTION:
                    for axis in range(3):
                        mean[axis] = numbers[cut + axis]
                elif kind == _DOMAIN:
                    wb, wc = _weights(places, faces[f, 0], faces[f, 1], faces[f, 2], x, y)
                    normal_on(vertices, faces, normals, f, wb, wc, True, flat, mean)
                elif outer.size > 0 and _trilinear(outer, px, py, pz) > -1e-3:
                    _slope(outer, px, py, pz, mean)
                    shown = _SKIN if shown == _SKIN else _DOMAIN
                else:
                    _slope(skin if shown == _SKIN else field, px, py, pz, mean)
                depth[p, place] = d * scale
                for axis in range(3):
                    normal[p, place, axis] = mean[0] * axes[axis, 0] + mean[1] * axes[axis, 1] + mean[2] * axes[axis, 2]
                    color[p, place, axis] = colors[shown, axis]
                break
