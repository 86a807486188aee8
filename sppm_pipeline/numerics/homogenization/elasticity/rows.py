"""Rows of three components at a time, as `multigrid.rows` has them for one: one loop instead of three."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import inline_jit
from sppm_pipeline.numerics.homogenization.multigrid.rows import APPLY, HEAD, SMOOTH, STRIDE

_1, _HEAD = np.uint64(1), np.uint64(HEAD)
_R = tuple(np.uint64(STRIDE * row) for row in range(45))


@inline_jit
def _gather_node(v: NDArray[Any], a: Any, b: Any, comp: Any, s: NDArray[Any], to: Any) -> None:
    c = comp + comp
    s[to], s[to + _R[1]] = v[a] + v[b], v[b] - v[a]
    s[to + _R[2]], s[to + _R[3]] = v[a + comp] + v[b + comp], v[b + comp] - v[a + comp]
    s[to + _R[4]], s[to + _R[5]] = v[a + c] + v[b + c], v[b + c] - v[a + c]


@inline_jit
def gather_rows(v: NDArray[Any], a: Any, b: Any, comp: Any, n: Any, start: Any, width: Any, s: NDArray[Any]) -> None:
    """Sum and difference of two rows of nodes, from ``start - 1`` to ``start + width``, to the first rows of scratch.

    Parameters
    ----------
    v : flat
    a, b : uint64
        Where the rows in the planes below and above begin.
    comp : uint64
        Distance of components.
    n, start, width : uint64
        Length of a row; the block.
    s : flat
    """
    c = comp + comp
    low, high = a + start, b + start
    for i in range(width):
        p, q, to = low + i, high + i, _HEAD + i
        x, y = v[p], v[q]
        s[to], s[to + _R[1]] = x + y, y - x
        x, y = v[p + comp], v[q + comp]
        s[to + _R[2]], s[to + _R[3]] = x + y, y - x
        x, y = v[p + c], v[q + c]
        s[to + _R[4]], s[to + _R[5]] = x + y, y - x
    before = start - _1 if start > 0 else n - _1
    _gather_node(v, a + before, b + before, comp, s, _HEAD - _1)
    after = start + width if start + width < n else start - start
    _gather_node(v, a + after, b + after, comp, s, _HEAD + width)


@inline_jit
def scatter_rows(s: NDArray[Any], plane: NDArray[Any], at: Any, width: Any) -> None:
    """From forces of bricks in modes of x and z (rows 30 to 41) to forces of nodes (rows 42 to 44).

    Parameters
    ----------
    s : flat
    plane : flat
        What the bricks below left for these nodes, components a stride apart; receives what the bricks leave for the
        plane above.
    at, width : uint64
        Where the row of `plane` begins; the block.
    """
    for i in range(width):
        b = _HEAD + i
        a = b - _1
        p = at + i
        low = (s[a + _R[30]] + s[a + _R[31]]) + (s[b + _R[30]] - s[b + _R[31]])
        high = (s[a + _R[32]] + s[a + _R[33]]) + (s[b + _R[32]] - s[b + _R[33]])
        s[i + _R[42]] = plane[p] + (low - high)
        plane[p] = low + high
        low = (s[a + _R[34]] + s[a + _R[35]]) + (s[b + _R[34]] - s[b + _R[35]])
        high = (s[a + _R[36]] + s[a + _R[37]]) + (s[b + _R[36]] - s[b + _R[37]])
        s[i + _R[43]] = plane[p + _R[1]] + (low - high)
        plane[p + _R[1]] = low + high
        low = (s[a + _R[38]] + s[a + _R[39]]) + (s[b + _R[38]] - s[b + _R[39]])
        high = (s[a + _R[40]] + s[a + _R[41]]) + (s[b + _R[40]] - s[b + _R[41]])
        s[i + _R[44]] = plane[p + _R[2]] + (low - high)
        plane[p + _R[2]] = low + high


@inline_jit
def _apply_rows(v: NDArray[Any], at: Any, comp: Any, s: NDArray[Any], out: NDArray[Any], width: Any) -> float:
    c = comp + comp
    for i in range(width):
        o = at + i
        out[o] = s[i + _R[42]]
        out[o + comp] = s[i + _R[43]]
        out[o + c] = s[i + _R[44]]
    total = 0.0
    for i in range(width):
        o = at + i
        total += np.float64(v[o]) * np.float64(s[i + _R[42]])
        total += np.float64(v[o + comp]) * np.float64(s[i + _R[43]])
        total += np.float64(v[o + c]) * np.float64(s[i + _R[44]])
    return total


@inline_jit
def _residual_rows(r: NDArray[Any], at: Any, comp: Any, s: NDArray[Any], out: NDArray[Any], width: Any) -> None:
    c = comp + comp
    for i in range(width):
        o = at + i
        out[o] = r[o] - s[i + _R[42]]
        out[o + comp] = r[o + comp] - s[i + _R[43]]
        out[o + c] = r[o + c] - s[i + _R[44]]


@inline_jit
def _smooth_rows(
    v: NDArray[Any], r: NDArray[Any], at: Any, comp: Any, weight: NDArray[Any], wat: Any, s: NDArray[Any],
    out: NDArray[Any], width: Any,
) -> float:  # fmt: skip
    c = comp + comp
    for i in range(width):
        o, w = at + i, weight[wat + i]
        s[i + _R[42]] = v[o] + w * (r[o] - s[i + _R[42]])
        s[i + _R[43]] = v[o + comp] + w * (r[o + comp] - s[i + _R[43]])
        s[i + _R[44]] = v[o + c] + w * (r[o + c] - s[i + _R[44]])
    return _apply_rows(r, at, comp, s, out, width)


@inline_jit
def finish_rows(
    mode: int, v: NDArray[Any], r: NDArray[Any], at: Any, comp: Any, weight: NDArray[Any], wat: Any, s: NDArray[Any],
    out: NDArray[Any], width: Any,
) -> float:  # fmt: skip
    """Write what the pass is asked for, `APPLY`, `RESIDUAL` or `SMOOTH`; returns the scalar product."""
    if mode == APPLY:
        return _apply_rows(v, at, comp, s, out, width)
    if mode == SMOOTH:
        return _smooth_rows(v, r, at, comp, weight, wat, s, out, width)
    _residual_rows(r, at, comp, s, out, width)
    return 0.0
