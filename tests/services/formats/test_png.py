"""Layers come back from an independent reader as they went in."""

import io
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from sppm_pipeline.services.formats.png import encode_layer

SIDES = st.integers(1, 40)


def read(data):
    with Image.open(io.BytesIO(data)) as image:
        image.load()
        return image.mode, np.asarray(image.convert("L")), image.info


@settings(deadline=None, derandomize=True)
@given(hnp.arrays(np.uint8, st.tuples(SIDES, SIDES)), st.integers(0, 9))
def test_eight_bits_hold_every_gray(image, level):
    mode, pixels, _ = read(encode_layer(image, bits=8, level=level))
    assert mode == "L"
    np.testing.assert_array_equal(pixels, image)


@settings(deadline=None, derandomize=True)
@given(hnp.arrays(np.uint8, st.tuples(SIDES, SIDES), elements=st.sampled_from([0, 1, 128, 255])), st.integers(0, 9))
def test_one_bit_is_white_where_the_layer_is_solid(image, level):
    mode, pixels, _ = read(encode_layer(image, bits=1, level=level))
    assert mode == "1"
    np.testing.assert_array_equal(pixels, np.where(image != 0, 255, 0))


@pytest.mark.parametrize("height", [37, 64])
@pytest.mark.parametrize("bits", [1, 8])
def test_booleans_and_views_are_layers_too(bits, height):
    image = np.random.default_rng(1).random((height, 90)) < 0.4
    expected = np.where(image, 255, 0)
    np.testing.assert_array_equal(read(encode_layer(image, bits))[1], expected)
    np.testing.assert_array_equal(read(encode_layer(image[::-2, ::3], bits))[1], expected[::-2, ::3])
    np.testing.assert_array_equal(read(encode_layer(image.T.view(np.uint8) * np.uint8(255), bits))[1], expected.T)


def test_the_pixel_pitch_is_written():
    data = encode_layer(np.zeros((4, 5), np.uint8), pixel_mm=(0.05, 0.04))
    at = data.index(b"pHYs") + 4
    assert struct.unpack(">IIB", data[at : at + 9]) == (20000, 25000, 1)
    assert read(data)[2]["dpi"] == pytest.approx((508.0, 635.0))
    assert b"pHYs" not in encode_layer(np.zeros((4, 5), np.uint8))


def test_every_chunk_is_intact_and_nothing_else_is_there():
    data = encode_layer(np.eye(50, dtype=np.uint8), pixel_mm=(0.1, 0.1))
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, kinds = 8, []
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        (checksum,) = struct.unpack(">I", data[at + 8 + size : at + 12 + size])
        assert checksum == zlib.crc32(data[at + 4 : at + 8 + size])
        kinds.append(kind)
        at += 12 + size
    assert kinds == [b"IHDR", b"pHYs", b"IDAT", b"IEND"]


def test_a_layer_of_blobs_is_small_and_repeatable():
    y, x = np.mgrid[0:600, 0:800]
    image = (np.sin(x / 9.0) * np.sin(y / 7.0) > 0.3).astype(np.uint8) * 255
    data = encode_layer(image)
    assert data == encode_layer(image.copy())
    assert len(data) < 0.3 * image.size / 8 < len(encode_layer(image, level=0))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"image": np.zeros((2, 2, 2), np.uint8)}, "h, w"),
        ({"image": np.zeros((0, 2), np.uint8)}, "non-empty"),
        ({"image": np.zeros((2, 2))}, "float64"),
        ({"bits": 4}, "1 or 8"),
        ({"level": 10}, "0 to 9"),
        ({"pixel_mm": (0.0, 0.1)}, "0.0 mm"),
        ({"pixel_mm": (0.1, float("nan"))}, "nan mm"),
        ({"pixel_mm": (3000.0, 0.1)}, "3000.0 mm"),
    ],
)
def test_nonsense_is_refused(change, word):
    with pytest.raises(ValueError, match=word):
        encode_layer(**{"image": np.zeros((2, 2), np.uint8), **change})
