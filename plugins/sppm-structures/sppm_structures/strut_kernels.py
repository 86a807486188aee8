"""Distances from struts, blended where they meet, evaluated at grids of points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import kernel
from sppm_structures.graphs import StrutGraph, images

__all__ = ["StrutTable", "evaluate_struts", "strut_table"]

BUCKETS = 16
"""Buckets of the cell along each axis; a sample looks only at the struts listed for its bucket."""

REACH = 4.0
"""Struts further away than the nearest by this many blend lengths have no part in the blend."""


class StrutTable(NamedTuple):
    """Struts sorted into buckets of the cell.

    Attributes
    ----------
    struts : (m, 8) float64
        Start, end, radius at the start, radius at the end, cell edges.
    first : (BUCKETS^3 + 1,) int64
        Where the list of each bucket begins.
    listed : (n,) int32
        Struts of the lists.
    """

    struts: NDArray[np.float64]
    first: NDArray[np.int64]
    listed: NDArray[np.int32]


def strut_table(graph: StrutGraph, radius: float, blend: float) -> StrutTable:
    """Sort struts of some mean radius into buckets, for a blend length; all in cell edges.

    A list holds every strut that can matter to any point of its bucket, so that the value at a point does not depend on
    the grid that it belongs to.
    """
    # no point of the cell is further than this from the nearest strut
    spread = images(graph, 1.0)
    struts = np.column_stack([spread.starts, spread.ends, radius * spread.start_radii, radius * spread.end_radii])
    count = np.zeros(BUCKETS**3 + 1, np.int64)
    listed = np.empty(0, np.int32)
    _list(struts, blend * REACH, count, listed, False)
    first = np.cumsum(count)
    listed = np.empty(first[-1], np.int32)
    _list(struts, blend * REACH, first.copy(), listed, True)
    return StrutTable(struts, first, listed)


def evaluate_struts(
    table: StrutTable, blend: float, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Blended distance from the surface of the struts, (nz, ny, nx) float32, cell edges.

    Parameters
    ----------
    table : StrutTable
    blend : float
        0 for sharp joints.
    x, y, z : (nx,), (ny,), (nz,) float64
        Positions in the cell, 0 <= x < 1.
    """
    values = np.empty((len(z), len(y), len(x)), np.float32)
    _evaluate(table.struts, table.first, table.listed, np.float64(blend), x, y, z, values)
    return values


@kernel
def _distance(strut: NDArray[np.float64], x: float, y: float, z: float) -> float:
    """From the surface of a round cone, measured across its axis."""
    dx, dy, dz = strut[3] - strut[0], strut[4] - strut[1], strut[5] - strut[2]
    px, py, pz = x - strut[0], y - strut[1], z - strut[2]
    along = (px * dx + py * dy + pz * dz) / (dx * dx + dy * dy + dz * dz)
    along = min(1.0, max(0.0, along))
    px, py, pz = px - along * dx, py - along * dy, pz - along * dz
    return np.sqrt(px * px + py * py + pz * pz) - (strut[6] + along * (strut[7] - strut[6]))


@kernel
def _list(
    struts: NDArray[np.float64], margin: float, first: NDArray[np.int64], listed: NDArray[np.int32], fill: bool
) -> None:
    """Count the struts of each bucket (into the place after it), or write them down."""
    half = 0.5 / BUCKETS
    distances = np.empty(len(struts))
    # how fast a distance can change: a cone's also by its radius
    steep = 1.0
    for strut in struts:
        length = np.sqrt((strut[3] - strut[0]) ** 2 + (strut[4] - strut[1]) ** 2 + (strut[5] - strut[2]) ** 2)
        steep = max(steep, 1.0 + abs(strut[7] - strut[6]) / length)
    reach = 2 * steep * half * np.sqrt(3.0) + margin + 1e-12
    for bucket in range(BUCKETS**3):
        x = (bucket % BUCKETS) / BUCKETS + half
        y = (bucket // BUCKETS % BUCKETS) / BUCKETS + half
        z = (bucket // BUCKETS**2) / BUCKETS + half
        nearest = np.inf
        for s in range(len(struts)):
            distances[s] = _distance(struts[s], x, y, z)
            nearest = min(nearest, distances[s])
        for s in range(len(struts)):
            if distances[s] <= nearest + reach:
                if fill:
                    listed[first[bucket]] = s
                    first[bucket] += 1
                else:
                    first[bucket + 1] += 1


@kernel
def _evaluate(
    struts: NDArray[np.float64],
    first: NDArray[np.int64],
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
    """
    distances = np.empty(len(listed))
    for k in range(len(z)):
        bz = int(z[k] * BUCKETS)
        for j in range(len(y)):
            by = int(y[j] * BUCKETS)
            for i in range(len(x)):
                bucket = (bz * BUCKETS + by) * BUCKETS + int(x[i] * BUCKETS)
                start, count = first[bucket], first[bucket + 1] - first[bucket]
                nearest = np.inf
                for at in range(count):
                    distances[at] = _distance(struts[listed[start + at]], x[i], y[j], z[k])
                    nearest = min(nearest, distances[at])
                if blend > 0.0:
                    total = 0.0
                    for at in range(count):
                        share = 1.0 - (distances[at] - nearest) / (REACH * blend)
                        if share > 0.0:
                            total += share * share * share * share
                    if total > 1.0:
                        nearest -= blend * np.log(total)
                values[k, j, i] = np.float32(nearest)
