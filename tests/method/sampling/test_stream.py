"""The random stream: known values of SplitMix64, range and moments."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.method.sampling.cell_list import new_stream, next_uniform


def test_reference_values() -> None:
    """First outputs of SplitMix64 for the seed 1234567, the published test vector."""
    words = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    stream = np.array([1234567], dtype=np.uint64)
    assert [next_uniform(stream) for _ in words] == [(word >> 11) / 2**53 for word in words]


def test_range_and_moments() -> None:
    stream = new_stream(np.random.default_rng(0))
    values = np.array([next_uniform(stream) for _ in range(20000)])
    assert values.min() >= 0.0
    assert values.max() < 1.0
    assert abs(values.mean() - 0.5) < 0.01
    assert abs(values.var() - 1 / 12) < 0.003
    assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 0.03
