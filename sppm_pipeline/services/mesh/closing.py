"""Closing of a surface at the border of the box: by a cap, or left open for the next periodic cell.

A field of n + 1 samples an edge whose opposite faces are equal (`wrapped`) gives, without a cap, a surface whose
opposite boundaries match vertex by vertex. `capped_marching_cubes` closes the solid with flat caps that lie exactly in
the border of the box.

How a cap is made: a layer of void around the samples makes the extractor close the surface just outside the box; the
vertices between sample and void layer are then moved into the border plane. The samples on an edge of the box have two
such vertices, those in a corner three; they are kept half an `EDGE_MARGIN` of a voxel away from the edge, each in its
own plane, so that no triangle loses its area. A solid box thereby gets bevels of 1/2048 voxel on its edges; its faces
are exact, and the mesh has the topology of the sampled solid. Where opposite faces have equal samples, the vertices of
the two caps match one by one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np

from sppm_pipeline.services.arrays import F32, F64, I64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_cubes import EDGE_MARGIN, Mesh, joined_mesh, marching_cubes_slabs

Border = Literal["samples", "voxels"]
Axes = tuple[bool, bool, bool]

_PLANES_AT_ONCE = 16  # small enough for a padded copy to stay in the cache, large enough for few calls


def wrapped(field: F32) -> F32:
    """Periodic samples (nz, ny, nx) with the first plane of each axis repeated: (nz + 1, ny + 1, nx + 1)."""
    nz, ny, nx = field.shape
    whole = np.empty((nz + 1, ny + 1, nx + 1), field.dtype)
    whole[:-1, :-1, :-1] = field
    whole[:-1, :-1, -1] = field[:, :, 0]
    whole[:-1, -1] = whole[:-1, 0]
    whole[-1] = whole[0]
    return whole


def capped_marching_cubes(
    field: F32,
    level: float = 0.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
    *,
    border: Border = "samples",
    axes: Axes = (True, True, True),
) -> Mesh:
    """Closed surface of the solid (below the level) in the box of a field (nz, ny, nx).

    The box ends at the outermost samples, for a grid of nodes, or with `border` "voxels" half a spacing further out,
    for a grid of voxel centers, whose outermost values then hold up to the border. Along axes (x, y, z) that are not to
    be capped the surface stays open and ends at the outermost samples; else it is a closed, oriented 2-manifold.
    """
    if np.ndim(field) != 3 or min(np.shape(field)) < 2:
        raise ValueError(f"marching cubes need at least 2 x 2 x 2 samples, not an array of shape {np.shape(field)}")
    slabs = (field[k : k + _PLANES_AT_ONCE] for k in range(0, field.shape[0], _PLANES_AT_ONCE))
    pieces = capped_marching_cubes_slabs(slabs, level, origin, spacing, border=border, axes=axes)
    return joined_mesh(pieces, lambda: _expected(field, level))


def _expected(field: F32, level: float) -> tuple[int, int]:
    """About how many vertices and faces the capped surface has, from where some of the planes change sign along x."""
    some = field[:: max(1, field.shape[0] // 12)] < np.float32(level)
    crossed = np.count_nonzero(some[:, :, 1:] != some[:, :, :-1]) + 4 * np.count_nonzero(
        some[:, :, :: field.shape[2] - 1]
    )
    # an isotropic surface crosses as many edges along y and z; a tenth more in reserve
    vertices = int(1.1 * 3 * crossed * field.shape[0] / len(some))
    # Euler: a closed surface of small genus has two triangles a vertex
    return vertices, 2 * vertices


def capped_marching_cubes_slabs(
    slabs: Iterable[F32],
    level: float = 0.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
    *,
    border: Border = "samples",
    axes: Axes = (True, True, True),
) -> Iterator[Mesh]:
    """`capped_marching_cubes` of a field that arrives as consecutive slabs of planes.

    Takes what `marching_cubes_slabs` takes and yields pieces like it, whose vertices and faces follow upon each other;
    a piece belongs to no particular slab. The bytes do not depend on how the field is cut.
    """
    if border not in ("samples", "voxels"):
        raise ValueError(f"border is 'samples' or 'voxels', not {border!r}")
    layers = 1 if border == "samples" else 2  # of void; of void and of repeated samples
    pad = np.where(axes, layers, 0)
    step = np.asarray(spacing, np.float64)
    # The sample positions that are to become the border, and the border itself.
    outermost = np.asarray(origin, np.float64) - (layers - 1) * step
    low = np.asarray(origin, np.float64) - (layers - 1) * step / 2
    counts = np.zeros(3, np.int64)  # samples seen so far along each axis
    complete = False

    def padded() -> Iterator[F32]:
        # The last plane of a slab is held back until it is known whether another follows, as the border passes there.
        nonlocal complete
        room = np.empty((0, 0, 0), np.float32)
        held = None
        for slab in slabs:
            if slab.shape[0] == 0:
                continue
            counts[:2] = slab.shape[2], slab.shape[1]
            counts[2] += slab.shape[0]
            ahead = held[None] if held is not None else slab[:0]
            before = int(pad[2]) if held is None else 0
            room = _void_around(room, ahead, slab[:-1], pad, layers, before, slab[0])
            held = slab[-1].copy()
            if room.shape[0]:
                yield room
        if held is not None:
            complete = True
            yield _void_around(room, held[None], held[None][:0], pad, layers, -int(pad[2]), held)

    start = tuple(float(value) for value in np.asarray(origin) - pad * step)
    capped = np.array(axes, np.bool_)
    for vertices, faces in marching_cubes_slabs(padded(), level, start, spacing):  # type: ignore[arg-type]
        high = low + (counts - 1 + (layers - 1)) * step
        last_sample = outermost + (counts - 1 + 2 * (layers - 1)) * step
        if not complete:
            high[2] = last_sample[2] = np.inf
        _move_to_border(vertices, capped, step, outermost, last_sample, low, high)
        yield vertices, faces


def _void_around(room: F32, ahead: F32, slab: F32, pad: I64, layers: int, outside: int, border: F32) -> F32:
    """The planes `ahead` and of a slab with (repeated samples and) void around them in x and y.

    `outside` planes of void, and of repeats of the plane `border`, come before them; if it is negative, after them.
    `room` is a former result, which is overwritten if it has the right size.
    """
    ny, nx = border.shape
    px, py = int(pad[0]), int(pad[1])
    repeated = layers - 1
    shape = (abs(outside) + ahead.shape[0] + slab.shape[0], ny + 2 * py, nx + 2 * px)
    padded = room if room.shape == shape else np.empty(shape, np.float32)
    # only the frame is void; x and y first, as the planes outside are overwritten as a whole
    padded[:, :py], padded[:, ny + py :] = np.inf, np.inf
    padded[:, :, :px], padded[:, :, nx + px :] = np.inf, np.inf
    inner = padded[:, py : py + ny, px : px + nx]
    first = max(outside, 0)
    inner[first : first + ahead.shape[0]] = ahead
    inner[first + ahead.shape[0] : shape[0] - max(-outside, 0)] = slab
    if outside and repeated:
        inner[first - 1 if outside > 0 else outside] = border
    if repeated and px:
        padded[:, py : py + ny, 1] = padded[:, py : py + ny, 2]
        padded[:, py : py + ny, -2] = padded[:, py : py + ny, -3]
    if repeated and py:
        padded[:, 1], padded[:, -2] = padded[:, 2], padded[:, -3]
    if outside:
        padded[0 if outside > 0 else -1] = np.inf
    return padded


@jit
def _move_to_border(vertices: F64, capped: Bools, step: F64, first: F64, last: F64, low: F64, high: F64) -> None:
    """Move vertices in or beyond the outermost planes of samples (first, last) into the border (low, high)."""
    # Vertices keep EDGE_MARGIN off the planes of samples unless they lie in them, so a quarter of it separates them.
    slack, inset = EDGE_MARGIN / 4, EDGE_MARGIN / 2
    for i in range(vertices.shape[0]):
        for axis in range(3):
            if not capped[axis]:
                continue
            value = vertices[i, axis]
            if value < first[axis] - slack * step[axis] or value > last[axis] + slack * step[axis]:
                for other in range(3):
                    if other != axis and capped[other]:
                        least, most = low[other] + inset * step[other], high[other] - inset * step[other]
                        vertices[i, other] = min(max(vertices[i, other], least), most)
        for axis in range(3):
            if capped[axis]:
                value = vertices[i, axis]
                if value < first[axis] + slack * step[axis]:
                    vertices[i, axis] = low[axis]
                elif value > last[axis] - slack * step[axis]:
                    vertices[i, axis] = high[axis]
