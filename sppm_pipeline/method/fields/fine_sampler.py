"""A sum of kernels on a fine grid, interpolated from the sum on a coarse one."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise, product
from threading import Lock
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.assembly.occupancy import spans_in_any
from sppm_pipeline.services.arrays import F32, I32, U8
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.interpolation import (
    BEFORE,
    BLOCK,
    TAPS,
    Band,
    band_of,
    interpolate_layers,
    stretch,
    taps_at,
)
from sppm_pipeline.services.threads import share_out

if TYPE_CHECKING:
    from sppm_pipeline.method.fields.kernel_sum import KernelSum, Patches

CHUNK_SAMPLES = 2**22
"""Samples of coarse planes that are summed and kept at a time, two such chunks at once. Of 16 MB, whose memory is used
again; that of larger ones comes fresh from the system, which takes as long as to fill it."""

LEAST_PLANES = 8
"""Coarse planes of a chunk at the least, so that kernels are not listed again for each plane."""

BAND_SAMPLES = 2**15
"""Samples of a coarse plane, stretched along x, whose rows are interpolated at a time, layer after layer, so that the
planes between them stay in the cache: the six of a layer take 768 kB."""

MARGIN = BEFORE + 1
"""Coarse samples beyond the lattice that are summed with its outermost cells."""


NEARBY = 4
"""Coarse rows beyond those wanted whose patches are added up as well, as the next layers may want them."""


class Span(NamedTuple):
    """Coarse samples along one axis that are summed together: those of a cell, with its margin at the border."""

    first: int
    samples: int
    own: list[tuple[slice, slice]]
    """Positions in the window: places among the samples of the span, and in the window."""


class FineSampler:
    """A sum of kernels on one fine grid (cell sizes); what all layers need is prepared once.

    The last coarse planes are kept; threads that ask for layers at once take turns. The coarse grid, with `per_cell`
    samples along a cell edge, has its origin at that of the lattice and divides the cells, and its samples are summed
    cell by cell: a sample depends on its position alone, neither on the grid it belongs to nor on what else is asked
    for. The field is not kept.
    """

    def __init__(self, field: KernelSum, grid: Grid, per_cell: int) -> None:
        self.of = grid, per_cell
        self._n = per_cell
        self._taps = [taps_at(grid.axis(axis) * per_cell) for axis in range(3)]
        self._band = band_of(self._taps[0])
        self._window = [range(int(taps.first[0]), int(taps.first[-1]) + TAPS) for taps in self._taps]
        self._spans = [
            _spans(window, per_cell, cells, field.periodic)
            for window, cells in zip(self._window[:2], field.cells[:2], strict=True)
        ]
        plane = grid.shape[0] * len(self._window[1])
        self._height = max(LEAST_PLANES, min(per_cell + 2 * MARGIN, CHUNK_SAMPLES // plane))
        rows = max(TAPS, BAND_SAMPLES // grid.shape[0])
        self._band_rows = max(1, rows * grid.shape[1] // len(self._window[1]))
        self._chunks: dict[int, _Chunk] = {}
        self._rooms: list[NDArray[np.float32]] = []
        self._sums = np.zeros((0, 0, 0), np.float32)
        self._lock = Lock()

    def sample(
        self,
        field: KernelSum,
        start: int,
        stop: int,
        threads: int,
        wanted: I32 | None,
        values: F32 | None,
        solid: U8 | None,
    ) -> None:
        """Write the field, or whether it is solid, in the layers start <= k < stop into one of the last arguments."""
        with self._lock:  # planes are kept from call to call
            nx, ny, nz = self.of[0].shape
            if wanted is None:
                wanted = np.tile(np.array([0, nx], np.int32), (stop - start, ny, 1))
            spans, (_, y, z), level = wanted, self._taps, field.solid_below
            for first, last in self._groups(start, stop):
                own = slice(first - start, last - start)
                low, *more = self._chunks_of(field, first, last, spans[own], threads)

                def work(
                    row: int,
                    layers: slice = slice(first, last),
                    own: slice = own,
                    low: _Chunk = low,
                    high: _Chunk = more[0] if more else low,
                ) -> None:
                    interpolate_layers(
                        low.stretched,
                        high.stretched,
                        z.first[layers] - low.planes.start,
                        z.weights[layers],
                        y,
                        level,
                        range(row, min(row + self._band_rows, ny)),
                        spans[own],
                        None if values is None else values[own],
                        None if solid is None else solid[own],
                    )

                share_out(work, range(0, ny, self._band_rows), threads)
            if stop == nz:
                self._chunks, self._rooms, self._sums = {}, [], np.zeros((0, 0, 0), np.float32)

    def _groups(self, start: int, stop: int) -> list[tuple[int, int]]:
        """Runs of layers that are interpolated from the same chunks."""
        low = self._taps[2].first[start:stop] + MARGIN
        changes = (np.diff(low // self._height) != 0) | (np.diff((low + TAPS - 1) // self._height) != 0)
        return list(pairwise([start, *(int(c) + 1 + start for c in np.flatnonzero(changes)), stop]))

    def _chunks_of(self, field: KernelSum, first: int, last: int, wanted: I32, threads: int) -> list[_Chunk]:
        """The one or two chunks for layers first <= k < last, with all samples that the wanted ones depend on."""
        low, high = (int(self._taps[2].first[layer]) for layer in (first, last - 1))
        high += TAPS - 1
        x, y, z = self._window
        numbers = range((low + MARGIN) // self._height, (high + MARGIN) // self._height + 1)
        for c in set(self._chunks) - set(numbers):  # fresh memory takes longer to get than to fill
            self._rooms.append(self._chunks.pop(c).room)
        for c in set(numbers) - set(self._chunks):
            first = c * self._height - MARGIN
            planes = range(max(first, z.start), min(first + self._height, z.stop))
            room = self._rooms.pop() if self._rooms else self._new_room(len(self._band.first) * BLOCK)
            self._chunks[c] = _Chunk(planes, x, y, self._band, room)
        chunks = [self._chunks[c] for c in numbers]
        if (patches := field.patches(self._n, 0.0, threads)) is not None:
            rows = self._coarse_rows(spans_in_any(wanted))
            for chunk in chunks:
                chunk.add_patches(patches, rows, self._scratch, threads)
        else:
            columns = self._columns(wanted)
            for chunk in chunks:
                chunk.sum_columns(field, self._n, columns - chunk.done, self._spans, threads)
        return chunks

    def _new_room(self, columns: int) -> F32:
        return np.empty((self._height, len(self._window[1]), columns), np.float32)

    def _scratch(self) -> F32:
        """Room for the sums of a chunk, for one after the other."""
        if not self._sums.size:
            self._sums = self._new_room(len(self._window[0]))
        return self._sums

    def _coarse_rows(self, wanted: I32) -> I32:
        """Span of each coarse row, in fine samples, needed for the wanted part of each fine row; both (rows, 2)."""
        first = self._taps[1].first - self._taps[1].first[0]
        rows = np.empty((len(self._window[1]), 2), np.int32)
        rows[:] = self.of[0].shape[0], 0
        for tap in range(TAPS):
            np.minimum.at(rows[:, 0], first + tap, wanted[:, 0])
            np.maximum.at(rows[:, 1], first + tap, wanted[:, 1])
        return rows

    def _columns(self, wanted: I32) -> set[tuple[int, int]]:
        """Numbers of the spans along x and y whose samples the wanted ones depend on."""
        first_x, first_y = (taps.first - taps.first[0] for taps in self._taps[:2])
        start, stop = spans_in_any(wanted).T
        found = set()
        for j, span_y in enumerate(self._spans[1]):
            rows = np.zeros(len(start), bool)
            for _, place in span_y.own:
                rows |= (first_y + TAPS > place.start) & (first_y < place.stop)
            rows &= start < stop
            if rows.any():
                low, high = first_x[start[rows].min()], first_x[stop[rows].max() - 1] + TAPS
                for i, span_x in enumerate(self._spans[0]):
                    if any(low < place.stop and high > place.start for _, place in span_x.own):
                        found.add((i, j))
        return found


def _widened(low: I32, high: I32, blocks: int) -> tuple[I32, I32]:
    """Ranges of blocks, one more on either side, joined with those of `NEARBY` rows."""
    low, high = np.where(low < high, low, blocks), np.where(low < high, high, 0)
    wide_low, wide_high = low.copy(), high.copy()
    for by in range(1, NEARBY + 1):
        wide_low[by:], wide_low[:-by] = np.minimum(wide_low[by:], low[:-by]), np.minimum(wide_low[:-by], low[by:])
        wide_high[by:], wide_high[:-by] = np.maximum(wide_high[by:], high[:-by]), np.maximum(wide_high[:-by], high[by:])
    there = wide_low < wide_high
    return np.where(there, np.maximum(wide_low - 1, 0), 0), np.where(there, np.minimum(wide_high + 1, blocks), 0)


class _Chunk:
    """Consecutive coarse planes, stretched along x; the kernels are summed where they are needed."""

    def __init__(self, planes: range, x: range, y: range, band: Band, room: F32) -> None:
        self.planes, self.x, self.y, self.band, self.room = planes, x, y, band, room
        self.stretched = room[: len(planes)]
        self.done: set[tuple[int, int]] = set()
        self._blocks = np.zeros((len(y), 2), np.int32)
        self._sums = np.zeros((0, 0, 0), np.float32)

    def add_patches(self, patches: Patches, needed: I32, scratch: Callable[[], F32], threads: int) -> None:
        """Add up patches for the needed parts of rows, (cy, 2) fine samples, unless that is done."""
        from sppm_pipeline.method.assembly.overlap_add import assemble

        low, high, done = needed[:, 0] // BLOCK, -(-needed[:, 1] // BLOCK), self._blocks
        if not ((low < high) & ((low < done[:, 0]) | (high > done[:, 1]))).any():
            return
        # the next layers want about the same; what they want beyond that is summed then, with the rows it belongs to
        low, high = _widened(low, high, len(self.band.first))
        x, y, z = self.x, self.y, self.planes
        first = self.band.first.astype(np.int32)
        there, empty = low < high, done[:, 0] >= done[:, 1]
        left = np.stack([low, np.where(there & ~empty, done[:, 0], high)], axis=1)
        right = np.stack([np.where(empty, high, done[:, 1]), high], axis=1)
        for blocks in (left, right):
            blocks[blocks[:, 0] >= blocks[:, 1]] = 0
            if not blocks.any():
                continue
            columns = np.stack([first[blocks[:, 0], 0], first[blocks[:, 1] - 1, -1] + TAPS], axis=1)
            columns[blocks[:, 1] == 0] = 0
            sums = scratch()[: len(z)]
            assemble(*patches, z.start, z.stop, x.start, x.stop, y.start, y.stop, sums, threads, columns)
            self._stretch(sums, range(len(y)), threads, blocks)
        done[:, 0] = np.where(there & (empty | (low < done[:, 0])), low, done[:, 0])
        done[:, 1] = np.where(there, np.maximum(high, done[:, 1]), done[:, 1])

    def sum_columns(
        self, field: KernelSum, n: int, columns: set[tuple[int, int]], spans: list[list[Span]], threads: int
    ) -> None:
        """Sum the kernels in columns of cells, which are numbers of spans along x and y."""
        if not columns:
            return
        if not self._sums.size:
            self.stretched[:] = 0  # samples of other columns enter nothing that is wanted, but are read
            self._sums = np.zeros((len(self.planes), len(self.y), len(self.x)), np.float32)

        def add(column: tuple[int, int]) -> None:
            x, y = (spans[axis][number] for axis, number in enumerate(column))
            # counted from a whole cell below the lattice, so that a plane has the same place in every chunk
            base = min(-1, self.planes.start // n)
            low, high = (k - base * n for k in (self.planes.start, self.planes.stop))
            grid = Grid((x.first / n, y.first / n, float(base)), (1.0 / n,) * 3, (x.samples, y.samples, high))
            sums = field.kernel_sums(grid, low, high)
            for (from_y, to_y), (from_x, to_x) in product(y.own, x.own):
                self._sums[:, to_y, to_x] = sums[:, from_y, from_x]

        share_out(add, sorted(columns), threads)
        for j in {j for _, j in columns}:
            for _, rows in spans[1][j].own:
                self._stretch(self._sums, range(rows.start, rows.stop), threads)
        self.done |= columns  # not before: an interrupt may come, and the field be asked again

    def _stretch(self, sums: F32, rows: range, threads: int, blocks: I32 | None = None) -> None:
        def work(some: slice) -> None:
            stretch(sums[some], self.band, rows, self.stretched[some], blocks)

        cuts = [len(self.planes) * part // threads for part in range(threads + 1)]
        share_out(work, [slice(*ends) for ends in pairwise(cuts)], threads)


def _spans(window: range, n: int, cells: int, periodic: bool) -> list[Span]:
    """The samples of a window cell by cell; of a periodic lattice each cell once, whatever the number of its images."""
    found: dict[int, Span] = {}
    for cell in range(window.start // n, (window.stop - 1) // n + 1):
        low, high = cell * n, (cell + 1) * n
        number = cell % cells if periodic else cell
        if not periodic:
            low += -MARGIN if cell == 0 else MARGIN if cell == cells else 0
            high += MARGIN if cell == cells - 1 else -MARGIN if cell == -1 else 0
        a, b = max(low, window.start), min(high, window.stop)
        if a < b:
            shift = (number - cell) * n
            span = found.setdefault(number, Span(low + shift, high - low, []))
            span.own.append((slice(a - low, b - low), slice(a - window.start, b - window.start)))
    return list(found.values())
