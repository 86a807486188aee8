"""The fast sum of kernels on a regular grid: each kernel is added to the rows that its reach touches.

A kernel is dropped where it falls below the cut-off; the tests bound what that costs (`cutoff_bound`). Every sample is
the sum of its kernels in the order in which they are given, whatever the number of threads, and whatever part of
the layers is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from sppm_pipeline.method.kernels.kernels import Kernels, boxes_meet, reach_boxes
from sppm_pipeline.method.kernels.profiles import (
    DEFAULT_CUTOFF,
    PORE_PROFILE,
    TUNNEL_PROFILES,
    TunnelProfile,
)
from sppm_pipeline.method.kernels.rows import (
    LANES,
    TABLE,
    add_gauss_rows,
    add_tunnel_rows,
    compiled_for,
    fill_gauss,
    point_rows,
    tunnel_rows,
    want_rows,
)
from sppm_pipeline.services.arrays import F32, F64, I32
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.metric import check_metric
from sppm_pipeline.services.threads import share_out

# Samples of one block of layers: 1 MB of float32 stays in the second level cache while kernels are added to it.
_BLOCK_SAMPLES = 1 << 18


def add_kernels(
    out: F32,
    grid: Grid,
    kernels: Kernels,
    cutoff: float = DEFAULT_CUTOFF,
    threads: int = 1,
    first_layer: int = 0,
    wanted: I32 | None = None,
) -> None:
    """Add all kernels to the samples of a grid (paper, eq. 1-3), layers ``first_layer <= k < first_layer + nz``.

    `out` (nz, ny, nx) is C-contiguous; grid and kernels are in one unit, spacings may differ from axis to axis, and
    tunnels of length zero are allowed. A kernel is dropped below the cut-off (some samples up to 15 spacings further
    out along x still receive it). `wanted` (nz, ny, 2) holds the first sample of each row that matters and the one
    after the last: samples beyond them hold parts of the sum or nothing. A layer's values depend neither on the threads
    nor on `first_layer`, nor on what else is wanted.

    Raises ValueError if `out` does not fit the grid, the cut-off lies outside [1e-12, 0.5], or a kernel is not finite
    or has a parameter that is not positive.
    """
    add_prepared(out, grid, prepared(kernels, grid, cutoff, first_layer, len(out)), threads, first_layer, wanted)


class Prepared(NamedTuple):
    """Kernels that reach some layers of a grid, as the compiled sums take them."""

    points: F64  # (n, columns), in order, see `_packed` and `packed_capsules`
    tunnels: F64
    profile: TunnelProfile
    stretched: bool  # kernels have metrics
    cutoff: float


def prepared(
    kernels: Kernels, grid: Grid, cutoff: float = DEFAULT_CUTOFF, first_layer: int = 0, layers: int | None = None
) -> Prepared:
    """Arguments of `add_prepared` for some layers of a grid, all of them unless given; errors as in `add_kernels`."""
    span = grid.layers(first_layer, first_layer + (grid.shape[2] if layers is None else layers))
    points, tunnels = _packed(kernels)
    stretched = kernels.pore_metric is not None
    # nothing to add: the compiled sums are not even loaded
    if len(points) + len(tunnels) == 0 or 0 in span.shape:
        points, tunnels = points[:0], tunnels[:0]
    elif stretched:
        from sppm_pipeline.method.kernels.stretched import packed_capsules

        points, tunnels = packed_capsules(kernels, span, cutoff)
    else:
        points, tunnels = _reaching(points, tunnels, kernels, span, cutoff)
    return Prepared(points, tunnels, TUNNEL_PROFILES[kernels.profile], stretched, cutoff)


def add_prepared(
    out: F32, grid: Grid, kernels: Prepared, threads: int = 1, first_layer: int = 0, wanted: I32 | None = None
) -> None:
    """Add kernels, prepared for these layers or more, to the samples of a grid; otherwise as `add_kernels`."""
    nx, ny, nz = grid.shape
    layers = len(out)
    if out.dtype != np.float32 or not out.flags.c_contiguous or out.shape[1:] != (ny, nx):
        raise ValueError(f"out must be a C-contiguous float32 array (layers, {ny}, {nx})")
    if first_layer < 0 or first_layer + layers > nz:
        raise ValueError(f"layers {first_layer} to {first_layer + layers} are not all in a grid of {nz} layers")
    points, tunnels, profile, stretched, cutoff = kernels
    if out.size == 0 or len(points) + len(tunnels) == 0:
        return
    pore_reach, tunnel_reach = PORE_PROFILE.scaled_reach(cutoff), profile.scaled_reach(cutoff)
    if stretched:
        from sppm_pipeline.method.kernels.stretched import stretched_adder

        add_stretched, add_tunnels = stretched_adder(PORE_PROFILE), stretched_adder(profile)
    else:
        add_tunnels = tunnel_adder(profile)
    origin, spacing = np.array(grid.origin), np.array(grid.spacing)
    # of each row the first sample that is wanted, and the last one
    spans = np.array([[0], [nx - 1]]) if wanted is None else wanted.reshape(-1, 2).T - [[0], [1]]
    spans = np.broadcast_to(spans, (2, layers * ny))
    height = max(1, min(layers, _BLOCK_SAMPLES // (nx * ny)))
    # blocks of layers are disjoint, so that threads never write to the same sample; four a thread even out costs
    height = max(1, min(height, -(-layers // (4 * threads)))) if threads > 1 else height

    width = 0 if stretched else 2 * int(pore_reach / (points[:, 3].min(initial=math.inf) * grid.spacing[0]) + 4 * LANES)

    def add_block(start: int) -> None:
        block = out[start : start + height]
        # as many more rows as a group may run over the end, of which nothing is wanted
        rows = np.zeros((2, len(block) * ny + LANES), np.int32)
        rows[1] = -1
        rows[:, :-LANES] = spans[:, start * ny : (start + len(block)) * ny]
        # Made here because an array that is made in a compiled function is counted in each call it is passed to.
        table = np.empty(TABLE, np.float32)
        whole = nx % LANES == 0
        # Blocks of samples may run over the end of a row: rows of an odd length are summed in padded rows.
        target = block if whole else np.zeros((len(block), ny, nx + LANES - nx % LANES), dtype=np.float32)
        arguments = (target.reshape(-1), target.shape, first_layer + start, origin, spacing, rows[0], rows[1])
        if stretched:
            add_stretched(*arguments, points, pore_reach, table, np.empty(7, np.float32))
        else:
            _add_points(*arguments, points, pore_reach, table, np.empty(width, np.float32))
        add_tunnels(*arguments, tunnels, tunnel_reach, table, np.empty(7, np.float32))
        if not whole:
            block += target[:, :, :nx]

    share_out(add_block, range(0, layers, height), threads)


def _packed(kernels: Kernels) -> tuple[F64, F64]:
    """Points as rows cx cy cz k, tunnels as rows ax ay az ux uy uz length k; k scales lengths to powers of 2."""
    for values in kernels[:5]:
        if not np.isfinite(values).all():
            raise ValueError("a kernel is not finite")
    if (kernels.omega <= 0.0).any() or (kernels.mu <= 0.0).any():
        raise ValueError("omega and mu must be positive")
    if (kernels.pore_metric is None) != (kernels.tunnel_metric is None):
        raise ValueError("pores and tunnels both have metrics, or none")
    for metric, n in ((kernels.pore_metric, len(kernels.omega)), (kernels.tunnel_metric, len(kernels.mu))):
        if metric is not None:
            check_metric(metric, n)
    points = np.empty((len(kernels.centers), 4))
    points[:, :3] = kernels.centers
    points[:, 3] = PORE_PROFILE.scale(kernels.omega)
    tunnels = np.empty((len(kernels.starts), 8))
    along = kernels.ends - kernels.starts
    # einsum sums in a fixed order, unlike a product of BLAS
    length = np.sqrt(np.einsum("ij,ij->i", along, along))
    tunnels[:, :3] = kernels.starts
    tunnels[:, 3:6] = (1.0, 0.0, 0.0)
    np.divide(along, length[:, None], out=tunnels[:, 3:6], where=length[:, None] > 0.0)
    tunnels[:, 6] = length
    tunnels[:, 7] = TUNNEL_PROFILES[kernels.profile].scale(kernels.mu)
    return points, tunnels


def _reaching(points: F64, tunnels: F64, kernels: Kernels, grid: Grid, cutoff: float) -> tuple[F64, F64]:
    """The kernels whose boxes of reach meet the box of the samples, in order."""
    lower = np.array(grid.origin)
    upper = lower + np.array(grid.spacing) * (np.array(grid.shape) - 1)
    pore_lower, pore_upper, tunnel_lower, tunnel_upper = reach_boxes(kernels, cutoff)
    return (
        points.compress(boxes_meet(pore_lower, pore_upper, lower, upper), axis=0),
        tunnels.compress(boxes_meet(tunnel_lower, tunnel_upper, lower, upper), axis=0),
    )


@jit
def _add_points(
    out: F32,
    shape: tuple[int, int, int],
    first_layer: int,
    origin: F64,
    spacing: F64,
    first_wanted: I32,
    last_wanted: I32,
    points: F64,
    reach: float,
    table: F32,
    along_x: F32,
) -> None:
    """Add Gaussians to the flat array `out`; a Gaussian is a row of values along x times one factor a row."""
    nz, ny, nx = shape
    for p in range(len(points)):
        scale = points[p, 3]
        radius = reach / scale
        z0 = max(math.ceil((points[p, 2] - radius - origin[2]) / spacing[2]), first_layer)
        z1 = min(math.floor((points[p, 2] + radius - origin[2]) / spacing[2]), first_layer + nz - 1)
        y0 = max(math.ceil((points[p, 1] - radius - origin[1]) / spacing[1]), 0)
        y1 = min(math.floor((points[p, 1] + radius - origin[1]) / spacing[1]), ny - 1)
        if z0 > z1 or y0 > y1:
            continue
        # Coordinates count from the sample beside the center, so that float32 keeps their digits on large grids.
        start = math.floor((points[p, 0] - origin[0]) / spacing[0])
        rest_x = scale * (origin[0] + start * spacing[0] - points[p, 0])
        step_x = scale * spacing[0]
        center = np.float32(start - rest_x / step_x)
        # Blocks overrun the reach by up to 15 samples on one side.
        half = int(radius / spacing[0]) + 2 * LANES
        blocks = (2 * half) // LANES
        fill_gauss(along_x, blocks, np.float32(rest_x - half * step_x), np.float32(step_x))
        dy = scale * (origin[1] + y0 * spacing[1] - points[p, 1])
        step_y = scale * spacing[1]
        for z in range(z0, z1 + 1):
            dz = np.float32(scale * (origin[2] + z * spacing[2] - points[p, 2]))
            for y in range(y0, y1 + 1, LANES):
                if not want_rows(table, first_wanted, last_wanted, (z - first_layer) * ny + y):
                    continue
                point_rows(
                    table, np.float32(reach), np.float32(dy + (y - y0) * step_y), np.float32(step_y), dz, center,
                    np.float32(1.0 / step_x), np.float32(nx),
                )  # fmt: skip
                offset = ((z - first_layer) * ny + y) * nx
                add_gauss_rows(out, offset, nx, min(LANES, y1 + 1 - y), table, along_x, half - start)


@cache
def tunnel_adder(profile: TunnelProfile) -> Callable[..., None]:
    """`_add_tunnels` compiled for one profile, once."""
    return compiled_for(profile, _add_tunnels)


def _add_tunnels(
    out: F32,
    shape: tuple[int, int, int],
    first_layer: int,
    origin: F64,
    spacing: F64,
    first_wanted: I32,
    last_wanted: I32,
    tunnels: F64,
    reach: float,
    table: F32,
    axis: F32,
) -> None:
    """Add segment kernels to the flat array `out`, row by row in the frame of the segment."""
    nz, ny, nx = shape
    for p in range(len(tunnels)):
        scale = tunnels[p, 7]
        radius = reach / scale
        end_z = tunnels[p, 2] + tunnels[p, 5] * tunnels[p, 6]
        low = min(tunnels[p, 2], end_z) - radius
        high = max(tunnels[p, 2], end_z) + radius
        z0 = max(math.ceil((low - origin[2]) / spacing[2]), first_layer)
        z1 = min(math.floor((high - origin[2]) / spacing[2]), first_layer + nz - 1)
        if z0 > z1:
            continue
        end_y = tunnels[p, 1] + tunnels[p, 4] * tunnels[p, 6]
        low = min(tunnels[p, 1], end_y) - radius
        high = max(tunnels[p, 1], end_y) + radius
        y0 = max(math.ceil((low - origin[1]) / spacing[1]), 0)
        y1 = min(math.floor((high - origin[1]) / spacing[1]), ny - 1)
        if y0 > y1:
            continue
        across = math.sqrt(tunnels[p, 4] ** 2 + tunnels[p, 5] ** 2)
        # nearly along x the division by `across` would lose all digits; the end balls then cut the row
        slanted = across > 1e-6
        axis[0] = tunnels[p, 3]
        axis[1] = across
        axis[2] = 1.0 / across if slanted else 0.0
        axis[3] = tunnels[p, 4] / across if across > 1e-30 else 1.0
        axis[4] = tunnels[p, 5] / across if across > 1e-30 else 0.0
        axis[5] = 1.0 if slanted else 0.0
        axis[6] = scale * tunnels[p, 6]
        step_x = scale * spacing[0]
        start = math.floor((tunnels[p, 0] - origin[0]) / spacing[0])
        first = np.float32(scale * (origin[0] + start * spacing[0] - tunnels[p, 0]))
        dy = scale * (origin[1] + y0 * spacing[1] - tunnels[p, 1])
        step_y = scale * spacing[1]
        for z in range(z0, z1 + 1):
            dz = np.float32(scale * (origin[2] + z * spacing[2] - tunnels[p, 2]))
            for y in range(y0, y1 + 1, LANES):
                if not want_rows(table, first_wanted, last_wanted, (z - first_layer) * ny + y):
                    continue
                tunnel_rows(
                    table, np.float32(reach), np.float32(dy + (y - y0) * step_y), np.float32(step_y), dz, axis,
                    np.float32(start), first, np.float32(step_x), np.float32(1.0 / step_x), np.float32(nx),
                )  # fmt: skip
                offset = ((z - first_layer) * ny + y) * nx
                rows = min(LANES, y1 + 1 - y)
                add_tunnel_rows(out, offset, nx, rows, table, axis, np.float32(step_x))
