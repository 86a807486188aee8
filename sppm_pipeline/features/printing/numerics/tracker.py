"""Components of a phase in every half-stack of a print, in one pass: suction cups, resin traps and islands.

Kept between layers are the runs of the last one, the component of each, and a row of numbers for each *open* component,
that is one with runs in the last layer. A step joins the runs of the new layer among themselves, then with those below;
what is joined becomes one open component, numbered in the order of its first run. A component without a successor is
complete: nothing printed later can reach it. So no number grows with the height of the print except the list of events.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.connectivity.runs import Runs
from sppm_pipeline.services.arrays import I32, I64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.union_find import find_root

JOINED, NEVER, AT_PLATE, AT_END = 0, 1, 2, 3
"""Ends of the time in which a component is on its own: joined to what is grounded (a cup is vented, an island caught);
complete without; complete and open only towards the build plate; still open in the last layer."""

MAX_LISTED = 2**18
"""Events kept one by one; of more only the largest are, and the totals of all."""

# columns of the table of open components, and of events behind their kind and their end
_GROUNDED, _PLATE, _BIRTH, _VOLUME, _SECTION, _Z, _Y, _X = range(8)
_COLUMNS = 8


class LayerCount(NamedTuple):
    """A phase in one layer."""

    area: int  # pixels of the phase
    loose: int  # of these, in components of the half-stack that are not grounded
    born: int  # of these, in components that begin in this layer
    components: int  # two-dimensional components of the layer
    largest: int  # pixels of the largest of them
    edges_x: int  # edges of pixels between the phase and the rest along x; the border of the image counts
    edges_y: int  # the same along y


class Events(NamedTuple):
    """Components that were not grounded for some layers, the largest first."""

    kind: I64  # (n,): `JOINED`, `NEVER`, `AT_PLATE` or `AT_END`
    birth: I64  # (n,), first layer
    end: I64  # (n,), the first layer in which it is not there on its own any more
    volume: I64  # (n,), voxels before `end`
    section: I64  # (n,), pixels of the largest section
    place: I64  # (n, 3), a voxel (layer, y, x) of the largest section, in the middle of its longest run
    counts: I64  # (4,), number of all events by kind, listed or not
    totals: I64  # (4,), voxels of all events by kind


class Tracker:
    """Components of one phase in every half-stack; call `add` for each layer from the lowest, then `finish`.

    Solid is grounded by the first layer that holds any. Void is grounded by the border of the image, and by the layer
    below the first solid one if that is open, as with a part that stands on `supports`; a `sealed` plate closes it.
    Layers below the first solid one hold nothing.
    """

    def __init__(self, phase: Literal["solid", "void"], plate: Literal["sealed", "supports"] = "sealed") -> None:
        self._void = phase == "void"
        self._open_below = self._void and plate == "supports"
        self._below: Runs | None = None
        self._table = np.zeros((0, _COLUMNS), np.int64)
        # open component of each run of the last layer, (n,)
        self.of_run = np.zeros(0, np.int32)
        # open component that each one before the last layer became, (m,); -1 if it is complete
        self.successor = np.zeros(0, np.int32)
        self._events = [np.zeros((0, 2 + _COLUMNS), np.int64)]
        self._waiting = 0
        self._count = np.zeros(4, np.int64)
        self._total = np.zeros(4, np.int64)

    @property
    def grounded(self) -> Bools:
        return np.asarray(self._table[:, _GROUNDED], np.bool_)

    @property
    def plate(self) -> Bools:
        """Open components of void that meet the build plate."""
        return np.asarray(self._table[:, _PLATE], np.bool_)

    def add(self, runs: Runs, layer: int) -> LayerCount:
        """Take in the runs of the next layer; the first one is the first that holds solid."""
        _, ny, nx = runs.shape
        first = self._below is None
        below = self._below or Runs((1, ny, nx), np.zeros(ny + 1, np.int64), np.zeros(0, np.int32))
        of_run = np.empty(runs.n_runs, np.int32)
        successor = np.full(len(self._table), -1, np.int32)
        grounds_all = self._open_below if self._void else True
        table, events, counts = _grow(
            runs.rows, runs.bounds, nx, below.rows, below.bounds, self.of_run, self._table, layer,
            self._void, first and grounds_all, first and self._void, of_run, successor,
        )  # fmt: skip
        self._keep(events)
        self._below, self.of_run, self._table, self.successor = runs, of_run, table, successor
        return LayerCount(*(int(count) for count in counts))

    def finish(self, layers: int) -> Events:
        """All events, once the last of so many layers was added."""
        left = self._table[self._table[:, _GROUNDED] == 0]
        kinds = np.full(len(left), AT_END if self._void else NEVER)
        self._keep(np.column_stack([kinds, np.full(len(left), layers), left]))
        e = np.concatenate(self._events)
        e = e[_largest_first(e)]
        b = e[:, 2:]
        return Events(
            e[:, 0], b[:, _BIRTH], e[:, 1], b[:, _VOLUME], b[:, _SECTION], b[:, [_Z, _Y, _X]], self._count, self._total
        )

    def _keep(self, events: I64) -> None:
        if not len(events):
            return
        np.add.at(self._count, events[:, 0], 1)
        np.add.at(self._total, events[:, 0], events[:, 2 + _VOLUME])
        self._events.append(events)
        self._waiting += len(events)
        if self._waiting > MAX_LISTED:
            merged = np.concatenate(self._events)
            self._events, self._waiting = [merged[_largest_first(merged)[:MAX_LISTED]]], 0


def _largest_first(events: I64) -> NDArray[np.intp]:
    """By volume, then by birth and place, so that equal ones have an order too."""
    b = events[:, 2:]
    return np.lexsort((b[:, _X], b[:, _Y], b[:, _Z], b[:, _BIRTH], -b[:, _VOLUME]))


def complement(runs: Runs) -> Runs:
    """The runs of the voxels that are not set, without a scan of the voxels."""
    rows, bounds = _complement(runs.rows, runs.bounds, runs.shape[2])
    return Runs(runs.shape, rows, bounds)


@jit
def _complement(rows: I64, bounds: I32, nx: int) -> tuple[I64, I32]:
    out_rows = np.empty_like(rows)
    out = np.empty(bounds.size + 2 * (rows.size - 1), np.int32)
    n = 0
    for line in range(rows.size - 1):
        out_rows[line] = n // 2
        start = 0
        for r in range(rows[line], rows[line + 1]):
            if bounds[2 * r] > start:
                out[n] = start
                out[n + 1] = bounds[2 * r]
                n += 2
            start = bounds[2 * r + 1]
        if start < nx:
            out[n] = start
            out[n + 1] = nx
            n += 2
    out_rows[rows.size - 1] = n // 2
    return out_rows, out[:n].copy()


@jit
def _join_within(rows: I64, bounds: I32, local: I32) -> int:
    """Point each run at the first one of its two-dimensional component; returns pixels with one of the phase below."""
    shared = 0
    for r in range(rows[0], rows[1]):
        local[r] = r
    for y in range(1, rows.size - 1):
        a, a_stop = rows[y], rows[y + 1]
        b, b_stop = rows[y - 1], rows[y]
        for r in range(a, a_stop):
            local[r] = r
        while a < a_stop and b < b_stop:
            a_end, b_end = bounds[2 * a + 1], bounds[2 * b + 1]
            overlap = min(a_end, b_end) - max(bounds[2 * a], bounds[2 * b])
            if overlap > 0:
                shared += overlap
                if local[a] != local[b]:
                    root_a, root_b = find_root(local, a), find_root(local, b)
                    low = min(root_a, root_b)
                    local[max(root_a, root_b)] = low
                    local[a] = low
            if a_end < b_end:
                a += 1
            else:
                b += 1
    for r in range(bounds.size // 2):
        local[r] = local[local[r]]  # a parent is never after its child
    return shared


@jit
def _join_below(
    rows: I64, bounds: I32, rows_below: I64, bounds_below: I32, of_below: I32, local: I32, touched: I32, forest: I32
) -> None:
    """Unite the open components that a two-dimensional one touches, and note one of them for it."""
    for y in range(rows.size - 1):
        a, a_stop = rows[y], rows[y + 1]
        b, b_stop = rows_below[y], rows_below[y + 1]
        while a < a_stop and b < b_stop:
            a_end, b_end = bounds[2 * a + 1], bounds_below[2 * b + 1]
            if min(a_end, b_end) > max(bounds[2 * a], bounds_below[2 * b]):
                c, other = local[a], of_below[b]
                mine = touched[c]
                if mine < 0:
                    touched[c] = other
                elif mine != other:  # rare: components of the half-stack meet in few places
                    root_a, root_b = find_root(forest, mine), find_root(forest, other)
                    low = min(root_a, root_b)
                    forest[max(root_a, root_b)] = low
                    touched[c] = low
            if a_end < b_end:
                a += 1
            else:
                b += 1


@jit
def _grow(
    rows: I64, bounds: I32, nx: int, rows_below: I64, bounds_below: I32, of_below: I32, table: I64, k: int,
    border_grounds: bool, all_grounded: bool, on_plate: bool, of_run: I32, successor: I32,
) -> tuple[I64, I64, I64]:  # fmt: skip
    """One step: the new table of open components, the events, and the numbers of `LayerCount`."""
    n, m, ny = bounds.size // 2, len(table), rows.size - 1
    local = np.empty(n, np.int32)
    shared = _join_within(rows, bounds, local)
    touched = np.full(n, -1, np.int32)
    forest = np.arange(m).astype(np.int32)
    _join_below(rows, bounds, rows_below, bounds_below, of_below, local, touched, forest)

    # new numbers, in the order of the first run
    label = np.full(m, -1, np.int32)
    n_open = 0
    for r in range(n):
        if local[r] != r:
            of_run[r] = of_run[local[r]]
            continue
        if touched[r] >= 0:
            root = find_root(forest, touched[r])
            if label[root] < 0:
                label[root] = n_open
                n_open += 1
            of_run[r] = label[root]
        else:
            of_run[r] = n_open
            n_open += 1

    # areas: `touched` now sums the pixels of two-dimensional components
    for r in range(n):
        touched[r] = 0
    for r in range(n):
        touched[local[r]] += bounds[2 * r + 1] - bounds[2 * r]
    grown = np.zeros((n_open, _COLUMNS), np.int64)
    section = np.zeros(n_open, np.int64)
    area = components = largest = 0
    for r in range(n):
        if local[r] == r:
            components += 1
            largest = max(largest, touched[r])
            area += touched[r]
            section[of_run[r]] += touched[r]
    for s in range(n_open):
        grown[s, _BIRTH] = k
        grown[s, _GROUNDED] = np.int64(all_grounded)
        grown[s, _PLATE] = np.int64(on_plate)
    if border_grounds:
        for y in range(ny):
            r, stop = rows[y], rows[y + 1]
            if r < stop and bounds[2 * r] == 0:
                grown[of_run[r], _GROUNDED] = 1
            if r < stop and bounds[2 * stop - 1] == nx:
                grown[of_run[stop - 1], _GROUNDED] = 1
            if y == 0 or y == ny - 1:
                for r in range(rows[y], stop):
                    grown[of_run[r], _GROUNDED] = 1

    # what each former component has become
    for c in range(m):
        s = label[find_root(forest, c)]
        successor[c] = s
        if s >= 0:
            grown[s, _GROUNDED] |= table[c, _GROUNDED]
            grown[s, _PLATE] |= table[c, _PLATE]
            grown[s, _BIRTH] = min(grown[s, _BIRTH], table[c, _BIRTH])
            grown[s, _VOLUME] += table[c, _VOLUME]
            if table[c, _SECTION] > grown[s, _SECTION]:
                for column in range(_SECTION, _COLUMNS):
                    grown[s, column] = table[c, column]
    events = np.empty((m, 10), np.int64)
    n_events = 0
    for c in range(m):
        s = successor[c]
        if table[c, _GROUNDED] == 0 and (s < 0 or grown[s, _GROUNDED] == 1):
            events[n_events, 0] = JOINED if s >= 0 else (AT_PLATE if table[c, _PLATE] else NEVER)
            events[n_events, 1] = k
            for column in range(8):
                events[n_events, 2 + column] = table[c, column]
            n_events += 1
    loose = born = 0
    longest = np.zeros(n_open, np.int64)
    for s in range(n_open):
        grown[s, _VOLUME] += section[s]
        longest[s] = nx + 1  # no run is: the place of what is grounded, or was larger before, is never read
        if grown[s, _GROUNDED] == 0:
            loose += section[s]
            if grown[s, _BIRTH] == k:
                born += section[s]
            if section[s] > grown[s, _SECTION]:
                grown[s, _SECTION] = section[s]
                longest[s] = 0
    if loose:
        for y in range(ny):
            for r in range(rows[y], rows[y + 1]):
                s, length = of_run[r], bounds[2 * r + 1] - bounds[2 * r]
                if length > longest[s]:
                    longest[s] = length
                    grown[s, _Z] = k
                    grown[s, _Y] = y
                    grown[s, _X] = (bounds[2 * r] + bounds[2 * r + 1] - 1) // 2
    counts = np.array([area, loose, born, components, largest, 2 * (area - shared), 2 * n])
    return grown, events[:n_events].copy(), counts
