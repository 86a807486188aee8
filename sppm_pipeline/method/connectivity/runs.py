"""A voxel mask as runs: the maximal stretches of set voxels along x.

A porous layer has one run in ten to thirty voxels, so everything that follows (union-find, counting, clearing) touches
runs and not voxels. Runs are found 64 voxels at a time: the set bits of ``word ^ (word << 1)`` are where runs begin and
end.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import I32, I64, U8, U64, Bools
from sppm_pipeline.services.bit_rows import bit_index, pack, set_bits
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.union_find import unite

_ONE = np.uint64(1)
_TOP_BIT = np.uint64(63)


class Runs(NamedTuple):
    """The runs of a stack of layers, in the order of the voxels (z slowest).

    Attributes
    ----------
    shape : tuple of 3 ints
        (nz, ny, nx) of the mask.
    rows : (nz * ny + 1,) int64
        The runs of row ``z * ny + y`` are rows[...] <= r < rows[... + 1].
    bounds : (2 n,) int32
        Run r holds the voxels bounds[2 r] <= x < bounds[2 r + 1].
    """

    shape: tuple[int, int, int]
    rows: I64
    bounds: I32

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return self.bounds.size // 2

    @property
    def lengths(self) -> I32:
        """Voxels in each run, (n,)."""
        return self.bounds[1::2] - self.bounds[::2]


def as_bytes(mask: Bools | U8) -> U8:
    """A (nz, ny, nx) mask of bool or uint8 as contiguous bytes, without a copy where that is possible."""
    if mask.ndim != 3 or mask.dtype not in (np.dtype(np.bool_), np.dtype(np.uint8)):
        raise ValueError(f"a mask is (nz, ny, nx) of bool or uint8, not {mask.shape} of {mask.dtype}")
    return np.ascontiguousarray(mask).view(np.uint8)


def neighbor_reach(connectivity: int) -> int:
    """Voxels past the ends of a run that touch it in a neighboring row: 0 across faces (6), 1 across corners (26)."""
    if connectivity not in (6, 26):
        raise ValueError(f"connectivity is 6 (faces) or 26 (faces, edges, corners), not {connectivity}")
    return 0 if connectivity == 6 else 1


def find_runs(mask: U8, zeros: bool = False) -> Runs:
    """Runs of voxels of a mask (nz, ny, nx) that are not 0, or with `zeros` of those that are."""
    return runs_of_bits(pack(mask), mask.shape[2], zeros)


def runs_of_bits(bits: U64, nx: int, zeros: bool = False) -> Runs:
    """The runs of a mask (nz, ny, words), nx voxels in a row, see `services.bit_rows`; `zeros` as in `find_runs`."""
    nz, ny, words = bits.shape
    rows = np.empty(nz * ny + 1, np.int64)
    each = np.ascontiguousarray(bits).reshape(nz * ny, words)
    flip = np.uint64(0xFFFFFFFFFFFFFFFF if zeros else 0)
    bounds = np.empty(2 * _count_runs(each, nx, flip, rows), np.int32)
    _find_runs(each, nx, flip, rows, bounds)
    return Runs((nz, ny, nx), rows, bounds)


def stack_runs(slabs: Sequence[Runs]) -> Runs:
    """The runs of a mask from those of its consecutive slabs, which have ny and nx in common; at least one."""
    _, ny, nx = slabs[0].shape
    starts = np.cumsum([0, *(slab.n_runs for slab in slabs)])
    rows = [slab.rows[:-1] + start for slab, start in zip(slabs, starts[:-1], strict=True)]
    bounds = np.concatenate([slab.bounds for slab in slabs])
    return Runs((sum(slab.shape[0] for slab in slabs), ny, nx), np.concatenate([*rows, starts[-1:]]), bounds)


@jit
def _count_runs(bits: U64, nx: int, flip: np.uint64, rows: I64) -> int:
    """Write where the runs of each row begin, and return how many there are."""
    n_words = bits.shape[1]
    end = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 * n_words - nx)
    n = 0
    for y in range(bits.shape[0]):
        rows[y] = n
        starts = carry = np.uint64(0)
        for w in range(n_words):
            word = bits[y, w] ^ flip
            if w == n_words - 1:
                word &= end
            starts += set_bits(word & ~((word << _ONE) | carry))
            carry = word >> _TOP_BIT
        n += int(np.int64(starts))
    rows[bits.shape[0]] = n
    return n


@jit
def _find_runs(bits: U64, nx: int, flip: np.uint64, rows: I64, bounds: I32) -> None:
    n_words = bits.shape[1]
    end = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 * n_words - nx)
    for y in range(bits.shape[0]):
        n = 2 * rows[y]
        carry = np.uint64(0)
        for w in range(n_words):
            word = bits[y, w] ^ flip
            if w == n_words - 1:
                word &= end
            change = word ^ ((word << _ONE) | carry)
            carry = word >> _TOP_BIT
            while change != 0:
                # two's complement leaves the lowest set bit alone
                lowest = change & (~change + _ONE)
                bounds[n] = 64 * w + bit_index(lowest)
                n += 1
                change ^= lowest
        if n < 2 * rows[y + 1]:
            bounds[n] = nx


@jit
def join_rows(bounds: I32, a: int, a_stop: int, b: int, b_stop: int, reach: int, parent: I32) -> None:
    """Unite the touching runs of two neighboring rows, a <= r < a_stop and b <= r < b_stop."""
    while a < a_stop and b < b_stop:
        if bounds[2 * a + 1] + reach <= bounds[2 * b]:
            a += 1
        elif bounds[2 * b + 1] + reach <= bounds[2 * a]:
            b += 1
        else:
            unite(parent, a, b)
            if bounds[2 * a + 1] < bounds[2 * b + 1]:
                a += 1
            else:
                b += 1
