"""Numbers in the binary part of a glTF file: accessors, their strides and sparse changes, each within its view."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.formats.gltf_json import Entry

_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Accessors:
    """The accessors of a document.

    Parameters
    ----------
    document : Entry
    binary : memoryview
        The binary part of the file, perhaps empty.
    """

    def __init__(self, document: Entry, binary: memoryview) -> None:
        self._accessors = document.entries("accessors")
        self._views = document.entries("bufferViews")
        self._buffers = document.entries("buffers")
        self._binary = binary

    def positions(self, user: Entry, number: int) -> NDArray[np.float64]:
        """Vertex positions (n, 3).

        Raises
        ------
        InputError
            If they leave their view, or are not finite.
        """
        accessor = self._of(user, number)
        values = self._read(accessor, "VEC3")
        with np.errstate(invalid="ignore"):  # some numbers that are none complain when they are converted
            points = values.astype(np.float64)
        if accessor.flag("normalized") and values.dtype.kind in "iu":
            points = np.maximum(points / (2 ** (8 * values.dtype.itemsize - (values.dtype.kind == "i")) - 1), -1.0)
        finite = np.isfinite(points).all(axis=1)
        if not finite.all():
            bad = int(np.flatnonzero(~finite)[0])
            accessor.fail(f"vertex {bad}: a coordinate must be finite, not {points[bad].tolist()}")
        return points

    def indices(self, user: Entry, number: int, vertices: int) -> NDArray[np.int64]:
        """Vertex numbers (n,).

        Raises
        ------
        InputError
            If they leave their view, or name a vertex that does not exist.
        """
        accessor = self._of(user, number)
        values = self._read(accessor, "SCALAR")
        if values.dtype.kind != "u":
            accessor.fail("vertex numbers are unsigned bytes, shorts or ints (componentType 5121, 5123 or 5125)")
        if values.size and int(values.max()) >= vertices:
            bad = int(np.flatnonzero(values.reshape(-1) >= vertices)[0])
            accessor.fail(
                f"number {bad} names vertex {int(values.reshape(-1)[bad])}; there are {vertices}, numbered from 0"
            )
        return values.reshape(-1).astype(np.int64)

    def _of(self, user: Entry, number: int) -> Entry:
        if number >= len(self._accessors):
            user.fail(f"there is no accessor {number}; the file has {len(self._accessors)}")
        return self._accessors[number]

    def _read(self, accessor: Entry, shape: str) -> NDArray[Any]:
        """The values of an accessor (count, width), its sparse changes made."""
        if accessor.word("type") != shape:
            accessor.fail(f"its type must be {shape}, not {accessor.word('type')[:20]!r}")
        kind, count = self._kind(accessor), accessor.whole("count")
        if "bufferView" not in accessor:
            accessor.fail(
                "it has no bufferView: its values are zeros, or compressed by Draco",
                hint="export without compression",
            )
        values = self._window(accessor, kind, count, _WIDTHS[shape], strides=True)
        if "sparse" not in accessor:
            return values
        sparse = accessor.entry("sparse")
        changes = sparse.whole("count")
        if changes > count:
            sparse.fail(f"it changes {changes} of {count} values")
        places, replaced = sparse.entry("indices"), sparse.entry("values")
        which = self._window(places, self._kind(places), changes, 1).reshape(-1)
        if which.dtype.kind != "u" or (which.size and int(which.max()) >= count):
            places.fail(f"its places must be unsigned and below {count}")
        values = values.copy()
        values[which.astype(np.int64)] = self._window(replaced, kind, changes, _WIDTHS[shape])
        return values

    def _kind(self, entry: Entry) -> np.dtype[Any]:
        number = entry.whole("componentType")
        if number not in _KINDS:
            entry.fail(f"the componentType {number} is unknown; there are {', '.join(map(str, _KINDS))}")
        return np.dtype(_KINDS[number])

    def _window(self, entry: Entry, kind: np.dtype[Any], count: int, width: int, strides: bool = False) -> NDArray[Any]:
        """Values (count, width) as they lie in the file; all bounds are checked before numpy sees them."""
        number = entry.whole("bufferView")
        if number >= len(self._views):
            entry.fail(f"there is no bufferView {number}; the file has {len(self._views)}")
        view = self._views[number]
        if "EXT_meshopt_compression" in view.entry("extensions"):
            view.fail("it is compressed (EXT_meshopt_compression)", hint="export without compression")
        buffer = view.whole("buffer")
        if buffer >= len(self._buffers):
            view.fail(f"there is no buffer {buffer}; the file has {len(self._buffers)}")
        if buffer > 0 or "uri" in self._buffers[buffer]:
            view.fail("its data lie outside of the file", hint="export as one GLB file, with everything in it")
        begin, length = view.whole("byteOffset", 0), view.whole("byteLength")
        held = min(len(self._binary), self._buffers[buffer].whole("byteLength"))
        if begin + length > held:
            view.fail(f"it ends at byte {begin + length} of a buffer of {held} bytes", hint="the file is cut off")
        row = kind.itemsize * width
        step = view.whole("byteStride", row) if strides else row
        if step < row or step > max(row, 252):
            view.fail(f"its byteStride of {step} bytes does not fit values of {row} bytes")
        offset = entry.whole("byteOffset", 0)
        needed = offset + step * (count - 1) + row if count else offset
        if needed > length:
            entry.fail(f"its {count} values take {needed} bytes of a bufferView of {length} bytes")
        if not count:
            return np.empty((0, width), kind)
        return np.ndarray((count, width), kind, self._binary, begin + offset, (step, kind.itemsize))
