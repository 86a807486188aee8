"""What happens to a surface at the border of the box: closed by a cap, or left open for the next periodic cell.

A field of n + 1 samples an edge whose opposite faces are equal (`wrapped`) gives, without a cap, a surface whose
opposite rims match vertex by vertex. `capped_marching_cubes` closes the solid with flat caps that lie exactly in the
border of the box.

How a cap is made: a layer of void around the samples makes the extractor close the surface just outside the box; the
vertices between sample and void layer are then moved into the border plane. The samples on an edge of the box have two
such vertices, those in a corner three; they are kept half an `EDGE_MARGIN` of a voxel away from the edge, each in its
own plane, so that no triangle loses its area. A solid box thereby gets bevels of 1/2048 voxel on its edges; its faces
are exact, and the mesh has the topology of the sampled solid.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.surface.marching_cubes import EDGE_MARGIN, Mesh, marching_cubes_slabs

__all__ = ["capped_marching_cubes", "capped_marching_cubes_slabs", "wrapped"]

Border = Literal["samples", "voxels"]
Axes = tuple[bool, bool, bool]

_PLANES_AT_ONCE = 16  # small enough for a padded copy to stay in the cache, large enough for few calls


def wrapped(field: NDArray[np.float32]) -> NDArray[np.float32]:
    """Periodic samples (nz, ny, nx) with the first plane of each axis repeated: (nz + 1, ny + 1, nx + 1)."""
    nz, ny, nx = field.shape
    whole = np.empty((nz + 1, ny + 1, nx + 1), field.dtype)
    whole[:-1, :-1, :-1] = field
    whole[:-1, :-1, -1] = field[:, :, 0]
    whole[:-1, -1] = whole[:-1, 0]
    whole[-1] = whole[0]
    return whole


def capped_marching_cubes(
    field: NDArray[np.float32],
    level: float = 0.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
    *,
    border: Border = "samples",
    axes: Axes = (True, True, True),
) -> Mesh:
    """Closed surface of the solid in a box.

    Parameters
    ----------
    field : (nz, ny, nx) float32
        Samples; below the level is solid.
    level, origin, spacing
        See `marching_cubes`.
    border : {"samples", "voxels"}
        Where the box ends: at the outermost samples (a grid of nodes), or half a spacing further out (a grid of voxel
        centres, whose outermost values then hold up to the border).
    axes : 3 bools, x, y, z
        Along which axes to cap; along the others the surface stays open and ends at the outermost samples.

    Returns
    -------
    vertices : (n, 3) float64
    faces : (m, 3) int32
        A closed, oriented 2-manifold if all axes are capped.

    Raises
    ------
    ValueError
        If the field is not three-dimensional or has fewer than two samples along an axis.
    ResourceError
        If the surface has more than 2^31 - 1 vertices.
    """
    if np.ndim(field) != 3 or min(np.shape(field)) < 2:
        raise ValueError(f"marching cubes need at least 2 x 2 x 2 samples, not an array of shape {np.shape(field)}")
    slabs = (field[k : k + _PLANES_AT_ONCE] for k in range(0, field.shape[0], _PLANES_AT_ONCE))
    pieces = list(capped_marching_cubes_slabs(slabs, level, origin, spacing, border=border, axes=axes))
    return np.concatenate([vertices for vertices, _ in pieces]), np.concatenate([faces for _, faces in pieces])


def capped_marching_cubes_slabs(
    slabs: Iterable[NDArray[np.float32]],
    level: float = 0.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
    *,
    border: Border = "samples",
    axes: Axes = (True, True, True),
) -> Iterator[Mesh]:
    """`capped_marching_cubes` of a field that arrives as consecutive slabs of planes.

    Takes what `marching_cubes_slabs` takes and yields pieces like it: one for each slab, one before and one after.
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

    def padded() -> Iterator[NDArray[np.float32]]:
        nonlocal complete
        last = None
        for slab in slabs:
            if slab.shape[0] == 0:
                continue
            counts[:2] = slab.shape[2], slab.shape[1]
            if last is None and axes[2]:
                yield _void_around(slab[:1], pad, layers, before=True)
            counts[2] += slab.shape[0]
            last = slab[-1:].copy()
            yield _void_around(slab, pad, layers)
        if last is not None and axes[2]:
            complete = True
            yield _void_around(last, pad, layers, after=True)

    start = tuple(float(value) for value in np.asarray(origin) - pad * step)
    for vertices, faces in marching_cubes_slabs(padded(), level, start, spacing):  # type: ignore[arg-type]
        high = low + (counts - 1 + (layers - 1)) * step
        last_sample = outermost + (counts - 1 + 2 * (layers - 1)) * step
        if not complete:
            high[2] = last_sample[2] = np.inf
        _move_to_border(vertices, axes, step, outermost, last_sample, low, high)
        yield vertices, faces


def _void_around(
    slab: NDArray[np.float32], pad: NDArray[np.int64], layers: int, before: bool = False, after: bool = False
) -> NDArray[np.float32]:
    """The slab with (repeated samples and) void around it in x and y; or what goes before or after a plane."""
    px, py = int(pad[0]), int(pad[1])
    repeated = layers - 1
    if before or after:
        slab = np.repeat(slab, repeated, axis=0)
    outside = int(before) + int(after)
    nz, ny, nx = slab.shape
    padded = np.full((nz + outside, ny + 2 * py, nx + 2 * px), np.inf, np.float32)
    inner = padded[outside * int(before) : nz + outside * int(before)]
    inner[:, py : py + ny, px : px + nx] = slab
    if repeated and px:
        inner[:, py : py + ny, 1], inner[:, py : py + ny, -2] = slab[:, :, 0], slab[:, :, -1]
    if repeated and py:
        inner[:, 1], inner[:, -2] = inner[:, 2], inner[:, -3]
    return padded


def _move_to_border(
    vertices: NDArray[np.float64],
    axes: Axes,
    step: NDArray[np.float64],
    first: NDArray[np.float64],
    last: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> None:
    """Move vertices in or beyond the outermost planes of samples (first, last) into the border (low, high)."""
    capped = [axis for axis in range(3) if axes[axis]]
    # Vertices keep EDGE_MARGIN off the planes of samples unless they lie in them, so a quarter of it tells them apart.
    slack, inset = EDGE_MARGIN / 4 * step, EDGE_MARGIN / 2 * step
    for axis in capped:
        values = vertices[:, axis]
        below, above = values < first[axis] - slack[axis], values > last[axis] + slack[axis]
        beyond = np.flatnonzero(below | above)
        for other in capped:
            if other != axis:
                vertices[beyond, other] = np.clip(
                    vertices[beyond, other], low[other] + inset[other], high[other] - inset[other]
                )
    for axis in capped:
        values = vertices[:, axis]
        values[values < first[axis] + slack[axis]] = low[axis]
        values[values > last[axis] - slack[axis]] = high[axis]
