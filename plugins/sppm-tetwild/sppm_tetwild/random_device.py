"""Giving fTetWild the random numbers that we choose.

fTetWild seeds its generators from the system's random device, ``std::random_device``, and offers no way to seed them
itself, so that no two of its meshes are the same. Its shared library calls the device through a slot that the dynamic
linker fills; here that slot is filled with a function of this module. Called in a child process before fTetWild starts;
where the library is not as expected nothing is changed, and the caller is notified.

The layout of the file is that of the System V ABI, chapters 4 and 5 ("Object files", "Program loading").
"""

from __future__ import annotations

import ctypes
import mmap
import platform
import random
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_DRAW = b"_ZNSt13random_device9_M_getvalEv"
"""``unsigned int std::random_device::_M_getval()`` as the linker knows it."""

_SLOTS = {"x86_64": (6, 7), "aarch64": (1025, 1026)}
"""Types of relocations that are slots for an address: GLOB_DAT, JUMP_SLOT."""

_DYNAMIC_SYMBOLS, _RELOCATIONS = 11, 4
_READ_WRITE = 3


class SeededDevice:
    """The random device of one shared library that was loaded, seeded.

    `landmark` is a function that it exports, by which its place in memory is known. `drawn` numbers were taken; none,
    if the device could not be replaced.
    """

    def __init__(self, path: Path, landmark: str, seed: int) -> None:
        self.drawn = 0
        self._numbers = random.Random(seed)
        self._function = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)(self._draw)
        try:
            slots, offset = _find(path.read_bytes(), landmark.encode())
            start = ctypes.cast(getattr(ctypes.CDLL(str(path)), landmark), ctypes.c_void_p).value
            target = ctypes.cast(self._function, ctypes.c_void_p).value
            if start is None or target is None:
                return
            for slot in slots:
                _write_address(start - offset + slot, target)
        except (OSError, ValueError, struct.error, IndexError):
            return

    def _draw(self, device: Any) -> int:
        self.drawn += 1
        return self._numbers.getrandbits(32)


def _find(data: bytes, landmark: bytes) -> tuple[list[int], int]:
    """Offsets of the slots of the random device, and of `landmark`, in the library as it is loaded.

    `ValueError` if there is no such slot or landmark, or the file is no 64-bit little-endian ELF library.
    """
    kinds = _SLOTS.get(platform.machine())
    if kinds is None or data[:6] != b"\x7fELF\x02\x01":
        raise ValueError("not a library of this machine")
    (table,) = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    # type, offset in the file, bytes, section it refers to
    sections = [struct.unpack_from("<4xI16xQQI", data, table + i * size) for i in range(count)]
    kind_of, offset_of, bytes_of, link_of = range(4)
    symbols = next((section for section in sections if section[kind_of] == _DYNAMIC_SYMBOLS), None)
    if symbols is None:
        raise ValueError("no dynamic symbols")
    names = sections[symbols[link_of]][offset_of]

    def numbered() -> Iterator[tuple[int, bytes, int]]:
        for number in range(symbols[bytes_of] // 24):
            name, value = struct.unpack_from("<I4xQ", data, symbols[offset_of] + 24 * number)
            yield number, data[names + name : data.index(b"\0", names + name)], value

    found = {name: (number, value) for number, name, value in numbered() if name in (_DRAW, landmark)}
    if found.keys() != {_DRAW, landmark}:
        raise ValueError("the library does not use the random device")
    slots = []
    for section in sections:
        if section[kind_of] == _RELOCATIONS:
            for i in range(section[bytes_of] // 24):
                offset, kind, symbol = struct.unpack_from("<QII", data, section[offset_of] + 24 * i)
                if symbol == found[_DRAW][0] and kind in kinds:
                    slots.append(offset)
    if not slots:
        raise ValueError("the library calls the random device in another way")
    return slots, found[landmark][1]


def _write_address(place: int, value: int) -> None:
    """Write an address into memory that may be protected; `OSError` if the system does not allow it."""
    page = place & ~(mmap.PAGESIZE - 1)
    if ctypes.CDLL(None).mprotect(ctypes.c_void_p(page), ctypes.c_size_t(mmap.PAGESIZE), _READ_WRITE):
        raise OSError("the linker's table can't be written to")
    ctypes.c_uint64.from_address(place).value = value
