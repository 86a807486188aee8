"""Spans of rows against a plain loop."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.numerics.domain.spans import row_spans


@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from([0.0, 0.02, 0.3, 1.0]))
@settings(deadline=None, derandomize=True, max_examples=40)
def test_first_and_last_of_each_row(seed, share):
    mask = (np.random.default_rng(seed).random((3, 4, 17)) < share).astype(np.uint8)
    spans = row_spans(mask)
    for k in range(3):
        for j in range(4):
            found = np.flatnonzero(mask[k, j])
            expected = (found[0], found[-1] + 1) if len(found) else (0, 0)
            assert tuple(spans[k, j]) == expected
