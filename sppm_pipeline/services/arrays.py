"""Short names of array types for signatures, by kind and bits; distinct values without the import of masked arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
I32 = NDArray[np.int32]
U64 = NDArray[np.uint64]
I16 = NDArray[np.int16]
I8 = NDArray[np.int8]
U16 = NDArray[np.uint16]
U8 = NDArray[np.uint8]
Bools = NDArray[np.bool_]
Array = NDArray[Any]


def distinct(values: NDArray[Any], axis: int | None = None) -> NDArray[Any]:
    """As `numpy.unique`, which asks whether the array is a masked one unless it is to count as well.

    For that question it imports `numpy.ma`, which takes longer than drawing a tile.
    """
    return np.unique(values, axis=axis, return_counts=True)[0]
