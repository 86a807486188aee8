"""Sums of vectors with what follows at once from them; scalar products are summed in double precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I16
from sppm_pipeline.services.jit.compiled import inline_jit, jit

# Sums are closed after so many terms: long vectors lose no digits, and the order does not depend on anything.
_CHUNK = 4096

_STEPS = 32767.0
"""Largest number of 16 bits."""

_0 = np.uint64(0)


@inline_jit
def _chunk_dot(a: NDArray[Any], b: NDArray[Any], start: Any, stop: Any) -> float:
    total = 0.0
    for i in range(start, stop):
        total += np.float64(a[i]) * np.float64(b[i])
    return total


@jit
def dot(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Scalar product of two flat vectors; with one that `pack` has rounded it is in steps of that."""
    total = 0.0
    for start in range(0, len(a), _CHUNK):
        total += _chunk_dot(a, b, np.uint64(start), np.uint64(min(start + _CHUNK, len(a))))
    return total


@inline_jit
def _weigh(r: NDArray[Any], weight: NDArray[Any], z: NDArray[Any], at: Any, n: Any) -> None:
    for i in range(n):
        z[at + i] = weight[i] * r[at + i]


@jit
def weighted(r: NDArray[Any], weight: NDArray[Any], z: NDArray[Any]) -> None:
    """``z = weight r``, the weights (nodes,) being those of each component of r (components * nodes,)."""
    n = np.uint64(len(weight))
    for c in range(np.uint64(len(r)) // n):
        _weigh(r, weight, z, c * n, n)


@inline_jit
def _step(
    u: NDArray[Any], r: NDArray[Any], p: NDArray[Any], q: NDArray[Any], alpha: Any, start: Any, stop: Any
) -> float:
    total = 0.0
    for i in range(start, stop):
        u[i] += alpha * p[i]
        r[i] -= alpha * q[i]
    for i in range(start, stop):
        total += np.float64(r[i]) * np.float64(r[i])
    return total


@jit
def step(u: NDArray[Any], r: NDArray[Any], p: NDArray[Any], q: NDArray[Any], alpha: float) -> float:
    """``u += alpha p``, ``r -= alpha q``; returns ``r . r``."""
    total = 0.0
    factor = u.dtype.type(alpha)
    for start in range(0, len(u), _CHUNK):
        total += _step(u, r, p, q, factor, np.uint64(start), np.uint64(min(start + _CHUNK, len(u))))
    return total


@inline_jit
def _turn(z: NDArray[Any], beta: Any, p: NDArray[Any]) -> None:
    for i in range(np.uint64(len(p))):
        p[i] = z[i] + beta * p[i]


@jit
def turn(z: NDArray[Any], beta: Any, p: NDArray[Any]) -> None:
    """``p = z + beta p``."""
    _turn(z, p.dtype.type(beta), p)


@jit
def dense_product(matrix: F64, r: NDArray[Any], z: NDArray[Any]) -> None:
    """``z = matrix r`` for the coarsest grid."""
    for i in range(len(z)):
        total = 0.0
        for j in range(len(r)):
            total += matrix[i, j] * r[j]
        z[i] = total


@inline_jit
def _largest(a: NDArray[Any], start: Any, stop: Any) -> Any:
    largest = a.dtype.type(0)
    for i in range(start, stop):
        largest = max(largest, abs(a[i]))
    return largest


@inline_jit
def _pack(a: NDArray[Any], factor: Any, out: I16, n: Any) -> None:
    for i in range(n):
        out[i] = np.int16(np.rint(factor * a[i]))


@jit
def pack(a: NDArray[Any], out: I16) -> float:
    """Round a finite flat vector to 16 bits; returns the step."""
    largest = _largest(a, _0, np.uint64(len(a)))
    if not largest > 0:
        out[:] = 0
        return 0.0
    _pack(a, a.dtype.type(_STEPS / largest), out, np.uint64(len(a)))
    return np.float64(largest) / _STEPS
