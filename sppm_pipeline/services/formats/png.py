"""PNG layers: a small writer for the images of a slice stack.

Layers are large, mostly flat, and there are thousands of them. One bit a pixel, the *Up* filter (a row minus the row
above, which is nearly all zeros) and deflate with run lengths only are thirty times faster than a general encoder and
the files are no larger. The bytes depend on the image and the options, nothing else: there is no time stamp and no
optional accelerator. Gray layers and other levels than 1 go through zlib, and depend on the one that Python was built
with.

Format: Portable Network Graphics, third edition (W3C, 2025).
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from sppm_pipeline.services.arrays import U8, U64, Bools
from sppm_pipeline.services.bit_rows import pack
from sppm_pipeline.services.formats.deflate import deflated_rows

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GRAYSCALE, _COLOR = 0, 2
_FILTER_UP = 2
_METER = 1  # the unit of a pHYs chunk
_LONGEST = 2**31 - 1  # of an integer in a chunk


def encode_layer(
    image: U8 | Bools,
    bits: int = 1,
    level: int = 1,
    pixel_mm: tuple[float, float] | None = None,
    subpixels: bool = False,
) -> bytes:
    """One layer (h, w) as a grayscale PNG; row 0 is the top row.

    With 8 bits these are the gray values, 0 black to 255 white (True is white); with 1 bit anything but 0 is white.
    Some printers want 8 bits even for binary layers. Level 0 stores, 1 compresses by run lengths (fast, right for
    layers), 2 to 9 are zlib's general levels (slower, and smaller where a pattern repeats). Width and height of a pixel
    (mm) are written as pixels per meter, rounded, as the format has integers there. `subpixels` writes three
    neighboring pixels as the red, green and blue of one; the width is a multiple of three then.
    """
    if image.ndim != 2 or image.size == 0 or image.dtype not in (np.dtype(np.uint8), np.dtype(np.bool_)):
        raise ValueError(f"a layer is a non-empty (h, w) image of uint8 or bool, not {image.shape} of {image.dtype}")
    if bits not in (1, 8):
        raise ValueError(f"a layer has 1 or 8 bits a pixel, not {bits}")
    if not 0 <= level <= 9:
        raise ValueError(f"the compression level is 0 to 9, not {level}")
    if bits == 1 and level == 1 and not subpixels:
        return encode_rows(pack(image[None].view(np.uint8))[0], image.shape[1], pixel_mm)
    height, width = image.shape
    if subpixels and (bits != 8 or width % 3):
        raise ValueError(f"subpixels need 8 bits and a width in threes, not {bits} and {width}")
    if bits == 1:
        rows = np.packbits(image, axis=1)
    elif image.dtype == np.bool_:
        rows = np.where(image, np.uint8(255), np.uint8(0))
    else:
        rows = image.view(np.uint8)
    filtered = np.empty((height, rows.shape[1] + 1), dtype=np.uint8)
    filtered[:, 0] = _FILTER_UP
    filtered[0, 1:] = rows[0]  # the row above the first counts as zeros
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    strategy = zlib.Z_RLE if level == 1 else zlib.Z_DEFAULT_STRATEGY
    deflate = zlib.compressobj(level, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, strategy)
    data = deflate.compress(filtered.data) + deflate.flush()
    columns, color = (width // 3, _COLOR) if subpixels else (width, _GRAYSCALE)
    return _file(columns, height, bits, color, data, pixel_mm)


def encode_rows(rows: U64, width: int, pixel_mm: tuple[float, float] | None = None) -> bytes:
    """A layer of black and white that is there as bits: the same file as that of `encode_layer` with one bit.

    The rows (h, words), from the top, are set where white, see `services.bit_rows`.
    """
    return _file(width, len(rows), 1, _GRAYSCALE, deflated_rows(rows, width).data, pixel_mm)


def _file(
    columns: int, height: int, bits: int, color: int, data: bytes | memoryview, pixel_mm: tuple[float, float] | None
) -> bytes:
    """The chunks of a file around its compressed rows."""
    parts = [_SIGNATURE, _chunk(b"IHDR", struct.pack(">IIBBBBB", columns, height, bits, color, 0, 0, 0))]
    if pixel_mm is not None:
        parts.append(_chunk(b"pHYs", struct.pack(">IIB", *(_per_meter(edge) for edge in pixel_mm), _METER)))
    parts += [_chunk(b"IDAT", data), _chunk(b"IEND", b"")]
    return b"".join(parts)


def _per_meter(edge_mm: float) -> int:
    # the comparisons are false for NaN
    if not 1000.0 / _LONGEST <= edge_mm <= 1000.0:
        raise ValueError(f"a pixel of {edge_mm} mm can't be written as an integer number of pixels per meter")
    return round(1000.0 / edge_mm)


def _chunk(kind: bytes, data: bytes | memoryview) -> bytes:
    if len(data) > _LONGEST:
        raise ValueError(f"a layer of {len(data)} compressed bytes is too large for a PNG chunk")
    return struct.pack(">I", len(data)) + kind + bytes(data) + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))
