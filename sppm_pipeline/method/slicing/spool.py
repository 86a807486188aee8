"""Layers that are kept while they are gone through twice: a bit a sample, in memory and beyond that on the disk."""

from __future__ import annotations

import shutil
import tempfile
from typing import IO, NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import U8, U64

IN_MEMORY = 2**27
"""Bytes that a spool keeps in memory; further slabs go into a temporary file. These are 10^9 samples; with half as
many more stacks go through the disk, which the system caches in memory anyway."""

MAX_DISK_SHARE = 0.25
"""Share of the free space for temporary files that a spool may take, so that other processes keep most of it; beyond
it the layers are evaluated twice."""

SPARSE = 0.5
"""Share of words with bits up to which a slab is kept as these words alone. Around a body most are empty: those of a
bunny take a third, and memory that the system has to give costs more time than to leave words out."""


class _Words(NamedTuple):
    """The words of a slab that are not 0, and which these are."""

    there: U8  # a bit a word
    words: U64
    shape: tuple[int, ...]

    def bits(self) -> U64:
        bits = np.zeros(self.shape, np.uint64)
        bits.reshape(-1)[np.unpackbits(self.there, count=bits.size).view(np.bool_)] = self.words
        return bits


def _kept(bits: U64) -> U64 | _Words:
    """A slab, or its words if there are few."""
    words = bits.reshape(-1)
    there = words != 0
    if np.count_nonzero(there) > SPARSE * len(words):
        return bits
    # the flags take 1/64 of the words
    return _Words(np.packbits(there), words[there], bits.shape)


class Spool:
    """Slabs of bits, see `services.bit_rows`, in the order in which they came.

    Evaluating a sample takes a nanosecond and more, and so does compressing its bit (zlib at its fastest, a quarter of
    the size), so bits are not compressed. `whole` is False once the disk had no room for a slab.
    """

    def __init__(self) -> None:
        self._slabs: list[tuple[int, tuple[int, ...], int]] = []  # first sheet, shape, place in the file
        self._bits: list[U64 | _Words] = []
        self._held = 0
        self._written = 0
        self._file: IO[bytes] | None = None
        self.whole = True

    def append(self, start: int, bits: U64) -> None:
        """Keep a slab, which must not be changed by others then; `start` is its first sheet."""
        if not self.whole:
            return
        self._slabs.append((start, bits.shape, self._written))
        if self._file is None and self._held + bits.nbytes <= IN_MEMORY:
            kept = _kept(bits)
            self._held += bits.nbytes if isinstance(kept, np.ndarray) else kept.there.nbytes + kept.words.nbytes
            self._bits.append(kept)
            return
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(prefix="sppm-layers-")  # noqa: SIM115  # gone with this process
            # of the space that was free without this file
            room = self._written + shutil.disk_usage(tempfile.gettempdir()).free  # before there was the file
            if self._written + bits.nbytes > MAX_DISK_SHARE * room:
                raise OSError("no room")
            self._file.write(bits.data)
            self._written += bits.nbytes
        except OSError:  # not an error: the layers are evaluated again
            self.whole = False
            self._bits.clear()
            self._drop_file()

    def __len__(self) -> int:
        return len(self._slabs)

    def slab(self, number: int) -> tuple[int, U64]:
        """The first sheet of a slab, and the slab; who changes it says so by `replace`."""
        start, shape, offset = self._slabs[number]
        if number < len(self._bits):
            kept = self._bits[number]
            return start, kept if isinstance(kept, np.ndarray) else kept.bits()
        assert self._file is not None
        self._file.seek(offset)
        bits = np.empty(shape, np.uint64)
        if self._file.readinto(bits.data.cast("B")) != bits.nbytes:  # type: ignore[attr-defined]
            raise OSError("the temporary file of the layers is cut off")
        return start, bits

    def replace(self, number: int, bits: U64) -> None:
        """Another content for a slab of the same shape."""
        if number < len(self._bits):
            self._bits[number] = _kept(bits)
        else:
            assert self._file is not None
            self._file.seek(self._slabs[number][2])
            self._file.write(bits.data)

    def _drop_file(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def __del__(self) -> None:
        self._drop_file()
