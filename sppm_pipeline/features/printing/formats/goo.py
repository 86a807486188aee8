"""GOO files (Elegoo and others): a header with two pictures, then layers as runs of equal gray.

The layout is Elegoo's GOO 3.0, with what its text leaves open as the readers of others have it: numbers are big-endian,
the check sum is the complement of the sum of a layer's bytes, and every pixel must be covered by a run, as the
printer's buffer is not cleared. Layers are encoded from the pixels of the part alone; the black around it is a number.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import jit

MAGIC = b"\x07\x00\x00\x00DLP\x00"
DELIMITER = b"\r\n"
FOOTER = b"\x00\x00\x00" + MAGIC

SMALL, BIG = (116, 116), (290, 290)
"""Width and height of the two pictures."""

TIME = "1980-01-01 00:00:00"
"""Of every file, so that equal layers are equal bytes."""

HEADER_BYTES = 195_477

_PAIR = ("bottom_", "")
_TWO_STAGES = [f"{which}{way}{stage}_{what}" for stage in ("", "2") for way in ("lift", "retract") for which in _PAIR
               for what in ("mm", "mm_min")]  # fmt: skip

HEADER = (
    ("version", "4s"), ("magic", "8s"), ("software", "32s"), ("software_version", "24s"), ("time", "24s"),
    ("printer_name", "32s"), ("printer_type", "32s"), ("profile", "32s"), ("antialiasing", "H"), ("gray", "H"),
    ("blur", "H"), ("small", f"{2 * SMALL[0] * SMALL[1]}s"), ("end_small", "2s"), ("big", f"{2 * BIG[0] * BIG[1]}s"),
    ("end_big", "2s"), ("layers", "I"), ("width", "H"), ("height", "H"), ("mirror_x", "?"), ("mirror_y", "?"),
    ("display_x", "f"), ("display_y", "f"), ("height_mm", "f"), ("layer_mm", "f"), ("exposure", "f"),
    ("wait_times", "?"), ("off", "f"), ("bottom_wait_after_cure", "f"), ("bottom_wait_after_lift", "f"),
    ("bottom_wait_before_cure", "f"), ("wait_after_cure", "f"), ("wait_after_lift", "f"), ("wait_before_cure", "f"),
    ("bottom_exposure", "f"), ("bottom_layers", "I"), *((name, "f") for name in _TWO_STAGES),
    ("bottom_pwm", "H"), ("pwm", "H"), ("per_layer", "?"), ("seconds", "I"), ("volume_mm3", "f"), ("grams", "f"),
    ("price", "f"), ("currency", "8s"), ("offset", "I"), ("gray_levels", "?"), ("transition_layers", "H"),
)  # fmt: skip
"""Entries of the header in their order, and how each is packed (`struct`)."""

_FIXED = {
    "version": b"V3.0", "magic": MAGIC, "software": b"sppm_pipeline", "time": TIME.encode(), "printer_type": b"DLP",
    "gray": 1, "end_small": DELIMITER, "end_big": DELIMITER, "wait_times": True, "bottom_pwm": 255, "pwm": 255,
    "currency": b"$", "offset": HEADER_BYTES, "gray_levels": True,
}  # fmt: skip

_LAYER = "H15fH2sI"
"""Pause; pause height, height, exposure, light off, three rests, lift and retract in two stages; PWM; end; length."""


def header(values: Mapping[str, object], little_endian: bool = False) -> bytes:
    """The header, `HEADER_BYTES` long; entries without a value are 0. KeyError if a value belongs to no entry."""
    if unknown := values.keys() - dict(HEADER).keys():
        raise KeyError(f"a GOO header has no {sorted(unknown)}")
    known = {**_FIXED, **values}
    packed = [known.get(name, b"" if code[-1] == "s" else 0) for name, code in HEADER]
    return struct.pack(("<" if little_endian else ">") + "".join(code for _, code in HEADER), *packed)


def text(words: str, size: int) -> bytes:
    """`words` in ASCII, cut so that a zero follows in a field of `size` bytes."""
    return words.encode("ascii", "replace")[: size - 1]


def picture(image: NDArray[np.uint8]) -> bytes:
    """(h, w, 3) uint8 in 16 bits a pixel, 5 red, 6 green and 5 blue, high byte first."""
    red, green, blue = (image[:, :, k].astype(np.uint16) for k in range(3))
    return ((red >> 3) << 11 | (green >> 2) << 5 | blue >> 3).astype(">u2").tobytes()


def layer_record(
    *, pause_mm: float, top_mm: float, exposure: float, waits: tuple[float, float, float],
    lift: tuple[float, float], retract: tuple[float, float], length: int, little_endian: bool = False,
) -> bytes:  # fmt: skip
    """Header of the data of a layer: heights in mm, times in s, speeds in mm a minute, `length` in bytes.

    `pause_mm` is the height of the plate in a pause, of which there is none; `top_mm` that of the upper side of the
    layer. `waits` are before the lift, after it, and after the plate has come back; `lift` and `retract` are way and
    speed.
    """
    numbers = (pause_mm, top_mm, exposure, 0.0, *waits, *lift, 0.0, 0.0, *retract, 0.0, 0.0)
    return struct.pack(("<" if little_endian else ">") + _LAYER, 0, *numbers, 255, DELIMITER, length)


def encode_layer(block: NDArray[np.uint8], top: int, left: int, height: int, width: int) -> bytes:
    """A layer: 0x55, the runs of a whole picture (height, width), and the check sum.

    `block`, (h, w), are the pixels that may be other than black, the first at row `top` and column `left`; ValueError
    if they do not lie within the picture.
    """
    rows, columns = block.shape
    if not (0 <= top <= height - rows and 0 <= left <= width - columns):
        raise ValueError(f"{columns} x {rows} pixels at ({left}, {top}) do not lie in {width} x {height}")
    words = np.zeros((rows, -(-columns // 8) * 8), np.uint8)  # whole words, black behind the last pixel
    words[:, :columns] = block
    data, total = _runs(words, words.view("<u8"), columns, top, left, height, width)
    return b"\x55" + data.tobytes() + bytes((~total & 0xFF,))


_LONGEST = 2**28 - 1
"""Pixels of the longest run: 28 bits."""

_EVERY_BYTE = np.uint64(0x0101010101010101)


@jit
def _put(out: NDArray[np.uint8], n: int, gray: int, length: int) -> int:
    """Append a run: kind (black, gray, white) and number of further length bytes above the lowest four bits."""
    while length > 0:
        part = min(length, _LONGEST)
        length -= part
        extra = 0 if part < 1 << 4 else 1 if part < 1 << 12 else 2 if part < 1 << 20 else 3
        kind = 0 if gray == 0 else 3 if gray == 255 else 1
        out[n] = kind << 6 | extra << 4 | part & 15
        n += 1
        if kind == 1:
            out[n] = gray
            n += 1
        for k in range(extra):
            out[n] = part >> (4 + 8 * (extra - 1 - k)) & 255
            n += 1
    return n


@jit
def _equal_bytes(difference: np.uint64) -> int:
    """Number of zero bytes before the first other one in a nonzero difference, the lowest first."""
    count = 0
    if difference & np.uint64(0xFFFFFFFF) == 0:
        difference, count = difference >> np.uint64(32), 4
    if difference & np.uint64(0xFFFF) == 0:
        difference, count = difference >> np.uint64(16), count + 2
    return count + 1 if difference & np.uint64(0xFF) == 0 else count


@jit
def _runs(
    pixels: NDArray[np.uint8], words: NDArray[np.uint64], columns: int, top: int, left: int, height: int, width: int
) -> tuple[NDArray[np.uint8], int]:
    """The runs of the picture and the sum of their bytes; `words` are the pixels, eight by eight (little-endian)."""
    rows = pixels.shape[0]
    room = 6 * (columns + 4)  # bytes that one row can add
    out = np.empty(room + pixels.size // 8 + 64, np.uint8)
    n, gray, length = 0, 0, top * width
    same = np.uint64(0)
    for y in range(rows):
        if n + room > out.size:
            grown = np.empty(2 * out.size + room, np.uint8)
            grown[:n] = out[:n]
            out = grown
        # black on the left ends a run of another gray; a black run goes on from the row before
        if gray != 0 and left > 0:
            n = _put(out, n, gray, length)
            gray, length, same = 0, 0, np.uint64(0)
        length += left
        for w in range(columns // 8):
            rest, at = words[y, w] ^ same, 0
            while rest != 0:  # one step for each change, not for each pixel
                equal = _equal_bytes(rest)
                n = _put(out, n, gray, length + equal)
                at += equal
                gray, length = int(pixels[y, 8 * w + at]), 0
                same = np.uint64(gray) * _EVERY_BYTE
                rest = (words[y, w] ^ same) >> np.uint64(8 * at)
            length += 8 - at
        for x in range(columns // 8 * 8, columns):
            value = int(pixels[y, x])
            if value != gray:
                n = _put(out, n, gray, length)
                gray, length = value, 0
                same = np.uint64(gray) * _EVERY_BYTE
            length += 1
        behind = width - left - columns
        if gray != 0 and behind > 0:
            n = _put(out, n, gray, length)
            gray, length, same = 0, 0, np.uint64(0)
        length += behind
    below = (height - top - rows) * width
    if gray != 0 and below > 0:
        n = _put(out, n, gray, length)
        gray, length = 0, 0
    n = _put(out, n, gray, length + below)
    total = 0
    for k in range(n):
        total += out[k]
    return out[:n], total
