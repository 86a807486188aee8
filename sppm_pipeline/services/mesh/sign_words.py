"""The signs of a field, 64 samples to a word, and counts of crossed edges and cubes from them.

Bit i % 64 of ``words[k, j, i // 64]`` says whether sample (i, j, k) is solid; bits past the end of a row are 0. A view
of a row would cost a reference count at every call, so the kernels take the plane and the number of the row.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import F32, U8, U64
from sppm_pipeline.services.bit_rows import gather, set_bits
from sppm_pipeline.services.jit.compiled import inline_jit, jit

ONE = np.uint64(1)
_LAST = np.uint64(63)


@inline_jit
def _below(row: F32, level: np.float32, flags: U8) -> None:
    for i in range(row.size):
        flags[i] = row[i] < level


@jit
def pack_signs(slab: F32, level: np.float32, words: U64) -> None:
    """Fill the words (nz, ny, ceil(nx / 64)) of a slab (nz, ny, nx)."""
    n_words = words.shape[2]
    flags = np.zeros(64 * n_words, np.uint8)
    bytes8 = flags.view(np.uint64)
    for k in range(slab.shape[0]):
        for j in range(slab.shape[1]):
            _below(slab[k, j], level, flags)
            for w in range(n_words):
                words[k, j, w] = gather(bytes8, 8 * w)


@jit
def ones(word: np.uint64) -> int:
    """Number of set bits."""
    return int(np.int64(set_bits(word)))


@jit
def lowest(word: np.uint64) -> int:
    """Number of the lowest set bit."""
    return ones((word & (~word + ONE)) - ONE)


@jit
def shifted_word(words: U64, j: int, w: int) -> np.uint64:
    """Word w of row j moved down by one: bit i holds sample i + 1."""
    word: np.uint64 = words[j, w] >> ONE
    if w + 1 < words.shape[1]:
        word |= words[j, w + 1] << _LAST
    return word


@jit
def cells_mask(w: int, nx: int) -> np.uint64:
    """Bits of word w that belong to one of the nx - 1 cubes of a row."""
    left = nx - 1 - 64 * w
    if left >= 64:
        return ~np.uint64(0)
    return (ONE << np.uint64(left)) - ONE


@jit
def plane_crossings(words: U64, nx: int) -> int:
    """Number of edges along x and y within one plane of samples that the surface crosses."""
    ny, n_words = words.shape
    n = 0
    for j in range(ny):
        for w in range(n_words):
            n += ones((words[j, w] ^ shifted_word(words, j, w)) & cells_mask(w, nx))
            if j + 1 < ny:
                n += ones(words[j, w] ^ words[j + 1, w])
    return n


@jit
def mixed_cells(low: U64, high: U64, j: int, w: int, nx: int) -> np.uint64:
    """The cubes between rows j and j + 1 of two planes whose corners are not all alike."""
    s0, s1, s2, s3 = low[j, w], low[j + 1, w], high[j, w], high[j + 1, w]
    n0, n1, n2, n3 = (
        shifted_word(low, j, w),
        shifted_word(low, j + 1, w),
        shifted_word(high, j, w),
        shifted_word(high, j + 1, w),
    )
    some: np.uint64 = s0 | s1 | s2 | s3 | n0 | n1 | n2 | n3
    every: np.uint64 = s0 & s1 & s2 & s3 & n0 & n1 & n2 & n3
    return some & ~every & cells_mask(w, nx)


@jit
def _layer_counts(low: U64, high: U64, nx: int) -> tuple[int, int]:
    """Number of crossed edges along z, and of cubes with the surface in them, between two planes."""
    ny, n_words = low.shape
    edges = 0
    cubes = 0
    for j in range(ny):
        for w in range(n_words):
            edges += ones(low[j, w] ^ high[j, w])
            if j + 1 < ny:
                cubes += ones(mixed_cells(low, high, j, w, nx))
    return edges, cubes


@jit
def slab_counts(words: U64, nx: int, first: bool) -> tuple[int, int]:
    """Number of vertices, and a bound on the number of triangles, that `_emit` will make.

    A loop of n edges makes n - 2 triangles, a cube with the surface in it has at least one loop, an edge touches at
    most four cubes.
    """
    planes = words.shape[0]
    before = plane_crossings(words[0], nx)
    vertices = before if first else 0
    triangles = 0
    for p in range(1, planes):
        here = plane_crossings(words[p], nx)
        edges, cubes = _layer_counts(words[p - 1], words[p], nx)
        vertices += here + edges
        triangles += 2 * (before + here) + 4 * edges - 2 * cubes
        before = here
    return vertices, triangles
