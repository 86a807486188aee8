"""Bits hold exactly the samples of the bytes they were made of."""

import numpy as np
import pytest

from sppm_pipeline.services.bit_rows import clear_span, count, fill_span, pack, unpack, words_of

WIDTHS = [1, 7, 8, 63, 64, 65, 128, 200]


@pytest.mark.parametrize("nx", WIDTHS)
def test_bits_are_the_bytes_they_were_made_of(nx):
    mask = np.random.default_rng(nx).integers(0, 3, (3, 5, nx)).astype(np.uint8)
    bits = pack(mask)
    assert bits.shape == (3, 5, words_of(nx))
    assert np.array_equal(unpack(bits, nx), mask > 0)
    assert np.array_equal(unpack(bits[:, ::-1], nx, 255), (mask[:, ::-1] > 0) * 255)
    assert np.array_equal(unpack(np.asfortranarray(bits), nx), mask > 0)
    assert count(bits) == np.count_nonzero(mask)
    x = nx - 1
    assert bits[1, 2, x // 64] >> np.uint64(x % 64) == (mask[1, 2, x] > 0)  # nothing is set behind the last one


@pytest.mark.parametrize("nx", WIDTHS)
def test_spans_touch_their_samples_alone(nx):
    for first in range(0, nx, 9):
        for stop in range(first + 1, nx + 1, 5):
            row = np.zeros(nx, np.uint8)
            row[first:stop] = 1
            bits = np.zeros(words_of(nx), np.uint64)
            fill_span(bits, first, stop)
            assert np.array_equal(bits, pack(row[None, None])[0, 0])
            full = pack(np.ones((1, 1, nx), np.uint8))[0, 0]
            clear_span(full, first, stop)
            assert np.array_equal(full, pack(1 - row[None, None])[0, 0])
