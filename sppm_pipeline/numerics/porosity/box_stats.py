"""Box-plot summaries of repeated draws (paper, figure 'porosity with n', a)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["BoxStats", "box_stats", "box_stats_by_group"]


class BoxStats(NamedTuple):
    """Five numbers and what a box plot draws besides.

    Attributes
    ----------
    minimum, lower_quartile, median, upper_quartile, maximum : float
        Quartiles interpolate between samples.
    whisker_low, whisker_high : float
        Outermost samples within 1.5 interquartile ranges of the box.
    outliers : tuple of floats
        The samples beyond the whiskers, ascending.
    mean : float
    samples : int
    """

    minimum: float
    lower_quartile: float
    median: float
    upper_quartile: float
    maximum: float
    whisker_low: float
    whisker_high: float
    outliers: tuple[float, ...]
    mean: float
    samples: int


def box_stats(values: ArrayLike) -> BoxStats:
    """Sum up one group of samples.

    Parameters
    ----------
    values : (m,) floats
        Finite; at least one.

    Returns
    -------
    BoxStats

    Raises
    ------
    ValueError
        If there are no samples, or one is not finite.
    """
    sorted_values = np.sort(np.asarray(values, dtype=np.float64).ravel())
    if sorted_values.size == 0 or not np.isfinite(sorted_values).all():
        raise ValueError("a box plot needs finite samples, at least one")
    minimum, lower, median, upper, maximum = (float(q) for q in np.quantile(sorted_values, [0, 0.25, 0.5, 0.75, 1]))
    reach = 1.5 * (upper - lower)
    within = (sorted_values >= lower - reach) & (sorted_values <= upper + reach)
    # a quartile that is interpolated may have no sample between itself and its whisker's bound: the box is the end then
    whisker_low = min(float(sorted_values[within][0]), lower)
    whisker_high = max(float(sorted_values[within][-1]), upper)
    return BoxStats(
        minimum,
        lower,
        median,
        upper,
        maximum,
        whisker_low,
        whisker_high,
        tuple(float(v) for v in sorted_values[~within]),
        float(sorted_values.mean()),
        int(sorted_values.size),
    )


def box_stats_by_group(n: ArrayLike, values: ArrayLike) -> dict[int, BoxStats]:
    """Sum up the samples of each number of pores.

    Parameters
    ----------
    n : (m,) integers
        Group of each sample.
    values : (m,) floats

    Returns
    -------
    dict of int to BoxStats
        In ascending order of n.

    Raises
    ------
    ValueError
        If the arrays differ in length, or a value is not finite.
    """
    group = np.asarray(n)
    value = np.asarray(values, dtype=np.float64)
    if group.ndim != 1 or group.shape != value.shape:
        raise ValueError(f"groups and values are two arrays of one length, not {group.shape} and {value.shape}")
    return {int(key): box_stats(value[group == key]) for key in np.unique(group)}
