"""XML within bounds: no document type (and so no entities), no nesting without end, no gigabytes of nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NoReturn
from xml.parsers import expat

from sppm_pipeline.errors import InputError

DEEPEST = 64
"""Elements inside each other; 3MF needs six."""

_SLACK, _PER_ELEMENT = 16 * 2**20, 256
# Bytes without an element, and bytes that each element may bring: a mesh takes some fifty.


class XmlReader:
    """Base of readers of XML parts: `start` and `end` are called with names ``URI local``.

    Parameters
    ----------
    name, part : str
        How to call the file and the part in messages.
    """

    def __init__(self, name: str, part: str) -> None:
        self._name = name
        self._part = part
        self._elements = 0
        self._lines = 0
        self.path: list[str] = []
        """The names of the elements around the place that is being read."""
        parser = expat.ParserCreate(namespace_separator=" ")
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.EntityDeclHandler = self._refuse_doctype
        self._parser = parser

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """An element begins; `path` does not hold it yet."""

    def end(self, tag: str) -> None:
        """An element ends."""

    def feed(self, chunks: Iterable[bytes]) -> None:
        """Read a part.

        Raises
        ------
        InputError
            With the part and the line of what is wrong.
        """
        try:
            for part in self.parts(self._counted(chunks)):
                self._parser.Parse(part, False)
            self._parser.Parse(b"", True)
        except expat.ExpatError as error:
            self.fail(f"this is no well-formed XML: {expat.ErrorString(error.code)}", error.lineno)
        except (LookupError, UnicodeError, ValueError) as error:
            self.fail(f"this is no XML in UTF-8 or UTF-16: {str(error)[:80]}")

    def parts(self, chunks: Iterable[bytes]) -> Iterable[bytes]:
        """What of the content the parser is given; readers may take something out."""
        return chunks

    def count(self, elements: int, lines: int) -> None:
        """Elements and lines that the parser was not given."""
        self._elements += elements
        self._lines += lines

    def _counted(self, chunks: Iterable[bytes]) -> Iterator[bytes]:
        size = 0
        for chunk in chunks:
            yield chunk
            size += len(chunk)
            if size > _SLACK + _PER_ELEMENT * self._elements:
                self.fail(f"{size} bytes of XML hold only {self._elements} elements")

    def fail(self, message: str, line: int | None = None, hint: str | None = None) -> NoReturn:
        """Raise the InputError for the place that is being read."""
        place = self._lines + (self._parser.CurrentLineNumber if line is None else line)
        where = f"{self._part}, line {place}"
        raise InputError(f"{self._name}: {where}: {message}", hint=hint)

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._elements += 1
        if len(self.path) >= DEEPEST:
            self.fail(f"elements are nested more than {DEEPEST} deep")
        self.start(tag, attributes)
        self.path.append(tag)

    def _end(self, tag: str) -> None:
        self.path.pop()
        self.end(tag)

    def _refuse_doctype(self, *_: object) -> None:
        self.fail("a document type declaration (DTD) is not allowed in 3MF", hint="remove the line <!DOCTYPE ...>")
