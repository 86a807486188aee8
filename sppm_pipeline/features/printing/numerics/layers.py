"""Single layers: overhang over the one below, first moments, the hull of the foot."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.connectivity.runs import Runs
from sppm_pipeline.services.jit.compiled import jit


def reach_of(distance: float, pixel: tuple[float, float]) -> NDArray[np.int64]:
    """Half widths of a disk in pixels, a row each from -R to R rows; pixel pitch along x and y in the disk's unit."""
    px, py = pixel
    rows = math.floor(distance / py + 1e-9)
    along = [math.sqrt(max(0.0, distance**2 - (row * py) ** 2)) / px for row in range(-rows, rows + 1)]
    return np.floor(np.array(along) + 1e-9).astype(np.int64)


def unsupported(runs: Runs, below: Runs, reach: NDArray[np.int64]) -> Runs:
    """The pixels of a layer farther from those of the layer below than `reach_of` says."""
    rows, bounds = _unsupported(runs.rows, runs.bounds, below.rows, below.bounds, runs.shape[2], reach)
    return Runs(runs.shape, rows, bounds)


@jit
def _unsupported(
    rows: NDArray[np.int64], bounds: NDArray[np.int32], rows_below: NDArray[np.int64], bounds_below: NDArray[np.int32],
    nx: int, reach: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:  # fmt: skip
    ny, around = rows.size - 1, reach.size // 2
    out_rows = np.empty_like(rows)
    out = np.empty(max(64, bounds.size), np.int32)
    # what of a row is left, and what is left of that; never more runs than fit into it
    left, rest = np.empty(nx + 2, np.int32), np.empty(nx + 2, np.int32)
    n = 0
    for y in range(ny):
        out_rows[y] = n // 2
        m = 2 * (rows[y + 1] - rows[y])
        left[:m] = bounds[2 * rows[y] : 2 * rows[y + 1]]
        for turn in range(2 * around + 1):
            dy = (turn + 1) // 2 if turn % 2 else -(turn // 2)  # the row itself holds most
            if m and 0 <= y + dy < ny:
                m = _subtract(
                    left, m, bounds_below, rows_below[y + dy], rows_below[y + dy + 1], reach[dy + around], rest
                )
                left, rest = rest, left
        if n + m > out.size:
            out = np.concatenate((out, np.empty(out.size + m, np.int32)))
        out[n : n + m] = left[:m]
        n += m
    out_rows[ny] = n // 2
    return out_rows, out[:n].copy()


@jit
def _subtract(
    runs: NDArray[np.int32], n: int, taken: NDArray[np.int32], r: int, r_stop: int, wide: int, out: NDArray[np.int32]
) -> int:
    """Write what of some runs lies outside of others, which are widened at both ends; returns the bounds written."""
    m = 0
    for i in range(0, n, 2):
        start, stop = runs[i], runs[i + 1]
        while r < r_stop and taken[2 * r + 1] + wide <= start:
            r += 1
        other = r
        while start < stop and other < r_stop and taken[2 * other] - wide < stop:
            if taken[2 * other] - wide > start:
                out[m] = start
                out[m + 1] = taken[2 * other] - wide
                m += 2
            start = max(start, taken[2 * other + 1] + wide)
            other += 1
        if start < stop:
            out[m] = start
            out[m + 1] = stop
            m += 2
    return m


def first_moments(runs: Runs) -> tuple[float, float]:
    """Sums of x and of y over the pixels of a layer, at their centers (x + 1/2, y + 1/2)."""
    x, y = _first_moments(runs.rows, runs.bounds)
    return float(x) / 2, float(y) / 2


@jit
def _first_moments(rows: NDArray[np.int64], bounds: NDArray[np.int32]) -> tuple[np.int64, np.int64]:
    x, y = np.int64(0), np.int64(0)
    for line in range(rows.size - 1):
        length = np.int64(0)
        for r in range(rows[line], rows[line + 1]):
            start, stop = np.int64(bounds[2 * r]), np.int64(bounds[2 * r + 1])
            length += stop - start
            x += (stop - start) * (start + stop)
        y += length * (2 * line + 1)
    return x, y


def convex_hull(runs: Runs) -> NDArray[np.float64]:
    """Corners of the convex hull of the pixels of a layer, counterclockwise, (n, 2), in pixels."""
    rows = np.flatnonzero(np.diff(runs.rows))
    low = runs.bounds[2 * runs.rows[rows]]
    high = runs.bounds[2 * runs.rows[rows + 1] - 1]
    # only the first and last pixel of a row can be on the hull; pixels count by their corners
    x = np.concatenate([low, low, high, high])
    y = np.concatenate([rows, rows + 1, rows, rows + 1])
    points = np.unique(np.stack([x, y], 1), axis=0).tolist()  # by x, then by y
    chains = []
    for ordered in (points, points[::-1]):  # Andrew's monotone chain (1979)
        chain: list[list[int]] = []
        for p in ordered:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        chains.append(chain[:-1])
    return np.array(chains[0] + chains[1], np.float64)


def _turn(a: list[int], b: list[int], c: list[int]) -> int:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def margin_inside(hull: NDArray[np.float64], point: tuple[float, float]) -> float:
    """Depth of a point in a convex polygon with counterclockwise corners; negative outside of an edge."""
    edge = np.roll(hull, -1, 0) - hull
    to_point = np.asarray(point) - hull
    return float(((edge[:, 0] * to_point[:, 1] - edge[:, 1] * to_point[:, 0]) / np.hypot(edge[:, 0], edge[:, 1])).min())
