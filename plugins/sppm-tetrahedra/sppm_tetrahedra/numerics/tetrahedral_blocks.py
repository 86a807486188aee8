"""Symmetric sparse matrices of 3 x 3 blocks: products and sweeps of Gauss and Seidel for six vectors at a time.

How long these take is how long it takes to read the matrix, so blocks below the diagonal are not kept: those above it
are read in their place.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.numerics import F64, I32, I64, inline_jit, jit
from sppm_tetrahedra.numerics.quality import SLOPES, quadratic_gradients

# The quadrature of degree 2 with four points (Hammer, Marlowe and Stroud 1956) suffices for
# straight-sided quadratic tetrahedra, whose gradients are linear.
_A, _B = (5 + 3 * 5**0.5) / 20, (5 - 5**0.5) / 20
_POINTS = np.array([[_A, _B, _B, _B], [_B, _A, _B, _B], [_B, _B, _A, _B], [_B, _B, _B, _A]])


class Assembled(NamedTuple):
    """The discrete problem of a cell."""

    matrix: Any  # scipy.sparse.bsr_matrix, (3 n, 3 n), blocks 3 x 3
    # (6, 3 n), forces of unit strains (Voigt, engineering shear); displacements solve ``matrix u = -load``
    loads: F64
    # (6, 6), volume times material stiffness: energies of the unit strains without any displacement
    mean: F64
    volume: float


def assemble(nodes: F64, cells: I32, unknowns: I64, lame: F64, shear: F64) -> Assembled:
    """Assemble the stiffness of a mesh of nodes (n, 3) and cells (m, 4) or (m, 10), in the order of `VolumeMesh`.

    `unknowns`, (n,), number the displacement that each node has from 0 without gaps; nodes that periodicity makes one
    share it. `lame` and `shear`, (m,), are Lamé's first constant and the shear modulus of each cell. ValueError if a
    cell has no positive volume at a point of quadrature.
    """
    from scipy.sparse import bsr_matrix, coo_matrix

    nodes, corners = np.ascontiguousarray(nodes, np.float64), np.ascontiguousarray(cells, np.int64)
    count = int(unknowns.max()) + 1
    gradients = _reference_gradients(corners.shape[1])
    weight = 1 / 6 / len(gradients)
    at = np.ascontiguousarray(unknowns[corners], np.int64)
    m, width = at.shape
    ones = np.ones(m * width * width, np.int8)
    pairs = (np.repeat(at, width, axis=1).reshape(-1), np.tile(at, (1, width)).reshape(-1))
    # the pattern first and the numbers into it: a list of all element matrices would take many times the
    # memory
    pattern = coo_matrix((ones, pairs), shape=(count, count)).tocsr()
    pattern.sort_indices()
    starts, columns = pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64)
    blocks = np.zeros((len(columns), 3, 3))
    loads = np.zeros((6, count, 3))
    mean = np.zeros((6, 6))
    volume, smallest = _scatter(
        nodes, corners, at, np.ascontiguousarray(lame), np.ascontiguousarray(shear), gradients, np.float64(weight),
        starts, columns, blocks, loads, mean,
    )  # fmt: skip
    if not smallest > 0:
        raise ValueError(f"a cell is turned inside out or flat: its Jacobian is {smallest:g}")
    matrix = bsr_matrix((blocks, columns, starts), shape=(3 * count, 3 * count))
    return Assembled(matrix, loads.reshape(6, -1), mean, float(volume))


def _reference_gradients(width: int) -> F64:
    """Gradients of the shape functions by the three reference coordinates, (points, width, 3)."""
    if width not in (4, 10):
        raise ValueError(f"tetrahedra have 4 or 10 nodes, got {width}")
    return SLOPES[None] if width == 4 else quadratic_gradients(_POINTS)


@jit
def _scatter(
    nodes: F64, cells: I64, at: I64, lame: F64, shear: F64, reference: F64, weight: float, starts: I64, columns: I64,
    blocks: F64, loads: F64, mean: F64,
) -> tuple[float, float]:  # fmt: skip
    """Add all cells in their order; the volume and the smallest Jacobian."""
    points, width, _ = reference.shape
    g = np.empty((width, 3))
    jacobian = np.empty((3, 3))
    inverse = np.empty((3, 3))
    total, smallest = 0.0, np.inf
    for cell in range(len(cells)):
        lam, mu = lame[cell], shear[cell]
        for q in range(points):
            for i in range(3):
                for j in range(3):
                    value = 0.0
                    for a in range(width):
                        value += nodes[cells[cell, a], i] * reference[q, a, j]
                    jacobian[i, j] = value
            for i in range(3):
                i1, i2 = (i + 1) % 3, (i + 2) % 3
                for j in range(3):
                    j1, j2 = (j + 1) % 3, (j + 2) % 3
                    # cofactors: the inverse but for the determinant
                    inverse[j, i] = jacobian[i1, j1] * jacobian[i2, j2] - jacobian[i1, j2] * jacobian[i2, j1]
            det = jacobian[0, 0] * inverse[0, 0] + jacobian[0, 1] * inverse[1, 0] + jacobian[0, 2] * inverse[2, 0]
            smallest = min(smallest, det)
            dv = det * weight
            total += dv
            for a in range(width):
                for i in range(3):
                    value = 0.0
                    for j in range(3):
                        value += reference[q, a, j] * inverse[j, i]
                    g[a, i] = value / det
            # energy of a unit mean strain, Voigt order xx yy zz yz xz xy, engineering shear
            for i in range(3):
                for j in range(3):
                    mean[i, j] += dv * lam
                mean[i, i] += 2 * dv * mu
                mean[3 + i, 3 + i] += dv * mu
            for a in range(width):
                row = at[cell, a]
                gx, gy, gz = dv * g[a, 0], dv * g[a, 1], dv * g[a, 2]
                for i in range(3):
                    # normal strain along i loads every direction by lame, its own by the shear modulus too
                    loads[i, row, 0] += lam * gx
                    loads[i, row, 1] += lam * gy
                    loads[i, row, 2] += lam * gz
                    loads[i, row, i] += 2 * mu * dv * g[a, i]
                loads[3, row, 1] += mu * gz
                loads[3, row, 2] += mu * gy
                loads[4, row, 0] += mu * gz
                loads[4, row, 2] += mu * gx
                loads[5, row, 0] += mu * gy
                loads[5, row, 1] += mu * gx
                for b in range(width):
                    column = at[cell, b]
                    # binary search in the sorted columns of the row
                    low, high = starts[row], starts[row + 1]
                    while low < high - 1:
                        half = (low + high) // 2
                        if columns[half] <= column:
                            low = half
                        else:
                            high = half
                    dot = g[a, 0] * g[b, 0] + g[a, 1] * g[b, 1] + g[a, 2] * g[b, 2]
                    for i in range(3):
                        for j in range(3):
                            blocks[low, i, j] += dv * (lam * g[a, i] * g[b, j] + mu * g[a, j] * g[b, i])
                        blocks[low, i, i] += dv * mu * dot
    return total, smallest


Vectors = F64

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
    def _inverses(self) -> F64:
        """Of the blocks on the diagonal."""
        inverses: F64 = np.linalg.inv(self._diagonal)
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
def _add_of_later(start: int, stop: int, columns: I32, values: F64, x: F64, total: F64) -> None:
    """Add the blocks of a row times their part of `x` to a sum (3, 6), the last first: memory is read in one way."""
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
def _add_to_later(start: int, stop: int, columns: I32, values: F64, own: F64, out: F64) -> None:
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
def _multiply(starts: I64, columns: I32, values: F64, diagonal: F64, x: F64, out: F64) -> None:
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
def _relax_from_zero(starts: I64, columns: I32, values: F64, inverses: F64, x: F64) -> None:
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
def _leave(starts: I64, columns: I32, values: F64, x: F64, left: F64) -> None:
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
def _relax_back(starts: I64, columns: I32, values: F64, inverses: F64, rest: F64, x: F64) -> None:
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
