"""Outlines of a layer: closed polygons along the sides of its pixels, or through values at their middles."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import F64, I32, I64, Bools


def outlines(solid: Bools) -> list[I32]:
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


def level_lines(values: F64, level: float) -> list[F64]:
    """Lines at a level through the middles of pixels (ny, nx), y increasing: (n, 2) as (x, y) in pixels, closed.

    What is above lies to the left, and void is around; the first point is not repeated. Points are interpolated between
    the middles of neighbors; where two of four pixels that meet are above, across from each other, they are apart
    (marching squares; Lorensen and Cline 1987 in the plane).
    """
    around = np.pad(values, 1, constant_values=min(0.0, float(values.min(initial=0.0))))
    above = around > level
    ny, nx = around.shape
    across = np.arange(ny * nx).reshape(ny, nx)  # numbers of the lines to the right of each middle, then of those up
    along = across + ny * nx
    lines = (across[:-1, :-1], along[:-1, 1:], across[1:, :-1], along[:-1, :-1])  # of a square, counterclockwise
    corners = (above[:-1, :-1], above[:-1, 1:], above[1:, 1:], above[1:, :-1])
    # a segment starts where one leaves what is above, counterclockwise, and ends where one entered it last
    leaves = [corners[k] & ~corners[(k + 1) % 4] for k in range(4)]
    enters = [~corners[k] & corners[(k + 1) % 4] for k in range(4)]
    following = np.full(2 * ny * nx, -1, np.int64)
    for k in range(4):
        ends = np.select([enters[k - 1], enters[k - 2]], [lines[k - 1], lines[k - 2]], lines[k - 3])
        following[lines[k][leaves[k]]] = ends[leaves[k]]
    crossed = np.flatnonzero(following >= 0)
    y, x = np.divmod(crossed % (ny * nx), nx)
    up = crossed >= ny * nx
    near, far = around[y, x], around[y + up, x + ~up]
    part = (level - near) / (far - near)
    points = np.column_stack([x + np.where(up, 0.0, part), y + np.where(up, part, 0.0)]) - 0.5
    return [points[ring] for ring in _rings(np.searchsorted(crossed, following[crossed]))]


def _rings(following: I64) -> list[list[int]]:
    """The cycles of a permutation, each from its smallest number on."""
    after, seen, found = following.tolist(), bytearray(len(following)), []
    for first in range(len(after)):
        ring, number = [], first
        while not seen[number]:
            seen[number] = 1
            ring.append(number)
            number = after[number]
        if ring:
            found.append(ring)
    return found
