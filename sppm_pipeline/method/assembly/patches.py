"""Sampled pieces: each piece of a tile set once, with the margin it reaches into its neighbors.

A patch keeps, row by row, the samples between the first and the last that lie above the cut-off, in blocks of sixteen.
If only few combinations of an interior and its six face colors occur, an interior, its connectors and its three low
faces are merged into one patch, which costs about a third of the additions.

A bank that only separates solid from void at one level keeps its samples in sixteen bits, cut off at the level: half
the memory, and sums that are exact whatever their order.
"""

from __future__ import annotations

import math
from threading import Condition
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.assembly.contents import PieceNumbers, Pieces, Sites, TilingArrays, site_pieces, sites_between
from sppm_pipeline.method.kernels.kernels import Kernels, concatenated, reach_boxes
from sppm_pipeline.method.kernels.profiles import DEFAULT_CUTOFF
from sppm_pipeline.method.kernels.rows import LANES
from sppm_pipeline.method.kernels.splat import add_kernels
from sppm_pipeline.services.arrays import F32, I16, I32, I64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.threads import share_out

#: The level in units of an int16 bank. One patch at the level makes a voxel void, so nothing above it is kept.
FULL = 32767
_SHIFT = np.uint64(4)


class PatchBank(NamedTuple):
    """Samples of all pieces at n voxels a cell edge; sample i lies at (i + offset) / n cell sizes."""

    n: int  # voxels along a cell edge
    offset: float  # 0.5 for voxel centers, 0 for voxel corners
    cutoff: float  # of the kernels; below it samples are trimmed from the ends of the rows
    numbers: PieceNumbers
    # (pieces + 1,) patch of each piece, -1 = the piece is empty, -2 = it has no patch of its own; the last is -1
    piece: I32
    codes: I64  # (m,) sorted codes of the merged combinations
    merged: I32  # (m,) the patch of each
    low: I32  # (p, 3) first sample of each patch along x, y, z, relative to the low corner of the cell
    size: I32  # (p, 3) its number of samples
    # (p,) where the rows of a patch begin in the row tables; row (z, y) is number ``z size_y + y``
    first_row: I64
    row_low: I32  # (rows,) first sample relative to the cell
    row_blocks: I32  # (rows,) length in blocks of 16 samples
    row_start: I64  # (rows,) where it begins in `data`
    # (samples,) float32, or int16 in units of ``solid_level / FULL`` and never above FULL
    data: F32 | I16
    solid_level: float | None  # the only level that an int16 bank can be asked for; None for float32

    @property
    def nbytes(self) -> int:
        """Bytes of the samples and the row tables."""
        return self.data.nbytes + self.row_low.nbytes + self.row_blocks.nbytes + self.row_start.nbytes


def _encode(rows: I64, base: int) -> I64:
    """One number for an interior and six colors -1 <= color < base - 1; sorts as the rows do."""
    # the largest code has to fit an int64
    if (float(rows[..., 0].max(initial=0)) + 2.0) * float(base) ** 6 > 2.0**62:
        raise ValueError(f"{base - 1} colors are too many for their combinations to be encoded in one number")
    code = rows[..., 0] + 1
    for column in range(1, 7):
        code = code * base + rows[..., column] + 1
    return code


def _base(numbers: PieceNumbers) -> int:
    return numbers.colors + 1


def _parts(pieces: Pieces, combinations: I32 | None) -> tuple[list[int], list[Kernels]]:
    """Which pieces get patches of their own, and the kernels of the merged patches."""
    if combinations is None:
        return list(range(len(pieces))), []
    numbers, merged = pieces.numbers, []
    for row in np.asarray(combinations, dtype=np.int32):
        interior, colors = row[:1], row[1:].reshape(3, 2, 1)
        members = [interior]
        for axis, (low, high) in enumerate(colors):
            members += [numbers.face(axis, low), numbers.connector(interior, axis, 0, low)]
            members += [numbers.connector(interior, axis, 1, high)]
        merged.append(concatenated(pieces[int(i[0])] for i in members if i[0] >= 0))
    faces = range(numbers.interiors, numbers.interiors + 3 * numbers.colors)
    return list(faces), merged


def _box(kernels: Kernels, n: int, offset: float, cutoff: float) -> tuple[I64, I64] | None:
    """First sample and number of samples within reach; the length along x is a multiple of 16. None if empty."""
    pore_lower, pore_upper, tunnel_lower, tunnel_upper = reach_boxes(kernels, cutoff)
    if len(pore_lower) + len(tunnel_lower) == 0:
        return None
    lower = np.concatenate([pore_lower, tunnel_lower]).min(axis=0)
    upper = np.concatenate([pore_upper, tunnel_upper]).max(axis=0)
    low = np.ceil(lower * n - offset).astype(np.int64)
    size = np.maximum(np.floor(upper * n - offset).astype(np.int64) + 1 - low, 1)
    # rows of whole blocks, as the sums along x are made in blocks of sixteen samples
    size[0] = -(-size[0] // LANES) * LANES
    return low, size


def predicted_bytes(
    pieces: Pieces,
    n: int,
    combinations: I32 | None = None,
    *,
    offset: float = 0.5,
    cutoff: float = DEFAULT_CUTOFF,
    solid_level: float | None = None,
) -> int:
    """Bytes that `build_bank` needs at most on one thread, for the same arguments; nothing is sampled.

    Each further thread works on a patch of its own, the largest at most.
    """
    own, merged = _parts(pieces, combinations)
    total = largest = 0
    for kernels in [pieces[i] for i in own] + merged:
        box = _box(kernels, n, offset, cutoff)
        if box is not None:
            samples = math.prod(int(s) for s in box[1])
            total += (4 if solid_level is None else 2) * samples + 16 * int(box[1][1] * box[1][2])
            largest = max(largest, (4 if solid_level is None else 6) * samples)
    return total + largest


def build_bank(
    pieces: Pieces,
    n: int,
    combinations: I32 | None = None,
    *,
    offset: float = 0.5,
    cutoff: float = DEFAULT_CUTOFF,
    threads: int = 1,
    solid_level: float | None = None,
) -> PatchBank:
    """Sample the pieces of a tile set, in cell units, at n voxels a cell edge; `offset` as in `PatchBank`.

    With `combinations` (m, 7) of an interior and six colors, each once, these are merged, and the bank serves tilings
    with these only. Without, every piece has a patch of its own, and the bank serves any tiling. A kernel is dropped
    below the cut-off, and a patch is trimmed where the sum of its kernels lies below it: with p patches over a voxel,
    trimming changes the sum by less than p times the cut-off. A `solid_level` makes an int16 bank, which serves
    `assemble_bits` at this level only, with half the memory; rounding changes the sum by at most ``p / 2 / 32767`` of
    the level. The result does not depend on the threads.
    """
    own, merged = _parts(pieces, combinations)
    kernels = [pieces[i] for i in own] + merged
    boxes = [_box(k, n, offset, cutoff) for k in kernels]
    there = [i for i, box in enumerate(boxes) if box is not None]
    low = np.array([boxes[i][0] for i in there], dtype=np.int32).reshape(-1, 3)  # type: ignore[index]
    size = np.array([boxes[i][1] for i in there], dtype=np.int32).reshape(-1, 3)  # type: ignore[index]
    rows = (size[:, 1] * size[:, 2]).astype(np.int64)
    first_row = np.cumsum(rows) - rows
    row_low = np.zeros(int(rows.sum()), dtype=np.int32)
    row_blocks = np.zeros_like(row_low)
    row_start = np.zeros(len(row_low), dtype=np.int64)
    # Upper bound of the length; memory that is never touched costs nothing, and the rest is given back below.
    kind = np.float32 if solid_level is None else np.int16
    data: NDArray[Any] = np.empty(int((size.prod(axis=1, dtype=np.int64)).sum()), dtype=kind)
    # Working space goes from patch to patch: fresh memory takes longer to get than to fill.
    most = int(size.prod(axis=1, dtype=np.int64).max(initial=0))
    scale = 1.0 if solid_level is None else FULL / solid_level
    free: list[tuple[F32, I16]] = []
    ends, numbers = _Ends(), iter(range(len(there)))

    def sampled(_: int) -> None:
        try:
            p = next(numbers)  # not the caller's number, which an interrupt may lose before it is taken
            part = slice(first_row[p], first_row[p] + rows[p])
            table = row_low[part], row_blocks[part], row_start[part]
            try:
                rooms = free.pop()
            except IndexError:
                rooms = np.empty(most, np.float32), np.empty(0 if solid_level is None else most, np.int16)
            room = rooms[0][: rows[p] * size[p, 0]]
            room[:] = 0.0
            values = room.reshape(size[p, 2], size[p, 1], size[p, 0])
            x, y, z = ((low[p] + offset) / n).tolist()
            add_kernels(values, Grid((x, y, z), (1.0 / n,) * 3, values.shape[::-1]), kernels[there[p]], cutoff)
            dense: NDArray[Any] = room
            if solid_level is not None:
                dense = rooms[1][: room.size]
                _round(room, np.float32(scale), dense)
            count = _measure(dense.reshape(-1, size[p, 0]), np.float32(cutoff * scale), int(low[p, 0]), *table)
            begin = ends.take(p, count)
        except BaseException:  # whatever happens, the next patch may wait for this one
            ends.give_up()
            raise
        if begin is None:
            return
        # rows were measured from 0 on; where the patch goes is known now
        table[2][:] += begin
        _copy_rows(dense.reshape(-1, size[p, 0]), int(low[p, 0]), *table, data)
        free.append(rooms)

    share_out(sampled, range(len(there)), threads)
    used = ends.last
    # in place: a copy would hold the bank twice for a moment
    data.resize(used, refcheck=False)

    patch = np.full(len(kernels), -1, dtype=np.int32)
    patch[there] = np.arange(len(there))
    piece = np.full(len(pieces) + 1, -2, dtype=np.int32)
    piece[own] = patch[: len(own)]
    piece[-1] = -1
    piece[:-1][np.diff(pieces.first_pore) + np.diff(pieces.first_tunnel) == 0] = -1
    codes = (
        _encode(np.asarray(combinations, dtype=np.int64).reshape(-1, 7), _base(pieces.numbers))
        if merged
        else np.zeros(0)
    )
    # sorted, so that a site finds its combination by bisection
    order = np.argsort(codes)
    return PatchBank(
        n, offset, cutoff, pieces.numbers, piece, codes[order].astype(np.int64), patch[len(own) :][order], low, size,
        first_row, row_low, row_blocks, row_start, data, solid_level,
    )  # fmt: skip


@jit
def _round(samples: F32, scale: np.float32, out: I16) -> None:
    """Samples in units of an int16 bank, none above FULL."""
    most = np.float32(FULL)
    for i in range(samples.size):
        out[i] = np.int16(min(np.rint(samples[i] * scale), most))


@jit
def _measure(dense: NDArray, threshold: np.float32, low: int, row_low: I32, row_blocks: I32, row_start: I64) -> int:
    """Write what each row (rows, nx) keeps, from the first to the last sample above the threshold; returns how much.

    Rows begin where the one before ends, the first at 0.
    """
    nx = dense.shape[1]
    used = 0
    for row in range(dense.shape[0]):
        row_start[row] = used
        first = 0
        while first < nx and dense[row, first] < threshold:
            first += 1
        if first == nx:
            continue
        last = nx - 1
        while dense[row, last] < threshold:
            last -= 1
        blocks = (last - first + LANES) // LANES
        # whole blocks that would run over the end begin earlier, at samples that are there
        row_low[row] = low + min(first, nx - LANES * blocks)
        row_blocks[row] = blocks
        used += LANES * blocks
    return used


@jit
def _copy_rows(dense: NDArray, low: int, row_low: I32, row_blocks: I32, row_start: I64, data: NDArray) -> None:
    """Copy what each row keeps to where it begins in `data`."""
    flat = dense.reshape(-1)
    for row in range(dense.shape[0]):
        source, to = np.uint64(row * dense.shape[1] + row_low[row] - low), np.uint64(row_start[row])
        for i in range(np.uint64(row_blocks[row]) << _SHIFT):
            data[to + i] = flat[source + i]


class _Ends:
    """Ends of consecutive patches whose lengths are determined by threads, in any order."""

    def __init__(self) -> None:
        self._known: dict[int, int] = {-1: 0}
        self._changed = Condition()
        self._given_up = False

    def take(self, number: int, length: int) -> int | None:
        """Start of a patch, once the lengths of all before it are known; None if one of them failed."""
        with self._changed:
            self._changed.wait_for(lambda: self._given_up or number - 1 in self._known)
            if self._given_up:
                return None
            begin = self._known[number - 1]
            self._known[number] = begin + length
            self._changed.notify_all()
        return begin

    def give_up(self) -> None:
        """Release all waiting threads after a failure."""
        with self._changed:
            self._given_up = True
            self._changed.notify_all()

    @property
    def last(self) -> int:
        """The end of the last one."""
        return max(self._known.values())


def patches_at(bank: PatchBank, tiling: TilingArrays, first: I64, stop: I64) -> tuple[Sites, I64, I32]:
    """The sites that exist of first <= site < stop, and the patches at each.

    Those of site i, in order z, y, x, are ``patches[begin[i] : begin[i + 1]]``. Raises ValueError if the bank was built
    for other combinations.
    """
    sites = sites_between(tiling, first, stop)
    numbers = site_pieces(bank.numbers, sites)
    found = bank.piece[numbers]
    if len(bank.codes):
        columns = [sites.interior] + [c for axis in range(3) for c in (sites.low[axis], sites.high[axis])]
        code = _encode(np.stack(columns, axis=-1).astype(np.int64), _base(bank.numbers))
        place = np.minimum(np.searchsorted(bank.codes, code), len(bank.codes) - 1)
        known = (bank.codes[place] == code) & (sites.interior >= 0)
        found[known] = -1
        found[known, 0] = bank.merged[place[known]]
    if (found == -2).any():
        raise ValueError("the tiling holds a combination of interior and colors for which the bank has no patches")
    flat = found.reshape(-1, found.shape[-1])
    keep = flat >= 0
    begin = np.concatenate([[0], np.cumsum(keep.sum(axis=1))]).astype(np.int64)
    return sites, begin, flat[keep]
