"""The sum of kernels that measure distances in metrics of their own.

With ``M = U^T U``, U upper triangular, distances in M are plain ones between the points U x, and rows of samples along
x stay parallel to x. So a row through a stretched kernel is a row through a round one, only that where it begins is
sheared from row to row: the loops over samples are those of `rows`. A pore is a tunnel of length zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from sppm_pipeline.method.kernels.kernels import Kernels, boxes_meet, reach_boxes
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES, TunnelProfile
from sppm_pipeline.method.kernels.rows import (
    ACROSS,
    ALONG,
    LANES,
    REST,
    add_tunnel_rows,
    clip_rows,
    compiled_for,
    want_rows,
)
from sppm_pipeline.services.arrays import F32, F64, I32
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import inline_jit
from sppm_pipeline.services.metric import upper_roots

_COLUMNS = 19


def packed_capsules(kernels: Kernels, grid: Grid, cutoff: float) -> tuple[F64, F64]:
    """Pores and tunnels that reach a grid as rows (n, 19) for `stretched_adder`, in order; also for plain distances.

    Columns: start x, y, z; U as xx, xy, xz, yy, yz, zz, scaled to powers of 2; direction and length of U (end - start);
    the lowest x, y, z within reach, then the highest.
    """
    boxes = reach_boxes(kernels, cutoff)
    pore_scale, tunnel_scale = PORE_PROFILE.scale(kernels.omega), TUNNEL_PROFILES[kernels.profile].scale(kernels.mu)
    return (
        _packed(kernels.centers, kernels.centers, kernels.pore_metric, pore_scale, boxes[:2], grid),
        _packed(kernels.starts, kernels.ends, kernels.tunnel_metric, tunnel_scale, boxes[2:], grid),
    )


def _packed(starts: F64, ends: F64, metric: F64 | None, scale: F64, box: tuple[F64, ...], grid: Grid) -> F64:
    lower, upper = box
    first = np.array(grid.origin)
    last = first + np.array(grid.spacing) * (np.array(grid.shape) - 1)
    near = np.flatnonzero(boxes_meet(lower, upper, first, last))
    scale, starts = scale.take(near), starts.take(near, axis=0)
    along = ends.take(near, axis=0) - starts
    made = np.zeros((len(near), _COLUMNS))
    if metric is None:
        made[:, 3] = made[:, 6] = made[:, 8] = scale
        along *= scale[:, None]
    else:
        root = upper_roots(metric[near]) * scale[:, None, None]
        made[:, 3:9] = root[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]
        along = np.einsum("nij,nj->ni", root, along)
    length = np.sqrt((along**2).sum(axis=1))
    made[:, :3] = starts
    # any direction will do for a length of zero
    made[:, 9] = 1.0
    np.divide(along, length[:, None], out=made[:, 9:12], where=length[:, None] > 0.0)
    made[:, 12] = length
    made[:, 13:16], made[:, 16:19] = lower.take(near, axis=0), upper.take(near, axis=0)
    return made


@inline_jit
def _capsule_row(
    table: F32, i: int, reach: float, x: float, y: float, z: float, axis: F32, step: float, start: float, nx: np.float32
) -> None:
    """Prepare row i through a capsule about a segment from 0, in units in which the capsule has the radius `reach`.

    Sample `start` of the row, an integer, lies at (x, y, z), the next one `step` further along x; `axis` holds
    direction and length of the segment and (ny, nz), the unit vector of its part across x.
    """
    ux, ua, length, ny, nz = float(axis[0]), float(axis[1]), float(axis[6]), float(axis[3]), float(axis[4])
    # the row lies at an offset t in the plane of x and the segment, and w beside it
    t, w = y * ny + z * nz, z * ny - y * nz
    radius2 = reach * reach - w * w
    low, high = 1e12, -1e12
    end = t - ua * length
    near2, end2 = radius2 - t * t, radius2 - end * end
    if near2 >= 0.0:
        low, high = -math.sqrt(near2), math.sqrt(near2)
    if end2 >= 0.0:
        low, high = min(low, ux * length - math.sqrt(end2)), max(high, ux * length + math.sqrt(end2))
    if radius2 >= 0.0 and ua > 1e-6:
        radius = math.sqrt(radius2)
        if 0.0 <= (t - radius * ux) / ua <= length:
            low = min(low, (t * ux - radius) / ua)
        if 0.0 <= (t + radius * ux) / ua <= length:
            high = max(high, (t * ux + radius) / ua)
    if low > high:
        first = clip_rows(table, np.float32(1e12), np.float32(-1e12), nx, i)
    else:
        first = clip_rows(table, np.float32(start + (low - x) / step), np.float32(start + (high - x) / step), nx, i)
    place = np.uint64(i)
    x += (float(first) - start) * step
    table[ACROSS + place] = np.float32(ua * x - ux * t)
    table[ALONG + place] = np.float32(ux * x + ua * t)
    table[REST + place] = np.float32(w * w)


@cache
def stretched_adder(profile: TunnelProfile) -> Callable[..., None]:
    """`_add_stretched` compiled for one profile, once."""
    return compiled_for(profile, _add_stretched)


def _add_stretched(
    out: F32,
    shape: tuple[int, int, int],
    first_layer: int,
    origin: F64,
    spacing: F64,
    first_wanted: I32,
    last_wanted: I32,
    capsules: F64,
    reach: float,
    table: F32,
    axis: F32,
) -> None:
    """Add stretched kernels to the flat array `out`, row by row; the rows of `capsules` are those of `_packed`."""
    nz, ny, nx = shape
    for p in range(len(capsules)):
        c = capsules[p]
        z0 = max(math.ceil((c[15] - origin[2]) / spacing[2]), first_layer)
        z1 = min(math.floor((c[18] - origin[2]) / spacing[2]), first_layer + nz - 1)
        y0 = max(math.ceil((c[14] - origin[1]) / spacing[1]), 0)
        y1 = min(math.floor((c[17] - origin[1]) / spacing[1]), ny - 1)
        if z0 > z1 or y0 > y1:
            continue
        across = math.sqrt(c[10] ** 2 + c[11] ** 2)
        axis[0], axis[1] = c[9], across
        axis[3] = c[10] / across if across > 1e-30 else 1.0
        axis[4] = c[11] / across if across > 1e-30 else 0.0
        axis[6] = c[12]
        start = math.floor((c[0] - origin[0]) / spacing[0])
        dx, step = origin[0] + start * spacing[0] - c[0], c[3] * spacing[0]
        for z in range(z0, z1 + 1):
            dz = origin[2] + z * spacing[2] - c[2]
            for y in range(y0, y1 + 1, LANES):
                if not want_rows(table, first_wanted, last_wanted, (z - first_layer) * ny + y):
                    continue
                rows = min(LANES, y1 + 1 - y)
                for i in range(rows):
                    dy = origin[1] + (y + i) * spacing[1] - c[1]
                    _capsule_row(
                        table, i, reach, c[3] * dx + c[4] * dy + c[5] * dz, c[6] * dy + c[7] * dz, c[8] * dz, axis,
                        step, float(start), np.float32(nx),
                    )  # fmt: skip
                add_tunnel_rows(out, ((z - first_layer) * ny + y) * nx, nx, rows, table, axis, np.float32(step))
