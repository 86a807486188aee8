"""Isotropic spinodoids after Kumar et al. (2020), in NumPy: 1,000 waves of one length, cut at the asked share."""

from __future__ import annotations

from itertools import product

import numpy as np

WAVES, LENGTH = 1000, 1 / 5
"""Number of waves, and their length in cell edges; wave vectors are rounded to periodic ones."""


def make(porosity, seed, n, length=LENGTH, stretch=(1, 1, 1)):
    """See README.md."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(WAVES, 3))
    waves = np.rint(directions / np.linalg.norm(directions, axis=1, keepdims=True) / length / np.array(stretch))
    axis, phase = 2 * np.pi * (np.arange(n) + 0.5) / n, rng.uniform(0, 2 * np.pi, WAVES)
    parts = [np.exp(1j * np.outer(waves[:, i], axis)) for i in range(3)]
    field = np.einsum("w,wx,wy,wz->xyz", np.exp(1j * phase), *parts, optimize=True).real
    return field > np.quantile(field, porosity)


def twin(scan, seed):
    """The length of waves, of six, whose covariance is nearest to that of a scan at the same porosity."""
    given, best = _covariance(scan), None
    for length in (1 / 3, 1 / 4, 1 / 5, 1 / 6, 1 / 7, 1 / 8):
        trial = make(1 - scan.mean(), seed, len(scan), length)
        off = np.abs(_covariance(trial) - given).max()
        best = (off, trial) if best is None or off < best[0] else best
    return best[1]


def like(stiffness, porosity, seed, n):
    """The nearest of 27 that are stretched along the axes, each measured on a coarse grid."""
    import sppm_pipeline as sppm

    def off(stretch):
        image = sppm.Voxels.from_array(make(porosity, seed, 24, stretch=stretch).astype(np.uint8), periodic=True)
        return np.linalg.norm(sppm.homogenize.voxel(image, grids=1).stiffness - stiffness)

    return make(porosity, seed, n, stretch=min(product((0.8, 1, 1.3), repeat=3), key=off))


def _covariance(solid):
    """Of the solid along the axes, up to a quarter of the cell."""
    near = range(len(solid) // 4 + 1)
    return np.array([np.mean([(solid & np.roll(solid, r, axis)).mean() for axis in range(3)]) for r in near])
