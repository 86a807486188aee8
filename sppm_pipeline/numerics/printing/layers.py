"""Single layers: overhang over the one below, first moments, the hull of the foot."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.connectivity.runs import Runs


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
    rows: NDArray[np.int64],
    bounds: NDArray[np.int32],
    rows_below: NDArray[np.int64],
    bounds_below: NDArray[np.int32],
    nx: int,
    reach: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    ny, around = rows.size - 1, reach.size // 2
    out_rows = np.empty_like(rows)
    out = np.empty(max(64, bounds.size), np.int32)
    held = np.zeros(nx, np.uint8)
    n = 0
    for y in range(ny):
        out_rows[y] = n // 2
        if rows[y] == rows[y + 1]:
            continue
        held[:] = 0
        for dy in range(-around, around + 1):
            if 0 <= y + dy < ny:
                wide = reach[dy + around]
                for r in range(rows_below[y + dy], rows_below[y + dy + 1]):
                    held[max(0, bounds_below[2 * r] - wide) : min(nx, bounds_below[2 * r + 1] + wide)] = 1
        for r in range(rows[y], rows[y + 1]):
            start, stop = bounds[2 * r], bounds[2 * r + 1]
            total = 0
            for x in range(start, stop):
                total += held[x]
            if total == stop - start:
                continue
            x = start
            while x < stop:
                while x < stop and held[x]:
                    x += 1
                if x == stop:
                    break
                if n + 2 > out.size:
                    out = np.concatenate((out, np.empty(out.size, np.int32)))
                out[n] = x
                while x < stop and not held[x]:
                    x += 1
                out[n + 1] = x
                n += 2
    out_rows[ny] = n // 2
    return out_rows, out[:n].copy()


def first_moments(runs: Runs) -> tuple[float, float]:
    """Sums of x and of y over the pixels of a layer, at their centers (x + 1/2, y + 1/2)."""
    start, stop = runs.bounds[::2].astype(np.int64), runs.bounds[1::2].astype(np.int64)
    per_row = np.add.reduceat(np.append(stop - start, 0), np.minimum(runs.rows[:-1], len(start)))
    per_row[np.diff(runs.rows) == 0] = 0  # `reduceat` gives an element where a row is empty
    along_x = float(((stop - start) * (start + stop)).sum()) / 2
    return along_x, float(per_row @ (np.arange(runs.shape[1]) + 0.5))


def convex_hull(runs: Runs) -> NDArray[np.float64]:
    """Corners of the convex hull of the pixels of a layer, counterclockwise, (n, 2), in pixels."""
    rows = np.flatnonzero(np.diff(runs.rows))
    low = runs.bounds[2 * runs.rows[rows]]
    high = runs.bounds[2 * runs.rows[rows + 1] - 1]
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
    """How far a point lies inside a convex polygon with counterclockwise corners; negative outside of an edge."""
    edge = np.roll(hull, -1, 0) - hull
    to_point = np.asarray(point) - hull
    return float(((edge[:, 0] * to_point[:, 1] - edge[:, 1] * to_point[:, 0]) / np.hypot(edge[:, 0], edge[:, 1])).min())
