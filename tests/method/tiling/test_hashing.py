"""The integer hash of lattice places."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.tiling.lattice import CORNER, FACE, INTERIOR, TIE, hash_places

WORD = 2**64
GOLDEN = [10609624906511340155, 1610224618062420470, 15476670969338587572]


def plain(seed, stream, i, j, k):
    """The same hash with Python integers."""
    state = 0
    for word in (seed, stream, k, j, i):
        bits = ((state ^ (word % WORD)) + 0x9E3779B97F4A7C15) % WORD
        bits ^= bits >> 30
        bits = bits * 0xBF58476D1CE4E5B9 % WORD
        bits ^= bits >> 27
        bits = bits * 0x94D049BB133111EB % WORD
        state = bits ^ (bits >> 31)
    return state


@settings(derandomize=True)
@given(
    st.integers(-(2**70), 2**70),
    st.sampled_from([INTERIOR, FACE, FACE + 1, FACE + 2, CORNER, TIE]),
    *[st.integers(-(2**63), 2**63 - 1)] * 3,
)
def test_equals_python_integers(seed, stream, i, j, k):
    assert int(hash_places(seed, stream, i, j, k)[0]) == plain(seed % WORD, stream, i, j, k)


def test_golden_values():
    # Tilings must not change between versions: these are decoded numbers of version 1.
    assert hash_places(7, FACE + 1, [0, 1, -1], 2, 3).tolist() == GOLDEN


def test_open_grid_equals_single_places():
    i, j, k = np.ogrid[:4, :3, :5]
    grid = hash_places(3, CORNER, i, j, k)
    assert grid.shape == (4, 3, 5)
    assert all(grid[p] == hash_places(3, CORNER, *p)[0] for p in np.ndindex(4, 3, 5))


def test_streams_are_distinct():
    assert len({INTERIOR, FACE, FACE + 1, FACE + 2, CORNER, TIE}) == 6


def test_no_collisions_and_every_bit_is_fair():
    i, j, k = np.ogrid[:64, :64, :64]
    bits = hash_places(1, INTERIOR, i, j, k).ravel()
    assert len(np.unique(bits)) == bits.size
    ones = np.array([np.count_nonzero(bits >> np.uint64(b) & np.uint64(1)) for b in range(64)])
    # Six standard deviations of a fair coin.
    assert (abs(ones - bits.size / 2) < 6 * np.sqrt(bits.size) / 2).all()


def test_avalanche():
    # Flipping one bit of an index flips each bit of the hash half of the time.
    places = np.arange(4000)
    for bit in (0, 1, 5):
        changed = hash_places(2, INTERIOR, places, 0, 0) ^ hash_places(2, INTERIOR, places ^ (1 << bit), 0, 0)
        share = np.array([np.count_nonzero(changed >> np.uint64(b) & np.uint64(1)) for b in range(64)]) / places.size
        assert (abs(share - 0.5) < 0.06).all()


def test_neighbors_are_uncorrelated():
    i, j, k = np.ogrid[:40, :40, :40]
    values = hash_places(5, FACE, i, j, k) / 2.0**64 - 0.5
    for axis in range(3):
        low, high = np.take(values, range(39), axis), np.take(values, range(1, 40), axis)
        assert abs((low * high).mean() * 12) < 6 / np.sqrt(low.size)
