"""The straight line from the number of pores to the porosity (paper, section 2.3, figure 'porosity with n')."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError


class PorosityLine(NamedTuple):
    """A fitted line; plain numbers, so that `PorosityLine(*values)` and `_asdict` carry it to a file and back."""

    slope: float  # porosity per pore
    intercept: float  # porosity at n = 0 (an extrapolation)
    r_squared: float  # fraction of the variance of the porosity that the line explains
    residual_sd: float  # two degrees of freedom are taken by the line; 0 for two samples
    largest_residual: float
    n_min: int  # the line says nothing beyond the range that was fitted
    n_max: int
    samples: int

    def reaches(self, porosity: float) -> bool:
        """Whether a porosity is in the range that was fitted, or off it by at most half a pore."""
        return self.n_min - 0.5 <= (porosity - self.intercept) / self.slope <= self.n_max + 0.5


def fit_line(n: ArrayLike, porosity: ArrayLike) -> PorosityLine:
    """Fit the line by least squares to numbers of pores (m,) and porosities (m,).

    A DesignError says that n does not vary, or that the porosity does not grow with it.
    """
    count = np.asarray(n, dtype=np.float64)
    value = np.asarray(porosity, dtype=np.float64)
    if count.size < 2 or count.min() == count.max():
        raise DesignError(
            "a line needs samples with at least two different numbers of pores", hint="widen the range of n"
        )
    # about the means, which keeps the sums well conditioned
    from_mean = count - count.mean()
    slope = float(from_mean @ (value - value.mean()) / (from_mean @ from_mean))
    intercept = float(value.mean() - slope * count.mean())
    residuals = value - (slope * count + intercept)
    left = float(residuals @ residuals)
    total = float(((value - value.mean()) ** 2).sum())
    # more pores make more void; if not, the samples are noise
    if slope <= 0.0:
        raise DesignError(
            f"the porosity does not grow with the number of pores (slope {slope:.3g} from {count.size} samples)",
            hint="widen the range of n, or draw more samples for each n",
        )
    return PorosityLine(
        slope=slope,
        intercept=intercept,
        r_squared=1.0 - left / total,
        residual_sd=math.sqrt(left / (count.size - 2)) if count.size > 2 else 0.0,
        largest_residual=float(np.abs(residuals).max()),
        n_min=int(count.min()),
        n_max=int(count.max()),
        samples=int(count.size),
    )


def predict_porosity(line: PorosityLine, n: float) -> float:
    """Porosity on the line at n pores."""
    return line.slope * n + line.intercept


def count_for_porosity(line: PorosityLine, porosity: float) -> int:
    """Number of pores whose porosity on the line is nearest to a target, within the range that was fitted.

    A target off that range by more than half a pore is a DesignError that names the porosities within reach.
    """
    if not line.reaches(porosity):
        low, high = predict_porosity(line, line.n_min), predict_porosity(line, line.n_max)
        raise DesignError(
            f"a porosity of {porosity:g} is outside of what the line was fitted to: "
            f"{low:.4g} to {high:.4g} for {line.n_min} to {line.n_max} pores",
            hint="choose a porosity in that range, fit a wider range of n, or change the radii",
        )
    # half a pore beyond the ends rounds back onto them
    return min(max(round((porosity - line.intercept) / line.slope), line.n_min), line.n_max)
