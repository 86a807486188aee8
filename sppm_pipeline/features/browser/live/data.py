"""View files: a line of JSON and packed arrays, which ``write.view`` writes and the live view reads.

``sppmview 1``, a line end, one line of JSON, a line end, and the blobs one after the other. The head's `blobs` lists
name, bytes, type (``u8``, ``u16``, ``u32`` or ``f32``), count of numbers and whether each number is the difference to
the one before. Each blob is gzip without name and time, so that equal data are equal files.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError

MAGIC = b"sppmview 1\n"
SUFFIX = ".view"
MAX_HEAD = 2**22
"""Bytes of a head that are read."""

_TYPES: dict[str, np.dtype[Any]] = {
    "u8": np.dtype("uint8"), "u16": np.dtype("<u2"), "u32": np.dtype("<u4"), "f32": np.dtype("<f4"),
}  # fmt: skip


def encode_view(head: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """A view file of a JSON-ready head and arrays of uint8, uint16, uint32 or floats."""
    blobs, listed = [], []
    for name, array in arrays.items():
        kind = f"u{8 * array.dtype.itemsize}" if array.dtype.kind == "u" else "f32"
        flat = np.ascontiguousarray(array, _TYPES[kind]).reshape(-1)
        # differences along the last axis are small in a smooth field, and small numbers pack well
        delta = kind != "f32"
        data = np.diff(flat, prepend=flat.dtype.type(0)).tobytes() if delta else flat.tobytes()
        blobs.append(gzip.compress(data, compresslevel=9, mtime=0))
        listed.append({"name": name, "bytes": len(blobs[-1]), "type": kind, "count": flat.size, "delta": delta})
    text = json.dumps({**head, "blobs": listed}, separators=(",", ":"), allow_nan=False)
    return b"".join([MAGIC, text.encode(), b"\n", *blobs])


def head_of(data: bytes) -> dict[str, Any]:
    """The head of a view file; `InputError` if it is none."""
    end = data.find(b"\n", len(MAGIC), len(MAGIC) + MAX_HEAD)
    try:
        if not data.startswith(MAGIC) or end < 0:
            raise ValueError("it does not begin as one")
        head = json.loads(data[len(MAGIC) : end])
        if not isinstance(head, dict) or sum(blob["bytes"] for blob in head["blobs"]) != len(data) - end - 1:
            raise ValueError("its blobs are not as long as it says")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"this is no view file: {error}", hint="write one with `write.view`") from error
    return head
