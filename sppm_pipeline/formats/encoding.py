"""What all mesh encoders share: the checks of what is to be written, and blocks of rows made by threads, in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.threads import ordered_map

ROWS_AT_ONCE = 65536
"""Rows of a block: a few megabytes, which the allocator reuses and a cache partly holds."""

T = TypeVar("T")


class Written(NamedTuple):
    """A mesh as the encoders want it.

    Attributes
    ----------
    points : (n, 3) float32 or float64, C-contiguous
    faces : (m, 3) int32, C-contiguous
    largest : float
        The largest absolute coordinate.
    """

    points: NDArray[np.floating]
    faces: NDArray[np.int32]
    largest: float


def as_written(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Written:
    """Check a mesh and bring its arrays into shape.

    Raises
    ------
    ValueError
        If the shapes are wrong, a coordinate is not finite or a face names a vertex that does not exist.
    """
    points: NDArray[np.floating] = np.ascontiguousarray(vertices)
    if points.dtype != np.float32:
        points = points.astype(np.float64, copy=False)
    if points.ndim != 2 or points.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"a mesh is (n, 3) vertices and (m, 3) faces, not {vertices.shape} and {faces.shape}")
    extreme = largest(points.reshape(-1))
    if not np.isfinite(extreme):
        raise ValueError("the coordinates of a mesh must be finite")
    count = min(points.shape[0], 2**31)
    if faces.dtype == np.int32 and faces.flags.c_contiguous:
        # a negative number is a large one when its sign is not looked at
        sound = not faces.size or int(faces.view(np.uint32).max()) < count
    else:
        sound = not faces.size or bool(faces.min() >= 0 and faces.max() < count)
    if not sound:
        raise ValueError(f"faces name vertices {faces.min()} to {faces.max()} of {points.shape[0]}")
    return Written(points, np.ascontiguousarray(faces, np.int32), extreme)


def within_float32(mesh: Written, format_name: str) -> NDArray[np.float32]:
    """The coordinates rounded to float32.

    Raises
    ------
    DesignError
        If one is beyond its range.
    """
    if mesh.largest > float(np.finfo(np.float32).max):
        raise DesignError(
            f"a coordinate of {mesh.largest:g} is beyond the range of {format_name} (float32)",
            hint="write the mesh as PLY or OBJ, or make the part smaller",
        )
    return mesh.points.astype(np.float32, copy=False)


def little_endian(rows: NDArray[Any]) -> memoryview:
    """The bytes of contiguous rows in the byte order of the files; not copied where that is the machine's own."""
    return rows.astype(rows.dtype.newbyteorder("<"), copy=False).reshape(-1).view(np.uint8).data


def in_blocks(rows: int, encode: Callable[[slice], T], threads: int) -> Iterator[T]:
    """What `encode` makes of each block of rows, in their order."""
    blocks = (slice(start, min(start + ROWS_AT_ONCE, rows)) for start in range(0, rows, ROWS_AT_ONCE))
    return ordered_map(encode, blocks, threads if rows > ROWS_AT_ONCE else 1)


def largest(values: NDArray[np.floating]) -> float:
    """Largest absolute value; infinity or NaN if there is one: without its sign, a float is ordered as its bits are."""
    unsigned = np.uint32 if values.dtype == np.float32 else np.uint64
    bits = np.array([_largest_bits(values.view(unsigned), unsigned(np.iinfo(unsigned).max // 2))], unsigned)
    return float(bits.view(values.dtype)[0])


@jit
def _largest_bits(bits: NDArray[np.unsignedinteger], mask: np.unsignedinteger) -> int:
    highest = np.uint64(0)
    for k in range(bits.size):
        highest = max(highest, np.uint64(bits[k] & mask))
    return int(highest)
