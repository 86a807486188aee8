"""Distances from struts, blended where they meet, evaluated at grids of points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import jit
from sppm_structures.graphs import StrutGraph, images

LEVELS = 4
BUCKETS = 1 << LEVELS
"""Buckets of the cell along each axis; a sample looks only at the struts listed for its bucket."""

RUN, ROWS = 32, 8
"""Most samples of a row, and most rows, that are done together."""

REACH = 4.0
"""Struts further away than the nearest by this many blend lengths have no part in the blend."""


class StrutTable(NamedTuple):
    """Struts sorted into buckets of the cell.

    `struts` (m, 8): start, end, radius at the start, radius at the end, cell sizes. The list of each bucket lies in
    `listed` (n,), from `begin` to `end` (BUCKETS^3,).
    """

    struts: NDArray[np.float64]
    begin: NDArray[np.int64]
    end: NDArray[np.int64]
    listed: NDArray[np.int32]


def strut_table(graph: StrutGraph, radius: float, blend: float) -> StrutTable:
    """Sort struts of some mean radius, and those of the neighboring cells, into buckets, for a blend length.

    All in cell sizes.
    """
    # no point of the cell is further than this from the nearest strut
    spread = images(graph, 1.0)
    struts = np.column_stack([spread.starts, spread.ends, radius * spread.start_radii, radius * spread.end_radii])
    return table_of_struts(struts, blend)


def table_of_struts(struts: NDArray[np.float64], blend: float) -> StrutTable:
    """Sort struts into buckets: (m, 8) as in `StrutTable`, those of the neighboring cells included.

    A list holds every strut that can matter to any point of its bucket, so that the value at a point does not depend on
    the grid that it belongs to.
    """
    struts = np.ascontiguousarray(struts, np.float64)
    return StrutTable(struts, *_list(struts, np.float64(blend * REACH)))


def evaluate_struts(
    table: StrutTable, blend: float, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Blended distance from the surface of the struts, (nx, ny, nz) float32, cell sizes; x is contiguous in memory.

    Positions lie in the cell, 0 <= x < 1; `blend` is 0 for sharp joints.
    """
    values = np.empty((len(z), len(y), len(x)), np.float32)
    _evaluate(table.struts, table.begin, table.end, table.listed, np.float64(blend), x, y, z, values)
    return values.T


@jit
def _distance(struts: NDArray[np.float64], s: int, x: float, y: float, z: float) -> float:
    """From the surface of a round cone, measured across its axis."""
    dx, dy, dz = struts[s, 3] - struts[s, 0], struts[s, 4] - struts[s, 1], struts[s, 5] - struts[s, 2]
    px, py, pz = x - struts[s, 0], y - struts[s, 1], z - struts[s, 2]
    along = (px * dx + py * dy + pz * dz) / (dx * dx + dy * dy + dz * dz)
    along = min(1.0, max(0.0, along))
    px, py, pz = px - along * dx, py - along * dy, pz - along * dz
    distance: float = np.sqrt(px * px + py * py + pz * pz) - (struts[s, 6] + along * (struts[s, 7] - struts[s, 6]))
    return distance


@jit
def place_of(morton: int, level: int) -> tuple[int, int, int]:
    """Indices of a bucket from the interleaved bits of its number, or of the block of 2^level buckets that it is in."""
    i, j, k = 0, 0, 0
    for bit in range(level, LEVELS):
        i |= (morton >> (3 * bit) & 1) << bit
        j |= (morton >> (3 * bit + 1) & 1) << bit
        k |= (morton >> (3 * bit + 2) & 1) << bit
    return i, j, k


@jit
def longer(listed: NDArray[np.int32], wanted: int) -> NDArray[np.int32]:
    """The same list with room for `wanted` entries and more."""
    copy = np.empty(2 * wanted, np.int32)
    for at in range(len(listed)):
        copy[at] = listed[at]
    return copy


@jit
def _list(struts: NDArray[np.float64], margin: float) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
    """The struts of each bucket: where its list begins and ends.

    Octants are listed first, then their octants, and so on, each from the list of the one that it is in.
    """
    begin, end = np.empty(BUCKETS**3, np.int64), np.empty(BUCKETS**3, np.int64)
    listed = np.empty(64 * BUCKETS**3, np.int32)
    total = 0
    distances = np.empty(len(struts))
    near = np.empty((LEVELS + 1, len(struts)), np.int64)
    count = np.zeros(LEVELS + 1, np.int64)
    # how fast a distance can change: a cone's also by its radius
    steep = 1.0
    for s in range(len(struts)):
        near[LEVELS, s] = s
        squared = 0.0
        for c in range(3):
            squared += (struts[s, 3 + c] - struts[s, c]) ** 2
        steep = max(steep, 1.0 + abs(struts[s, 7] - struts[s, 6]) / np.sqrt(squared))
    count[LEVELS] = len(struts)
    for morton in range(BUCKETS**3):
        for level in range(LEVELS - 1, -1, -1):
            # a block is listed when its first bucket comes, and serves all of its buckets
            if morton % (1 << (3 * level)) != 0:
                continue
            i, j, k = place_of(morton, level)
            half = 0.5 * (1 << level)
            x, y, z = (i + half) / BUCKETS, (j + half) / BUCKETS, (k + half) / BUCKETS
            nearest = np.inf
            for at in range(count[level + 1]):
                s = near[level + 1, at]
                distances[s] = _distance(struts, s, x, y, z)
                nearest = min(nearest, distances[s])
            # half a diagonal from the center, nearest and limit both change by `steep` times as much at most
            limit = nearest + 2.0 * steep * np.sqrt(3.0) * half / BUCKETS + margin + 1e-12
            count[level] = 0
            for at in range(count[level + 1]):
                s = near[level + 1, at]
                if distances[s] <= limit:
                    near[level, count[level]] = s
                    count[level] += 1
        i, j, k = place_of(morton, 0)
        bucket = (k * BUCKETS + j) * BUCKETS + i
        if total + count[0] > len(listed):
            listed = longer(listed, total + count[0])
        begin[bucket] = total
        for at in range(count[0]):
            listed[total + at] = near[0, at]
        total += count[0]
        end[bucket] = total
    return begin, end, listed[:total].copy()


@jit
def _evaluate(
    struts: NDArray[np.float64],
    begin: NDArray[np.int64],
    end: NDArray[np.int64],
    listed: NDArray[np.int32],
    blend: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    values: NDArray[np.float32],
) -> None:
    """The nearest distance, or a smooth minimum: -b log(sum w((d - nearest) / b)) + nearest.

    The weight w(t) = (1 - t / 4)^4, 0 from t = 4 on, stands for exp(-t), with which this would be the usual smooth
    minimum; it keeps struts that are far apart from touching each other's value, and costs no power.

    The samples of some rows that share a bucket are done together, strut by strut: a loop over the few samples of one
    row would take longer to begin than to run.
    """
    longest = 0
    for bucket in range(BUCKETS**3):
        longest = max(longest, end[bucket] - begin[bucket])
    distances = np.empty((longest, RUN * ROWS))
    nearest, total = np.empty(RUN * ROWS), np.empty(RUN * ROWS)
    at_x, at_y = np.empty(RUN * ROWS), np.empty(RUN * ROWS)
    fade = 1.0 / (REACH * blend) if blend > 0.0 else 0.0
    for k in range(len(z)):
        bz = int(z[k] * BUCKETS)
        j = 0
        while j < len(y):
            by = int(y[j] * BUCKETS)
            last = j + 1
            while last < len(y) and last < j + ROWS and int(y[last] * BUCKETS) == by:
                last += 1
            i = 0
            while i < len(x):
                bx = int(x[i] * BUCKETS)
                stop = i + 1
                while stop < len(x) and stop < i + RUN and int(x[stop] * BUCKETS) == bx:
                    stop += 1
                bucket = (bz * BUCKETS + by) * BUCKETS + bx
                start, count = begin[bucket], end[bucket] - begin[bucket]
                number = 0
                for row in range(j, last):
                    for n in range(i, stop):
                        at_x[number], at_y[number] = x[n], y[row]
                        nearest[number], total[number] = np.inf, 0.0
                        number += 1
                # the nearest of all has to be known before shares are added, so distances are kept
                for at in range(count):
                    _distances(struts, listed[start + at], at_x, at_y, z[k], number, distances, at, nearest)
                if blend > 0.0:
                    for at in range(count):
                        _add_shares(distances, at, number, nearest, fade, total)
                number = 0
                for row in range(j, last):
                    for n in range(i, stop):
                        value = nearest[number]
                        # one strut alone has the share 1, whose logarithm is 0
                        if total[number] > 1.0:
                            value -= blend * np.log(total[number])
                        values[k, row, n] = np.float32(value)
                        number += 1
                i = stop
            j = last


@jit
def _distances(
    struts: NDArray[np.float64],
    s: int,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: float,
    number: int,
    distances: NDArray[np.float64],
    at: int,
    nearest: NDArray[np.float64],
) -> None:
    """As `_distance`, for a number of samples of a layer; `nearest` is lowered to what is less."""
    sx, sy, r, dr = struts[s, 0], struts[s, 1], struts[s, 6], struts[s, 7] - struts[s, 6]
    dx, dy, dz = struts[s, 3] - sx, struts[s, 4] - sy, struts[s, 5] - struts[s, 2]
    pz = z - struts[s, 2]
    inverse = 1.0 / (dx * dx + dy * dy + dz * dz)
    for n in range(number):
        px, py = x[n] - sx, y[n] - sy
        along = (px * dx + (py * dy + pz * dz)) * inverse
        # selections without branches, so that the compiler may take several samples at once
        along = along if along > 0.0 else 0.0
        along = along if along < 1.0 else 1.0
        qx, qy, qz = px - along * dx, py - along * dy, pz - along * dz
        distance = np.sqrt(qx * qx + qy * qy + qz * qz) - (r + along * dr)
        distances[at, n] = distance
        nearest[n] = distance if distance < nearest[n] else nearest[n]


@jit
def _add_shares(
    distances: NDArray[np.float64],
    at: int,
    count: int,
    nearest: NDArray[np.float64],
    fade: float,
    total: NDArray[np.float64],
) -> None:
    for n in range(count):
        share = 1.0 - (distances[at, n] - nearest[n]) * fade
        share = share if share > 0.0 else 0.0
        share *= share
        total[n] += share * share
