"""Monotone interpolation of few homogenizations, to propose the parameter for a target modulus."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def parameter_for(
    parameters: NDArray[np.float64], moduli: NDArray[np.float64], target: float
) -> tuple[float, tuple[float, float]]:
    """The parameter at which the modulus is expected to be `target`, and the known ones around it.

    The logarithm of the modulus, which is nearly straight in the porosity, is interpolated by a monotone cubic between
    the samples (Fritsch and Carlson 1980), so that the guess always lies between two samples that enclose the target.

    Parameters
    ----------
    parameters : (n,) float64
        Different; n >= 2.
    moduli : (n,) float64
        Positive.
    target : float
        Positive.

    Returns
    -------
    guess : float
    around : (low, high)
        Neighboring parameters whose moduli enclose the target.

    Raises
    ------
    ValueError
        If no neighboring samples enclose the target.
    """
    from scipy.interpolate import PchipInterpolator

    order = np.argsort(parameters)
    x, y, goal = parameters[order], np.log(moduli[order]), np.log(target)
    crossed = np.flatnonzero((y[:-1] - goal) * (y[1:] - goal) <= 0)
    if not len(crossed):
        raise ValueError("the target lies outside of the samples")
    # of several crossings the one between the samples that come nearest
    best = crossed[np.argmin(np.minimum(np.abs(y[crossed] - goal), np.abs(y[crossed + 1] - goal)))]
    low, high = float(x[best]), float(x[best + 1])
    curve = PchipInterpolator(x, y)
    a, b = low, high
    for _ in range(60):
        middle = (a + b) / 2
        if (curve(middle) - goal) * (curve(a) - goal) <= 0:
            b = middle
        else:
            a = middle
    return (a + b) / 2, (low, high)
