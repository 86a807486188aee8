"""Artifacts on disk: a tree of plain values as JSON, and their arrays as .npy files.

Works for every frozen dataclass made of arrays, numbers, strings, tuples, lists, mappings, named tuples and further
frozen dataclasses, so that a new artifact needs nothing of its own. Fields with ``compare=False`` hold what can be
computed again; they start empty. Nothing is pickled: reading a file builds values and calls the constructors of
artifacts, and never anything else.

Arrays of some size have a file each. Small ones, of which a tile set has thousands, share one file, each at a
multiple of 64 bytes.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import io
import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

TREE = "value.json"
SHARED = "small.npy"

SMALL = 1 << 16
"""Arrays of up to this many bytes share a file."""

_CHUNK = 1 << 22
_ALIGN = 64


class NotStorable(TypeError):
    """The value holds something that can't be written, such as a function."""


class DamagedError(Exception):
    """Stored data differ from what was written."""


class StoredFile(NamedTuple):
    """One file of a stored value."""

    name: str
    bytes: int
    sha256: str


def stored_bytes(value: Any) -> int:
    """About how many bytes `save_value` would write; `NotStorable` if it can't write the value."""
    arrays: list[NDArray[Any]] = []
    tree = _encode(value, _Arrays(arrays))
    return sum(array.nbytes for array in arrays) + 24 * _leaves(tree)


def save_value(value: Any, folder: Path, *, durable: bool = False) -> list[StoredFile]:
    """Write an artifact, or whatever artifacts are made of, into an empty folder; sizes and digests, which `load_value`
    checks.

    With `durable` the files survive that the machine stops right after. `NotStorable` is raised before anything is
    written.
    """
    arrays: list[NDArray[Any]] = []
    tree = _encode(value, _Arrays(arrays))
    small = [i for i, array in enumerate(arrays) if array.nbytes <= SMALL]
    places: list[dict[str, Any]] = []
    size = 0
    for i, array in enumerate(arrays):
        fortran = array.ndim > 1 and array.flags.f_contiguous and not array.flags.c_contiguous
        place: dict[str, Any] = {"dtype": array.dtype.str, "shape": list(array.shape), "fortran": fortran}
        if array.nbytes <= SMALL:
            place["at"] = size
            # aligned, so that each can be viewed as any dtype
            size += -(-array.nbytes // _ALIGN) * _ALIGN
        else:
            place["file"] = f"{i:04}.npy"
        places.append(place)
    files = []
    for array, place in zip(arrays, places, strict=True):
        if "file" in place:
            files.append(_write(folder / place["file"], _npy_pieces(array), durable))
    if small:
        shared = np.zeros(size, np.uint8)
        for i in small:
            at = places[i]["at"]
            shared[at : at + arrays[i].nbytes] = np.frombuffer(_buffer(arrays[i]), np.uint8)
        files.append(_write(folder / SHARED, _npy_pieces(shared), durable))
    text = json.dumps({"arrays": places, "value": tree}, separators=(",", ":"), allow_nan=False).encode()
    files.append(_write(folder / TREE, [memoryview(text)], durable))
    return files


def load_value(folder: Path, files: Mapping[str, StoredFile]) -> Any:
    """Read what `save_value` wrote; every byte is checked.

    Raises `DamagedError` if a size or a digest differs, or an artifact's class is gone, `FileNotFoundError` if a file
    is.
    """

    def read(name: str) -> NDArray[np.uint8]:
        if name not in files:
            raise DamagedError(f"{name} is not listed")
        return _read(folder / name, files[name])

    document = json.loads(read(TREE).tobytes())
    shared = _npy_content(read(SHARED)) if any("at" in place for place in document["arrays"]) else None
    arrays: list[NDArray[Any]] = []
    for place in document["arrays"]:
        dtype, shape = np.dtype(place["dtype"]), tuple(place["shape"])
        count = math.prod(shape) * dtype.itemsize
        if "at" in place:
            assert shared is not None
            # a copy of its own, so that one small array does not keep all others in memory
            raw = shared[place["at"] : place["at"] + count].copy()
        else:
            raw = _npy_content(read(place["file"]))
        if len(raw) != count:
            raise DamagedError(f"an array has {len(raw)} bytes, not {count}")
        order: Literal["C", "F"] = "F" if place["fortran"] else "C"
        array = raw.view(dtype).reshape(shape, order=order) if count else np.empty(shape, dtype)
        array.setflags(write=False)
        arrays.append(array)
    try:
        return _decode(document["value"], arrays)
    except (LookupError, AttributeError, ImportError, TypeError, ValueError) as error:
        raise DamagedError(f"can't be put together again: {type(error).__name__}: {error}") from error


# --- values and trees --------------------------------------------------------------------------------------------


class _Arrays:
    """Numbers the arrays of a value; one that occurs twice is written once."""

    def __init__(self, arrays: list[NDArray[Any]]) -> None:
        self._arrays = arrays
        self._numbers: dict[int, int] = {}

    def number(self, array: NDArray[Any]) -> int:
        if array.dtype.hasobject or array.dtype.names:
            raise NotStorable(f"an array of {array.dtype}")
        if id(array) not in self._numbers:
            self._numbers[id(array)] = len(self._arrays)
            # numbered by identity, so that arrays that artifacts share are shared again after loading
            contiguous = array.flags.c_contiguous or array.flags.f_contiguous
            self._arrays.append(array if contiguous else np.ascontiguousarray(array))
        return self._numbers[id(array)]


def _encode(value: Any, arrays: _Arrays) -> Any:
    """`value` as JSON has it: plain values as they are, all else as a map with one key that says what it is."""
    # exact types: a subclass, such as an enum, would come back as its base
    if value is None or type(value) in (bool, int, str):
        return value
    if type(value) is float:
        # JSON has neither infinities nor NaN
        return value if math.isfinite(value) else {"float": repr(value)}
    if isinstance(value, Path):
        return {"path": str(value)}
    if isinstance(value, np.ndarray):
        return {"array": arrays.number(value)}
    if isinstance(value, np.generic):
        return {"scalar": arrays.number(np.asarray(value).reshape(1))}
    if type(value) in (tuple, list):
        return {type(value).__name__: [_encode(item, arrays) for item in value]}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return {"record": [_name_of(type(value)), *(_encode(item, arrays) for item in value)]}
    if isinstance(value, Mapping):
        if type(value) is not dict:
            raise NotStorable(type(value).__name__)
        return {"map": [[_encode(key, arrays), _encode(item, arrays)] for key, item in value.items()]}
    if not isinstance(value, type) and _is_frozen(type(value)):
        fields = {}
        for field in dataclasses.fields(value):
            # what is computed from other fields is computed again
            if not field.compare and not (field.default is field.default_factory is dataclasses.MISSING):
                continue
            if not field.init:
                raise NotStorable(f"{type(value).__name__}.{field.name} is not set by the constructor")
            fields[field.name] = _encode(getattr(value, field.name), arrays)
        return {"artifact": _name_of(type(value)), "fields": fields}
    raise NotStorable(type(value).__name__)


def _decode(tree: Any, arrays: list[NDArray[Any]]) -> Any:
    if not isinstance(tree, dict):
        return tree
    if "artifact" in tree:
        cls = _class_of(tree["artifact"], _is_frozen)
        return cls(**{name: _decode(item, arrays) for name, item in tree["fields"].items()})
    ((kind, content),) = tree.items()
    match kind:
        case "float":
            return float(content)
        case "path":
            return Path(content)
        case "array":
            return arrays[content]
        case "scalar":
            return arrays[content][0]
        case "tuple":
            return tuple(_decode(item, arrays) for item in content)
        case "list":
            return [_decode(item, arrays) for item in content]
        case "map":
            return {_decode(key, arrays): _decode(item, arrays) for key, item in content}
        case "record":
            cls = _class_of(content[0], lambda c: issubclass(c, tuple) and hasattr(c, "_fields"))
            return cls(*(_decode(item, arrays) for item in content[1:]))
    raise ValueError(f"unknown kind {kind!r}")


def _leaves(tree: Any) -> int:
    if isinstance(tree, dict):
        return 1 + sum(_leaves(item) for item in tree.values())
    return sum(_leaves(item) for item in tree) if isinstance(tree, list) else 1


def _is_frozen(cls: Any) -> bool:
    return bool(dataclasses.is_dataclass(cls) and getattr(cls, "__dataclass_params__").frozen)  # noqa: B009 - untyped


def _name_of(cls: type) -> str:
    if "<locals>" in cls.__qualname__:
        raise NotStorable(f"{cls.__qualname__}, a class inside of a function")
    return f"{cls.__module__}:{cls.__qualname__}"


def _class_of(name: str, allowed: Callable[[Any], bool]) -> Any:
    """A class by module and name; only kinds of classes that were written are built."""
    module, _, path = name.partition(":")
    found: Any = sys.modules.get(module) or importlib.import_module(module)
    for word in path.split("."):
        found = getattr(found, word)
    # the file names a class, never a function to call: damaged or foreign data must not run code
    if not isinstance(found, type) or not allowed(found):
        raise TypeError(f"{name} is no class of a value")
    return found


# --- bytes -------------------------------------------------------------------------------------------------------


def _buffer(array: NDArray[Any]) -> memoryview:
    """The bytes of a contiguous array in the order of its memory, without a copy."""
    flat = array.reshape(-1, order="A") if array.size else np.zeros(0, np.uint8)
    return flat.view(np.uint8).data


def _npy_pieces(array: NDArray[Any]) -> list[memoryview]:
    """The content of a .npy file: header and data."""
    fortran = array.ndim > 1 and array.flags.f_contiguous and not array.flags.c_contiguous
    shape = "(" + "".join(f"{n}, " for n in array.shape) + ")"
    about = f"{{'descr': {array.dtype.str!r}, 'fortran_order': {fortran}, 'shape': {shape}, }}".encode()
    # data begin at a multiple of 64 bytes, as NumPy writes them
    about += b" " * (-(len(about) + 13) % _ALIGN) + b"\n"
    return [memoryview(b"\x93NUMPY\x02\x00" + len(about).to_bytes(4, "little") + about), _buffer(array)]


def _npy_content(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The bytes behind the header of a .npy file of version 2."""
    if data[:8].tobytes() != b"\x93NUMPY\x02\x00":
        raise DamagedError("no .npy file")
    return data[12 + int.from_bytes(data[8:12].tobytes(), "little") :]


def _write(path: Path, content: Iterable[memoryview], durable: bool) -> StoredFile:
    """Write and hash in one pass."""
    digest = hashlib.sha256()
    size = 0
    # unbuffered: pieces are large, and a buffer would be one copy more
    with path.open("xb", buffering=0) as file:
        for data in content:
            for start in range(0, len(data), _CHUNK):
                piece = data[start : start + _CHUNK]
                digest.update(piece)
                _write_all(file, piece)
                size += len(piece)
        if durable:
            os.fsync(file.fileno())
    return StoredFile(path.name, size, digest.hexdigest())


def _write_all(file: io.FileIO, data: memoryview) -> None:
    while len(data):
        data = data[file.write(data) :]


def _read(path: Path, expected: StoredFile) -> NDArray[np.uint8]:
    """The bytes of a file into memory of an array, hashed on the way."""
    with path.open("rb", buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        if size != expected.bytes:
            raise DamagedError(f"{path.name} has {size} bytes, not {expected.bytes}")
        data = np.empty(size, np.uint8)
        _read_into(file, data.data, path.name)
    if hashlib.sha256(data.data).hexdigest() != expected.sha256:
        raise DamagedError(f"{path.name} is damaged: its SHA-256 differs")
    return data


def _read_into(file: io.FileIO, data: memoryview, name: str) -> None:
    while len(data):
        count = file.readinto(data)
        if not count:
            raise DamagedError(f"{name} is cut short")
        data = data[count:]
