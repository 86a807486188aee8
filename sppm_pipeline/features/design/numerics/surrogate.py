"""Gaussian processes on logarithms of properties, with bands by the residuals of designs that were left out."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64

LENGTHS, ROUGH, NOISE = (0.4, 0.8, 1.6), (0.0, 0.1, 1.0), (0.01, 0.05, 0.2)
"""Lengths of correlation over ranges of parameters, variance of what no parabola has, and variance of draws, both over
that of the property: the triple with the smallest residuals of designs left out is taken."""

PARABOLA = 3.0
"""Variance of the parabola's coefficients, over that of the property."""

COVERED = 0.9
"""Share of fresh draws that bands hold."""


class Surrogate(NamedTuple):
    """A fitted property of a family."""

    weights: F64  # of the draws, (n,)
    settings: F64  # one of `LENGTHS`, `ROUGH` and `NOISE`, (3,)
    mean: float  # of the logarithm
    deviation: float
    band: float  # half width


def covariance(a: F64, b: F64, length: float, rough: float) -> F64:
    """Covariance of parabolas and of rough rests between points (n, d) and (m, d), parameters from 0 to 1."""
    made = PARABOLA * (1 + (2 * a - 1) @ (2 * b - 1).T) ** 2 / (1 + a.shape[1]) ** 2
    if rough:
        squared = (a**2).sum(1)[:, None] + (b**2).sum(1) - 2 * a @ b.T
        made += rough * np.exp(squared / (-2 * length**2))
    return np.asarray(made)


def fitted(points: F64, values: F64, designs: F64) -> Surrogate:
    """Fit the logarithms (n,) of a property at parameters (n, d), from 0 to 1.

    Residuals are those of a design, of which `designs` has the number (n,), that was left out with all its draws.
    """
    mean, deviation = float(values.mean()), float(max(values.std(), 1e-9))
    y = (values - mean) / deviation
    best: tuple[float, F64, F64, F64] | None = None
    groups = [np.flatnonzero(designs == number) for number in np.unique(designs)]
    for length, rough, noise in product(LENGTHS, ROUGH, NOISE):
        inverse = np.linalg.inv(covariance(points, points, length, rough) + noise * np.eye(len(y)))
        weights = inverse @ y
        left = np.empty_like(y)
        for group in groups:  # what the others predict, in closed form
            left[group] = np.linalg.solve(inverse[np.ix_(group, group)], weights[group])
        error = float(np.sqrt(np.mean(left**2)))
        if best is None or error < best[0]:
            best = error, weights, np.array([length, rough, noise]), np.abs(left)
    assert best is not None
    _, weights, settings, left = best
    rank = min(len(left), int(np.ceil((len(left) + 1) * COVERED)))
    return Surrogate(weights, settings, mean, deviation, deviation * float(np.sort(left)[rank - 1]))


def predicted(surrogates: Sequence[Surrogate], points: F64, at: F64) -> F64:
    """Logarithms of properties at parameters (m, d), (m, properties)."""
    made = np.empty((len(at), len(surrogates)))
    settings = [(float(one.settings[0]), float(one.settings[1])) for one in surrogates]
    for length, rough in dict.fromkeys(settings):
        own = [k for k, each in enumerate(settings) if each == (length, rough)]
        weights = np.stack([surrogates[k].deviation * surrogates[k].weights for k in own], axis=1)
        made[:, own] = covariance(at, points, length, rough) @ weights
    return np.asarray(made + np.array([one.mean for one in surrogates]))
