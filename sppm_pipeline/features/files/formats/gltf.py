"""The document of a glTF file, and its tables: every value and bound is checked before numpy sees it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.formats.mesh_arrays import MAX_TRIANGLES, DecodedMesh, merge_equal, require_sound
from sppm_pipeline.services.mesh.measures import edge_counts

_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_NO_SURFACE = {0, 1, 2, 3}  # points and lines
_LARGEST, _MAX_VALUES = 2**24, 2**20


def read_document(text: bytes, name: str) -> Entry:
    """Read the JSON part of a file; InputError if it is no JSON object, or a very large one."""
    # bounds the objects that the parser makes, each of which takes far more memory than its text
    values = text.count(b",") + text.count(b"[") + text.count(b"{")
    if len(text) > _LARGEST or values > _MAX_VALUES:
        raise InputError(
            f"{name}: its JSON has {len(text)} bytes and about {values} values; read are up to {_LARGEST} and "
            f"{_MAX_VALUES}",
            hint="export fewer objects: join them to one mesh",
        )
    try:
        # Python's JSON takes NaN and Infinity, which the standard does not know
        document = json.loads(text.decode("utf-8"), parse_constant=_no_number)
    except RecursionError as error:
        raise InputError(f"{name}: its JSON is nested too deep") from error
    except ValueError as error:
        raise InputError(
            f"{name}: its JSON cannot be read: {str(error)[:100]}", hint="the file is damaged: export it again"
        ) from error
    if not isinstance(document, dict):
        raise InputError(f"{name}: its JSON is no object")
    return Entry(document, name, "")


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number")


class Entry:
    """An object of the document, which knows where it stands: ``accessor 3``, or "" for the document itself."""

    def __init__(self, values: dict[str, Any], name: str, where: str) -> None:
        self._values = values
        self._name = name
        self.where = where

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def fail(self, message: str, hint: str | None = None) -> NoReturn:
        """Raise the InputError for this place."""
        where = f"{self.where}: " if self.where else ""
        raise InputError(f"{self._name}: {where}{message}", hint=hint)

    def integer(self, key: str, default: int | None = None) -> int:
        """An integer >= 0; required without a default."""
        value: int = self._checked(key, default, _is_index, "an integer >= 0")
        return value

    def numbers(self, key: str, count: int | None) -> list[float] | None:
        """Finite numbers, as many as `count` says; None if there are none."""
        if key not in self._values:
            return None
        value = self._values[key]
        wanted = "finite numbers" if count is None else f"{count} finite numbers"
        if not isinstance(value, list) or (count is not None and len(value) != count):
            self._refuse(key, value, wanted)
        for number in value:
            if isinstance(number, bool) or not isinstance(number, (int, float)) or not _finite(number):
                self._refuse(key, value, wanted)
        return [float(number) for number in value]

    def integers(self, key: str) -> list[int]:
        """Integers >= 0, perhaps none."""
        return list(self._checked(key, [], lambda v: _are(v, _is_index), "a list of integers >= 0"))

    def strings(self, key: str) -> list[str]:
        """Strings, perhaps none."""
        return list(self._checked(key, [], lambda v: _are(v, lambda word: isinstance(word, str)), "a list of strings"))

    def string(self, key: str) -> str:
        """A string; empty if there is none."""
        return str(self._checked(key, "", lambda v: isinstance(v, str), "a string"))

    def entry(self, key: str) -> Entry:
        """An object inside this one; without values if there is none."""
        value = self._checked(key, {}, lambda v: isinstance(v, dict), "an object")
        return Entry(value, self._name, f"{self.where} {key}".lstrip())

    def entries(self, key: str) -> list[Entry]:
        """Objects in a list, perhaps none."""
        value = self._checked(key, [], lambda v: _are(v, lambda item: isinstance(item, dict)), "a list of objects")
        place = f"{self.where} {key}".lstrip()
        return [Entry(item, self._name, f"{place}[{k}]") for k, item in enumerate(value)]

    def flag(self, key: str) -> bool:
        """True or false; false if it is not given."""
        return bool(self._checked(key, False, lambda v: isinstance(v, bool), "true or false"))

    def _checked(self, key: str, default: Any, fits: Callable[[Any], bool], wanted: str) -> Any:
        value = self._values.get(key, default)
        if not fits(value):
            self._refuse(key, value, wanted)
        return value

    def _refuse(self, key: str, value: object, wanted: str) -> NoReturn:
        self.fail(f"{key!r} must be {wanted}, not {repr(value)[:60]}" if key in self else f"{key!r} is missing")


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0  # Python's booleans are integers


def _are(values: Any, fits: Callable[[Any], bool]) -> bool:
    return isinstance(values, list) and all(map(fits, values))


def _finite(number: int | float) -> bool:
    try:
        return math.isfinite(number)
    except OverflowError:
        return False


def read_meshes(document: Entry, binary: memoryview, meshes: Sequence[Entry], name: str) -> list[DecodedMesh]:
    """All surfaces of each mesh, equal positions merged unless it is closed without.

    `binary` is the binary part of the file, perhaps empty. InputError if values leave their view, are not finite, or
    name a vertex that does not exist.
    """
    tables = _Tables(document, binary)
    made = []
    for mesh in meshes:
        points: list[F64] = [np.empty((0, 3))]
        faces: list[I64] = [np.empty((0, 3), np.int64)]
        for surface in tables.surfaces(mesh):
            vertices, triangles = require_sound(name, mesh.where, *surface)
            faces.append(triangles + sum(map(len, points)))
            points.append(vertices)
        vertices, triangles = np.concatenate(points), np.concatenate(faces)
        if len(triangles) and not edge_counts(triangles).closed:
            # Adding 0 turns -0 into 0, which is the same place with other bits.
            first, numbers = merge_equal(vertices.astype(np.float32) + np.float32(0))
            vertices, triangles = vertices[first], numbers[triangles].astype(np.int64)
        made.append((vertices, triangles))
    return made


class _Tables:
    """The accessors of a document, and the binary part that they look into."""

    def __init__(self, document: Entry, binary: memoryview) -> None:
        self._accessors = document.entries("accessors")
        self._views = document.entries("bufferViews")
        self._buffers = document.entries("buffers")
        self._binary = binary
        self._rows = 0

    def surfaces(self, mesh: Entry) -> Iterator[DecodedMesh]:
        """Positions and triangles of each surface of a mesh, as they are stored."""
        if any(mesh.numbers("weights", None) or []):
            mesh.fail("it is deformed by morph targets", hint="apply the shape and export a plain mesh")
        for primitive in mesh.entries("primitives"):
            mode = primitive.integer("mode", _TRIANGLES)
            if mode in _NO_SURFACE:
                continue
            if mode not in (_TRIANGLES, _STRIP, _FAN):
                primitive.fail(f"the mode {mode} is unknown; there are 0 to 6")
            if "KHR_draco_mesh_compression" in primitive.entry("extensions"):
                primitive.fail("it is compressed by Draco", hint="export without compression")
            user = primitive.entry("attributes")
            positions = self._values(user, user.integer("POSITION"), "VEC3")
            if "indices" in primitive:
                corners = self._values(primitive, primitive.integer("indices"), "SCALAR").reshape(-1)
                if corners.dtype.kind != "u":
                    primitive.fail(
                        "vertex numbers are unsigned bytes, shorts or ints (componentType 5121, 5123 or 5125)"
                    )
            else:
                corners = np.arange(len(positions), dtype="<u4")
            if mode == _TRIANGLES and len(corners) % 3:
                primitive.fail(f"its {len(corners)} corners are not a multiple of 3")
            if len(corners) < 3:
                continue
            self._rows += max(len(positions), len(corners) // (3 if mode == _TRIANGLES else 1))
            if self._rows > MAX_TRIANGLES:
                primitive.fail(f"with it the file has more than {MAX_TRIANGLES} vertices or triangles")
            if mode == _TRIANGLES:
                triangles = corners.reshape(-1, 3)
            elif mode == _FAN:
                triangles = np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], 1)
            else:
                triangles = np.stack([corners[:-2], corners[1:-1], corners[2:]], 1)
                triangles[1::2] = triangles[1::2, ::-1]  # every other one is turned over
                a, b, c = triangles.T  # strips are joined by triangles without area
                triangles = triangles[(a != b) & (b != c) & (c != a)]
            yield positions, triangles

    def _values(self, user: Entry, number: int, shape: str) -> NDArray[Any]:
        """The bytes of an accessor as (count, width) values, its sparse changes made, normalized ones as float32."""
        if number >= len(self._accessors):
            user.fail(f"there is no accessor {number}; the file has {len(self._accessors)}")
        accessor = self._accessors[number]
        if accessor.string("type") != shape:
            accessor.fail(f"its type must be {shape}, not {accessor.string('type')[:20]!r}")
        kind, count = self._kind(accessor), accessor.integer("count")
        if "bufferView" not in accessor:
            accessor.fail(
                "it has no bufferView: its values are zeros, or compressed by Draco", hint="export without compression"
            )
        values = self._window(accessor, kind, count, _WIDTHS[shape], strides=True)
        if "sparse" in accessor:
            values = self._changed(accessor, values, kind, _WIDTHS[shape])
        if accessor.flag("normalized") and kind.kind in "iu":
            largest = 2 ** (8 * kind.itemsize - (kind.kind == "i")) - 1
            values = np.maximum(values / np.float32(largest), np.float32(-1)).astype("<f4")
        return values

    def _changed(self, accessor: Entry, values: NDArray[Any], kind: np.dtype[Any], width: int) -> NDArray[Any]:
        """The values with the sparse changes of an accessor."""
        sparse = accessor.entry("sparse")
        changes = sparse.integer("count")
        if changes > len(values):
            sparse.fail(f"it changes {changes} of {len(values)} values")
        places, replaced = sparse.entry("indices"), sparse.entry("values")
        which = self._window(places, self._kind(places), changes, 1).reshape(-1)
        if which.dtype.kind != "u" or (which.size and int(which.max()) >= len(values)):
            places.fail(f"its places must be unsigned and below {len(values)}")
        # the window is a view of the file, which stays as it is
        values = values.copy()
        values[which.astype(np.int64)] = self._window(replaced, kind, changes, width)
        return values

    def _kind(self, entry: Entry) -> np.dtype[Any]:
        number = entry.integer("componentType")
        if number not in _KINDS:
            entry.fail(f"the componentType {number} is unknown; there are {', '.join(map(str, _KINDS))}")
        return np.dtype(_KINDS[number])

    def _window(self, entry: Entry, kind: np.dtype[Any], count: int, width: int, strides: bool = False) -> NDArray[Any]:
        """Values (count, width) as they lie in the file; all bounds are checked before numpy sees them."""
        number = entry.integer("bufferView")
        if number >= len(self._views):
            entry.fail(f"there is no bufferView {number}; the file has {len(self._views)}")
        view = self._views[number]
        if "EXT_meshopt_compression" in view.entry("extensions"):
            view.fail("it is compressed (EXT_meshopt_compression)", hint="export without compression")
        buffer = view.integer("buffer")
        if buffer >= len(self._buffers):
            view.fail(f"there is no buffer {buffer}; the file has {len(self._buffers)}")
        if buffer > 0 or "uri" in self._buffers[buffer]:
            view.fail("its data lie outside of the file", hint="export as one GLB file, with everything in it")
        begin, length = view.integer("byteOffset", 0), view.integer("byteLength")
        held = min(len(self._binary), self._buffers[buffer].integer("byteLength"))
        if begin + length > held:
            view.fail(f"it ends at byte {begin + length} of a buffer of {held} bytes", hint="the file is cut off")
        row = kind.itemsize * width
        step = view.integer("byteStride", row) if strides else row
        # 252 bytes are the largest stride that the specification allows
        if step < row or step > max(row, 252):
            view.fail(f"its byteStride of {step} bytes does not fit values of {row} bytes")
        offset = entry.integer("byteOffset", 0)
        # the last value takes its own length, not a whole stride
        needed = offset + step * (count - 1) + row if count else offset
        if needed > length:
            entry.fail(f"its {count} values take {needed} bytes of a bufferView of {length} bytes")
        if not count:
            return np.empty((0, width), kind)
        return np.ndarray((count, width), kind, self._binary, begin + offset, (step, kind.itemsize))
