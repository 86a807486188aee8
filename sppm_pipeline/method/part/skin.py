"""The solid skin of a part: what is inside and within a distance of the outside.

Exact Euclidean distances by one pass per axis (squared distances add up along the axes), but only as far as the skin
is thick. x and z are done for one plane of constant y at a time, and a ring of such planes serves the pass along y, so
that the memory is a few rows per layer. Blocks of a row that no outside reaches are skipped, and most of a thick part
is such.
"""

from __future__ import annotations

import math

import numpy as np

from sppm_pipeline.services.arrays import F32, U8
from sppm_pipeline.services.jit.compiled import jit

# a distance that equals the thickness up to rounding counts as within
_SLACK = 1.0 + 1e-6
_BLOCK = 128
_MIXED, _OUT, _DEEP = 0, 1, 2  # state of a block: all of it outside, or none of it reached by any outside
_FAR = np.float32(1e30)


def halo_layers(thickness: float, spacing: float) -> int:
    """Number of layers above and below that decide on the skin of a layer."""
    return math.floor(thickness / spacing * _SLACK)


def skin_layers(occupancy: U8, spacing: tuple[float, float, float], thickness: float, below: int, above: int) -> U8:
    """The skin of some layers, (n, ny, nx): voxels inside whose center is within the thickness of one outside.

    `occupancy` has `below` and `above` layers more, that are only looked at: `halo_layers` of them or, at the ends of
    the part, what there is, as beyond the array everything is outside. Anything but 0 is inside. Spacing (along x, y,
    z) and thickness are in one unit; below the spacing there is no skin. The same voxel for voxel however the part is
    cut.
    """
    n = occupancy.shape[0] - below - above
    skin = np.zeros((n, *occupancy.shape[1:]), dtype=np.uint8)
    hx, hy, hz = (np.float32(h * h) for h in spacing)
    nz, ny, nx = occupancy.shape  # farther than the array is wide, what lies beyond it has counted already
    rx, ry, rz = (min(halo_layers(thickness, h), n) for h, n in zip(spacing, (nx, ny, nz), strict=True))
    limit = np.float32((thickness * _SLACK) ** 2)
    _skin(np.ascontiguousarray(occupancy), below, hx, hy, hz, rx, ry, rz, limit, skin)
    return skin


@jit
def _row_distances(inside: U8, h: np.float32, reach: int, out: F32) -> None:
    """Squared distance to the nearest voxel outside in the same row; far where it is beyond reach."""
    n = inside.size
    x = 0
    while x < n:
        begin = x
        while x < n and inside[x] == 0:
            x += 1
        for i in range(begin, x):
            out[i] = 0.0
        begin = x
        while x < n and inside[x] != 0:
            x += 1
        for i in range(begin, x):
            # beyond both ends of the array is outside
            d = min(i + 1 - begin, x - i)
            out[i] = h * np.float32(d * d) if d <= reach else _FAR


@jit
def _lower(least: F32, other: F32, add: np.float32) -> None:
    for x in range(least.size):
        least[x] = min(least[x], other[x] + add)


@jit
def _state(block: F32) -> int:
    # counted, because sums of integers are vectorized under strict arithmetic and extrema of floats are not
    outside = np.int32(0)
    deep = np.int32(0)
    for x in range(block.size):
        outside += np.int32(block[x] == 0.0)
        deep += np.int32(block[x] == _FAR)
    if outside == block.size:
        return _OUT
    return _DEEP if deep == block.size else _MIXED


@jit
def _skin(
    occupancy: U8,
    below: int,
    hx: np.float32,
    hy: np.float32,
    hz: np.float32,
    rx: int,
    ry: int,
    rz: int,
    limit: np.float32,
    skin: U8,
) -> None:
    nz, ny, nx = skin.shape
    halo_nz = occupancy.shape[0]
    n_blocks = (nx + _BLOCK - 1) // _BLOCK
    rows = np.empty((halo_nz, nx), np.float32)
    row_states = np.empty((halo_nz, n_blocks), np.uint8)
    ring = 2 * ry + 1
    planes = np.empty((ring, nz, nx), np.float32)
    states = np.empty((ring, nz, n_blocks), np.uint8)
    least = np.empty(_BLOCK, np.float32)
    nothing = np.zeros(_BLOCK, np.float32)  # distances in a row beyond the array
    for ahead in range(ny + ry):
        # plane `ahead` enters the ring; then all that row `ahead - ry` needs is there
        if ahead < ny:
            slot = ahead % ring
            for z in range(halo_nz):
                _row_distances(occupancy[z, ahead], hx, rx, rows[z])
                for b in range(n_blocks):
                    row_states[z, b] = _state(rows[z, b * _BLOCK : (b + 1) * _BLOCK])
            for z in range(nz):
                own = z + below
                for b in range(n_blocks):
                    start, stop = b * _BLOCK, min(nx, (b + 1) * _BLOCK)
                    block = planes[slot, z, start:stop]
                    for x in range(stop - start):
                        block[x] = rows[own, start + x]
                    state = row_states[own, b]
                    if state != _OUT:
                        for dz in range(1, rz + 1):
                            add = hz * np.float32(dz * dz)
                            for other in (own - dz, own + dz):
                                if other < 0 or other >= halo_nz:
                                    _lower(block, nothing[: stop - start], add)
                                    state = _MIXED
                                elif row_states[other, b] != _DEEP:
                                    _lower(block, rows[other, start:stop], add)
                                    state = _MIXED
                    states[slot, z, b] = state
        y = ahead - ry
        if y < 0:
            continue
        slot = y % ring
        for z in range(nz):
            for b in range(n_blocks):
                state = states[slot, z, b]
                if state == _OUT:
                    continue
                start, stop = b * _BLOCK, min(nx, (b + 1) * _BLOCK)
                block = least[: stop - start]
                for x in range(stop - start):
                    block[x] = planes[slot, z, start + x]
                for dy in range(1, ry + 1):
                    add = hy * np.float32(dy * dy)
                    for other in (y - dy, y + dy):
                        if other < 0 or other >= ny:
                            _lower(block, nothing[: stop - start], add)
                            state = _MIXED
                        elif states[other % ring, z, b] != _DEEP:
                            _lower(block, planes[other % ring, z, start:stop], add)
                            state = _MIXED
                # no outside within reach of the whole block
                if state == _DEEP:
                    continue
                own_plane = planes[slot, z, start:stop]
                target = skin[z, y, start:stop]
                for x in range(stop - start):
                    target[x] = np.uint8(own_plane[x] > 0.0) & np.uint8(block[x] <= limit)
