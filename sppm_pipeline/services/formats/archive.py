"""ZIP archives (3MF is one), read within bounds, as one can promise more than there is memory, and written in pieces.

What is written depends on the content alone: the same content gives the same bytes, and threads share the packing.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator

from sppm_pipeline.errors import DesignError, InputError

LARGEST_PART = 2**31
"""Bytes of all parts that are read, unpacked."""

HIGHEST_RATIO, ALWAYS_ALLOWED = 200, 2**20
"""A part larger than this may unpack to this many times its size; meshes as XML unpack to ten or twenty times."""

_DIRECTORY = 4 * 2**20  # bytes of the list of parts, about 40,000
_CHUNK = 2**20
_BROKEN = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError
)  # fmt: skip


class _Bounded(io.BytesIO):
    """A file that refuses to be read in one huge piece, as the list of parts of a hostile archive would be."""

    def read(self, size: int | None = -1) -> bytes:
        left = max(0, len(self.getbuffer()) - self.tell())
        if (left if size is None or size < 0 else min(size, left)) > _DIRECTORY:
            raise zipfile.BadZipFile("its list of parts is too long")
        return super().read(size)


class Archive:
    """A ZIP archive in memory; `name` is how to call the file in messages."""

    def __init__(self, data: bytes | memoryview | bytearray, name: str) -> None:
        self._name = name
        self._size = len(data)
        self._left = LARGEST_PART
        try:
            self._file = zipfile.ZipFile(_Bounded(data))
        except _BROKEN as error:
            raise self._broken(error) from error
        names = [(_key(info.filename), info.filename) for info in self._file.infolist()]
        self._parts = dict(names)
        self._twice = {key for key, count in Counter(key for key, _ in names).items() if count > 1}

    def __contains__(self, part: str) -> bool:
        return _key(part) in self._parts

    def read(self, part: str, limit: int) -> bytes:
        """A small part, whole; an error if it is missing, broken or has more than `limit` bytes."""
        return b"".join(self.chunks(part, limit))

    def chunks(self, part: str, limit: int = LARGEST_PART) -> Iterator[bytes]:
        """The content of a part, piece by piece; its check sum is verified at the end.

        An error if it is missing, broken, or unpacks to more than a part of its kind does.
        """
        key = _key(part)
        if key not in self._parts:
            raise InputError(f"{self._name}: the part {part!r} is missing", hint="write the file again")
        if key in self._twice:
            raise InputError(f"{self._name}: there are several parts {part!r}", hint="write the file again")
        info = self._file.getinfo(self._parts[key])
        if info.flag_bits & 1:
            raise InputError(f"{self._name}: the part {part!r} is encrypted", hint="write the file without a password")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputError(
                f"{self._name}: the part {part!r} is packed by method {info.compress_type}; "
                "a 3MF holds parts that are stored (0) or deflated (8)"
            )
        packed = min(info.compress_size, self._size)
        if info.file_size > min(limit, self._left, max(ALWAYS_ALLOWED, HIGHEST_RATIO * packed)):
            raise InputError(
                f"{self._name}: the part {part!r} would unpack from {packed} to {info.file_size} bytes; allowed are "
                f"{HIGHEST_RATIO} times as many and {min(limit, self._left)} bytes",
                hint="the file is broken or made to fill the memory",
            )
        self._left -= info.file_size
        try:
            with self._file.open(info) as file:
                while chunk := file.read(_CHUNK):
                    yield chunk
        except _BROKEN as error:
            raise self._broken(error) from error

    def _broken(self, error: Exception) -> InputError:
        return InputError(
            f"{self._name}: this is no readable ZIP archive: {str(error)[:100]}",
            hint="the file is cut off or damaged: write or download it again",
        )


def _key(part: str) -> str:
    """Names of parts are the same whatever their case."""
    return part.lstrip("/").casefold()


Packed = tuple[bytes | memoryview, bytes]
"""A piece of a part, as it is and deflated."""

_LEVEL = 3
"""Deflation that takes a third of the time of zlib's own choice and gives a tenth more bytes, measured on meshes."""

_LAST_BLOCK = b"\x03\x00"  # an empty one, which ends a deflated stream
_VERSION, _NO_FLAGS, _DEFLATED, _NO_TIME, _DATE = 20, 0, 8, 0, 1 << 5 | 1  # 1980-01-01, the first day of the format
_LARGEST_PLAIN = 2**32 - 1  # bytes of an archive without the extension ZIP64


def packed(piece: bytes | memoryview) -> Packed:
    """Deflate a piece so that others can follow it."""
    packer = zlib.compressobj(_LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
    return piece, packer.compress(piece) + packer.flush(zlib.Z_SYNC_FLUSH)


def zipped(parts: Iterable[tuple[str, Iterable[Packed]]]) -> Iterator[bytes]:
    """An archive of parts (name, pieces), below 4 GiB, without times or other traces of the machine."""
    directory = b""
    position, count = 0, 0
    for name, pieces in parts:
        size, check = 0, 0
        stream: list[bytes] = []
        for piece, deflated in pieces:
            size += len(piece)
            check = zlib.crc32(piece, check)
            stream.append(deflated)
        stream.append(_LAST_BLOCK)
        length = sum(map(len, stream))
        if max(size, position + length + 1024) > _LARGEST_PLAIN:
            raise DesignError(f"{name} would have {size} bytes, more than a plain ZIP archive holds (4 GiB)")
        path = name.encode("ascii")
        same = struct.pack(
            "<5H3L2H", _VERSION, _NO_FLAGS, _DEFLATED, _NO_TIME, _DATE, check, length, size, len(path), 0
        )
        header = b"PK\x03\x04" + same + path
        directory += b"PK\x01\x02" + struct.pack("<H", _VERSION) + same + struct.pack("<3H2L", 0, 0, 0, 0, position)
        directory += path
        yield header
        yield from stream
        position += len(header) + length
        count += 1
    yield directory + b"PK\x05\x06" + struct.pack("<4H2LH", 0, 0, count, count, len(directory), position, 0)
