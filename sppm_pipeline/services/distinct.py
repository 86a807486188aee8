"""The distinct values of an array, without the import of masked arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def distinct(values: NDArray[Any], axis: int | None = None) -> NDArray[Any]:
    """As `numpy.unique`, which asks whether the array is a masked one unless it is to count as well.

    For that question it imports `numpy.ma`, which takes longer than drawing a tile.
    """
    return np.unique(values, axis=axis, return_counts=True)[0]
