"""The ids of the runs of a layer, and what is done with runs once it is known which of them stay.

See `streaming` for what ids are; the functions here hold no state.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import I32, I64, U64, Bools
from sppm_pipeline.services.bit_rows import clear_span, fill_span
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.union_find import find_root


@inline_jit
def _touched(
    bounds: I32, b: int, b_stop: int, first: int, stop: int, ids: I32, parent: I32, found: int
) -> tuple[int, int]:
    """Unite `found` (-1 for none) and the ids of the runs b <= r < b_stop that overlap first <= x < stop.

    Returns the last of these runs, as the next run may touch it, too, and the smallest of the ids. Runs that end before
    are passed over.
    """
    while b < b_stop and bounds[2 * b + 1] <= first:
        b += 1
    k = b
    while k < b_stop and bounds[2 * k] < stop:
        other = int(np.int64(ids[k]))
        if other != found:
            if found < 0:
                found = other
            else:
                other, found = find_root(parent, other), find_root(parent, found)
                # the smaller id stays, as ids follow the order of first voxels
                if other < found:
                    parent[found] = other
                    found = other
                elif found < other:
                    parent[other] = found
        k += 1
    return max(b, k - 1), found


@jit
def _unite_with(bounds: I32, b: int, b_stop: int, a: int, ids: I32, parent: I32) -> None:
    """Unite the id of a run with those of the runs b <= r < b_stop of another row that it touches."""
    first, stop = bounds[2 * a], bounds[2 * a + 1]
    low, high = b, b_stop  # the first run that ends behind `first` is sought by halves
    while low < high:
        middle = (low + high) // 2
        if bounds[2 * middle + 1] <= first:
            low = middle + 1
        else:
            high = middle
    _touched(bounds, low, b_stop, first, stop, ids, parent, int(np.int64(ids[a])))


@jit
def layer_ids(
    rows: I64,
    bounds: I32,
    rows_below: I64,
    bounds_below: I32,
    ids_below: I32,
    ids: I32,
    parent: I32,
    voxels: I64,
    boxes: I32,
    known: int,
    largest: int,
    z: int,
    counting: bool,
) -> tuple[int, int]:
    """Write the id of each run of a layer into `ids`; returns the number of ids so far, and the one with most voxels.

    `known` is that number before the layer. No run has an id that is known to be one with a smaller one.
    """
    n_ids = known
    # Runs of the largest component so far need not be compared with each other: others are, which are few.
    main = find_root(parent, largest) if known > 0 else int(np.int64(-1))
    others = np.empty(ids.size, np.int32)
    n_others, n_before = 0, 0  # those of this row are the last ones, those of the row before come before them
    for y in range(rows.size - 1):
        n_row = 0
        b, b_stop = rows_below[y], rows_below[y + 1]
        for a in range(rows[y], rows[y + 1]):
            found = int(np.int64(-1))
            b, found = _touched(bounds_below, b, b_stop, bounds[2 * a], bounds[2 * a + 1], ids_below, parent, found)
            if found < 0:
                found = n_ids
                parent[n_ids] = n_ids
                n_ids += 1
            ids[a] = found
            # the rest is one with the largest component already
            if found != main:
                others[n_others] = a
                n_others += 1
                n_row += 1
        if y > 0:
            before, here = rows[y - 1], rows[y]
            after = rows[y + 1]
            # a search by halves pays where few runs are loose
            if 8 * (n_row + n_before) > after - before:
                for a in range(here, after):
                    first, stop = bounds[2 * a], bounds[2 * a + 1]
                    before, _ = _touched(bounds, before, here, first, stop, ids, parent, int(np.int64(ids[a])))
            else:
                for i in range(n_others - n_row - n_before, n_others - n_row):
                    _unite_with(bounds, here, after, others[i], ids, parent)
                for i in range(n_others - n_row, n_others):
                    _unite_with(bounds, before, here, others[i], ids, parent)
        n_before = n_row
    # New ids that are one with another are given up; a smaller id never has a larger one as its parent.
    stays = np.empty(n_ids - known, np.int32)
    left = known
    for i in range(known, n_ids):
        root = find_root(parent, i)
        if root == i:
            stays[i - known] = left
            left += 1
        else:
            stays[i - known] = root if root < known else stays[root - known]
    for i in range(known, left):
        parent[i] = i
        if counting:
            voxels[i] = 0
            boxes[i, 0] = boxes[i, 2] = boxes[i, 4] = 2147483647
            boxes[i, 1] = boxes[i, 3] = boxes[i, 5] = -1
    # Nearly all runs are of one id: what it gathers is held in these, and written down when another one comes.
    held, count, x_low, x_high, y_low, y_high = -1, 0, 0, 0, 0, 0
    for y in range(rows.size - 1):
        for a in range(rows[y], rows[y + 1]):
            i = int(np.int64(ids[a]))
            i = find_root(parent, i) if i < known else int(np.int64(stays[i - known]))
            ids[a] = i
            if not counting:
                continue
            if i != held:
                if held >= 0:
                    _gather(voxels, boxes, held, count, x_low, x_high, y_low, y_high, z)
                    if voxels[held] > voxels[largest]:
                        largest = held
                held, count, y_low = i, 0, y
                x_low, x_high = bounds[2 * a], bounds[2 * a + 1]
            count += bounds[2 * a + 1] - bounds[2 * a]
            x_low, x_high, y_high = min(x_low, bounds[2 * a]), max(x_high, bounds[2 * a + 1]), y
    if held >= 0:
        _gather(voxels, boxes, held, count, x_low, x_high, y_low, y_high, z)
        if voxels[held] > voxels[largest]:
            largest = held
    return left, largest


@inline_jit
def _gather(
    voxels: I64, boxes: I32, i: int, count: int, x_low: int, x_high: int, y_low: int, y_high: int, z: int
) -> None:
    """Add to an id's voxels and box those of some runs of layer z; x_high is the voxel after the last."""
    voxels[i] += count
    box = boxes[i]
    box[0], box[1] = min(box[0], x_low), max(box[1], x_high - 1)
    box[2], box[3] = min(box[2], y_low), max(box[3], y_high)
    box[4], box[5] = min(box[4], z), z


@jit
def list_loose(rows: I64, bounds: I32, ids: I32, main: int, loose: I32) -> None:
    n = 0
    for y in range(rows.size - 1):
        for r in range(rows[y], rows[y + 1]):
            if ids[r] != main:
                loose[n, 0], loose[n, 1], loose[n, 2], loose[n, 3] = y, bounds[2 * r], bounds[2 * r + 1], ids[r]
                n += 1


@jit
def still_loose(ids: I32, parent: I32, main: int) -> Bools:
    still = np.empty(ids.size, np.bool_)
    for i in range(ids.size):
        still[i] = find_root(parent, ids[i]) != main
    return still


@jit
def clear_runs(rows: I64, bounds: I32, keep: Bools, layer: U64) -> None:
    """Take the runs that are not kept out of a layer (ny, words)."""
    for y in range(layer.shape[0]):
        for r in range(rows[y], rows[y + 1]):
            if not keep[r]:
                clear_span(layer[y], bounds[2 * r], bounds[2 * r + 1])


@jit
def set_runs(runs: I32, value: bool, layer: U64) -> None:
    """Set or clear runs (row, first voxel, the one after the last, id) of a layer (ny, words)."""
    for i in range(runs.shape[0]):
        if value:
            fill_span(layer[runs[i, 0]], runs[i, 1], runs[i, 2])
        else:
            clear_span(layer[runs[i, 0]], runs[i, 1], runs[i, 2])
