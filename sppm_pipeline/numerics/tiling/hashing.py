"""A fixed integer hash of lattice places: the same place and seed give the same 64 bits on every machine, for ever."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Streams keep draws made for different purposes at the same place independent. FACE + axis is used for axis 0, 1, 2.
INTERIOR, FACE, CORNER, TIE = 1, 2, 5, 6

# 2^64 / golden ratio, and the two multipliers of variant 13 of D. Stafford's 64-bit finalizers, as in SplitMix64
# (Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators").
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)


def _absorbed(state: NDArray[np.uint64], word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    # For a fixed state this is a bijection of the word, and the other way round: no two places of a row collide.
    bits = (state ^ word) + _GOLDEN
    bits ^= bits >> np.uint64(30)
    bits *= _FIRST
    bits ^= bits >> np.uint64(27)
    bits *= _SECOND
    bits ^= bits >> np.uint64(31)
    return bits


def hash_places(seed: int, stream: int, i: ArrayLike, j: ArrayLike, k: ArrayLike) -> NDArray[np.uint64]:
    """Hash the lattice places (i, j, k).

    Parameters
    ----------
    seed : int
        Taken modulo 2^64.
    stream : int
        Purpose of the draw, one of this module's constants.
    i, j, k : integer array_like
        Indices along x, y, z, negative ones included; broadcast against each other. Open index arrays
        (`numpy.ogrid`) are cheapest.

    Returns
    -------
    (broadcast shape) uint64
        At least one-dimensional. Uniform over all 64-bit numbers; ``% n`` gives a draw from range(n) whose bias is
        below n / 2^64.
    """
    # One-element arrays instead of scalars: array arithmetic wraps modulo 2^64 silently, scalar arithmetic warns.
    state = _absorbed(np.zeros(1, np.uint64), np.array([seed % 2**64], np.uint64))
    state = _absorbed(state, np.array([stream], np.uint64))
    for index in (k, j, i):
        # int64 -> uint64 keeps the bits, so that negative indices are places like any other.
        state = _absorbed(state, np.atleast_1d(np.asarray(index, np.int64)).astype(np.uint64))
    return state
