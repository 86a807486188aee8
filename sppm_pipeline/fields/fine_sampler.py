"""A sum of kernels on a fine grid, interpolated from the sum on a coarse one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.interpolation import (
    BEFORE,
    BLOCK,
    TAPS,
    Band,
    band_of,
    interpolate_layers,
    stretch,
    taps_at,
)

if TYPE_CHECKING:
    from sppm_pipeline.fields.kernel_sum import KernelSum, Patches

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


class Span(NamedTuple):
    """Coarse samples along one axis that are summed together: those of a cell, with its margin at the border."""

    first: int
    samples: int
    own: list[tuple[slice, slice]]
    """Where they go in the window: places among the samples of the span, and in the window."""


class FineSampler:
    """A sum of kernels on one fine grid; what all layers need is prepared once, the last coarse planes are kept.

    The coarse grid has its origin at that of the lattice and divides the cells, and its samples are summed cell by
    cell: a sample depends on its position alone, neither on the grid it belongs to nor on what else is asked for.

    Parameters
    ----------
    field : KernelSum
        What is sampled; it is not kept.
    grid : Grid
        The fine samples, cell sizes.
    per_cell : int
        Coarse samples along a cell edge.
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

    def sample(
        self,
        field: KernelSum,
        start: int,
        stop: int,
        threads: int,
        wanted: NDArray[np.int32] | None,
        values: NDArray[np.float32] | None,
        solid: NDArray[np.uint8] | None,
    ) -> None:
        """Write the field, or whether it is solid, in the layers start <= k < stop into one of the last arguments."""
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

            _in_threads(work, range(0, ny, self._band_rows), threads)
        if stop == nz:
            self._chunks = {}

    def _groups(self, start: int, stop: int) -> list[tuple[int, int]]:
        """Runs of layers that are interpolated from the same chunks."""
        low = self._taps[2].first[start:stop] + MARGIN
        changes = (np.diff(low // self._height) != 0) | (np.diff((low + TAPS - 1) // self._height) != 0)
        return list(pairwise([start, *(int(c) + 1 + start for c in np.flatnonzero(changes)), stop]))

    def _chunks_of(
        self, field: KernelSum, first: int, last: int, wanted: NDArray[np.int32], threads: int
    ) -> list[_Chunk]:
        """The one or two chunks for layers first <= k < last, with all samples that the wanted ones depend on."""
        low, high = (int(self._taps[2].first[layer]) for layer in (first, last - 1))
        high += TAPS - 1
        x, y, z = self._window
        chunks = {}
        for c in range((low + MARGIN) // self._height, (high + MARGIN) // self._height + 1):
            first = c * self._height - MARGIN
            planes = range(max(first, z.start), min(first + self._height, z.stop))
            chunks[c] = self._chunks.get(c) or _Chunk(planes, x, y, self._band)
        self._chunks = chunks
        if (patches := field.patches(self._n, 0.0, threads)) is not None:
            for chunk in chunks.values():
                chunk.add_patches(patches, threads)
        else:
            columns = self._columns(wanted)
            for chunk in chunks.values():
                chunk.sum_columns(field, self._n, columns - chunk.done, self._spans, threads)
        return list(chunks.values())

    def _columns(self, wanted: NDArray[np.int32]) -> set[tuple[int, int]]:
        """Numbers of the spans along x and y whose samples the wanted ones depend on."""
        first_x, first_y = (taps.first - taps.first[0] for taps in self._taps[:2])
        there = wanted[..., 0] < wanted[..., 1]
        start = np.where(there, wanted[..., 0], self.of[0].shape[0]).min(0)
        stop = np.where(there, wanted[..., 1], 0).max(0)
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


class _Chunk:
    """Consecutive coarse planes, stretched along x; the kernels are summed where they are needed."""

    def __init__(self, planes: range, x: range, y: range, band: Band) -> None:
        self.planes, self.x, self.y, self.band = planes, x, y, band
        self.stretched = np.empty((len(planes), len(y), len(band.first) * BLOCK), np.float32)
        self.done: set[tuple[int, int]] = set()
        self._sums = np.zeros((0, 0, 0), np.float32)

    def add_patches(self, patches: Patches, threads: int) -> None:
        """Add up patches for all of the chunk, unless that is done."""
        from sppm_pipeline.numerics.assembly.overlap_add import assemble

        if not self.done:
            x, y, z = self.x, self.y, self.planes
            sums = assemble(*patches, z.start, z.stop, x.start, x.stop, y.start, y.stop, threads=threads)
            self._stretch(sums, range(len(y)), threads)
            self.done.add((0, 0))

    def sum_columns(
        self, field: KernelSum, n: int, columns: set[tuple[int, int]], spans: list[list[Span]], threads: int
    ) -> None:
        """Sum the kernels in columns of cells, which are numbers of spans along x and y."""
        if not columns:
            return
        if not self._sums.size:
            self._sums = np.zeros((len(self.planes), len(self.y), len(self.x)), np.float32)
            self.stretched[:] = 0  # samples of other columns enter nothing that is wanted, but are read

        def add(column: tuple[int, int]) -> None:
            x, y = (spans[axis][number] for axis, number in enumerate(column))
            # counted from a whole cell below the lattice, so that a plane has the same place in every chunk
            base = min(-1, self.planes.start // n)
            low, high = (k - base * n for k in (self.planes.start, self.planes.stop))
            grid = Grid((x.first / n, y.first / n, float(base)), (1.0 / n,) * 3, (x.samples, y.samples, high))
            sums = field.kernel_sums(grid, low, high)
            for (from_y, to_y), (from_x, to_x) in product(y.own, x.own):
                self._sums[:, to_y, to_x] = sums[:, from_y, from_x]

        _in_threads(add, sorted(columns), threads)
        self.done |= columns
        for j in {j for _, j in columns}:
            for _, rows in spans[1][j].own:
                self._stretch(self._sums, range(rows.start, rows.stop), threads)

    def _stretch(self, sums: NDArray[np.float32], rows: range, threads: int) -> None:
        def work(some: slice) -> None:
            stretch(sums[some], self.band, rows, self.stretched[some])

        cuts = [len(self.planes) * part // threads for part in range(threads + 1)]
        _in_threads(work, [slice(*ends) for ends in pairwise(cuts)], threads)


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


def _in_threads(work: Callable[[Any], None], tasks: Iterable[Any], threads: int) -> None:
    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(work, tasks))
    else:
        for task in tasks:
            work(task)
