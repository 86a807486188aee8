"""Labels and thresholds of images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_LABELS = 64
"""Different values of an image that may be labels of phases; images with more are gray."""


def labels_of(values: NDArray[Any]) -> NDArray[Any] | None:
    """The different values of an image, ascending; None if there are too many for labels."""
    found: NDArray[Any] = np.zeros(0, values.dtype)
    for k in range(values.shape[2]):  # layer by layer, so that nothing of the image's size is sorted
        found = np.union1d(found, values[:, :, k])
        if len(found) > MAX_LABELS:
            return None
    return found


def otsu(values: NDArray[Any]) -> float:
    """The threshold that makes the two classes of gray values as different as possible; itself in the upper one.

    ValueError if all values, which are finite, are equal. Otsu 1979, "A threshold
    selection method from gray-level histograms".
    """
    low, high = float(values.min()), float(values.max())
    if not high > low:
        raise ValueError("an image of one value has no two classes")
    counts, edges = np.histogram(values, 1024, (low, high))
    middle = (edges[:-1] + edges[1:]) / 2
    below = np.cumsum(counts)[:-1].astype(np.float64)
    above = counts.sum() - below
    mass = np.cumsum(counts * middle)
    mean_below, mean_above = mass[:-1] / below, (mass[-1] - mass[:-1]) / np.maximum(above, 1)
    between = below * above * (mean_below - mean_above) ** 2
    # where bins between the classes are empty, every threshold among them is as good: the middle one is taken
    best = np.flatnonzero(between >= between.max() * (1 - 1e-12))
    return float((edges[best[0] + 1] + edges[best[-1] + 1]) / 2)
