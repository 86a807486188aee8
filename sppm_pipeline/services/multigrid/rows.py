"""Row operations of the passes over a grid, for any number of components.

A pass takes rows in blocks of at most `BLOCK` nodes. A row of scratch holds the block from the node before it to the
one after it, the first node of the block at `HEAD`. Rows of scratch lie `STRIDE` apart, a constant, so that the
compiler can tell that they never overlap, and uses vector instructions. For the same reason arrays are flat, offsets
are unsigned (no index can count from the end), and nothing is sliced: a slice costs as much as ten nodes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import inline_jit

LANES = 8
HEAD = 16
BLOCK = 256
STRIDE = HEAD + BLOCK + 32

#: What a pass makes of the forces f of the displacements v: f itself and v·f; or r - f; or v + w (r - f), times r.
APPLY, RESIDUAL, SMOOTH = 0, 1, 2

_1, _HEAD = np.uint64(1), np.uint64(HEAD)
_R1, _R2, _R3 = np.uint64(STRIDE), np.uint64(2 * STRIDE), np.uint64(3 * STRIDE)


@inline_jit
def gather_row(v: NDArray[Any], low: Any, high: Any, n: Any, start: Any, width: Any, s: NDArray[Any], row: Any) -> None:
    """Sum and difference of two rows of nodes, from ``start - 1`` to ``start + width``, periodic.

    Parameters
    ----------
    v : flat
    low, high : uint64
        Where the rows in the planes below and above begin.
    n, start, width : uint64
        Length of a row; the block.
    s : flat
        Receives ``low + high`` and, a stride further, ``high - low``.
    row : uint64
        Where the row of scratch begins.
    """
    to = row + _HEAD
    for i in range(width):
        a, b = v[low + start + i], v[high + start + i]
        s[to + i] = a + b
        s[to + _R1 + i] = b - a
    before = start - _1 if start > 0 else n - _1
    a, b = v[low + before], v[high + before]
    s[to - _1] = a + b
    s[to + _R1 - _1] = b - a
    after = start + width if start + width < n else start - start
    a, b = v[low + after], v[high + after]
    s[to + width] = a + b
    s[to + _R1 + width] = b - a


@inline_jit
def scatter_row(s: NDArray[Any], line: Any, to: Any, plane: NDArray[Any], at: Any, width: Any) -> None:
    """From forces of bricks in modes of x and z to forces of nodes.

    Parameters
    ----------
    s : flat
    line : uint64
        Where the modes begin: (sum, sum), (sum, difference), (difference, sum), (difference, difference) along z and x.
    to : uint64
        Where the forces of the nodes go.
    plane : flat
        What the bricks below left for these nodes; receives what the bricks leave for the plane above.
    at, width : uint64
        Where the row of `plane` begins; the block.
    """
    b = line + _HEAD
    a = b - _1
    for i in range(width):
        low = (s[a + i] + s[a + _R1 + i]) + (s[b + i] - s[b + _R1 + i])
        high = (s[a + _R2 + i] + s[a + _R3 + i]) + (s[b + _R2 + i] - s[b + _R3 + i])
        s[to + i] = plane[at + i] + (low - high)
        plane[at + i] = low + high


@inline_jit
def _apply_row(v: NDArray[Any], at: Any, s: NDArray[Any], f: Any, out: NDArray[Any], width: Any) -> float:
    total = 0.0
    for i in range(width):
        out[at + i] = s[f + i]
    for i in range(width):
        total += np.float64(v[at + i]) * np.float64(s[f + i])
    return total


@inline_jit
def _residual_row(r: NDArray[Any], at: Any, s: NDArray[Any], f: Any, out: NDArray[Any], width: Any) -> None:
    for i in range(width):
        out[at + i] = r[at + i] - s[f + i]


@inline_jit
def _smooth_row(
    v: NDArray[Any], r: NDArray[Any], at: Any, weight: NDArray[Any], wat: Any, s: NDArray[Any], f: Any,
    out: NDArray[Any], width: Any,
) -> float:  # fmt: skip
    total = 0.0
    for i in range(width):
        s[f + i] = v[at + i] + weight[wat + i] * (r[at + i] - s[f + i])
    for i in range(width):
        out[at + i] = s[f + i]
    for i in range(width):
        total += np.float64(r[at + i]) * np.float64(s[f + i])
    return total


@inline_jit
def finish_row(
    mode: int, v: NDArray[Any], r: NDArray[Any], at: Any, weight: NDArray[Any], wat: Any, s: NDArray[Any], f: Any,
    out: NDArray[Any], width: Any,
) -> float:  # fmt: skip
    """Write what the pass is asked for, `APPLY`, `RESIDUAL` or `SMOOTH`; returns the scalar product."""
    if mode == APPLY:
        return _apply_row(v, at, s, f, out, width)
    if mode == SMOOTH:
        return _smooth_row(v, r, at, weight, wat, s, f, out, width)
    _residual_row(r, at, s, f, out, width)
    return 0.0
