"""Pictures of sampled fields by rays: from each pixel through the field, within the triangles that bound the part.

Where a ray is inside the part is known from the triangles themselves. Rims, where the microstructure meets the surface
of the part, are therefore exact, which they are not on a mesh of the maximum of both fields. A pixel has one ray;
those on edges, of which a neighbor has another depth, normal or color, get eight more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.tiling.lattice import dilated
from sppm_pipeline.services.arrays import F32, F64, I64, U8, Bools
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.pictures.camera import Frame, projected
from sppm_pipeline.services.pictures.mesh_view import vertex_normals
from sppm_pipeline.services.pictures.rays import RayScene, list_overlaps, trace
from sppm_pipeline.services.pictures.shading import (
    BONE,
    CUT,
    LINEAR,
    MATERIALS,
    OWN,
    SKIN,
    Background,
    Color,
    Hidden,
    Material,
    Seen,
    add_light,
    empty_seen,
    finish_of,
    hidden_sky,
    lit,
    on_background,
    on_ground,
    shaded,
)
from sppm_pipeline.services.threads import in_bands

_BATCH = 2**15  # pixels that are traced at a time
_BAND = 64  # rows
_FAR = 3  # blocks without solid around one that are looked for

_NO_VALUES = np.empty((0, 0, 0), np.float32)

# Rays miss the middles of pixels by this, so that views along an axis do not run within faces or through corners.
_ASIDE = (3.1e-5, 1.7e-5)

# Eight places in a pixel of which no two share a row or column (a solution of the queens' problem), besides its middle.
_PLACES = (np.stack([np.arange(8), np.array([3, 6, 2, 7, 1, 4, 0, 5])], axis=1) + 0.5) / 8

_SAME_NORMAL = 0.85  # cosine (32 degrees); smaller values leave steps on edges, larger ones refine smooth surfaces, too
_FLAT = np.float32(0.2)  # cosine; surfaces seen at a smaller angle are as good as steep
_SAME_DEPTH = 0.75  # pixels off the plane of a sample up to which a neighbor is of the same surface


class Solid(NamedTuple):
    """Solid: negative samples (nz, ny, nx) within a mesh."""

    grid: Grid  # of the samples, all spacings equal
    vertices: F64  # (n, 3), of the mesh, in the unit of the grid
    faces: NDArray[np.integer]  # (m, 3); they bound the part, wound outwards
    field: F32  # negative in the solid of the microstructure
    skin: F32 = _NO_VALUES  # negative in the skin, which is united with the microstructure
    # positive outside of a part whose triangles do not bound it; the mesh is then something around it
    outer: F32 = _NO_VALUES


Plane = tuple[Sequence[float], float]
"""The unit vector towards what is left out, where the viewer is, and the distance along it from the origin."""


class Colors(NamedTuple):
    """Colors of the microstructure's surface, the surface of the part, the skin, and the section plane."""

    field: Color = BONE
    domain: Color = OWN
    skin: Color = SKIN
    section: Color = CUT


COLORS = Colors()


def _traced(scene: RayScene, pixels: I64, offsets: F64, threads: int) -> Iterator[tuple[I64, Seen]]:
    """Some of the pixels at a time, and what rays through some places of each see, (pixels, places)."""
    for start in range(0, len(pixels), _BATCH):
        some = pixels[start : start + _BATCH]
        shape = len(some), len(offsets)
        found = empty_seen(shape[1], shape[0])
        in_bands(partial(trace, scene, some, offsets, *found), len(some), threads)
        yield some, found


def _edges(seen: Seen) -> I64:
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
    solid: Solid, frame: Frame, size: tuple[int, int], *, section: Sequence[Plane] = (), colors: Colors = COLORS,
    occlusion: float = 1.0, background: Background = "light", antialias: bool = True,
    material: Material = MATERIALS["bone"], shadow: bool = False, threads: int = 1,
) -> U8:  # fmt: skip
    """Picture (height, width, 3) uint8 (sRGB) of a solid, with the opacity as a fourth channel if the background is
    transparent.

    `frame` is the camera, pointed at the solid for a picture of this `size` (width, height). What is beyond all planes
    of `section`, one or two, is left out. `occlusion` is the strength of the darkening of pores and creases; 0 leaves
    it out. The `background` is "light" or "dark", which are gradients, "transparent", or one color. With `antialias`
    pixels on edges get eight rays more; with `shadow` the part casts soft shadows on itself and on the ground, and what
    is far is darker.
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
    if shadow:
        hidden = hidden._replace(pores=1 - (1 - hidden.pores) * (1 - np.float32(0.5) * shaded(seen, threads)))
    light = lit(seen, hidden, occlusion, material=material)
    if antialias:
        strength, finish = np.float32(occlusion), finish_of(material)
        for pixels, more in _traced(scene, _edges(seen), _PLACES + _ASIDE, threads):
            add = partial(add_light, pixels, *more, seen.depth, *hidden, strength, LINEAR, finish, light)
            in_bands(add, len(pixels), threads)
    if shadow:
        on_ground(seen, frame, light)
    return on_background(light, background)


def _scene(solid: Solid, frame: Frame, size: tuple[int, int], section: Sequence[Plane], colors: Colors) -> RayScene:
    width, height = size
    origin, h = np.array(solid.grid.origin), solid.grid.spacing[0]
    faces = np.ascontiguousarray(solid.faces, np.int64)
    places = projected(frame, np.ascontiguousarray(solid.vertices, np.float64))
    vertices = (solid.vertices - origin) / h
    starts = np.zeros(width * height + 2, np.int64)
    list_overlaps(places, faces, width, height, starts[1:], np.empty(0, np.int32))
    np.cumsum(starts, out=starts)
    owners = np.empty(max(1, int(starts[-1])), np.int32)
    list_overlaps(places, faces, width, height, starts, owners)
    # lengths of the frame in spacings; nearness becomes the reciprocal of such a length
    places[:, 2] *= h if frame.distance > 0.0 else 1 / h
    planes: list[float] = []
    for normal, place in [*section, *([((0.0, 0.0, 0.0), 0.0)] * 2)][:2]:
        planes += [*normal, (place - float(np.dot(normal, origin))) / h]
    target = (np.asarray(frame.target) - origin) / h
    numbers = [*target, frame.distance / h, frame.scale * h, frame.column, frame.row, *planes, len(section), width]
    return RayScene(
        solid.field, solid.skin, solid.outer, _void(solid), vertices, faces, vertex_normals(vertices, faces), places,
        starts, owners, np.asarray(frame.axes), np.array(numbers, np.float64), np.array(colors, np.uint8),
    )  # fmt: skip


def _void(solid: Solid) -> U8:
    """Lower bound of the distance of each block, in blocks, to the next one that may hold solid; up to `_FAR`."""
    near = _in_blocks(solid.field < 0 if not solid.skin.size else (solid.field < 0) | (solid.skin < 0))
    if solid.outer.size:
        near &= _in_blocks(solid.outer < 0)
    # blocks are 2 x 2 x 2 cubes of samples; distances are the largest difference of indices, 0 is the block itself
    void = np.zeros(near.shape, np.uint8)
    for _ in range(_FAR):
        void += ~near
        near = dilated(near)
    return void


def _in_blocks(mask: Bools) -> Bools:
    """Blocks of 2 x 2 x 2 cubes with any of their 27 samples in the mask."""
    for axis in range(3):
        low = np.arange(0, max(1, mask.shape[axis] - 1), 2)
        ends = (np.minimum(low + step, mask.shape[axis] - 1) for step in range(3))
        first, second, third = (mask.take(end, axis) for end in ends)
        mask = first | second | third
    return mask
