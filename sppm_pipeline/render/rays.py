"""Pictures of sampled fields by rays: from each pixel through the field, within the triangles that bound the part.

Where a ray is inside the part is known from the triangles themselves: each pixel has a list of those that it may see
(an A-buffer; Carpenter 1984, "The A-buffer, an antialiased hidden surface method"). Rims, where the microstructure
meets the surface of the part, are therefore exact, which they are not on a mesh of the maximum of both fields. A pixel
has one ray; those on edges, of which a neighbor has another depth, normal or color, get eight more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.connectivity.islands import grown
from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.threads import in_bands
from sppm_pipeline.render.camera import Frame, projected
from sppm_pipeline.render.mesh_view import normal_on, vertex_normals
from sppm_pipeline.render.shading import (
    BONE,
    CUT,
    LINEAR,
    SKIN,
    Background,
    Color,
    Hidden,
    Seen,
    empty_seen,
    hidden_sky,
    light_of,
    lit,
    on_background,
)

STEP = 0.6
"""Steps along a ray near the solid, in spacings of the samples: a choice. What is missed is thinner than a voxel."""

_BATCH = 2**15  # pixels that are traced at a time
_BAND = 64  # rows
_FAR = 3  # blocks without solid around one that are looked for
_BEHIND = 0.25  # spacings behind a surface at which it is told whose it is
_PAST = 1e-4  # spacings by which a ray enters the next block, so that rounding does not keep it where it is

_NO_VALUES = np.empty((0, 0, 0), np.float32)
_FIELD, _DOMAIN, _SKIN, _SECTION = 0, 1, 2, 3

# Rays miss the middles of pixels by this, so that views along an axis do not run within faces or through corners.
_ASIDE = (3.1e-5, 1.7e-5)

# Eight places in a pixel of which no two share a row or column (a solution of the queens' problem), besides its middle.
_PLACES = (np.stack([np.arange(8), np.array([3, 6, 2, 7, 1, 4, 0, 5])], axis=1) + 0.5) / 8

_SAME_NORMAL = 0.85  # cosine; a choice
_FLAT = np.float32(0.2)  # cosine; surfaces seen at a smaller angle are as good as steep
_SAME_DEPTH = 0.75  # pixels by which a neighbor may be off the plane of a sample; a choice


class Solid(NamedTuple):
    """What is solid: negative samples within a mesh.

    Attributes
    ----------
    grid : Grid
        Where the samples are; all spacings are equal.
    vertices : (n, 3) float64
        Of the mesh, in the unit of the grid.
    faces : (m, 3) int
        They bound the part, wound outwards.
    field : (nz, ny, nx) float32
        Negative in the solid of the microstructure.
    skin : (nz, ny, nx) float32, optional
        Negative in the skin, which is united with the microstructure.
    outer : (nz, ny, nx) float32, optional
        Positive outside of a part whose triangles do not bound it; the mesh is then something around it.
    """

    grid: Grid
    vertices: NDArray[np.float64]
    faces: NDArray[np.integer]
    field: NDArray[np.float32]
    skin: NDArray[np.float32] = _NO_VALUES
    outer: NDArray[np.float32] = _NO_VALUES


class Colors(NamedTuple):
    """Colors of the microstructure's surface, the surface of the part, the skin, and the section plane."""

    field: Color = BONE
    domain: Color = CUT
    skin: Color = SKIN
    section: Color = CUT


COLORS = Colors()


class _Scene(NamedTuple):
    """All that a ray needs; lengths in spacings of the samples, measured from the first one."""

    field: NDArray[np.float32]
    skin: NDArray[np.float32]
    outer: NDArray[np.float32]
    void: NDArray[np.uint8]
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float64]
    places: NDArray[np.float64]
    starts: NDArray[np.int64]
    owners: NDArray[np.int32]
    axes: NDArray[np.float64]
    # target (3), distance, scale, column and row of the frame, then the plane: normal (3), place;
    # and the width of the picture
    numbers: NDArray[np.float64]
    colors: NDArray[np.uint8]


@jit
def _overlaps(
    places: NDArray[np.float64],
    faces: NDArray[np.int64],
    width: int,
    height: int,
    starts: NDArray[np.int64],
    owners: NDArray[np.int32],
) -> None:
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
def _left(places: NDArray[np.float64], tail: int, head: int, x: float, y: float) -> bool:
    """Whether a point is to the left of an edge; the triangles at both sides of it get the same answer."""
    low, high = min(tail, head), max(tail, head)
    ax, ay = places[low, 0], places[low, 1]
    left: bool = (places[high, 0] - ax) * (y - ay) - (places[high, 1] - ay) * (x - ax) >= 0.0
    return left == (tail < head)


@jit
def _weights(places: NDArray[np.float64], a: int, b: int, c: int, x: float, y: float) -> tuple[float, float]:
    """Weights of the second and third corner of a triangle at a point of the picture."""
    ax, ay = places[a, 0], places[a, 1]
    bx, by = places[b, 0] - ax, places[b, 1] - ay
    cx, cy = places[c, 0] - ax, places[c, 1] - ay
    area = bx * cy - by * cx
    return ((x - ax) * cy - (y - ay) * cx) / area, ((y - ay) * bx - (x - ax) * by) / area


@jit
def _trilinear(values: NDArray[np.float32], x: float, y: float, z: float) -> float:
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
def _value(
    field: NDArray[np.float32], skin: NDArray[np.float32], outer: NDArray[np.float32], x: float, y: float, z: float
) -> float:
    """Negative in the solid."""
    value = _trilinear(field, x, y, z)
    if skin.size > 0:
        value = min(value, _trilinear(skin, x, y, z))
    if outer.size > 0:
        value = max(value, _trilinear(outer, x, y, z))
    return value


@jit
def _march(
    field: NDArray[np.float32],
    skin: NDArray[np.float32],
    outer: NDArray[np.float32],
    void: NDArray[np.uint8],
    line: NDArray[np.float64],
    begin: float,
    end: float,
) -> float:
    """Where the line `line[:3] + d * line[3:]` enters the solid, going back from d = `begin` to `end`; else -inf.

    Blocks without any solid are crossed at once.
    """
    nz, ny, nx = void.shape
    x, y, z, u, v, w = line[0], line[1], line[2], line[3], line[4], line[5]
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
    """How far a line that goes back has to go to leave the blocks less than `reach` away from block i, on one axis."""
    if along > 0.0:
        return (x - 2 * (i - reach + 1)) / along
    return (x - 2 * (i + reach)) / along if along < 0.0 else np.inf


@jit
def _slope(values: NDArray[np.float32], x: float, y: float, z: float, out: NDArray[np.float64]) -> None:
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
    places: NDArray[np.float64],
    faces: NDArray[np.int64],
    owners: NDArray[np.int32],
    first: int,
    last: int,
    x: float,
    y: float,
    depths: NDArray[np.float64],
    found: NDArray[np.int64],
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
def _trace(
    scene: _Scene,
    pixels: NDArray[np.int64],
    offsets: NDArray[np.float64],
    depth: NDArray[np.float32],
    normal: NDArray[np.float32],
    color: NDArray[np.uint8],
    start: int,
    stop: int,
) -> None:
    """What rays through some places of each pixel see; depth, normal and color are (pixels, places) as in `Seen`."""
    field, skin, outer, void, vertices, faces, normals, places, starts, owners, axes, numbers, colors = scene
    distance, scale = numbers[3], numbers[4]
    depths, found, line = np.empty(owners.size), np.empty(owners.size, np.int64), np.empty(6)
    flat, mean = np.zeros(3), np.zeros(3)
    width = np.int64(numbers[11])
    for p in range(start, stop):
        pixel = pixels[p]
        for place in range(offsets.shape[0]):
            x, y = pixel % width + offsets[place, 0], pixel // width + offsets[place, 1]
            n = _crossings(places, faces, owners, starts[pixel], starts[pixel + 1], x, y, depths, found)
            if n < 2:
                continue
            # the point at depth d is line[:3] + d * line[3:]
            right, up = (x - numbers[5]) / scale, (numbers[6] - y) / scale
            toward, ahead = 0.0, numbers[10]
            for axis in range(3):
                aside = right * axes[0, axis] + up * axes[1, axis]
                line[axis] = numbers[axis] + aside
                line[3 + axis] = axes[2, axis] - (aside / distance if distance > 0.0 else 0.0)
                toward += numbers[7 + axis] * line[3 + axis]
                ahead -= numbers[7 + axis] * line[axis]
            # the section keeps the depths between these
            front = ahead / toward if toward > 0.0 else np.inf
            back = ahead / toward if toward < 0.0 else -np.inf
            if toward == 0.0 and ahead < 0.0:
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
                        mean[axis] = numbers[7 + axis]
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


@jit
def _add_light(
    pixels: NDArray[np.int64],
    depths: NDArray[np.float32],
    normals: NDArray[np.float32],
    colors: NDArray[np.uint8],
    depth: NDArray[np.float32],
    creases: NDArray[np.float32],
    pores: NDArray[np.float32],
    strength: np.float32,
    linear: NDArray[np.float32],
    light: NDArray[np.float32],
    start: int,
    stop: int,
) -> None:
    """Add the light of more rays to some pixels; what hides the sky is that of the pixel nearest in depth."""
    height, width = depth.shape
    share = np.float32(1.0 / (depths.shape[1] + 1))
    for p in range(start, stop):
        r, c = pixels[p] // width, pixels[p] % width
        for s in range(depths.shape[1]):
            if depths[p, s] == -np.inf:
                continue
            near = np.inf
            crease, pore = np.float32(0.0), np.float32(0.0)
            for rr in range(max(r - 1, 0), min(r + 2, height)):
                for cc in range(max(c - 1, 0), min(c + 2, width)):
                    gap = abs(depth[rr, cc] - depths[p, s])
                    if gap < near:
                        near = gap
                        crease, pore = creases[rr, cc], pores[rr, cc]
            red, green, blue = light_of(
                normals[p, s, 0], normals[p, s, 1], normals[p, s, 2], colors[p, s], crease, pore, strength, linear
            )  # fmt: skip
            light[r, c, 0] += red
            light[r, c, 1] += green
            light[r, c, 2] += blue
            light[r, c, 3] += np.float32(1.0)
        for channel in range(4):
            light[r, c, channel] *= share


def _traced(
    scene: _Scene, pixels: NDArray[np.int64], offsets: NDArray[np.float64], threads: int
) -> Iterator[tuple[NDArray[np.int64], Seen]]:
    """Some of the pixels at a time, and what rays through some places of each see, (pixels, places)."""
    for start in range(0, len(pixels), _BATCH):
        some = pixels[start : start + _BATCH]
        shape = len(some), len(offsets)
        found = empty_seen(shape[1], shape[0])
        in_bands(partial(_trace, scene, some, offsets, *found), len(some), threads)
        yield some, found


def _edges(seen: Seen) -> NDArray[np.int64]:
    """Pixels whose depth, normal or color jumps to a neighbor in their row or column, by number."""
    edges = np.zeros(seen.depth.shape, np.bool_)
    for start in range(0, len(edges), _BAND):  # a band at a time, for memory
        rows = slice(max(0, start - 1), start + _BAND)
        depth, normal, color = seen.depth[rows], seen.normal[rows], seen.color[rows]
        there = np.isfinite(depth)
        for axis in (0, 1):
            one = tuple(slice(None, -1) if a == axis else slice(None) for a in (0, 1))
            two = tuple(slice(1, None) if a == axis else slice(None) for a in (0, 1))
            both = there[one] & there[two]
            jump = there[one] != there[two]
            jump |= both & (color[one] != color[two]).any(2)
            m, n = normal[one], normal[two]
            jump |= both & (np.einsum("...i,...i", m, n) < np.float32(_SAME_NORMAL))
            # a neighbor in the plane of a sample: right is the first coordinate, and rows count downwards
            toward = m[..., 2] + n[..., 2]
            rise = m[..., 0] + n[..., 0] if axis == 1 else -m[..., 1] - n[..., 1]
            step = np.where(both, depth[two], 0) - np.where(both, depth[one], 0)
            jump |= both & (np.abs(step * toward + rise) > np.float32(_SAME_DEPTH) * np.maximum(np.abs(toward), _FLAT))
            edges[rows][one] |= jump
            edges[rows][two] |= jump
    return np.flatnonzero(edges)


def render_solid(
    solid: Solid,
    frame: Frame,
    size: tuple[int, int],
    *,
    section: tuple[Sequence[float], float] | None = None,
    colors: Colors = COLORS,
    occlusion: float = 1.0,
    background: Background = "light",
    antialias: bool = True,
    threads: int = 1,
) -> NDArray[np.uint8]:
    """Picture of a solid.

    Parameters
    ----------
    solid : Solid
    frame : Frame
        The camera, pointed at the solid for a picture of this size.
    size : (width, height)
        In pixels.
    section : (normal, place), optional
        A plane, as the unit vector towards what is left out and its distance along that from the origin; the viewer is
        on that side.
    colors : Colors
    occlusion : float
        Strength of the darkening of pores and creases; 0 leaves it out.
    background : Background
        "light" or "dark", which are gradients, "transparent", or one color.
    antialias : bool
        Whether pixels on edges get eight rays more.
    threads : int

    Returns
    -------
    (height, width, 3) uint8
        The picture (sRGB); with a fourth channel, the opacity, if the background is transparent.
    """
    width, height = size
    scene = _scene(solid, frame, size, section, colors)
    seen = empty_seen(width, height)
    middle = np.array([[0.5, 0.5]]) + _ASIDE
    for pixels, found in _traced(scene, np.flatnonzero(np.diff(scene.starts)), middle, threads):
        rows, columns = np.divmod(pixels, width)
        seen.depth[rows, columns] = found.depth[:, 0]
        seen.normal[rows, columns] = found.normal[:, 0]
        seen.color[rows, columns] = found.color[:, 0]
    hidden = hidden_sky(seen, threads) if occlusion > 0.0 else Hidden(*(np.zeros_like(seen.depth),) * 2)
    light = lit(seen, hidden, occlusion)
    if antialias:
        strength = np.float32(occlusion)
        for pixels, more in _traced(scene, _edges(seen), _PLACES + _ASIDE, threads):
            add = partial(_add_light, pixels, *more, seen.depth, *hidden, strength, LINEAR, light)
            in_bands(add, len(pixels), threads)
    return on_background(light, background)


def _scene(
    solid: Solid,
    frame: Frame,
    size: tuple[int, int],
    section: tuple[Sequence[float], float] | None,
    colors: Colors,
) -> _Scene:
    width, height = size
    origin, h = np.array(solid.grid.origin), solid.grid.spacing[0]
    faces = np.ascontiguousarray(solid.faces, np.int64)
    places = projected(frame, np.ascontiguousarray(solid.vertices, np.float64))
    vertices = (solid.vertices - origin) / h
    starts = np.zeros(width * height + 2, np.int64)
    _overlaps(places, faces, width, height, starts[1:], np.empty(0, np.int32))
    np.cumsum(starts, out=starts)
    owners = np.empty(max(1, int(starts[-1])), np.int32)
    _overlaps(places, faces, width, height, starts, owners)
    # lengths of the frame in spacings; nearness becomes the reciprocal of such a length
    places[:, 2] *= h if frame.distance > 0.0 else 1 / h
    normal, place = section or ((0.0, 0.0, 0.0), 0.0)
    target = (np.asarray(frame.target) - origin) / h
    cut = (place - float(np.dot(normal, origin))) / h
    numbers = [*target, frame.distance / h, frame.scale * h, frame.column, frame.row, *normal, cut, width]
    return _Scene(
        solid.field, solid.skin, solid.outer, _void(solid), vertices, faces, vertex_normals(vertices, faces), places,
        starts, owners, np.asarray(frame.axes), np.array(numbers, np.float64), np.array(colors, np.uint8),
    )  # fmt: skip


def _void(solid: Solid) -> NDArray[np.uint8]:
    """How many blocks away from each block, at least, the next one is that may hold some solid; up to `_FAR`.

    Blocks are 2 x 2 x 2 cubes of samples; distances are the largest difference of indices, 0 is the block itself.
    """
    near = _in_blocks(solid.field < 0 if not solid.skin.size else (solid.field < 0) | (solid.skin < 0))
    if solid.outer.size:
        near &= _in_blocks(solid.outer < 0)
    void = np.zeros(near.shape, np.uint8)
    for _ in range(_FAR):
        void += ~near
        near = grown(near)
    return void


def _in_blocks(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Blocks of 2 x 2 x 2 cubes with any of their 27 samples in the mask."""
    for axis in range(3):
        low = np.arange(0, max(1, mask.shape[axis] - 1), 2)
        ends = (np.minimum(low + step, mask.shape[axis] - 1) for step in range(3))
        first, second, third = (mask.take(end, axis) for end in ends)
        mask = first | second | third
    return mask
