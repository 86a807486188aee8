"""Gyroid sheets of microgen, two cells an edge, at the offset that it finds for a density; seeds shift their phase."""

from __future__ import annotations

import numpy as np

NEEDS = ("microgen",)
CELLS = 2


def make(porosity, seed, n):
    """See README.md; microgen makes meshes, so its field is read at the centers of voxels."""
    from microgen import Tpms
    from microgen.shape.surface_functions import gyroid

    offset = Tpms.offset_from_density(gyroid, "sheet", 1 - porosity)
    shift = np.random.default_rng(seed).uniform(0, 2 * np.pi, 3)
    axes = [2 * np.pi * CELLS * (np.arange(n) + 0.5) / n + one for one in shift]
    return np.abs(gyroid(*np.meshgrid(*axes, indexing="ij"))) < offset / 2
