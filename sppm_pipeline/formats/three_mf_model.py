"""The model part of a 3MF file: objects that are meshes or made of components, and what is to be built."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.formats.mesh_arrays import DecodedMesh
from sppm_pipeline.formats.placing import IDENTITY, MOST_PLACED, MOST_TRIANGLES, Matrix
from sppm_pipeline.formats.xml_tables import Table, TableReader, real

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
_TABLES = (
    Table(b"<vertices>", _VERTICES, b"<vertex", (b"x", b"y", b"z"), False),
    Table(b"<triangles>", _TRIANGLES, b"<triangle", (b"v1", b"v2", b"v3"), True),
)


class Use(NamedTuple):
    """An object as a component of another one, or as an item to be built.

    Attributes
    ----------
    part : str or None
        The model part that holds the object; None for the part that says so.
    identifier : int
    matrix : (3, 4) float64
    """

    part: str | None
    identifier: int
    matrix: Matrix


class Object(NamedTuple):
    """A mesh, or components; one of them is empty."""

    kind: str
    mesh: DecodedMesh | None
    components: list[Use]


class Model(NamedTuple):
    """A model part."""

    unit: str
    objects: dict[int, Object]
    items: list[Use]


def read_model(chunks: Iterable[bytes], name: str, part: str) -> Model:
    """Read a model part.

    Raises
    ------
    InputError
        With the part and the line of what is wrong.
    """
    reader = _ModelReader(name, part)
    reader.feed(chunks)
    return reader.model()


class _ModelReader(TableReader):
    tables = _TABLES

    def __init__(self, name: str, part: str) -> None:
        super().__init__(name, part)
        self._unit: str | None = None
        self._objects: dict[int, Object] = {}
        self._items: list[Use] = []
        self._identifier: int | None = None
        self._kind = "model"
        self._has_mesh = False
        self._components: list[Use] = []
        self._uses = 0
        self._coordinates = array("d")
        self._corners = array("q")
        self._prefixes: dict[str, str] = {}
        self._parser.StartNamespaceDeclHandler = self._declare

    def model(self) -> Model:
        """What was read."""
        if self._unit is None:
            self.fail("there is no model")
        return Model(self._unit, self._objects, self._items)

    def _declare(self, prefix: str | None, uri: str | None) -> None:
        self._prefixes.setdefault(prefix or "", uri or "")

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        around = self.path[-1] if self.path else None
        if tag == _VERTEX and around == _VERTICES:
            try:
                self._coordinates.extend([real(attributes[axis]) for axis in "xyz"])
            except (KeyError, ValueError):
                self.fail(f"a vertex has three numbers x, y and z, not {_shown(attributes)}")
            self._require_few()
        elif tag == _TRIANGLE and around == _TRIANGLES:
            try:
                self._corners.extend([_whole(attributes[corner]) for corner in ("v1", "v2", "v3")])
            except (KeyError, ValueError, OverflowError):
                self.fail(f"a triangle has three vertex numbers v1, v2 and v3, not {_shown(attributes)}")
            self._require_few()
        elif around is None:
            self._start_model(tag, attributes)
        elif tag == _OBJECT and around == _RESOURCES:
            self._identifier = self._number(attributes, "id")
            if self._identifier in self._objects:
                self.fail(f"there are two objects with the id {self._identifier}")
            self._kind = attributes.get("type", "model")
            self._has_mesh, self._components = False, []
            self._coordinates, self._corners = array("d"), array("q")
        elif tag == _MESH and around == _OBJECT:
            self._has_mesh = True
        elif tag == _COMPONENT and around == _COMPONENTS:
            self._components.append(self._use(attributes))
        elif tag == _ITEM and around == _BUILD:
            self._items.append(self._use(attributes))

    def rows(self, table: Table, values: NDArray[np.float64] | NDArray[np.int64]) -> None:
        (self._corners if table.whole else self._coordinates).frombytes(values.tobytes())
        self._require_few()

    def _require_few(self) -> None:
        if max(len(self._coordinates), len(self._corners)) > 3 * MOST_TRIANGLES:
            self.fail(f"a mesh has more than {MOST_TRIANGLES} vertices or triangles")

    def end(self, tag: str) -> None:
        if tag == _OBJECT and self._identifier is not None and self.path[-1] == _RESOURCES:
            mesh = self._mesh() if self._has_mesh else None
            self._objects[self._identifier] = Object(self._kind, mesh, self._components)
            self._identifier = None
            if len(self._objects) > MOST_PLACED:
                self.fail(f"there are more than {MOST_PLACED} objects")

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

    def _mesh(self) -> DecodedMesh:
        vertices = np.frombuffer(self._coordinates, np.float64).reshape(-1, 3) if self._coordinates else _NO_VERTICES
        faces = np.frombuffer(self._corners, np.int64).reshape(-1, 3) if self._corners else _NO_FACES
        finite = np.isfinite(vertices).all(axis=1)
        if not finite.all():
            bad = int(np.flatnonzero(~finite)[0])
            self.fail(f"object {self._identifier}, vertex {bad}: a coordinate must be finite")
        if faces.size and (int(faces.min()) < 0 or int(faces.max()) >= len(vertices)):
            bad = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))[0])
            self.fail(
                f"object {self._identifier}, triangle {bad}: it names a vertex that does not exist, in "
                f"{faces[bad].tolist()}; there are {len(vertices)} vertices, numbered from 0"
            )
        return vertices, faces

    def _use(self, attributes: dict[str, str]) -> Use:
        self._uses += 1
        if self._uses > MOST_PLACED:
            self.fail(f"there are more than {MOST_PLACED} components and items")
        part = attributes.get(_PATH)
        return Use(part, self._number(attributes, "objectid"), self._matrix(attributes.get("transform")))

    def _number(self, attributes: dict[str, str], key: str) -> int:
        text = attributes.get(key, "")
        if not (text.isascii() and text.isdigit() and len(text) <= 10):
            self.fail(f"{key} is a positive whole number, not {text[:40]!r}")
        return int(text)

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


_NO_VERTICES, _NO_FACES = np.empty((0, 3)), np.empty((0, 3), np.int64)


def _shown(attributes: dict[str, str]) -> str:
    return repr({key[:20]: value[:20] for key, value in list(attributes.items())[:4]})


def _whole(text: str) -> int:
    if "_" in text or len(text) > 20:
        raise ValueError
    return int(text)
