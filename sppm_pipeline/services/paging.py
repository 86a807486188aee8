"""Arrays that lie in mapped files: gone through in blocks, without all of them becoming resident."""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROWS = 2**18
"""Rows of a block."""


def mapping_of(array: NDArray[Any]) -> mmap.mmap | None:
    """The mapping of a file that an array lies in, if it does."""
    base: Any = array
    while isinstance(base, (np.ndarray, memoryview)):
        base = base.base if isinstance(base, np.ndarray) else base.obj
    return base if isinstance(base, mmap.mmap) else None


def release(*arrays: NDArray[Any]) -> None:
    """Let the system take back the pages of arrays in mapped files; they are read again when they are needed."""
    for array in arrays:
        mapping = mapping_of(array)
        if mapping is not None and hasattr(mapping, "madvise"):
            mapping.madvise(mmap.MADV_DONTNEED)


def blocks(rows: int, *arrays: NDArray[Any]) -> Iterator[slice]:
    """Slices of all rows; the pages of arrays in mapped files are released after each. One slice if there are none."""
    if all(mapping_of(array) is None for array in arrays):
        yield slice(0, rows)
        return
    for first in range(0, rows, ROWS):
        yield slice(first, min(first + ROWS, rows))
        release(*arrays)
