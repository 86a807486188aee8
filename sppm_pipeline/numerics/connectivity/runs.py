"""A voxel mask as runs: the maximal stretches of set voxels along x.

A porous layer has one run in ten to thirty voxels, so everything that follows (union-find, counting, clearing) touches
runs and not voxels. Runs are found 64 voxels at a time: eight bytes of zeros and ones become eight bits by one
multiplication, and the set bits of ``word ^ (word << 1)`` are where runs begin and end.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit

_ONE = np.uint64(1)
# byte i of a word of zeros and ones lands in bit 56 + i; the partial products never meet, so nothing is carried
_GATHER = np.uint64(0x0102040810204080)
_GATHER_SHIFT = np.uint64(56)
_TOP_BIT = np.uint64(63)
# index of the only set bit: the six top bits of a de Bruijn sequence times that bit are different for each bit
_SEQUENCE = 0x03F79D71B4CB0A89
_DE_BRUIJN = np.uint64(_SEQUENCE)
_DE_BRUIJN_SHIFT = np.uint64(58)
_BIT_INDEX = np.argsort([((_SEQUENCE << bit) & 0xFFFFFFFFFFFFFFFF) >> 58 for bit in range(64)]).astype(np.int32)


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
    rows: NDArray[np.int64]
    bounds: NDArray[np.int32]

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return self.bounds.size // 2

    @property
    def lengths(self) -> NDArray[np.int32]:
        """Voxels in each run, (n,)."""
        return self.bounds[1::2] - self.bounds[::2]


def as_bytes(mask: NDArray[np.bool_] | NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A (nz, ny, nx) mask as contiguous bytes, without a copy where that is possible.

    Raises
    ------
    ValueError
        If the mask is not three-dimensional or neither bool nor uint8.
    """
    if mask.ndim != 3 or mask.dtype not in (np.dtype(np.bool_), np.dtype(np.uint8)):
        raise ValueError(f"a mask is (nz, ny, nx) of bool or uint8, not {mask.shape} of {mask.dtype}")
    return np.ascontiguousarray(mask).view(np.uint8)


def neighbor_reach(connectivity: int) -> int:
    """How far a neighboring row is looked past a run: 0 for 6-connectivity (faces), 1 for 26 (edges, corners).

    Raises
    ------
    ValueError
        For any other connectivity.
    """
    if connectivity not in (6, 26):
        raise ValueError(f"connectivity is 6 (faces) or 26 (faces, edges, corners), not {connectivity}")
    return 0 if connectivity == 6 else 1


def find_runs(mask: NDArray[np.uint8], zeros: bool = False) -> Runs:
    """The runs of a mask.

    Parameters
    ----------
    mask : (nz, ny, nx) uint8, C-contiguous
        Anything but 0 is set.
    zeros : bool
        Find the runs of the voxels that are not set.

    Returns
    -------
    Runs
    """
    rows, bounds = _find_runs(mask, np.uint8(zeros))
    return Runs((mask.shape[0], mask.shape[1], mask.shape[2]), rows, bounds.copy())


def stack_runs(slabs: Sequence[Runs]) -> Runs:
    """The runs of a mask from those of its consecutive slabs, which have ny and nx in common; at least one."""
    _, ny, nx = slabs[0].shape
    starts = np.cumsum([0, *(slab.n_runs for slab in slabs)])
    rows = [slab.rows[:-1] + start for slab, start in zip(slabs, starts[:-1], strict=True)]
    bounds = np.concatenate([slab.bounds for slab in slabs])
    return Runs((sum(slab.shape[0] for slab in slabs), ny, nx), np.concatenate([*rows, starts[-1:]]), bounds)


@jit
def _find_runs(mask: NDArray[np.uint8], flip: np.uint8) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    nz, ny, nx = mask.shape
    rows = np.empty(nz * ny + 1, np.int64)
    n_words = (nx + 63) // 64
    words = np.zeros(n_words * 8, np.uint64)
    flags = words.view(np.uint8)
    most = 2 * (nx // 2 + 1)  # bounds that one row can add
    bounds = np.empty(max(most, mask.size // 16), np.int32)
    n = 0
    for z in range(nz):
        for y in range(ny):
            rows[z * ny + y] = n // 2
            if n + most > bounds.size:
                grown = np.empty(2 * bounds.size + most, np.int32)
                for i in range(n):
                    grown[i] = bounds[i]
                bounds = grown
            row = mask[z, y]
            for x in range(nx):
                flags[x] = np.uint8(row[x] != 0) ^ flip
            carry = np.uint64(0)
            for w in range(n_words):
                packed = np.uint64(0)
                for b in range(8):
                    packed |= ((words[8 * w + b] * _GATHER) >> _GATHER_SHIFT) << np.uint64(8 * b)
                change = packed ^ ((packed << _ONE) | carry)
                carry = packed >> _TOP_BIT
                while change != 0:
                    lowest = change & (~change + _ONE)
                    bounds[n] = 64 * w + _BIT_INDEX[(lowest * _DE_BRUIJN) >> _DE_BRUIJN_SHIFT]
                    n += 1
                    change ^= lowest
            if n % 2 == 1:
                bounds[n] = nx
                n += 1
    rows[nz * ny] = n // 2
    return rows, bounds[:n]


@jit
def find_root(parent: NDArray[np.int32], i: int) -> int:
    """Root of `i` in a union-find forest whose parents never have a larger index; halves the path on its way."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@jit
def unite(parent: NDArray[np.int32], i: int, j: int) -> None:
    """Unite the components of two members of such a forest; the smaller root stays."""
    root_i = find_root(parent, i)
    root_j = find_root(parent, j)
    if root_i < root_j:
        parent[root_j] = root_i
    elif root_j < root_i:
        parent[root_i] = root_j


@jit
def join_rows(
    bounds: NDArray[np.int32], a: int, a_stop: int, b: int, b_stop: int, reach: int, parent: NDArray[np.int32]
) -> None:
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
