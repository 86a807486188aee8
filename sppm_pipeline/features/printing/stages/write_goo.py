"""``write.goo``: the file of Elegoo's printers and some others, straight from the runs of the layers.

GOO files (Elegoo and others): a header with two pictures, then layers as runs of equal gray.

The layout is Elegoo's GOO 3.0, with what its text leaves open as the readers of others have it: numbers are big-endian,
the check sum is the complement of the sum of a layer's bytes, and every pixel must be covered by a run, as the
printer's buffer is not cleared. Layers are encoded from the pixels of the part alone; the black around it is a number.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline import SliceStack, options
from sppm_pipeline.features.printing.printer_writer import Place, PrinterWriter, thumbnail
from sppm_pipeline.method.families.layer_writer import EncodedLayers
from sppm_pipeline.method.nouns.printer import Job, Printer
from sppm_pipeline.services.arrays import U8, U64
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


def picture(image: U8) -> bytes:
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


def encode_layer(block: U8, top: int, left: int, height: int, width: int) -> bytes:
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
def _put(out: U8, n: int, gray: int, length: int) -> int:
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
def _runs(pixels: U8, words: U64, columns: int, top: int, left: int, height: int, width: int) -> tuple[U8, int]:
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


@jit
def _fill(data: U8, picture: U8) -> None:
    """Decode the runs of a layer into the pixels of a picture, which is black, as far as both reach."""
    at, n, gray = 0, 0, 0
    while at < data.size and n < picture.size:
        kind, extra, length = data[at] >> 6, data[at] >> 4 & 3, int(data[at] & 15)
        at += 1
        if kind == 1 and at < data.size:
            gray = int(data[at])
            at += 1
        for k in range(extra):
            length |= (int(data[at + k]) if at + k < data.size else 0) << (4 + 8 * (extra - 1 - k))
        at += extra
        value = 0 if kind == 0 else 255 if kind == 3 else gray
        end = min(n + length, picture.size)
        if value:
            picture[n:end] = value
        n = end


@dataclass(frozen=True, kw_only=True)
class WriteGoo(PrinterWriter):
    """Write the layers as a GOO file: run lengths of the whole display, two pictures, exposures, lifts and rests.

    The date in the file is fixed, so that equal layers are equal files.
    """

    name: ClassVar[str] = "write.goo"
    format: ClassVar[str] = "goo"

    path: str = options.write_path("part.goo", suffixes=(".goo",))

    def encode_placed(self, block: U8, place: Place, printer: Printer) -> bytes:
        return encode_layer(block, *place)

    @classmethod
    def pictures(cls, target: Path, printer: Printer, shape: tuple[int, int]) -> Callable[[int], U8]:
        record = struct.Struct(("<" if printer.little_endian else ">") + _LAYER)
        starts = [HEADER_BYTES]  # of the records of layers, as far as they have been found

        def picture(k: int) -> U8:
            with target.open("rb") as file:
                for number in range(min(k, len(starts) - 1), k + 1):
                    file.seek(starts[number])
                    length = int(record.unpack(file.read(record.size))[-1])
                    if len(starts) == number + 1:
                        starts.append(file.tell() + length + len(DELIMITER))
                data = file.read(length)
            found = np.zeros(shape, np.uint8)
            _fill(np.frombuffer(data[1:-1], np.uint8), found.reshape(-1))
            return found

        return picture

    def store(self, target: Path, stack: SliceStack, layers: EncodedLayers) -> None:
        job, printer, motion = self.job(stack, {}), self._printer(stack), self._printer(stack).motion
        with target.open("wb") as file:
            file.write(bytes(HEADER_BYTES))
            for number, data in enumerate(layers):
                k = int(number >= job.resin.bottom_layers)
                file.write(
                    layer_record(
                        pause_mm=printer.height_mm,
                        top_mm=(number + 1) * job.layer_mm,
                        exposure=job.exposure_s(number),
                        waits=(motion.wait_after_cure_s[k], motion.wait_after_lift_s[k], motion.wait_before_cure_s[k]),
                        lift=(motion.lift_mm[k], motion.lift_mm_min[k]),
                        retract=(motion.lift_mm[k], motion.retract_mm_min[k]),
                        length=len(data),
                        little_endian=printer.little_endian,
                    )
                )
                file.write(data + DELIMITER)
            file.write(FOOTER)
            file.seek(0)
            pictures = {
                "small": picture(thumbnail(layers, *SMALL)), "big": picture(thumbnail(layers, *BIG))
            }  # fmt: skip
            file.write(header(_settings(self.job(stack, layers.findings)) | pictures, printer.little_endian))


def _settings(job: Job) -> dict[str, object]:
    """The entries of the header that follow from printer, resin and part."""
    printer, motion = job.printer, job.printer.motion
    (width, height), (wide, high) = printer.picture
    found: dict[str, object] = {
        "printer_name": text(printer.model, 32), "profile": text(job.resin.name, 32),
        "antialiasing": 8 if job.gray else 1, "layers": job.layers, "width": width,
        "height": height, "mirror_x": printer.mirror_x, "mirror_y": printer.mirror_y,
        "display_x": wide, "display_y": high, "height_mm": printer.height_mm,
        "layer_mm": job.layer_mm, "bottom_layers": job.resin.bottom_layers, "seconds": round(job.seconds),
        "volume_mm3": job.volume_mm3, "grams": job.grams, "price": job.price or 0.0,
    }  # fmt: skip
    for k, which in enumerate(("bottom_", "")):
        found |= {
            f"{which}exposure": job.resin.exposure_s[k], f"{which}wait_after_cure": motion.wait_after_cure_s[k],
            f"{which}wait_after_lift": motion.wait_after_lift_s[k],
            f"{which}wait_before_cure": motion.wait_before_cure_s[k], f"{which}lift_mm": motion.lift_mm[k],
            f"{which}lift_mm_min": motion.lift_mm_min[k], f"{which}retract_mm": motion.lift_mm[k],
            f"{which}retract_mm_min": motion.retract_mm_min[k],
        }  # fmt: skip
    return found
