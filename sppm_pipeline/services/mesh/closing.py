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

import numpy as np

from sppm_pipeline.services.arrays import F32, F64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_cubes import EDGE_MARGIN, Mesh, joined_mesh, marching_cubes_slabs

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
) -> Mesh:
    """Closed, oriented surface of the solid (below the level) in the box of a field (nz, ny, nx), which ends at the
    outermost samples.
    """
    if np.ndim(field) != 3 or min(np.shape(field)) < 2:
        raise ValueError(f"marching cubes need at least 2 x 2 x 2 samples, not an array of shape {np.shape(field)}")
    slabs = (field[k : k + _PLANES_AT_ONCE] for k in range(0, field.shape[0], _PLANES_AT_ONCE))
    pieces = capped_marching_cubes_slabs(slabs, level, origin, spacing)
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
) -> Iterator[Mesh]:
    """`capped_marching_cubes` of a field that arrives as consecutive slabs of planes.

    Takes what `marching_cubes_slabs` takes and yields pieces like it, whose vertices and faces follow upon each other;
    a piece belongs to no particular slab. The bytes do not depend on how the field is cut.
    """
    step, low = np.asarray(spacing, np.float64), np.asarray(origin, np.float64)
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
            ahead = slab[:0] if held is None else held[None]
            room = _void_around(room, ahead, slab[:-1], 1 if held is None else 0)
            held = slab[-1].copy()
            if room.shape[0]:
                yield room
        if held is not None:
            complete = True
            yield _void_around(room, held[None], held[None][:0], -1)

    start = tuple(float(value) for value in low - step)
    for vertices, faces in marching_cubes_slabs(padded(), level, start, spacing):  # type: ignore[arg-type]
        high = low + (counts - 1) * step
        if not complete:
            high[2] = np.inf
        _move_to_border(vertices, step, low, high)
        yield vertices, faces


def _void_around(room: F32, ahead: F32, slab: F32, outside: int) -> F32:
    """The planes `ahead` and of a slab with void around them, one plane before them, or if `outside` is -1 after them.

    `room` is a former result, which is overwritten if it has the right size.
    """
    first, count = max(outside, 0), len(ahead) + len(slab)
    size = (abs(outside) + count, slab.shape[1] + 2, slab.shape[2] + 2)
    padded = room if room.shape == size else np.empty(size, np.float32)
    # only the frame is void
    padded[:, [0, -1]], padded[:, :, [0, -1]] = np.inf, np.inf
    padded[first : first + len(ahead), 1:-1, 1:-1] = ahead
    padded[first + len(ahead) : first + count, 1:-1, 1:-1] = slab
    if outside:
        padded[0 if outside > 0 else -1] = np.inf
    return padded


@jit
def _move_to_border(vertices: F64, step: F64, low: F64, high: F64) -> None:
    """Move vertices in or beyond the outermost planes of samples into them, which are the border."""
    # Vertices keep EDGE_MARGIN off the planes of samples unless they lie in them, so a quarter of it separates them.
    slack, inset = EDGE_MARGIN / 4, EDGE_MARGIN / 2
    for i in range(vertices.shape[0]):
        for axis in range(3):
            value = vertices[i, axis]
            if value < low[axis] - slack * step[axis] or value > high[axis] + slack * step[axis]:
                for other in range(3):
                    if other != axis:
                        least, most = low[other] + inset * step[other], high[other] - inset * step[other]
                        vertices[i, other] = min(max(vertices[i, other], least), most)
        for axis in range(3):
            value = vertices[i, axis]
            if value < low[axis] + slack * step[axis]:
                vertices[i, axis] = low[axis]
            elif value > high[axis] - slack * step[axis]:
                vertices[i, axis] = high[axis]
