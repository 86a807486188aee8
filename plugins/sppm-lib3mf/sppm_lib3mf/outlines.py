"""Outlines of pixels: the closed polygons between solid and void, whose corners are corners of pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def outlines(solid: NDArray[np.bool_]) -> list[NDArray[np.int32]]:
    """Outlines of the solid pixels of a layer (ny, nx), y increasing: corners (n, 2) int32 as (x, y) in pixels.

    The solid lies to the left; the first corner is not repeated. A corner has one side along x and one along y. Sorted
    along a line of the grid, corners are the ends of sides two by two, so that both partners of each follow from two
    sorts. Where two solid pixels meet at a corner only, two corners stand at one place, and their order distinguishes
    them.
    """
    ringed = np.pad(solid, 1).astype(np.uint8)
    low_left, low_right, high_left, high_right = ringed[:-1, :-1], ringed[:-1, 1:], ringed[1:, :-1], ringed[1:, 1:]
    kind = low_left | low_right << 1 | high_left << 2 | high_right << 3
    count = low_left + low_right + high_left + high_right
    rising, falling = kind == 0b1001, kind == 0b0110  # the two diagonals
    y, x = np.nonzero((count % 2 == 1) | rising | falling)
    twice = (rising | falling)[y, x]
    x, y = np.repeat(x, 1 + twice), np.repeat(y, 1 + twice)
    second = np.zeros(len(x), bool)  # of two corners at one place, the first has its side along x to the left
    second[1:] = (x[1:] == x[:-1]) & (y[1:] == y[:-1])
    up = second == rising[y, x]  # and its side along y upwards if the diagonal falls
    by_row, by_column = np.lexsort((second, x, y)), np.lexsort((up, y, x))
    across, along = np.empty(len(x), np.int64), np.empty(len(x), np.int64)
    across[by_row[::2]], across[by_row[1::2]] = by_row[1::2], by_row[::2]
    along[by_column[::2]], along[by_column[1::2]] = by_column[1::2], by_column[::2]
    partners = (across.tolist(), along.tolist())
    starts_right = high_right[y, x] > 0  # at the lowest left corner of an outline: solid above its side along x
    seen = [False] * len(x)
    found = []
    for first in by_row.tolist():
        if seen[first]:
            continue
        ring, corner, turn = [], first, 0 if starts_right[first] else 1
        while not seen[corner]:
            seen[corner] = True
            ring.append(corner)
            corner = partners[turn][corner]
            turn = 1 - turn
        found.append(np.column_stack([x[ring], y[ring]]).astype(np.int32))
    return found
