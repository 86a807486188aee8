"""What a chart shows: its series, and the statistics behind box plots and fitted lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.render.shading import Color


class Line(NamedTuple):
    """Points joined by a line.

    Attributes
    ----------
    x, y : (n,) float
        Points in the order of the line; a NaN interrupts it.
    label : str
        Entry in the legend; none if empty.
    color : (r, g, b), optional
        Color (sRGB); the next one of the palette otherwise.
    dashed : bool
        Whether the line is dashed.
    """

    x: ArrayLike
    y: ArrayLike
    label: str = ""
    color: Color | None = None
    dashed: bool = False


class Points(NamedTuple):
    """Separate points, marked by discs.

    Attributes
    ----------
    x, y : (n,) float
        Points; those with a NaN are left out.
    label : str
        Entry in the legend; none if empty.
    color : (r, g, b), optional
        Color (sRGB); the next one of the palette otherwise.
    """

    x: ArrayLike
    y: ArrayLike
    label: str = ""
    color: Color | None = None


class Boxes(NamedTuple):
    """Box plots: box from quartile to quartile, line at the median, whiskers and outliers as `box_statistics` says.

    Attributes
    ----------
    x : (n,) float
        Where each box stands.
    samples : sequence of n (m_i,) float
        Values of each box, at least one.
    label : str
        Entry in the legend; none if empty.
    color : (r, g, b), optional
        Color (sRGB); the next one of the palette otherwise.
    """

    x: ArrayLike
    samples: Sequence[ArrayLike]
    label: str = ""
    color: Color | None = None


class BoxStatistics(NamedTuple):
    """What a box plot shows: lower whisker, lower quartile, median, upper quartile, upper whisker, outliers."""

    low: float
    lower_quartile: float
    median: float
    upper_quartile: float
    high: float
    outliers: NDArray[np.float64]


def box_statistics(values: ArrayLike) -> BoxStatistics:
    """Numbers of a box plot after Tukey.

    Parameters
    ----------
    values : (n,) float
        At least one value.

    Returns
    -------
    BoxStatistics
        Quartiles are interpolated linearly; a whisker ends at the last value within 1.5 interquartile ranges of the
        box, values beyond are outliers.

    Raises
    ------
    ValueError
        If there are no values.
    """
    numbers = np.sort(np.asarray(values, np.float64).ravel())
    if not numbers.size:
        raise ValueError("a box plot needs at least one value")
    lower, median, upper = (float(q) for q in np.quantile(numbers, (0.25, 0.5, 0.75)))
    reach = 1.5 * (upper - lower)
    inside = (numbers >= lower - reach) & (numbers <= upper + reach)
    kept = numbers[inside]
    return BoxStatistics(float(kept[0]), lower, median, upper, float(kept[-1]), numbers[~inside])
