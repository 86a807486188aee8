"""The lattice that isosurface stuffing cuts: body-centered cubic inside a box, closed by the faces of the box.

Corners of the cubes of a grid and their centers form a body-centered cubic lattice. Its tetrahedra have an edge of a
cube and the two centers on either side of a face as corners, so those at the border stick halfway out of the box. There
the edge between the centers is cut at the center of the cube's face: the box is filled exactly, by halves of
tetrahedra at its border.

All points have whole coordinates in a grid of half the spacing (the *doubled grid*): corners are even in x, y and z,
centers odd, centers of faces even along the normal of the face and odd in its plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import jit

CORNERS_OF_CUBE = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.int64)
"""From the center of a cube to its corners, x, y, z."""


class Crossings(NamedTuple):
    """The edges of the lattice that the surface crosses, and which of them meet in a point.

    On a periodic box a point and its copies on opposite faces are one, its *representative* the one on the low side; an
    edge in a high face is left out for its copy.
    """

    ends: NDArray[np.int32]  # (e, 2, 3), where the edges begin and end in the doubled grid, x, y, z; both in the box
    slots: NDArray[np.int32]  # (e, 2), the two points as numbers from 0 of all points at such edges
    # (s,), index of each point, as its representative, in the raveled doubled grid; ascending
    points: NDArray[np.int64]
    starts: NDArray[np.int64]  # (s + 1,), where the edges of each point begin in `incident`
    incident: NDArray[np.int64]  # (2 e,), edges by point, ascending at each
    # (2 nz + 1, 2 ny + 1, 2 nx + 1), number of the point; -1 for those at no such edge, and for copies
    slot_of: NDArray[np.int32]


def doubled_grid(
    corners: NDArray[np.float32],
    centers: NDArray[np.float32],
    faces: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    periodic: bool,
) -> NDArray[np.float32]:
    """Samples at the points of the lattice, laid into the doubled grid (2 nz + 1, 2 ny + 1, 2 nx + 1).

    `corners`, (nz + 1, ny + 1, nx + 1), and `centers`, (nz, ny, nx), are those of the cubes; `faces`, (nz, ny, 2), (nz,
    2, nx), (2, ny, nx), lie at the centers of the squares in the low and the high face of the box, across x, y, z. If
    the box is periodic, samples in the high faces are replaced by those in the low ones. 1 where there is no point of
    the lattice; NaN counts as void.
    """
    nz, ny, nx = centers.shape
    grid = np.ones((2 * nz + 1, 2 * ny + 1, 2 * nx + 1), np.float32)
    grid[::2, ::2, ::2] = corners
    grid[1::2, 1::2, 1::2] = centers
    across_x, across_y, across_z = faces
    for side, last in ((0, 0), (1, -1)):
        grid[1::2, 1::2, last] = across_x[:, :, side]
        grid[1::2, last, 1::2] = across_y[:, side, :]
        grid[last, 1::2, 1::2] = across_z[side]
    if periodic:
        repeat_low_faces(grid)
    np.copyto(grid, 1, where=np.isnan(grid))
    return grid


def repeat_low_faces(grid: NDArray[np.generic]) -> None:
    """Write what stands in the low faces of an array over its high faces."""
    grid[:, :, -1] = grid[:, :, 0]
    grid[:, -1, :] = grid[:, 0, :]
    grid[-1, :, :] = grid[0, :, :]


def find_crossings(values: NDArray[np.float32], periodic: bool) -> Crossings:
    """The edges of the lattice between a negative and a positive sample, as `doubled_grid` lays them."""
    # counted first, so that the memory is exactly that of the edges
    count = _crossing_edges(values, periodic, np.empty((0, 2, 3), np.int32), False)
    ends = np.empty((count, 2, 3), np.int32)
    _crossing_edges(values, periodic, ends, True)
    wrapped = ends.astype(np.int64)
    if periodic:
        wrapped %= np.array(values.shape[::-1]) - 1
    index = (wrapped[..., 2] * values.shape[1] + wrapped[..., 1]) * values.shape[2] + wrapped[..., 0]
    order = np.argsort(index.ravel(), kind="stable")
    sorted_ = index.ravel()[order]
    first = np.flatnonzero(np.diff(sorted_, prepend=-1))
    points = sorted_[first]
    slot_of = np.full(values.size, -1, np.int32)
    slot_of[points] = np.arange(len(points), dtype=np.int32)
    return Crossings(
        ends, slot_of[index], points, np.append(first, len(sorted_)), order // 2, slot_of.reshape(values.shape)
    )


@jit
def _crossing_edges(values: NDArray[np.float32], periodic: bool, ends: NDArray[np.int32], fill: bool) -> int:
    """Count the edges between samples of opposite sign, or write them down; each once."""
    top = np.empty(3, np.int64)
    for axis in range(3):
        top[axis] = values.shape[2 - axis] - 1
    at, to = np.empty(3, np.int64), np.empty(3, np.int64)
    count = 0
    for z in range(values.shape[0]):
        for y in range(values.shape[1]):
            for x in range(values.shape[2]):
                odd = (x & 1) + (y & 1) + (z & 1)
                if odd == 1:
                    continue
                at[0], at[1], at[2] = x, y, z
                here = values[z, y, x]
                normal = -1
                if odd == 2:
                    normal = 0 if x & 1 == 0 else (1 if y & 1 == 0 else 2)
                    if at[normal] != 0 and (at[normal] != top[normal] or periodic):
                        continue
                # 0-7: center to corners, or center of a face to the corners of its square;
                # 8-10: to the next point along an axis; 11-13: from a center to the low face of the box
                for way in range(14):
                    for axis in range(3):
                        to[axis] = at[axis]
                    if way < 8:
                        if odd == 0:
                            continue
                        if odd == 2 and CORNERS_OF_CUBE[way, normal] < 0:
                            continue
                        for axis in range(3):
                            if axis != normal:
                                to[axis] += CORNERS_OF_CUBE[way, axis]
                    elif way < 11:
                        axis = way - 8
                        if odd == 2:
                            continue
                        to[axis] += 2
                        if odd == 0:
                            if to[axis] > top[axis]:
                                continue
                            b, c = (axis + 1) % 3, (axis + 2) % 3
                            if periodic and (at[b] == top[b] or at[c] == top[c]):
                                continue
                        elif to[axis] > top[axis]:
                            to[axis] = top[axis]
                    else:
                        axis = way - 11
                        if odd != 3 or at[axis] != 1:
                            continue
                        to[axis] = 0
                    there = values[to[2], to[1], to[0]]
                    if (here < 0 and there > 0) or (here > 0 and there < 0):
                        if fill:
                            for axis in range(3):
                                ends[count, 0, axis] = at[axis]
                                ends[count, 1, axis] = to[axis]
                        count += 1
    return count
