"""Monotone cubic interpolation (PCHIP) in NumPy alone, as the import of SciPy's takes longer than many a stage."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I64


class MonotoneCubic(NamedTuple):
    """A piecewise cubic through points that rises and falls only where they do (Fritsch and Carlson 1980)."""

    places: F64  # (m,), ascending; two or more
    values: F64
    slopes: F64

    def at(self, x: F64) -> F64:
        """Values at x; beyond the ends the outermost cubics go on."""
        k, t, h = self._pieces(x)
        s = 1 - t
        found: F64 = (
            (1 + 2 * t) * s**2 * self.values[k]
            + t**2 * (3 - 2 * t) * self.values[k + 1]
            + h * t * s * (s * self.slopes[k] - t * self.slopes[k + 1])
        )
        return found

    def slope_at(self, x: F64) -> F64:
        """The derivative at x."""
        k, t, h = self._pieces(x)
        s = 1 - t
        found: F64 = (
            6 * t * s * (self.values[k + 1] - self.values[k]) / h
            + s * (1 - 3 * t) * self.slopes[k]
            + t * (3 * t - 2) * self.slopes[k + 1]
        )
        return found

    def _pieces(self, x: F64) -> tuple[I64, F64, F64]:
        """For each x the number of its piece, the place in it from 0 to 1, and the length of the piece."""
        k = np.clip(np.searchsorted(self.places, x, side="right") - 1, 0, len(self.places) - 2)
        h = np.diff(self.places)[k]
        return k, (x - self.places[k]) / h, h


def monotone_cubic(places: F64, values: F64) -> MonotoneCubic:
    """The interpolant; slopes are weighted harmonic means of those beside a point (Fritsch and Butland 1984)."""
    x, y = np.asarray(places, np.float64), np.asarray(values, np.float64)
    h = np.diff(x)
    d = np.diff(y) / h
    slopes = np.zeros(len(x))
    if len(x) == 2:
        slopes[:] = d[0]
        return MonotoneCubic(x, y, slopes)
    before, after = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    same = np.sign(d[:-1]) * np.sign(d[1:]) > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (before + after) / (before / d[:-1] + after / d[1:])
    slopes[1:-1] = np.where(same, mean, 0.0)
    slopes[0] = _end(h[0], h[1], float(d[0]), float(d[1]))
    slopes[-1] = _end(h[-1], h[-2], float(d[-1]), float(d[-2]))
    return MonotoneCubic(x, y, slopes)


def _end(near: float, next_one: float, own: float, beside: float) -> float:
    """The slope at an end: that of the parabola through three points, as far as the curve stays monotone."""
    slope = float(((2 * near + next_one) * own - near * beside) / (near + next_one))
    if slope * own <= 0:
        return 0.0
    if own * beside <= 0 and abs(slope) > 3 * abs(own):
        return 3 * own
    return slope
