"""Line reader for ASCII mesh files: words and numbers, and error messages with the line."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NoReturn

from sppm_pipeline.errors import InputError

_LONGEST = 400  # characters of a number
_LONGEST_INDEX = 18  # digits of a vertex number


class Lines:
    """The lines of an ASCII file from byte `start` on, each as its words; empty ones are skipped.

    `name` is how to call the file in messages, `comment` what begins a comment, empty if the format has none; lines may
    be `continued` by a backslash at their end.
    """

    def __init__(
        self,
        data: bytes | memoryview | bytearray,
        name: str,
        *,
        comment: bytes = b"#",
        continued: bool = False,
        start: int = 0,
    ) -> None:
        content = bytes(data)
        if b"\n" not in content:  # as old Macintosh programs end their lines
            content = content.replace(b"\r", b"\n")
        self._content = content
        self._comment = comment
        self._continued = continued and b"\\" in content
        self._start = start
        self.name = name
        self.begin = self.end = start
        """First byte of the current line, and the one after it."""

    def __iter__(self) -> Iterator[list[bytes]]:
        file = io.BytesIO(self._content)
        file.seek(self._start)
        self.end = self._start
        for line in file:
            self.begin, self.end = self.end, self.end + len(line)
            if self._continued:
                while line.rstrip(b"\r\n").endswith(b"\\") and (more := file.readline()):
                    line = line.rstrip(b"\r\n")[:-1] + b" " + more
                    self.end += len(more)
            if self._comment and self._comment in line:
                line = line.split(self._comment, 1)[0]
            if words := line.split():
                yield words
        self.begin = self.end

    def row(self, rows: Iterator[list[bytes]], message: str) -> list[bytes]:
        """The next line that is not empty; fails with a message at the end of the file."""
        words = next(rows, None)
        if words is None:
            self.fail(message)
        return words

    def fail(self, message: str, word: bytes | None = None, hint: str | None = None) -> NoReturn:
        """Raise the InputError for a word of the current line: ``NAME: line L (byte B): MESSAGE``."""
        place = self.begin
        if word is not None:
            found = re.search(rb"(?<!\S)" + re.escape(word[:_LONGEST]), self._content[self.begin : self.end])
            place += found.start() if found else 0
        line = 1 + self._content.count(b"\n", 0, place)
        raise InputError(f"{self.name}: line {line} (byte {place}): {message}", hint=hint)

    def floats(self, words: Sequence[bytes]) -> list[float]:
        """Finite numbers, correctly rounded."""
        try:
            values = [float(word) for word in words]
            if all(map(math.isfinite, values)) and max(map(len, words)) <= _LONGEST and b"_" not in b"".join(words):
                return values
        except ValueError:
            pass
        for word in words:
            self._require_finite(word)
        raise AssertionError("a row that is not accepted holds a word that is refused")

    def _require_finite(self, word: bytes) -> None:
        try:
            if b"_" in word or len(word) > _LONGEST:  # Python takes 1_000
                raise ValueError
            value = float(word)
        except ValueError:
            self.fail(f"a number is expected, not {shown(word)}", word)
        if not math.isfinite(value):
            self.fail(f"a coordinate must be finite, not {shown(word)}", word)

    def integer(self, word: bytes) -> int | None:
        """An integer of at most 18 digits; None if the word is none."""
        digits = word[1:] if word[:1] in (b"-", b"+") else word
        return int(word) if digits.isdigit() and len(digits) <= _LONGEST_INDEX else None

    def polygon(self, words: Sequence[bytes], vertices: int) -> list[int]:
        """The vertex numbers of a face, numbered from 0."""
        if len(words) < 3:
            self.fail(f"a face has at least three corners, not {len(words)}")
        corners = []
        for word in words:
            index = self.integer(word)
            if index is None:
                self.fail(f"an integer is expected, not {shown(word)}", word)
            if not 0 <= index < vertices:
                self.fail(f"there is no vertex {shown(word)}; the file has {vertices} vertices, numbered from 0", word)
            corners.append(index)
        return corners


def shown(word: bytes) -> str:
    """A word for a message."""
    return repr(word[:40].decode("ascii", "backslashreplace"))


def fan(corners: Sequence[int]) -> list[int]:
    """The triangles of a polygon that share its first corner, one after the other."""
    if len(corners) == 3:
        return list(corners)
    first = corners[0]
    return [c for a, b in pairwise(corners[1:]) for c in (first, a, b)]
