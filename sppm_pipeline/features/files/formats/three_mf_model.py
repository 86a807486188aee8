"""The model part of a 3MF file: objects that are meshes or made of components, and what is to be built.

XML is read within bounds: no document type (and so no entities), no nesting without end, no gigabytes of nothing.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, NoReturn
from xml.parsers import expat

import numpy as np

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.formats.mesh_arrays import (
    IDENTITY,
    MAX_PLACED,
    MAX_TRIANGLES,
    DecodedMesh,
    Matrix,
    require_sound,
)

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"

UNITS_IN_MM = {
    "micron": 0.001, "millimeter": 1.0, "centimeter": 10.0, "inch": 25.4, "foot": 304.8, "meter": 1000.0
}  # fmt: skip

# Extensions that add nothing to the shape, or what is read here; a file may require any of them.
_HARMLESS = {
    CORE,
    PRODUCTION,
    "http://schemas.microsoft.com/3dmanufacturing/material/2015/02",
    "http://schemas.microsoft.com/3dmanufacturing/trianglesets/2021/07",
}
_KNOWN = {
    "http://schemas.microsoft.com/3dmanufacturing/slice/2015/07": "slices instead of meshes",
    "http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02": "beam lattices",
    "http://schemas.microsoft.com/3dmanufacturing/securecontent/2019/04": "encrypted parts",
    "http://schemas.3mf.io/3dmanufacturing/booleanoperations/2023/07": "Boolean operations",
    "http://schemas.3mf.io/3dmanufacturing/displacement/2023/10": "displaced surfaces",
    "http://schemas.3mf.io/3dmanufacturing/volumetric/2022/01": "volumetric data",
    "http://schemas.3mf.io/3dmanufacturing/implicit/2023/12": "implicit surfaces",
}

_MODEL, _RESOURCES, _OBJECT, _MESH, _BUILD, _ITEM = (
    f"{CORE} {tag}" for tag in ("model", "resources", "object", "mesh", "build", "item")
)
_VERTICES, _VERTEX, _TRIANGLES, _TRIANGLE, _COMPONENTS, _COMPONENT = (
    f"{CORE} {tag}" for tag in ("vertices", "vertex", "triangles", "triangle", "components", "component")
)
_PATH = f"{PRODUCTION} path"
_ROWS = {_VERTEX: _VERTICES, _TRIANGLE: _TRIANGLES}
_DECIMAL = re.compile(r"\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*", re.ASCII)
_INTEGER = re.compile(r"\s*\d{1,18}\s*", re.ASCII)


class Use(NamedTuple):
    """An object as a component of another one, or as an item to be built."""

    part: str | None  # the model part that holds the object; None for the part that says so
    identifier: int
    matrix: Matrix  # (3, 4)


class Object(NamedTuple):
    """A mesh, or components; one of them is empty."""

    kind: str
    mesh: DecodedMesh | None
    components: list[Use]
    name: str


class Model(NamedTuple):
    """A model part."""

    unit: str
    objects: dict[int, Object]
    items: list[Use]


MAX_DEPTH = 64
"""Elements inside each other; 3MF needs six."""

_SLACK, _PER_ELEMENT = 16 * 2**20, 256
# Bytes without an element, and bytes that each element may bring: a mesh takes some fifty.


class XmlReader:
    """Base of readers of XML parts: `start` and `end` get names ``URI local``; messages name file and part."""

    def __init__(self, name: str, part: str) -> None:
        self._name = name
        self._part = part
        self._elements = 0
        self.path: list[str] = []
        """The names of the elements around the place that is being read."""
        parser = expat.ParserCreate(namespace_separator=" ")
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        # without a DTD there are no entities, which could expand to any size or name other files
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.EntityDeclHandler = self._refuse_doctype
        self._parser = parser

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """An element begins; `path` does not hold it yet."""

    def end(self, tag: str) -> None:
        """An element ends."""

    def feed(self, chunks: Iterable[bytes]) -> None:
        """Read a part; InputError with the part and the line of what is wrong."""
        try:
            for chunk in self._counted(chunks):
                self._parser.Parse(chunk, False)
            self._parser.Parse(b"", True)
        except expat.ExpatError as error:
            self.fail(f"this is no well-formed XML: {expat.ErrorString(error.code)}", error.lineno)
        except (LookupError, UnicodeError, ValueError) as error:
            self.fail(f"this is no XML in UTF-8 or UTF-16: {str(error)[:80]}")

    def _counted(self, chunks: Iterable[bytes]) -> Iterator[bytes]:
        size = 0
        for chunk in chunks:
            yield chunk
            size += len(chunk)
            # a ZIP packs gigabytes of blanks into kilobytes
            if size > _SLACK + _PER_ELEMENT * self._elements:
                self.fail(f"{size} bytes of XML hold only {self._elements} elements")

    def number(self, attributes: dict[str, str], key: str) -> int:
        """A positive integer of an element."""
        text = attributes.get(key, "")
        if not (text.isascii() and text.isdigit() and len(text) <= 10):
            self.fail(f"{key} is a positive integer, not {text[:40]!r}")
        return int(text)

    def fail(self, message: str, line: int | None = None, hint: str | None = None) -> NoReturn:
        """Raise the InputError for the place that is being read."""
        where = f"{self._part}, line {self._parser.CurrentLineNumber if line is None else line}"
        raise InputError(f"{self._name}: {where}: {message}", hint=hint)

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._elements += 1
        if len(self.path) >= MAX_DEPTH:
            self.fail(f"elements are nested more than {MAX_DEPTH} deep")
        self.start(tag, attributes)
        self.path.append(tag)

    def _end(self, tag: str) -> None:
        self.path.pop()
        self.end(tag)

    def _refuse_doctype(self, *_: object) -> None:
        self.fail("a document type declaration (DTD) is not allowed in 3MF", hint="remove the line <!DOCTYPE ...>")


def read_model(chunks: Iterable[bytes], name: str, part: str) -> Model:
    """Read a model part; InputError with the part and the line of what is wrong."""
    reader = _ModelReader(name, part)
    reader.feed(chunks)
    return reader.model()


class _ModelReader(XmlReader):
    def __init__(self, name: str, part: str) -> None:
        super().__init__(name, part)
        self._unit: str | None = None
        self._objects: dict[int, Object] = {}
        self._items: list[Use] = []
        self._identifier: int | None = None
        self._kind, self._object_name = "model", ""
        self._mesh: DecodedMesh | None = None
        self._components: list[Use] = []
        self._uses = 0
        self._tables: dict[str, array[Any]] = {}  # of the mesh that is being read
        self._prefixes: dict[str, str] = {}
        self._parser.StartNamespaceDeclHandler = self._declare

    def model(self) -> Model:
        """The model that was read."""
        if self._unit is None:
            self.fail("there is no model")
        return Model(self._unit, self._objects, self._items)

    def _declare(self, prefix: str | None, uri: str | None) -> None:
        self._prefixes[prefix or ""] = uri or ""

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        around = self.path[-1] if self.path else None
        if (table := _ROWS.get(tag)) is not None and around != table:
            self.fail(f"a <{tag.partition(' ')[2]}> stands in a table of its kind, not elsewhere")
        if tag == _VERTEX:
            words = [attributes.get(axis, "") for axis in "xyz"]
            if not all(map(_DECIMAL.fullmatch, words)):
                self.fail(f"a vertex has three numbers x, y and z, not {_shown(attributes)}")
            self._tables[_VERTICES].extend(map(float, words))
        elif tag == _TRIANGLE:
            words = [attributes.get(corner, "") for corner in ("v1", "v2", "v3")]
            if not all(map(_INTEGER.fullmatch, words)):
                self.fail(f"a triangle has three vertex numbers v1, v2 and v3, not {_shown(attributes)}")
            self._tables[_TRIANGLES].extend(map(int, words))
        elif around is None:
            self._start_model(tag, attributes)
        elif tag == _OBJECT and around == _RESOURCES:
            self._identifier = self.number(attributes, "id")
            if self._identifier in self._objects:
                self.fail(f"there are two objects with the id {self._identifier}")
            self._kind, self._object_name = attributes.get("type", "model"), attributes.get("name", "")
            self._mesh, self._components = None, []
        elif tag == _MESH and around == _OBJECT:
            self._tables = {}
        elif tag in (_VERTICES, _TRIANGLES):
            if around == _MESH and tag not in self._tables:
                self._tables[tag] = array("d" if tag == _VERTICES else "q")
                return
            self.fail(f"a mesh has one table <{tag.partition(' ')[2]}>, inside <mesh>")
        elif tag == _COMPONENT and around == _COMPONENTS:
            self._components.append(self._use(attributes))
        elif tag == _ITEM and around == _BUILD:
            self._items.append(self._use(attributes))

    def end(self, tag: str) -> None:
        if tag == _MESH and self.path[-1] == _OBJECT:
            if self._mesh is not None:
                self.fail(f"object {self._identifier} has two meshes")
            self._mesh = self._sound()
        if tag == _OBJECT and self._identifier is not None and self.path[-1] == _RESOURCES:
            self._objects[self._identifier] = Object(self._kind, self._mesh, self._components, self._object_name)
            self._identifier = None
            if len(self._objects) > MAX_PLACED:
                self.fail(f"there are more than {MAX_PLACED} objects")

    def _start_model(self, tag: str, attributes: dict[str, str]) -> None:
        if tag != _MODEL:
            self.fail(f"the root of a 3MF model is <model> of {CORE}, not <{tag[:100]}>")
        self._unit = attributes.get("unit", "millimeter")
        if self._unit not in UNITS_IN_MM:
            self.fail(f"the unit {self._unit[:40]!r} is unknown; 3MF has {', '.join(UNITS_IN_MM)}")
        for prefix in attributes.get("requiredextensions", "").split():
            uri = self._prefixes.get(prefix, prefix)
            if uri not in _HARMLESS:
                what = _KNOWN.get(uri, f"the extension {uri[:100]}")
                self.fail(f"the file requires {what}, which is not read", hint="save it as plain meshes")

    def _sound(self) -> DecodedMesh:
        """The mesh that has ended."""
        vertices, faces = (np.array(self._tables.get(table, ())).reshape(-1, 3) for table in (_VERTICES, _TRIANGLES))
        if not len(faces):
            return np.empty((0, 3)), np.empty((0, 3), np.int64)
        if max(len(vertices), len(faces)) > MAX_TRIANGLES:
            self.fail(f"a mesh has more than {MAX_TRIANGLES} vertices or triangles")
        where = f"{self._name}: {self._part}, object {self._identifier}"
        return require_sound(where, "its mesh", vertices, faces)

    def _use(self, attributes: dict[str, str]) -> Use:
        self._uses += 1
        if self._uses > MAX_PLACED:
            self.fail(f"there are more than {MAX_PLACED} components and items")
        part = attributes.get(_PATH)
        return Use(part, self.number(attributes, "objectid"), self._matrix(attributes.get("transform")))

    def _matrix(self, text: str | None) -> Matrix:
        if text is None:
            return IDENTITY
        try:
            numbers = np.array([float(word) for word in text[:1000].split()])
            if numbers.shape != (12,) or not np.isfinite(numbers).all():
                raise ValueError
        except ValueError:
            self.fail(f"a transform has twelve finite numbers, not {text[:60]!r}")
        return np.ascontiguousarray(numbers.reshape(4, 3).T)  # 3MF multiplies rows by it


def _shown(attributes: dict[str, str]) -> str:
    return repr({key[:20]: value[:20] for key, value in list(attributes.items())[:4]})
