"""Fields made comparable by normal scores, and mixed so that the share of solid is what it should be.

The score of a value is the standard normal quantile of the share of samples below it. Where two fields are
independent, ``cos(s pi / 2) Z_1 + sin(s pi / 2) Z_2`` of their scores is standard normal again, whatever s is, so that
a cut at the quantile of the share of solid keeps that share (Heitz and Neyret 2018, "High-performance by-example noise
using a histogram-preserving blending operator"). A plain linear blend is off by up to ten points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SCORES = np.linspace(-4.5, 4.5, 1153)
"""Scores at which a table holds values: steps of 1/128. Beyond lie 7 samples in a million."""


class ScoreTable(NamedTuple):
    """Values (k,) of a field and their scores, both ascending."""

    values: NDArray[np.float64]
    scores: NDArray[np.float64]


def score_table(samples: NDArray[np.floating]) -> ScoreTable:
    """The table of a field from samples of equal weight; the score of 0 is exact. `ValueError` if all have one sign."""
    from scipy.special import ndtr, ndtri

    zero = ndtri((samples < 0).mean())
    if not np.isfinite(zero):
        raise ValueError("the samples of the field are all on one side of its surface")

    values = np.quantile(samples.astype(np.float64), ndtr(SCORES))
    # where many samples have one value, as where no kernel reaches, it has the mean of their scores
    distinct, which = np.unique(values, return_inverse=True)
    scores = np.bincount(which.ravel(), SCORES) / np.bincount(which.ravel())
    below, above = (distinct < 0) & (scores < zero), (distinct > 0) & (scores > zero)
    return ScoreTable(
        np.concatenate([distinct[below], [0.0], distinct[above]]),
        np.concatenate([scores[below], [zero], scores[above]]),
    )


def scores_of(table: ScoreTable, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Scores of values, linear in the table and beyond its ends."""
    v, z = table
    found = np.interp(values, v, z)
    for end, inner, beyond in ((0, 1, values < v[0]), (-1, -2, values > v[-1])):
        if beyond.any() and len(v) > 1:
            # rarer values than any sample go on as the last two entries of the table
            slope = (z[end] - z[inner]) / (v[end] - v[inner])
            found[beyond] = z[end] + slope * (values[beyond] - v[end])
    return found.astype(np.float32)


def blended(
    first: NDArray[np.float32], second: NDArray[np.float32], weight: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Scores of two independent fields mixed; a weight of 0 gives the first and of 1 the second, to the bit."""
    angle = np.float32(np.pi / 2) * weight
    mixed = np.cos(angle) * first + np.sin(angle) * second
    return np.where(weight <= 0, first, np.where(weight >= 1, second, mixed)).astype(np.float32)
