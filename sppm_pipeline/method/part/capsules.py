"""Capsules, balls swept along segments: the holes by which a part drains."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from sppm_pipeline.services.arrays import F32, F64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit

Window = tuple[slice, slice, slice]


def depths_in_capsules(
    grid: Grid, capsules: Sequence[Sequence[float]] | F64, margin: float = 0.0
) -> Iterator[tuple[Window, F32]]:
    """Windows (slices along z, y, x) that hold samples in capsules, with their depths (nz, ny, nx).

    Capsules (n, 7) are both ends (x, y, z) of a segment and the radius. Depths are the radius minus the distance from
    the segment, positive inside, and include samples outside up to the margin; the same bits however the grid is cut
    into layers.
    """
    rows = np.reshape(np.asarray(capsules, np.float64), (-1, 7))
    heights, reach = rows[:, [2, 5]], rows[:, 6] + margin
    low, high = grid.origin[2], grid.origin[2] + grid.spacing[2] * grid.shape[2]
    near = (heights.min(1, initial=np.inf) - reach <= high) & (heights.max(1, initial=-np.inf) + reach >= low)
    for row in rows[near]:
        a, b, radius = row[:3], row[3:6], float(row[6])
        window = []
        for axis in (2, 1, 0):
            lowest, highest = min(a[axis], b[axis]) - radius - margin, max(a[axis], b[axis]) + radius + margin
            first = math.floor((lowest - grid.origin[axis]) / grid.spacing[axis])
            last = math.ceil((highest - grid.origin[axis]) / grid.spacing[axis])
            window.append(slice(max(0, first), max(0, min(grid.shape[axis], last + 1))))
        z, y, x = (
            grid.axis(axis)[one].reshape([-1 if i == 2 - axis else 1 for i in range(3)])
            for axis, one in zip((2, 1, 0), window, strict=True)
        )
        if not (z.size and y.size and x.size):
            continue
        offset, along = (x - a[0], y - a[1], z - a[2]), b - a
        length2 = float(along @ along)
        dot = offset[0] * along[0] + offset[1] * along[1] + offset[2] * along[2]
        t = np.clip(dot / length2, 0, 1) if length2 else np.zeros_like(dot)
        squares = [(o - t * d) ** 2 for o, d in zip(offset, along, strict=True)]
        yield (
            (window[0], window[1], window[2]),
            (radius - np.sqrt(squares[0] + squares[1] + squares[2])).astype(np.float32),
        )


def fill_capsules(grid: Grid, capsules: F64, margin: float, edge: np.float32, field: F32) -> None:
    """Lower a field (nz, ny, nx) to the distance from capsules (n, 7) over an edge, near them; in place.

    The same as by `depths_in_capsules`, of which thousands would take long.
    """
    _fill(capsules, np.array(grid.origin), np.array(grid.spacing), margin, edge, field)


@jit
def _fill(capsules: F64, origin: F64, spacing: F64, margin: float, edge: np.float32, field: F32) -> None:
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    along = np.empty(3)
    for n in range(capsules.shape[0]):
        a, b, radius = capsules[n, :3], capsules[n, 3:6], capsules[n, 6]
        length2 = 0.0
        for axis in range(3):
            along[axis] = b[axis] - a[axis]
            length2 += along[axis] * along[axis]
            lowest, highest = min(a[axis], b[axis]) - radius - margin, max(a[axis], b[axis]) + radius + margin
            first[axis] = max(0, int(np.floor((lowest - origin[axis]) / spacing[axis])))
            last[axis] = min(field.shape[2 - axis], int(np.ceil((highest - origin[axis]) / spacing[axis])) + 1)
        for k in range(first[2], last[2]):
            z = origin[2] + k * spacing[2] - a[2]
            for j in range(first[1], last[1]):
                y = origin[1] + j * spacing[1] - a[1]
                for i in range(first[0], last[0]):
                    x = origin[0] + i * spacing[0] - a[0]
                    dot = x * along[0] + y * along[1] + z * along[2]
                    t = min(max(dot / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
                    square = (x - t * along[0]) ** 2 + (y - t * along[1]) ** 2 + (z - t * along[2]) ** 2
                    away = np.float32(np.sqrt(square) - radius) / edge
                    field[k, j, i] = min(field[k, j, i], away)
