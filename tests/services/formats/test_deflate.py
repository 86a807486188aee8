"""The streams unpack to the filtered rows, for pictures of all kinds and widths, and are about as small as zlib's."""

import zlib

import numpy as np
import pytest

from sppm_pipeline.services.bit_rows import pack
from sppm_pipeline.services.formats.deflate import code_lengths, deflated_rows


def filtered(image):
    """The bytes of a picture after the Up filter of PNG."""
    rows = np.packbits(image, axis=1).astype(np.int64)
    above = np.vstack([np.zeros_like(rows[:1]), rows[:-1]])
    return np.hstack([np.full((len(rows), 1), 2), (rows - above) % 256]).astype(np.uint8).tobytes()


def by_zlib(data):
    packer = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE)
    return packer.compress(data) + packer.flush()


def pores(height, width):
    y, x = np.mgrid[:height, :width]
    return np.sin(x / 7) + np.sin(y / 9) + np.sin((x + 2 * y) / 23) > 0.4


MADE = {
    "void": lambda h, w: np.zeros((h, w), bool),
    "solid": lambda h, w: np.ones((h, w), bool),
    "stripes": lambda h, w: np.broadcast_to(np.arange(h)[:, None] % 2 == 0, (h, w)),
    "columns": lambda h, w: np.broadcast_to(np.arange(w) % 3 == 0, (h, w)),
    "pores": pores,
    "noise": lambda h, w: np.random.default_rng(1).random((h, w)) < 0.5,
    "dust": lambda h, w: np.random.default_rng(2).random((h, w)) < 0.002,
    "one pixel": lambda h, w: np.arange(h * w).reshape(h, w) == h * w - 1,
}


@pytest.mark.parametrize("kind", MADE)
@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 8), (40, 9), (90, 64), (70, 1000), (300, 2085), (2, 9001)])
def test_streams_unpack_to_the_filtered_rows(kind, height, width):
    image = MADE[kind](height, width)
    data = filtered(image)
    stream = deflated_rows(pack(image[None].view(np.uint8))[0], width).tobytes()
    assert zlib.decompress(stream) == data
    assert len(stream) <= 1.03 * len(by_zlib(data)) + 2 * height + 60


def test_large_pictures_need_more_room_than_there_was_at_first():
    image = np.random.default_rng(3).random((400, 640)) < 0.5
    stream = deflated_rows(pack(image[None].view(np.uint8))[0], 640).tobytes()
    assert zlib.decompress(stream) == filtered(image)


def test_code_lengths_are_a_prefix_code_however_skewed():
    for counts in ([5], [1, 1], [0, 3, 0, 9], 2 ** np.arange(40), np.random.default_rng(5).integers(0, 99, 286)):
        for longest in (7, 15):
            often = np.array(counts, np.int64)[: 2**longest]
            lengths = code_lengths(often, longest)
            assert ((lengths > 0) == (often > 0)).all()
            assert lengths.max() <= longest
            kraft = (0.5 ** lengths[lengths > 0]).sum()
            assert kraft == (0.5 if np.count_nonzero(often) == 1 else 1.0)
            order = np.argsort(often, kind="stable")[np.count_nonzero(often == 0) :]
            assert (np.diff(lengths[order]) <= 0).all()  # what is rarer has no shorter code


def test_a_code_longer_than_what_is_written_at_once():
    """Counts like Fibonacci numbers make codes of fifteen bits, three zeros and a byte more than thirty-two."""
    rng = np.random.default_rng(7)
    sizes = [1, 1]
    while sum(sizes) < 60_000:
        sizes.append(sizes[-1] + sizes[-2])
    values = rng.permutation(np.repeat(np.arange(1, len(sizes) + 1), sizes)).astype(np.uint8)
    for at in (40, 20_001, 40_003):  # zeros are rare here
        values[at : at + 4] = (0, 0, 0, 1)
    for skipped in range(12):  # whatever bits are left of what was before
        image = np.unpackbits(values[skipped:])[None]  # one row, so that nothing comes between three zeros
        assert b"\0\0\0\1" in filtered(image)
        assert zlib.decompress(deflated_rows(pack(image[None])[0], image.size).tobytes()) == filtered(image)
