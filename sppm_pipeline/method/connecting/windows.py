"""Windows over a lattice of blocks of pores: a graph that is too large for one search is joined window by window.

Pores are sorted by block, blocks by lattice place in C order of (x, y, z). Windows are boxes of blocks that share no
block and together hold all of them; a window may be looked at with a margin of pores from the blocks around it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I64, Bools


class Lattice(NamedTuple):
    """Pores sorted by the blocks of a lattice; block (x, y, z) fills [x, x + 1] x [y, y + 1] x [z, z + 1]."""

    points: F64  # (n, 3) in edges of a block
    first: I64  # (blocks + 1,) where the pores of each block begin
    shape: tuple[int, int, int]  # blocks along x, y and z
    period: F64  # (3,) `shape` along axes that repeat, else 0


class Window(NamedTuple):
    """Pores of a window and of its margin."""

    pores: I64  # (n,) by block and index; a pore may occur several times, as different images
    turns: I64  # (n, 3) whole cells from each pore to its image here
    own: Bools  # (n,) in a block of the window, not in the margin


def window_edge(spacing: float, most: int, margin: float) -> int:
    """Blocks along the edge of the largest cubic window that holds, margin included, about `most` pores.

    `spacing` is the mean distance of pores in blocks.
    """
    return max(1, int(most ** (1 / 3) * spacing - 2 * margin))


def window_corners(shape: tuple[int, int, int], edge: int) -> Iterator[I64]:
    """Low and high block (2, 3) of each window, in C order."""
    cuts = [np.minimum(np.arange(0, size + edge, edge), size) for size in shape]
    for i in range(len(cuts[0]) - 1):
        for j in range(len(cuts[1]) - 1):
            for k in range(len(cuts[2]) - 1):
                yield np.array([[c[m], c[m + 1]] for c, m in zip(cuts, (i, j, k), strict=True)]).T


def window(lattice: Lattice, corners: I64, margin: float) -> Window:
    """The pores of the blocks between two corners, and those at most `margin` away from that box along any axis."""
    shape = np.array(lattice.shape)
    period = lattice.period.astype(np.int64)
    around = int(np.ceil(margin))
    low = np.where(period > 0, corners[0] - around, np.maximum(corners[0] - around, 0))
    high = np.where(period > 0, corners[1] + around, np.minimum(corners[1] + around, shape))
    blocks = np.stack(np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
    blocks = blocks.reshape(-1, 3)
    number = np.ravel_multi_index(tuple((blocks % shape).T), lattice.shape)
    count = lattice.first[number + 1] - lattice.first[number]
    before = np.cumsum(count) - count
    pores = np.repeat(lattice.first[number] - before, count) + np.arange(count.sum())
    turns = np.repeat(blocks - blocks % shape, count, axis=0)
    own = np.repeat(((blocks >= corners[0]) & (blocks < corners[1])).all(axis=1), count)
    places = lattice.points[pores] + turns
    # whole blocks would be up to a block wider than the margin asks for, and their pores joined in vain
    near = own | ((places >= corners[0] - margin) & (places <= corners[1] + margin)).all(axis=1)
    return Window(pores[near], turns[near], own[near])


def edges_of_window(found: Window, edges: I64, shifts: I64) -> tuple[I64, I64]:
    """The edges among pores of a window with margin that belong to the window: those whose lower pore is its own.

    Windows that overlap by their margins thus report each edge once. Edges between images of one pore are dropped.
    Edges (m, 2) and shifts (m, 3) are between positions in ``found.pores``; the result is between pores i < j, from
    ``points[i]`` to ``points[j] + shift``.
    """
    pores = found.pores[edges]
    # from the lower pore, so that both windows of an edge across a border name it alike
    turned = pores[:, 0] > pores[:, 1]
    ends = np.where(turned[:, None], edges[:, ::-1], edges)
    kept = found.own[ends[:, 0]] & (pores[:, 0] != pores[:, 1])
    moved = np.where(turned[:, None], -shifts, shifts) + found.turns[ends[:, 1]] - found.turns[ends[:, 0]]
    return found.pores[ends[kept]], moved[kept]
