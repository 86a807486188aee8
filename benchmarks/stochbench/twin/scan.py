"""The specimens: balls of void whose centers are random, on the torus; their statistics are known exactly."""

from __future__ import annotations

import numpy as np


def scan(seed, n, radius, balls):
    """(n, n, n) bool, True in the solid; `radius` of the balls in cell edges."""
    rng = np.random.default_rng(seed)
    axis = (np.arange(n) + 0.5) / n
    void = np.zeros((n, n, n), bool)
    for center in rng.random((balls, 3)):
        parts = [(np.abs(axis - c) - (np.abs(axis - c) > 0.5)) ** 2 for c in center]
        void |= np.add.outer(np.add.outer(parts[0], parts[1]), parts[2]) <= radius**2
    return ~void


def exact_s2(distance, radius, balls):
    """Chance that two points at a distance (cell edges) are both solid: no center within a ball around either.

    The Boolean model with a given number of balls: Torquato, Random Heterogeneous Materials (2002), section 5.2.
    """
    share = np.minimum(distance / (2 * radius), 1.0)
    volume = 4 / 3 * np.pi * radius**3
    return (1 - volume * (1 + 1.5 * share - 0.5 * share**3)) ** balls
