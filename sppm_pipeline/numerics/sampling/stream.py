"""A stream of uniform numbers inside kernels.

A kernel draws one number after another from one word of state, so that no chunk size, buffer or thread count enters
the result. The generator is SplitMix64 (Steele, Lea and Flood 2014), whose output function is a bijection of a counter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit

_STEP = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


def new_stream(rng: np.random.Generator) -> NDArray[np.uint64]:
    """State (1,) of a stream whose start is drawn from `rng` (one 64-bit draw)."""
    return rng.integers(0, 2**64, size=1, dtype=np.uint64)


@jit
def next_uniform(stream: NDArray[np.uint64]) -> float:
    """Advance `stream` and return a number in [0, 1) with 53 random bits."""
    stream[0] += _STEP
    word = stream[0]
    word = (word ^ (word >> _S30)) * _FIRST
    word = (word ^ (word >> _S27)) * _SECOND
    word = word ^ (word >> _S31)
    return np.float64(word >> _S11) * 2.0**-53
