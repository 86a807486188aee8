"""Whole machine words anywhere in a buffer of bytes, little-endian as in the files, for compiled kernels.

Written byte by byte the same is several times slower. No bound is checked: who calls has made sure that the word lies
within the buffer.
"""

from __future__ import annotations

import sys
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def _place(context: Any, builder: Any, array_type: Any, array: Any, index: Any, bits: int) -> Any:
    """Pointer to an integer of `bits` bits, `index` bytes into the array."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), ir.IntType(bits).as_pointer())


def _swapped(builder: Any, value: Any) -> Any:
    return builder.bswap(value) if sys.byteorder == "big" else value


def _store(bits: int, unsigned: Any) -> Any:
    def typed(typing_context: Any, array: Any, index: Any, value: Any) -> Any:
        """Write an unsigned integer at array[index:]."""

        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = _place(context, builder, signature.args[0], arguments[0], arguments[1], bits)
            builder.store(_swapped(builder, arguments[2]), pointer, align=1)
            return context.get_dummy_value()

        return types.void(array, types.intp, unsigned), code

    return intrinsic(typed)


store2 = _store(16, types.uint16)
store4 = _store(32, types.uint32)
store8 = _store(64, types.uint64)


@intrinsic
def load4(typing_context: Any, array: Any, index: Any) -> Any:
    """The 32 bits at array[index:], as an unsigned integer."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _place(context, builder, signature.args[0], arguments[0], arguments[1], 32)
        return _swapped(builder, builder.load(pointer, align=1))

    return types.uint32(array, types.intp), code


def _zeros(count: str) -> Any:
    def typed(typing_context: Any, value: Any) -> Any:
        """How many bits of a word of 64 bits are 0 before the first 1 from one end; 64 if all are."""

        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, count)(arguments[0], ir.Constant(ir.IntType(1), 0))

        return types.int64(types.uint64), code

    return intrinsic(typed)


leading_zeros = _zeros("ctlz")
trailing_zeros = _zeros("cttz")
