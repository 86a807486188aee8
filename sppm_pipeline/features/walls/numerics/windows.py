"""Depth in tunnels taken as capsules: radius less the distance from the nearest axis."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.threads import in_bands


def raise_to_depth(
    out: NDArray[np.float32],
    grid: Grid,
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    radii: NDArray[np.float64],
    margin: float,
    threads: int = 1,
    first_layer: int = 0,
) -> None:
    """Raise samples to their depth in tunnels, which is negative outside; the nearest tunnel counts.

    Parameters
    ----------
    out : (nz, ny, nx) float32, C-contiguous
        The layers ``first_layer <= k < first_layer + nz`` of the grid, not less than ``-margin`` where no tunnel has
        been yet.
    grid : Grid
    starts, ends : (m, 3) float64
        Axes of the tunnels, in the unit of the grid; length zero is allowed.
    radii : (m,) float64
    margin : float
        Samples farther than this from a tunnel stay as they are.
    threads : int
        Number of threads; the result does not depend on it.
    first_layer : int
    """
    layers = len(out)
    if layers == 0 or len(starts) == 0:
        return
    origin, spacing = np.array(grid.origin), np.array(grid.spacing)

    def fill(start: int, stop: int) -> None:
        block = out[start:stop]
        arguments = block.reshape(-1), block.shape, first_layer + start, origin, spacing
        _raise_tunnels(*arguments, starts, ends, radii, margin)

    in_bands(fill, layers, threads)


@inline_jit
def _raise_row(
    out: NDArray[np.float32],
    at: int,
    count: int,
    x: np.float32,
    step: np.float32,
    y: np.float32,
    z: np.float32,
    ux: np.float32,
    uy: np.float32,
    uz: np.float32,
    length: np.float32,
    radius: np.float32,
) -> None:
    """Raise ``out[at + i]`` to the radius less the distance of ``(x + i step, y, z)`` from a segment at the origin."""
    first = np.uint64(at)
    aside = y * uy + z * uz
    for i in range(np.uint64(count)):
        dx = x + step * np.float32(np.int32(i))
        foot = min(max(dx * ux + aside, np.float32(0.0)), length)
        px, py, pz = dx - foot * ux, y - foot * uy, z - foot * uz
        out[first + i] = max(out[first + i], radius - np.float32(math.sqrt(px * px + py * py + pz * pz)))


@jit
def _raise_tunnels(
    out: NDArray[np.float32],
    shape: tuple[int, int, int],
    first_layer: int,
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    radii: NDArray[np.float64],
    margin: float,
) -> None:
    """Visit the rows of the box around every tunnel, each over the samples that its capsule can reach."""
    nz, ny, nx = shape
    hx, hy, hz = spacing[0], spacing[1], spacing[2]
    for t in range(len(starts)):
        ax, ay, az = starts[t, 0], starts[t, 1], starts[t, 2]
        ux, uy, uz = ends[t, 0] - ax, ends[t, 1] - ay, ends[t, 2] - az
        length = math.sqrt(ux * ux + uy * uy + uz * uz)
        if length > 0.0:
            ux, uy, uz = ux / length, uy / length, uz / length
        reach = radii[t] + margin
        bz, by = az + uz * length, ay + uy * length
        z0 = max(math.ceil((min(az, bz) - reach - origin[2]) / hz), first_layer)
        z1 = min(math.floor((max(az, bz) + reach - origin[2]) / hz), first_layer + nz - 1)
        y0 = max(math.ceil((min(ay, by) - reach - origin[1]) / hy), 0)
        y1 = min(math.floor((max(ay, by) + reach - origin[1]) / hy), ny - 1)
        beside = math.floor((ax - origin[0]) / hx)
        rest = origin[0] + beside * hx - ax
        for z in range(z0, z1 + 1):
            dz = origin[2] + z * hz - az
            for y in range(y0, y1 + 1):
                dy = origin[1] + y * hy - ay
                # the part of the axis that comes near enough to the row
                aside = dy * uy + dz * uz
                slant = 1.0 - ux * ux
                aside2 = dy * dy + dz * dz
                low, high = 0.0, length
                if slant > 1e-9:
                    square = aside * aside - slant * (aside2 - reach * reach)
                    if square < 0.0:
                        continue
                    root = math.sqrt(square)
                    low, high = max(low, (aside - root) / slant), min(high, (aside + root) / slant)
                elif aside2 > reach * reach:
                    continue
                if low > high:
                    continue
                left, right = min(low * ux, high * ux) - reach, max(low * ux, high * ux) + reach
                start = max(math.ceil((left - rest) / hx), -beside)
                stop = min(math.floor((right - rest) / hx), nx - 1 - beside) + 1
                if start >= stop:
                    continue
                _raise_row(
                    out, ((z - first_layer) * ny + y) * nx + beside + start, stop - start,
                    np.float32(rest + start * hx), np.float32(hx), np.float32(dy), np.float32(dz),
                    np.float32(ux), np.float32(uy), np.float32(uz), np.float32(length), np.float32(radii[t]),
                )  # fmt: skip
