"""Common parts of the mesh encoders: input checks, blocks of rows encoded in order, operations on machine words."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import F64, I32, U8
from sppm_pipeline.services.jit.compiled import Intrinsic, jit
from sppm_pipeline.services.paging import blocks, release
from sppm_pipeline.services.threads import ordered_map

Bytes = U8

ROWS_AT_ONCE = 65536
"""Rows of a block: a few megabytes, which the allocator reuses and a cache partly holds."""

RELEASED_AFTER = 16
"""Blocks after which the pages of mapped files are given back."""

T = TypeVar("T")


class Written(NamedTuple):
    """A mesh as the encoders need it, C-contiguous."""

    points: NDArray[np.floating]  # (n, 3), float32 or float64
    faces: I32
    largest: float  # the largest absolute coordinate


class InPieces(NamedTuple):
    """Encoder of a file whose mesh comes piece by piece: a head, vertices in front, faces behind.

    `front` makes the bytes that follow upon those of the piece before, of its points and those of this piece, how many
    of them are known, and the triangles of this piece with corners among these points, numbered from 0. `back` makes
    those behind all in front, of the triangles with corners numbered in the whole mesh.
    """

    head: bytes
    front: Callable[[F64, int, I32], memoryview]
    back: Callable[[I32], memoryview] | None = None
    back_at: int | None = None  # where these begin; None if that is known at the end only
    # of the largest absolute coordinate: whether this is the file that `encode` makes
    fits: Callable[[float], bool] = np.isfinite


def as_written(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Written:
    """Check a mesh and bring its arrays into shape."""
    points: NDArray[np.floating] = np.ascontiguousarray(vertices)
    if points.dtype != np.float32:
        points = points.astype(np.float64, copy=False)
    if points.ndim != 2 or points.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"a mesh is (n, 3) vertices and (m, 3) faces, not {vertices.shape} and {faces.shape}")
    extreme = 0.0
    for rows in blocks(len(points), points):
        found = largest(points[rows].reshape(-1))
        if not np.isfinite(found):
            raise ValueError("the coordinates of a mesh must be finite")
        extreme = max(extreme, found)
    count = min(points.shape[0], 2**31)
    if faces.dtype == np.int32 and faces.flags.c_contiguous:
        # a negative number is a large one when its sign is not looked at
        whole = faces.view(np.uint32)
        sound = all(int(whole[rows].max()) < count for rows in blocks(len(whole), whole) if faces.size)
    else:
        sound = not faces.size or bool(faces.min() >= 0 and faces.max() < count)
    if not sound:
        raise ValueError(f"faces name vertices {faces.min()} to {faces.max()} of {points.shape[0]}")
    return Written(points, np.ascontiguousarray(faces, np.int32), extreme)


def require_float32(mesh: Written, format_name: str) -> None:
    """Raise DesignError if a coordinate is beyond the range of float32."""
    if mesh.largest > float(np.finfo(np.float32).max):
        raise DesignError(
            f"a coordinate of {mesh.largest:g} is beyond the range of {format_name} (float32)",
            hint="write the mesh as PLY or OBJ, or make the part smaller",
        )


def little_endian(rows: NDArray[Any]) -> memoryview:
    """The bytes of contiguous rows in the byte order of the files; not copied where that is the machine's own."""
    return rows.astype(rows.dtype.newbyteorder("<"), copy=False).reshape(-1).view(np.uint8).data


def in_blocks(rows: int, encode: Callable[[slice], T], threads: int, *arrays: NDArray[Any]) -> Iterator[T]:
    """Encode each block of rows by threads, in order; arrays in mapped files that it reads do not become resident."""
    slices = (slice(start, min(start + ROWS_AT_ONCE, rows)) for start in range(0, rows, ROWS_AT_ONCE))
    for number, made in enumerate(ordered_map(encode, slices, threads if rows > ROWS_AT_ONCE else 1)):
        yield made
        if number % RELEASED_AFTER == RELEASED_AFTER - 1:
            release(*arrays)


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


# Whole machine words anywhere in a buffer of bytes, little-endian as in the files, for compiled functions: written byte
# by byte the same is several times slower. No bound is checked: the caller has made sure that the word lies within.


def _store(bits: int) -> Any:
    def definition() -> Any:
        from llvmlite import ir
        from numba import types

        def typed(typing_context: Any, array: Any, index: Any, value: Any) -> Any:
            """Write an unsigned integer at array[index:]."""

            def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
                data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
                pointer = builder.bitcast(builder.gep(data, [arguments[1]]), ir.IntType(bits).as_pointer())
                word = builder.bswap(arguments[2]) if sys.byteorder == "big" else arguments[2]
                builder.store(word, pointer, align=1)
                return context.get_dummy_value()

            return types.void(array, types.intp, getattr(types, f"uint{bits}")), code

        return typed

    return Intrinsic(definition)


store2, store4, store8 = map(_store, (16, 32, 64))


def _zeros(count: str) -> Any:
    def definition() -> Any:
        from llvmlite import ir
        from numba import types

        def typed(typing_context: Any, value: Any) -> Any:
            """Number of zero bits of a word of 64 bits before the first 1 from one end; 64 if all are zero."""

            def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
                return getattr(builder, count)(arguments[0], ir.Constant(ir.IntType(1), 0))

            return types.int64(types.uint64), code

        return typed

    return Intrinsic(definition)


leading_zeros, trailing_zeros = map(_zeros, ("ctlz", "cttz"))
