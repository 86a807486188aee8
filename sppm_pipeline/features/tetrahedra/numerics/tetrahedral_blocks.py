"""Symmetric sparse matrices of 3 x 3 blocks: products and sweeps of Gauss and Seidel for six vectors at a time.

How long these take is how long it takes to read the matrix, so blocks below the diagonal are not kept: those above it
are read in their place.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import inline_jit

Vectors = NDArray[np.float64]

CASES = 6
"""Load cases that are solved at a time, so that the matrix is read once for all of them."""


class Blocks:
    """A symmetric matrix that multiplies, and is relaxed for, six vectors at a time.

    Made of a bsr_matrix, (3 n, 3 n), of blocks 3 x 3, those on the diagonal positive definite. Of the rest only the
    part above it is read.
    """

    def __init__(self, matrix: Any) -> None:
        size = len(matrix.indptr) - 1
        rows = np.repeat(np.arange(size, dtype=matrix.indices.dtype), np.diff(matrix.indptr))
        beyond = matrix.indices > rows
        self._starts = np.concatenate([[0], np.cumsum(np.bincount(rows[beyond], minlength=size))])
        self._columns, self._values = matrix.indices[beyond], matrix.data[beyond]
        self._diagonal = matrix.data[matrix.indices == rows]

    @cached_property
    def _inverses(self) -> NDArray[np.float64]:
        """Of the blocks on the diagonal."""
        inverses: NDArray[np.float64] = np.linalg.inv(self._diagonal)
        return inverses

    def product(self, x: Vectors) -> Vectors:
        """The matrix times each column of `x`, (3 n, 6)."""
        made = np.empty((len(self._diagonal), 3, CASES))
        _multiply(self._starts, self._columns, self._values, self._diagonal, x.reshape(made.shape), made)
        return made.reshape(-1, CASES)

    def relaxed(self, right: Vectors) -> tuple[Vectors, Vectors]:
        """One sweep from zero, from the first block to the last, and what is left of the right-hand side then.

        The sweep finds zeros beyond each block, and only they change what is left of it afterwards.
        """
        x = right.reshape(len(self._diagonal), 3, CASES).copy()
        left = np.empty_like(x)
        _relax_from_zero(self._starts, self._columns, self._values, self._inverses, x)
        _leave(self._starts, self._columns, self._values, x, left)
        return x.reshape(-1, CASES), left.reshape(-1, CASES)

    def relax_back(self, right: Vectors, x: Vectors) -> None:
        """One sweep, from the last block to the first; changes `x`, (3 n, 6)."""
        x = x.reshape(len(self._diagonal), 3, CASES)
        rest = right.reshape(x.shape).copy()
        _relax_back(self._starts, self._columns, self._values, self._inverses, rest, x)


@inline_jit
def _add_of_later(
    start: int, stop: int, columns: NDArray[np.int32], values: NDArray[np.float64], x: NDArray[np.float64],
    total: NDArray[np.float64],
) -> None:  # fmt: skip
    """Add the blocks of a row times their part of `x` to a sum (3, 6).

    From the last one on, as rows are taken from the last one on: memory is read in one direction.
    """
    for at in range(stop - 1, start - 1, -1):
        column = columns[at]
        a, b, c = values[at, 0, 0], values[at, 0, 1], values[at, 0, 2]
        d, e, f = values[at, 1, 0], values[at, 1, 1], values[at, 1, 2]
        g, h, i = values[at, 2, 0], values[at, 2, 1], values[at, 2, 2]
        for k in range(CASES):
            u, v, w = x[column, 0, k], x[column, 1, k], x[column, 2, k]
            total[0, k] += a * u + b * v + c * w
            total[1, k] += d * u + e * v + f * w
            total[2, k] += g * u + h * v + i * w


@inline_jit
def _add_to_later(
    start: int, stop: int, columns: NDArray[np.int32], values: NDArray[np.float64], own: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    """Add the blocks of a row, as those of the column that it is too, times a part of a vector (3, 6)."""
    for at in range(start, stop):
        column = columns[at]
        a, b, c = values[at, 0, 0], values[at, 0, 1], values[at, 0, 2]
        d, e, f = values[at, 1, 0], values[at, 1, 1], values[at, 1, 2]
        g, h, i = values[at, 2, 0], values[at, 2, 1], values[at, 2, 2]
        for k in range(CASES):
            u, v, w = own[0, k], own[1, k], own[2, k]
            out[column, 0, k] += a * u + d * v + g * w
            out[column, 1, k] += b * u + e * v + h * w
            out[column, 2, k] += c * u + f * v + i * w


@inline_jit
def _multiply(
    starts: NDArray[np.int64], columns: NDArray[np.int32], values: NDArray[np.float64], diagonal: NDArray[np.float64],
    x: NDArray[np.float64], out: NDArray[np.float64],
) -> None:  # fmt: skip
    """The matrix times (n, 3, 6)."""
    own, total = np.empty((3, CASES)), np.empty((3, CASES))
    for row in range(len(out) - 1, -1, -1):
        for i in range(3):
            a, b, c = diagonal[row, i, 0], diagonal[row, i, 1], diagonal[row, i, 2]
            for k in range(CASES):
                own[i, k] = x[row, i, k]
                total[i, k] = a * x[row, 0, k] + b * x[row, 1, k] + c * x[row, 2, k]
        _add_of_later(starts[row], starts[row + 1], columns, values, x, total)
        for i in range(3):
            for k in range(CASES):
                out[row, i, k] = total[i, k]
        _add_to_later(starts[row], starts[row + 1], columns, values, own, out)


@inline_jit
def _relax_from_zero(
    starts: NDArray[np.int64],
    columns: NDArray[np.int32],
    values: NDArray[np.float64],
    inverses: NDArray[np.float64],
    x: NDArray[np.float64],
) -> None:
    """Replace a right-hand side, block by block, by what its residual asks for while all later blocks are zero."""
    own = np.empty((3, CASES))
    for row in range(len(x)):
        for i in range(3):
            a, b, c = inverses[row, i, 0], inverses[row, i, 1], inverses[row, i, 2]
            for k in range(CASES):
                own[i, k] = a * x[row, 0, k] + b * x[row, 1, k] + c * x[row, 2, k]
        for i in range(3):
            for k in range(CASES):
                x[row, i, k] = own[i, k]
                own[i, k] = -own[i, k]
        _add_to_later(starts[row], starts[row + 1], columns, values, own, x)


@inline_jit
def _leave(
    starts: NDArray[np.int64],
    columns: NDArray[np.int32],
    values: NDArray[np.float64],
    x: NDArray[np.float64],
    left: NDArray[np.float64],
) -> None:
    """Residual after a sweep from the first block to the last: less what later blocks have taken from zero to `x`."""
    total = np.empty((3, CASES))
    for row in range(len(x) - 1, -1, -1):
        for i in range(3):
            for k in range(CASES):
                total[i, k] = 0.0
        _add_of_later(starts[row], starts[row + 1], columns, values, x, total)
        for i in range(3):
            for k in range(CASES):
                left[row, i, k] = -total[i, k]


@inline_jit
def _relax_back(
    starts: NDArray[np.int64], columns: NDArray[np.int32], values: NDArray[np.float64], inverses: NDArray[np.float64],
    rest: NDArray[np.float64], x: NDArray[np.float64],
) -> None:  # fmt: skip
    """Set each block, from the last on, to what the right-hand side asks for; `rest` is that, and is used up."""
    own, total = np.empty((3, CASES)), np.empty((3, CASES))
    for row in range(len(x)):
        for i in range(3):
            for k in range(CASES):
                own[i, k] = -x[row, i, k]
        _add_to_later(starts[row], starts[row + 1], columns, values, own, rest)
    for row in range(len(x) - 1, -1, -1):
        for i in range(3):
            for k in range(CASES):
                total[i, k] = 0.0
        _add_of_later(starts[row], starts[row + 1], columns, values, x, total)
        for i in range(3):
            for k in range(CASES):
                total[i, k] = rest[row, i, k] - total[i, k]
        for i in range(3):
            a, b, c = inverses[row, i, 0], inverses[row, i, 1], inverses[row, i, 2]
            for k in range(CASES):
                x[row, i, k] = a * total[0, k] + b * total[1, k] + c * total[2, k]
