"""Pictures of sampled fields by rays: from each pixel through the field, within the triangles that bound the part.

Where a ray is inside the part is known from the triangles themselves: each pixel has a list of those that it may see
(an A-buffer; Carpenter 1984, "The A-buffer, an antialiased hidden surface method"). Rims, where the microstructure
meets the surface of the part, are therefore exact, which they are not on a mesh of the maximum of both fields. A pixel
has one ray; those on edges, of which a neighbor has another depth, normal or color, get eight more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
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
"""Steps along a ray, in spacings of the samples: a choice. A strut that is missed is thinner than a voxel."""

_NO_VALUES = np.empty((0, 0, 0), np.float32)
_FIELD, _DOMAIN, _SKIN, _SECTION = 0, 1, 2, 3

# Rays miss the middles of pixels by this, so that views along an axis do not run within faces or through corners.
_ASIDE = (3.1e-5, 1.7e-5)

# Eight places in a pixel of which no two share a row or column (a solution of the queens' problem), besides its middle.
_PLACES = (np.stack([np.arange(8), np.array([3, 6, 2, 7, 1, 4, 0, 5])], axis=1) + 0.5) / 8

_SAME_NORMAL = 0.85  # cosine; a choice
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
    faces: NDArray[np.int64]
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
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float64]
    places: NDArray[np.float64]
    starts: NDArray[np.int64]
    owners: NDArray[np.int32]
    axes: NDArray[np.float64]
    # target (3), distance, scale, column and row of the frame, then the plane: normal (3), place
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

    `starts` holds at p + 1 the number of triangles of pixel p, or where the list of pixel p has its next free place.
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
    left = (places[high, 0] - ax) * (y - ay) - (places[high, 1] - ay) * (x - ax) >= 0.0
    return left == (tail < head)


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
    return a + z * (c - a)


@jit
def _value(scene: _Scene, x: float, y: float, z: float) -> float:
    """Negative in the solid."""
    value = _trilinear(scene.field, x, y, z)
    if scene.skin.size > 0:
        value = min(value, _trilinear(scene.skin, x, y, z))
    if scene.outer.size > 0:
        value = max(value, _trilinear(scene.outer, x, y, z))
    return value


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
    scene: _Scene, pixel: int, x: float, y: float, depths: NDArray[np.float64], found: NDArray[np.int64]
) -> int:
    """The triangles that a ray pierces, the nearest one first; those that face away are found as -1 - f."""
    n = 0
    for place in range(scene.starts[pixel], scene.starts[pixel + 1]):
        f = np.int64(scene.owners[place])
        a, b, c = scene.faces[f, 0], scene.faces[f, 1], scene.faces[f, 2]
        side = _left(scene.places, a, b, x, y)
        if _left(scene.places, b, c, x, y) != side or _left(scene.places, c, a, x, y) != side or n == depths.size:
            continue
        ax, ay, an = scene.places[a, 0], scene.places[a, 1], scene.places[a, 2]
        bx, by = scene.places[b, 0] - ax, scene.places[b, 1] - ay
        cx, cy = scene.places[c, 0] - ax, scene.places[c, 1] - ay
        area = bx * cy - by * cx
        wb, wc = ((x - ax) * cy - (y - ay) * cx) / area, ((y - ay) * bx - (x - ax) * by) / area
        depth = an + wb * (scene.places[b, 2] - an) + wc * (scene.places[c, 2] - an)
        if scene.numbers[3] > 0.0:
            depth = scene.numbers[3] - 1.0 / depth
        s = n
        while s > 0 and depths[s - 1] < depth:
            depths[s], found[s] = depths[s - 1], found[s - 1]
            s -= 1
        # rows count downwards, so what is wound to the left in space turns to the right
        depths[s], found[s] = depth, -1 - f if side else f
        n += 1
    return n


@jit
def _ray(
    scene: _Scene,
    pixel: int,
    x: float,
    y: float,
    depths: NDArray[np.float64],
    found: NDArray[np.int64],
    flat: NDArray[np.float64],
    normal: NDArray[np.float64],
) -> tuple[float, int]:
    """Depth of the first solid along the ray through a point of the picture, and its color; normal in `normal`."""
    n = _crossings(scene, pixel, x, y, depths, found)
    if n == 0:
        return -np.inf, 0
    numbers, axes = scene.numbers, scene.axes
    right, up = (x - numbers[5]) / numbers[4], (numbers[6] - y) / numbers[4]
    # the point at depth d is at + d * along
    lean = 1.0 / numbers[3] if numbers[3] > 0.0 else 0.0
    sx, sy = right * axes[0, 0] + up * axes[1, 0], right * axes[0, 1] + up * axes[1, 1]
    sz = right * axes[0, 2] + up * axes[1, 2]
    at_x, at_y, at_z = numbers[0] + sx, numbers[1] + sy, numbers[2] + sz
    along_x, along_y, along_z = axes[2, 0] - lean * sx, axes[2, 1] - lean * sy, axes[2, 2] - lean * sz
    step = STEP / math.sqrt(along_x**2 + along_y**2 + along_z**2)
    # the section keeps the depths between these
    front, back = np.inf, -np.inf
    toward = numbers[7] * along_x + numbers[8] * along_y + numbers[9] * along_z
    ahead = numbers[10] - (numbers[7] * at_x + numbers[8] * at_y + numbers[9] * at_z)
    if toward > 0.0:
        front = ahead / toward
    elif toward < 0.0:
        back = ahead / toward
    elif ahead < 0.0:
        return -np.inf, 0
    winding = 0
    for s in range(n - 1):
        before = winding
        winding += 1 if found[s] >= 0 else -1
        if winding <= 0:
            continue
        d, end = depths[s], max(depths[s + 1], back)
        if end >= min(d, front):
            continue
        # shells may overlap; what begins within one is its microstructure
        kind, f = _DOMAIN if before <= 0 else _FIELD, found[s]
        if d > front:
            d, kind = front, _SECTION
        value = _value(scene, at_x + d * along_x, at_y + d * along_y, at_z + d * along_z)
        if not value < 0.0:
            kind = _FIELD
            while d > end:
                last, at_last = d, value
                d = max(d - step, end)
                value = _value(scene, at_x + d * along_x, at_y + d * along_y, at_z + d * along_z)
                if value < 0.0:
                    low, at_low = d, value
                    for _ in range(6):  # regula falsi, Illinois
                        d = low + (last - low) * at_low / (at_low - at_last)
                        value = _value(scene, at_x + d * along_x, at_y + d * along_y, at_z + d * along_z)
                        if value < 0.0:
                            low, at_low = d, value
                            at_last *= 0.5
                        else:
                            last, at_last = d, value
                            at_low *= 0.5
                    value = -1.0
                    break
            if not value < 0.0:
                continue
        px, py, pz = at_x + d * along_x, at_y + d * along_y, at_z + d * along_z
        color = kind
        if kind == _SECTION:
            for axis in range(3):
                normal[axis] = numbers[7 + axis]
        elif kind == _DOMAIN:
            a, b, c = scene.faces[f, 0], scene.faces[f, 1], scene.faces[f, 2]
            ax, ay = scene.places[a, 0], scene.places[a, 1]
            bx, by = scene.places[b, 0] - ax, scene.places[b, 1] - ay
            cx, cy = scene.places[c, 0] - ax, scene.places[c, 1] - ay
            area = bx * cy - by * cx
            wb, wc = ((x - ax) * cy - (y - ay) * cx) / area, ((y - ay) * bx - (x - ax) * by) / area
            normal_on(scene.vertices, scene.faces, scene.normals, f, wb, wc, True, flat, normal)
        if scene.skin.size > 0:
            inner, skin = _trilinear(scene.field, px, py, pz), _trilinear(scene.skin, px, py, pz)
            if skin < (inner if kind == _FIELD else 0.0):
                color = _SKIN
        if kind == _FIELD:
            if scene.outer.size > 0 and _trilinear(scene.outer, px, py, pz) > -1e-3:
                _slope(scene.outer, px, py, pz, normal)
                color = _SKIN if color == _SKIN else _DOMAIN
            else:
                _slope(scene.skin if color == _SKIN else scene.field, px, py, pz, normal)
        return d, color
    return -np.inf, 0


@jit
def _turned(scene: _Scene, normal: NDArray[np.float64], out: NDArray[np.float32]) -> None:
    """The normal in the frame right, up, towards the viewer."""
    for axis in range(3):
        out[axis] = normal[0] * scene.axes[axis, 0] + normal[1] * scene.axes[axis, 1] + normal[2] * scene.axes[axis, 2]


@jit
def _see(
    scene: _Scene,
    aside: tuple[float, float],
    depth: NDArray[np.float32],
    normal: NDArray[np.float32],
    color: NDArray[np.uint8],
    most: int,
    start: int,
    stop: int,
) -> None:
    """What the middles of the pixels of some rows show."""
    depths, found, flat, mean = np.empty(most), np.empty(most, np.int64), np.zeros(3), np.zeros(3)
    width = depth.shape[1]
    for r in range(start, stop):
        for c in range(width):
            d, kind = _ray(
                scene, r * width + c, c + 0.5 + aside[0], r + 0.5 + aside[1], depths, found, flat, mean
            )  # fmt: skip
            if d == -np.inf:
                continue
            depth[r, c] = d * scene.numbers[4]
            _turned(scene, mean, normal[r, c])
            for channel in range(3):
                color[r, c, channel] = scene.colors[kind, channel]


@jit
def _refine(
    scene: _Scene,
    offsets: NDArray[np.float64],
    edges: NDArray[np.bool_],
    depth: NDArray[np.float32],
    creases: NDArray[np.float32],
    pores: NDArray[np.float32],
    strength: np.float32,
    linear: NDArray[np.float32],
    light: NDArray[np.float32],
    most: int,
    start: int,
    stop: int,
) -> None:
    """Add the light of more rays where there are edges; what hides the sky is that of the pixel nearest in depth."""
    depths, found, flat, mean = np.empty(most), np.empty(most, np.int64), np.zeros(3), np.zeros(3)
    turned = np.zeros(3, np.float32)
    height, width = depth.shape
    share = np.float32(1.0 / (offsets.shape[0] + 1))
    for r in range(start, stop):
        for c in range(width):
            if not edges[r, c]:
                continue
            for s in range(offsets.shape[0]):
                d, kind = _ray(
                    scene, r * width + c, c + offsets[s, 0], r + offsets[s, 1], depths, found, flat, mean
                )  # fmt: skip
                if d == -np.inf:
                    continue
                _turned(scene, mean, turned)
                near = np.inf
                crease, pore = np.float32(0.0), np.float32(0.0)
                for rr in range(max(r - 1, 0), min(r + 2, height)):
                    for cc in range(max(c - 1, 0), min(c + 2, width)):
                        gap = abs(depth[rr, cc] - d * scene.numbers[4])
                        if gap < near:
                            near = gap
                            crease, pore = creases[rr, cc], pores[rr, cc]
                red, green, blue = light_of(
                    turned[0], turned[1], turned[2], scene.colors[kind], crease, pore, strength, linear
                )  # fmt: skip
                light[r, c, 0] += red
                light[r, c, 1] += green
                light[r, c, 2] += blue
                light[r, c, 3] += np.float32(1.0)
            for channel in range(4):
                light[r, c, channel] *= share


def _edges(seen: Seen) -> NDArray[np.bool_]:
    """Pixels whose depth, normal or color jumps to a neighbor in their row or column."""
    edges = np.zeros(seen.depth.shape, np.bool_)
    there = np.isfinite(seen.depth)
    for axis in (0, 1):
        one = tuple(slice(None, -1) if a == axis else slice(None) for a in (0, 1))
        two = tuple(slice(1, None) if a == axis else slice(None) for a in (0, 1))
        both = there[one] & there[two]
        jump = there[one] != there[two]
        jump |= both & (seen.color[one] != seen.color[two]).any(2)
        m, n = seen.normal[one], seen.normal[two]
        jump |= both & (np.einsum("...i,...i", m, n) < np.float32(_SAME_NORMAL))
        # a neighbor in the plane of a sample: right is the first coordinate, and rows count downwards
        mean = m + n
        rise = mean[..., 0] if axis == 1 else -mean[..., 1]
        step = np.where(both, seen.depth[two], 0) - np.where(both, seen.depth[one], 0)
        room = np.float32(_SAME_DEPTH) * np.maximum(np.abs(mean[..., 2]), np.float32(0.2))
        jump |= both & (np.abs(step * mean[..., 2] + rise) > room)
        edges[one] |= jump
        edges[two] |= jump
    return edges


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
    scene, most = _scene(solid, frame, size, section, colors)
    seen = empty_seen(width, height)
    in_bands(partial(_see, scene, _ASIDE, *seen, most), height, threads)
    hidden = hidden_sky(seen, threads) if occlusion > 0.0 else Hidden(*(np.zeros_like(seen.depth),) * 2)
    light = lit(seen, hidden, occlusion)
    if antialias:
        offsets = _PLACES + _ASIDE
        in_bands(
            partial(
                _refine, scene, offsets, _edges(seen), seen.depth, *hidden, np.float32(occlusion), LINEAR, light, most
            ),
            height,
            threads,
        )  # fmt: skip
    return on_background(light, background)


def _scene(
    solid: Solid,
    frame: Frame,
    size: tuple[int, int],
    section: tuple[Sequence[float], float] | None,
    colors: Colors,
) -> tuple[_Scene, int]:
    """The scene, and the largest number of triangles that a ray may pierce."""
    width, height = size
    origin, h = np.array(solid.grid.origin), solid.grid.spacing[0]
    faces = np.ascontiguousarray(solid.faces, np.int64)
    places = projected(frame, np.ascontiguousarray(solid.vertices, np.float64))
    vertices = (solid.vertices - origin) / h
    starts = np.zeros(width * height + 1, np.int64)
    _overlaps(places, faces, width, height, starts, np.empty(0, np.int32))
    most = int(starts.max())
    np.cumsum(starts, out=starts)
    owners = np.empty(max(1, int(starts[-1])), np.int32)
    following = np.concatenate([starts[:1], starts[:-1]])
    _overlaps(places, faces, width, height, following, owners)
    # lengths of the frame in spacings; nearness becomes the reciprocal of such a length
    places[:, 2] *= h if frame.distance > 0.0 else 1 / h
    normal, place = section or ((0.0, 0.0, 0.0), 0.0)
    target = (np.asarray(frame.target) - origin) / h
    cut = (place - float(np.dot(normal, origin))) / h
    numbers = [*target, frame.distance / h, frame.scale * h, frame.column, frame.row, *normal, cut]
    scene = _Scene(
        solid.field, solid.skin, solid.outer, vertices, faces, vertex_normals(vertices, faces), places, starts, owners,
        np.asarray(frame.axes), np.array(numbers, np.float64), np.array(colors, np.uint8),
    )  # fmt: skip
    return scene, most
