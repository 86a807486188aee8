"""The field of a tiling from sampled pieces: patches are added where they overlap.

Each sample is the sum of the patches over it in the order of their sites (z, y, x) and of the pieces of a site. This
order belongs to the lattice alone, so the bytes of a sample depend neither on the slab or window it is asked for in,
nor on the number of threads, and they repeat with a periodic tiling.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.assembly.patches import FULL, PatchBank, patches_at
from sppm_pipeline.services.arrays import F32, I32, I64, U64
from sppm_pipeline.services.bit_rows import empty_bits, gather
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.threads import share_out

# Samples that are summed at a time: 512 kB of float32 stay in the second level cache beside the patches.
_BLOCK_SAMPLES = 1 << 17
_SHIFT = np.uint64(4)
_ONE, _WORD, _WORD_SHIFT = np.uint64(1), np.uint64(64), np.uint64(6)


def assemble(
    bank: PatchBank,
    tiling: TilingArrays,
    layer_start: int,
    layer_stop: int,
    x0: int,
    x1: int,
    y0: int,
    y1: int,
    out: F32 | None = None,
    threads: int = 1,
    wanted: I32 | None = None,
) -> F32:
    """The field G in a box of samples, layer_start <= k < layer_stop, y0 <= j < y1, x0 <= i < x1.

    Sample (i, j, k) lies at ``(i + bank.offset) / bank.n`` cell sizes, and so on. The box may leave the tiling; beyond
    the reach of its pieces the field is zero, unless the tiling is periodic and repeats. `wanted` (y1 - y0, 2) is the
    part of each row that matters, in all layers: its first sample, counted from x0, and the one after the last; others
    are left as they are in `out`, 0 without it. `out` (layers, y1 - y0, x1 - x0) is overwritten. The result does not
    depend on the threads.

    Raises ValueError if the bank has no patches for a cell near the box.
    """
    shape = layer_stop - layer_start, y1 - y0, x1 - x0
    if bank.solid_level is not None:
        raise ValueError("an int16 bank distinguishes only solid and void; build one without solid_level")
    if out is None:
        out = np.empty(shape, np.float32) if wanted is None else np.zeros(shape, np.float32)
    field = out
    _run(bank, tiling, (x0, y0, layer_start), shape, field, None, 0.0, threads, wanted)
    return field


def assemble_bits(
    bank: PatchBank,
    tiling: TilingArrays,
    level: float,
    layer_start: int,
    layer_stop: int,
    x0: int,
    x1: int,
    y0: int,
    y1: int,
    threads: int = 1,
    wanted: I32 | None = None,
) -> U64:
    """Bits (layers, y1 - y0, words) of the samples below a level: set = solid. No layer of the field is held in memory.

    Arguments and errors as for `assemble`; outside of the tiling the field is zero, which counts as solid. Bits of what
    is not wanted are 0, or what they are. Solid is G < C, decided on the float32 values that `assemble` gives; an int16
    bank serves the level C it was built for. Rows are those of `services.bit_rows`; the first bit is x0.
    """
    layers, rows, columns = layer_stop - layer_start, y1 - y0, x1 - x0
    if bank.solid_level is not None and level != bank.solid_level:
        raise ValueError(f"the int16 bank was built for the level {bank.solid_level!r}, not {level!r}")
    solid = empty_bits(layers, rows, columns)
    if wanted is not None:
        solid[:] = 0
    _run(bank, tiling, (x0, y0, layer_start), (layers, rows, columns), None, solid, level, threads, wanted)
    return solid


def _run(
    bank: PatchBank,
    tiling: TilingArrays,
    corner: tuple[int, int, int],
    size: tuple[int, int, int],
    field: F32 | None,
    solid: U64 | None,
    level: float,
    threads: int,
    wanted: I32 | None,
) -> None:
    """Cut the box, layers x rows x columns, into blocks of layers and rows, and fill one of the arrays."""
    layers, rows, columns = size
    if layers * rows * columns == 0:
        return
    start = np.array(corner, dtype=np.int64)
    stop = start + np.array([columns, rows, layers])
    low, high = (
        (bank.low.min(axis=0), (bank.low + bank.size).max(axis=0)) if len(bank.low) else (np.zeros(3), np.zeros(3))
    )
    # Site s reaches the box if s n + low < stop and s n + high > start.
    first_site = np.floor_divide(start - high, bank.n).astype(np.int64) + 1
    stop_site = -np.floor_divide(low - stop, bank.n).astype(np.int64)
    sites, begin, patches = patches_at(bank, tiling, first_site, stop_site)
    # the rows that are summed hold every patch whole, so that none has to be clipped at its low end and the inner loop
    # stays without a branch; the last one may run over by a block
    base = min(int(sites.first[0]) * bank.n + int(low[0]), corner[0])
    end = max(int(sites.stop[0] - 1) * bank.n + int(high[0]), int(stop[0]))
    width = end - base
    block_rows = max(1, _BLOCK_SAMPLES // width)
    # about square in layers and rows: patches are added most often whole
    block_layers = max(1, min(layers, round(block_rows**0.5)))
    block_rows = max(1, min(rows, block_rows // block_layers))
    down, across = -(-layers // block_layers), -(-rows // block_rows)
    shape = np.array([layers, rows, columns])
    # sums of 16-bit patches need more bits than these; exact integers don't depend on the order
    kind = np.float32 if bank.solid_level is None else np.int32
    if wanted is None:
        wanted = np.tile(np.array([0, columns], np.int32), (rows, 1))

    def work(part: range) -> None:
        _assemble_blocks(
            part.start, part.stop, across, np.array([block_layers, block_rows, width]),
            np.zeros(block_layers * block_rows * width, dtype=kind), wanted, base, start, shape,
            np.empty(0, np.float32) if field is None else field.reshape(-1),
            np.empty(0, np.uint64) if solid is None else solid.reshape(-1), np.zeros(8, np.uint64), solid is not None,
            kind(level) if bank.solid_level is None else kind(FULL), bank.n, sites.first,
            np.array(sites.interior.shape), begin, patches, bank.low, bank.size,
            np.array([low[1], high[1], low[2], high[2]], dtype=np.int64), bank.first_row, bank.row_low,
            bank.row_blocks, bank.row_start, bank.data,
        )  # fmt: skip

    blocks = down * across
    # four parts a thread even out what blocks differ in cost
    parts = min(blocks, 4 * threads) if threads > 1 else 1
    cuts = [blocks * i // parts for i in range(parts + 1)]
    share_out(work, map(range, cuts[:-1], cuts[1:]), threads)


@inline_jit
def _add_rows(
    rows: NDArray,
    target: int,
    stride: int,
    count: int,
    x: int,
    first: int,
    stop: int,
    row: np.uint64,
    row_low: I32,
    row_blocks: I32,
    row_start: I64,
    data: NDArray,
) -> None:
    """Add `count` rows of a patch, from number `row` on, for the samples first <= i < stop; x is that of the cell.

    Unsigned indices and whole blocks let the compiler make a vector loop without a scalar remainder.
    """
    for i in range(np.uint64(count)):
        low = x + int(row_low[row + i])
        # whole blocks of sixteen on both sides: what lies beyond is summed in vain, but by vectors
        begin = max(first - low, 0) >> 4 << 4
        end = int(min(row_blocks[row + i] << 4, (stop - low + 15) >> 4 << 4))
        to = np.uint64(target + np.int64(i) * stride + low + begin)
        source = np.uint64(row_start[row + i] + begin)
        for k in range(np.uint64(max(end - begin, 0)) >> _SHIFT << _SHIFT):
            rows[to + k] += data[source + k]


@inline_jit
def _copy_row(source: NDArray, start: np.uint64, target: F32, to: np.uint64, count: np.uint64) -> None:
    for i in range(count):
        target[to + i] = source[start + i]


@inline_jit
def _threshold_row(
    source: NDArray,
    start: np.uint64,
    target: U64,
    to: np.uint64,
    count: np.uint64,
    level: np.float32 | np.int32,
    flags: U64,
) -> None:
    """Write a bit for each sample; `flags` is room for the bytes of a word."""
    each = flags.view(np.uint8)
    for w in range(count >> _WORD_SHIFT):
        first = start + (np.uint64(w) << _WORD_SHIFT)
        for i in range(_WORD):
            each[i] = np.uint8(source[first + i] < level)
        target[to + np.uint64(w)] = gather(flags, 0)
    rest = count & (_WORD - _ONE)
    if rest > 0:
        for b in range(8):
            flags[b] = 0
        first = start + count - rest
        for i in range(rest):
            each[i] = np.uint8(source[first + i] < level)
        target[to + (count >> _WORD_SHIFT)] = gather(flags, 0)


@jit
def _assemble_blocks(
    first_block: int,
    stop_block: int,
    across: int,
    block: I64,
    rows: NDArray,
    wanted: I32,
    base: int,
    start: I64,
    shape: I64,
    field: F32,
    solid: U64,
    flags: U64,
    threshold: bool,
    level: np.float32 | np.int32,
    n: int,
    first_site: I64,
    site_shape: I64,
    begin: I64,
    patches: I32,
    low: I32,
    size: I32,
    margins: I64,
    first_row: I64,
    row_low: I32,
    row_blocks: I32,
    row_start: I64,
    data: NDArray,
) -> None:
    """Sum the patches over blocks of rows, and write each block as field or solid."""
    width = block[2]
    for number in range(first_block, stop_block):
        za = start[2] + number // across * block[0]
        zb = min(za + block[0], start[2] + shape[0])
        ya = start[1] + number % across * block[1]
        yb = min(ya + block[1], start[1] + shape[1])
        # what is wanted of any row of the block
        xa, xb = width, np.int64(0)
        for y in range(ya - start[1], yb - start[1]):
            if wanted[y, 0] < wanted[y, 1]:
                xa, xb = min(xa, np.int64(wanted[y, 0])), max(xb, np.int64(wanted[y, 1]))
        if xa >= xb:
            continue
        if threshold:  # whole words, but for the last one of a row
            xa, xb = xa >> 6 << 6, min((xb + 63) >> 6 << 6, shape[2])
        xa, xb = xa + start[0] - base, xb + start[0] - base
        for row in range((zb - za) * block[1]):
            for i in range(np.uint64(row * width + xa), np.uint64(row * width + xb)):
                rows[i] = 0
        # Sites whose patches can reach the block: s n + lowest < b and s n + highest > a.
        sz0 = max((za - margins[3]) // n + 1 - first_site[2], 0)
        sz1 = min(-((margins[2] - zb) // n) - first_site[2], site_shape[0])
        sy0 = max((ya - margins[1]) // n + 1 - first_site[1], 0)
        sy1 = min(-((margins[0] - yb) // n) - first_site[1], site_shape[1])
        for sz in range(sz0, sz1):
            for sy in range(sy0, sy1):
                for sx in range(site_shape[2]):
                    site = (sz * site_shape[1] + sy) * site_shape[2] + sx
                    x = (first_site[0] + sx) * n - base
                    for item in range(begin[site], begin[site + 1]):
                        p = patches[item]
                        if x + low[p, 0] >= xb or x + low[p, 0] + size[p, 0] <= xa:
                            continue
                        z_low = (first_site[2] + sz) * n + low[p, 2]
                        y_low = (first_site[1] + sy) * n + low[p, 1]
                        y0 = max(ya, y_low)
                        count = min(yb, y_low + size[p, 1]) - y0
                        if count <= 0:
                            continue
                        for z in range(max(za, z_low), min(zb, z_low + size[p, 2])):
                            row = first_row[p] + (z - z_low) * size[p, 1] + y0 - y_low
                            target = ((z - za) * block[1] + y0 - ya) * width
                            _add_rows(
                                rows, target, width, count, x, xa, xb,
                                np.uint64(row), row_low, row_blocks, row_start, data,
                            )  # fmt: skip
        for z in range(za, zb):
            for y in range(ya, yb):
                first, stop = np.int64(wanted[y - start[1], 0]), np.int64(wanted[y - start[1], 1])
                if first >= stop:
                    continue
                row = (z - start[2]) * shape[1] + y - start[1]
                source = ((z - za) * block[1] + y - ya) * width + start[0] - base
                if threshold:
                    first, stop = first >> 6 << 6, min((stop + 63) >> 6 << 6, shape[2])
                    to = np.uint64(row * ((shape[2] + 63) // 64) + (first >> 6))
                    count = np.uint64(stop - first)
                    _threshold_row(rows, np.uint64(source + first), solid, to, count, level, flags)
                else:
                    to = np.uint64(row * shape[2] + first)
                    _copy_row(rows, np.uint64(source + first), field, to, np.uint64(stop - first))
