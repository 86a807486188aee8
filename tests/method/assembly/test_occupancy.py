"""Gray values are rounded shares."""

from fractions import Fraction

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.assembly.occupancy import gray_by_coverage, row_spans, row_spans_of_bits, spans_in_any
from sppm_pipeline.services.bit_rows import pack


@settings(derandomize=True, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(*[st.integers(1, 4)] * 3),
    st.tuples(st.integers(1, 6), st.integers(1, 6)),
    st.floats(0, 1),
)
def test_gray_is_the_rounded_share(seed, factors, size, share):
    fx, fy, sheets = factors
    h, w = size
    samples = (np.random.default_rng(seed).random((sheets, h * fy, w * fx)) < share).astype(np.uint8) * 3
    gray = gray_by_coverage(samples, (fx, fy))
    blocks = (samples > 0).reshape(sheets, h, fy, w, fx).sum(axis=(0, 2, 4))
    expected = [[int(Fraction(255 * int(n), sheets * fy * fx) + Fraction(1, 2)) for n in row] for row in blocks]
    assert gray.tolist() == expected


def test_a_single_sheet_may_be_an_image():
    samples = np.array([[1, 0, 1, 1], [0, 0, 1, 1]], bool)
    assert gray_by_coverage(samples, (2, 2)).tolist() == [[64, 255]]
    assert gray_by_coverage(samples, (1, 1)).tolist() == [[255, 0, 255, 255], [0, 0, 255, 255]]


@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from([0.0, 0.02, 0.3, 1.0]))
@settings(deadline=None, derandomize=True, max_examples=40)
def test_first_and_last_of_each_row(seed, share):
    mask = (np.random.default_rng(seed).random((3, 4, 177)) < share).astype(np.uint8)
    spans = row_spans(mask)
    assert np.array_equal(row_spans_of_bits(pack(mask)), spans)
    for k in range(3):
        for j in range(4):
            found = np.flatnonzero(mask[k, j])
            expected = (found[0], found[-1] + 1) if len(found) else (0, 0)
            assert tuple(spans[k, j]) == expected


def test_the_span_of_a_row_in_any_layer():
    spans = np.array([[[3, 5], [0, 0], [7, 2]], [[9, 11], [4, 4], [1, 2]]], np.int32)
    found = spans_in_any(spans)
    assert found[0].tolist() == [3, 11]
    assert found[2].tolist() == [1, 2]
    assert found[1, 1] == 0 < found[1, 0]
    assert spans_in_any(spans[:0]).tolist() == [found[1].tolist()] * 3
