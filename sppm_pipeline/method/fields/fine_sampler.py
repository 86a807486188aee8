"""A sum of kernels on a fine grid, interpolated from the sum on a coarse one."""

from __future__ import annotations

import math
from itertools import pairwise, product
from threading import Lock
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sppm_pipeline.method.assembly.occupancy import spans_in_any
from sppm_pipeline.services.arrays import F32, I32, U8
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.interpolation import (
    BEFORE,
    BLOCK,
    TAPS,
    band_of,
    coarse_rows,
    interpolate_layers,
    logarithms,
    stretch,
    taps_at,
)
from sppm_pipeline.services.threads import share_out

if TYPE_CHECKING:
    from sppm_pipeline.method.fields.kernel_sum import KernelSum

MAX_SAMPLES = 2**22
"""Samples of coarse planes, stretched along x, that are kept at a time: 16 MB, unless `MIN_PLANES` are more."""

MIN_PLANES = 8
"""Coarse planes that are summed together at the least, so that kernels are not listed again for each plane."""

BAND_SAMPLES = 2**15
"""Samples of a coarse plane, stretched along x, whose rows are interpolated at a time, layer after layer, so that the
planes between them stay in the cache: the six of a layer take 768 kB."""

MARGIN = BEFORE + 1
"""Coarse samples beyond the lattice that are summed with its outermost cells."""


NEARBY = 6
"""Coarse rows beyond those wanted that are summed as well, as the next layers may want them."""

CELLS_ALONG, CELLS_ACROSS = 4, 2
"""Cells along x and y whose kernels are listed and summed together: short rows cost more a sample than long ones."""

LEAST = 1e-3
"""Sums below this fraction of the level are taken for it: no sample near the level is interpolated from such."""


class Span(NamedTuple):
    """Coarse samples along one axis that are summed together: those of cells, with the margin at the border."""

    first: int
    samples: int
    own: list[tuple[slice, slice]]
    """Positions in the window: places among the samples of the span, and in the window."""


class FineSampler:
    """A sum of kernels on one fine grid (cell sizes); what all layers need is prepared once.

    The last coarse planes are kept; threads that ask for layers at once take turns. The coarse grid, with `per_cell`
    samples along a cell edge, has its origin at that of the lattice and divides the cells, and its samples are summed
    by blocks of cells: a sample depends on its position alone, neither on the grid it belongs to nor on what else is
    asked for. What is interpolated is the logarithm of the sum: that of a single kernel is a distance or its square,
    which polynomials follow much more closely. The field is not kept.
    """

    def __init__(self, field: KernelSum, grid: Grid, per_cell: int) -> None:
        self.of = grid, per_cell
        self._n = per_cell
        self._taps = [taps_at(grid.axis(axis) * per_cell) for axis in range(3)]
        self._band = band_of(self._taps[0])
        self._window = [range(int(taps.first[0]), int(taps.first[-1]) + TAPS) for taps in self._taps]
        self._spans = [
            _spans(window, per_cell, cells, field.periodic, along)
            for window, cells, along in zip(self._window[:2], field.cells[:2], (CELLS_ALONG, CELLS_ACROSS), strict=True)
        ]
        plane = grid.shape[0] * len(self._window[1])
        self._height = TAPS - 1 + max(MIN_PLANES, min(per_cell, MAX_SAMPLES // plane))
        rows = max(TAPS, BAND_SAMPLES // grid.shape[0])
        self._band_rows = max(1, rows * grid.shape[1] // len(self._window[1]))
        self._forget()
        self._lock = Lock()

    def _forget(self) -> None:
        # plane k lies at k modulo the height; of each of its rows these blocks are there
        self._planes, self._blocks = range(0), np.zeros((self._height, len(self._window[1]), 2), np.int32)
        self._stretched = self._sums = np.zeros((0, 0, 0), np.float32)

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
            spans, (_, y, z), level = wanted, self._taps, math.log(field.solid_below)
            first = start
            while first < stop:
                # as many layers as the planes that are kept are enough for
                most = int(z.first[first]) + self._height - TAPS
                last = max(first + 1, int(np.searchsorted(z.first[:stop], most, "right")))
                own = slice(first - start, last - start)
                self._complete(field, first, last, spans[own], threads)

                def work(row: int, layers: slice = slice(first, last), own: slice = own) -> None:
                    interpolate_layers(
                        self._stretched,
                        z.first[layers],
                        z.weights[layers],
                        y,
                        level,
                        range(row, min(row + self._band_rows, ny)),
                        spans[own],
                        None if values is None else values[own],
                        None if solid is None else solid[own],
                    )

                share_out(work, range(0, ny, self._band_rows), threads)
                first = last
            if values is not None:  # G - C from ln (G / C)
                np.exp(values, out=values)
                values -= 1
                values *= np.float32(field.solid_below)
            if stop == nz:
                self._forget()

    def _complete(self, field: KernelSum, first: int, last: int, wanted: I32, threads: int) -> None:
        """Sum the planes for layers first <= k < last, with all samples that the wanted ones depend on."""
        start, stop = int(self._taps[2].first[first]), int(self._taps[2].first[last - 1]) + TAPS
        if not self._stretched.size:
            shape = self._height, len(self._window[1])
            self._stretched = np.empty((*shape, len(self._band.first) * BLOCK), np.float32)
            self._sums = np.empty((*shape, len(self._window[0])), np.float32)
        old = range(start, self._planes.stop if start in self._planes else start)
        new, needed = range(old.stop, max(old.stop, stop)), self._needed(first, last, wanted)
        if len(new):  # the next layers want about the same of the last planes
            last_planes = self._widened(spans_in_any(needed[1 - TAPS :]))
            needed[max(len(old), len(needed) + 1 - TAPS) :] = last_planes
            stop = max(stop, min(old.stop + MIN_PLANES, start + self._height, self._window[2].stop))
            new = range(old.stop, stop)
            needed = np.concatenate([needed, np.tile(last_planes, (stop - start - len(needed), 1, 1))])
        else:
            needed = np.pad(needed, ((0, len(old) - len(needed)), (0, 0), (0, 0)))
        # an interrupt may come, and the field be asked again
        planes, self._planes = range(start, new.stop), range(0)
        self._blocks[np.array(new, np.int64) % self._height] = 0
        slots = np.array(planes, np.int64) % self._height
        done, (low, high) = self._blocks[slots], np.moveaxis(needed, -1, 0)
        there, empty = low < high, done[..., 0] >= done[..., 1]
        before = np.stack([low, np.where(there & ~empty, np.minimum(done[..., 0], high), low)], axis=-1)
        after = np.stack([np.where(empty, low, np.maximum(done[..., 1], low)), high], axis=-1)
        for some, blocks in ((old, before[: len(old)]), (old, after[: len(old)]), (new, needed[len(old) :])):
            if len(some) and (blocks[..., 0] < blocks[..., 1]).any():
                self._sum(field, some, np.where(blocks[..., :1] < blocks[..., 1:], blocks, 0), threads)
        self._blocks[slots] = _hulls(done, needed)
        self._planes = planes

    def _needed(self, first: int, last: int, wanted: I32) -> I32:
        """Blocks (planes, cy, 2) of coarse rows that the wanted samples of layers first <= k < last depend on."""
        layers, rows = self._taps[2].first[first:last], self._taps[1].first
        out = np.zeros((int(layers[-1] - layers[0]) + TAPS, len(self._window[1]), 2), np.int32)
        coarse_rows(wanted, layers - layers[0], rows - rows[0], out)
        return np.asarray(np.stack([out[..., 0] // BLOCK, -(-out[..., 1] // BLOCK)], axis=-1))

    def _widened(self, blocks: I32) -> I32:
        """Ranges of blocks (cy, 2), one more on either side, joined with those of `NEARBY` rows."""
        most = len(self._band.first)
        low, high = np.where(blocks[:, 0] < blocks[:, 1], blocks.T, [[most], [0]])
        wide_low, wide_high = low.copy(), high.copy()
        for by in range(1, NEARBY + 1):
            for to, of in ((slice(by, None), slice(-by)), (slice(-by), slice(by, None))):
                wide_low[to] = np.minimum(wide_low[to], low[of])
                wide_high[to] = np.maximum(wide_high[to], high[of])
        wide = np.stack([np.maximum(wide_low - 1, 0), np.minimum(wide_high + 1, most)], axis=-1)
        return np.where((wide_low < wide_high)[:, None], wide, 0).astype(np.int32)

    def _sum(self, field: KernelSum, planes: range, blocks: I32, threads: int) -> None:
        """Sum some blocks (planes, cy, 2) of the rows of planes, and stretch their logarithms."""
        x, y, _ = self._window
        first = self._band.first.astype(np.int32)
        columns = np.stack([first[blocks[..., 0], 0], first[blocks[..., 1] - 1, -1] + TAPS], axis=-1)
        columns[blocks[..., 1] == 0] = 0
        sums = self._sums[: len(planes)]
        if (patches := field.patches(self._n, 0.0, threads)) is None:
            self._add_kernels(field, planes, columns, sums, threads)
        else:
            from sppm_pipeline.method.assembly.overlap_add import assemble

            box = planes.start, planes.stop, x.start, x.stop, y.start, y.stop
            assemble(*patches, *box, sums, threads, spans_in_any(columns))
        least = np.float32(LEAST * field.solid_below)

        def finish(k: int) -> None:
            at = (planes.start + k) % self._height
            logarithms(sums[k], columns[k], least)
            stretch(sums[k], self._band, blocks[k], self._stretched[at])

        share_out(finish, range(len(planes)), threads)

    def _add_kernels(self, field: KernelSum, planes: range, columns: I32, sums: F32, threads: int) -> None:
        """Sum the kernels of coarse planes, in the `columns` (planes, cy, 2) of their rows, block of cells by block."""
        n = self._n
        # counted from a whole cell below the lattice, so that a plane has the same place in every call
        base = min(-1, planes.start // n)
        low, high, top = (k - base * n for k in (planes.start, planes.stop, self._window[2].stop))

        def add(block: tuple[Span, ...]) -> None:
            x, y = block
            wanted, places = np.zeros((len(planes), y.samples, 2), np.int32), list(product(y.own, x.own))
            for (of_y, to_y), (of_x, to_x) in places:
                found = np.clip(columns[:, to_y] - to_x.start, 0, to_x.stop - to_x.start) + of_x.start
                wanted[:, of_y] = found if len(places) == 1 else _hulls(wanted[:, of_y], found)
            if not wanted.any():
                return
            grid = Grid((x.first / n, y.first / n, float(base)), (1.0 / n,) * 3, (x.samples, y.samples, top))
            made = field.kernel_sums(grid, low, high, wanted=wanted)
            for (of_y, to_y), (of_x, to_x) in places:
                sums[:, to_y, to_x] = made[:, of_y, of_x]

        share_out(add, list(product(*self._spans)), threads)


def _hulls(some: I32, others: I32) -> I32:
    """Ranges that hold those of two arrays (..., 2)."""
    low, high = np.minimum(some[..., 0], others[..., 0]), np.maximum(some[..., 1], others[..., 1])
    one, other = some[..., :1] < some[..., 1:], others[..., :1] < others[..., 1:]
    return np.where(one & other, np.stack([low, high], axis=-1), np.where(one, some, np.where(other, others, 0)))


def _spans(window: range, n: int, cells: int, periodic: bool, along: int) -> list[Span]:
    """The samples of a window by blocks of cells; of a periodic lattice each once, however many its images are."""
    whole, step = n * cells, n * along
    if periodic:
        edges, shifts = [*range(0, whole, step), whole], range(window.start // whole * whole, window.stop, whole)
    else:
        edges, shifts = [-MARGIN, *range(step, whole, step), whole + MARGIN], range(1)
        edges = [*range(edges[0], window.start - step, -step)][:0:-1] + edges
        edges += range(edges[-1] + step, window.stop + step, step)
    found: dict[int, Span] = {}
    for shift, (low, high) in product(shifts, pairwise(edges)):
        a, b = max(low + shift, window.start), min(high + shift, window.stop)
        if a < b:
            own = slice(a - low - shift, b - low - shift), slice(a - window.start, b - window.start)
            found.setdefault(low, Span(low, high - low, [])).own.append(own)
    return list(found.values())
