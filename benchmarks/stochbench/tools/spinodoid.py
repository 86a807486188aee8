"""Isotropic spinodoids after Kumar et al. (2020), in NumPy: 1,000 waves of one length, cut at the asked share."""

from __future__ import annotations

import numpy as np

WAVES, LENGTH = 1000, 1 / 5
"""Number of waves, and their length in cell edges; wave vectors are rounded to periodic ones."""


def make(porosity, seed, n):
    """See README.md."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(WAVES, 3))
    waves = np.rint(directions / np.linalg.norm(directions, axis=1, keepdims=True) / LENGTH)
    axis, phase = 2 * np.pi * (np.arange(n) + 0.5) / n, rng.uniform(0, 2 * np.pi, WAVES)
    parts = [np.exp(1j * np.outer(waves[:, i], axis)) for i in range(3)]
    field = np.einsum("w,wx,wy,wz->xyz", np.exp(1j * phase), *parts, optimize=True).real
    return field > np.quantile(field, porosity)
