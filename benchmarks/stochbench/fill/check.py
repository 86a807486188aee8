"""A ball is filled with cells and cut into layers, by NumPy: what a printer is given. Pieces by SciPy."""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def ball(radius, cells, n):
    """Voxels of a ball of `radius` cell edges in the middle of `cells` cells along each axis."""
    axis = (np.arange(cells * n) + 0.5) / n - cells / 2
    return np.add.outer(np.add.outer(axis**2, axis**2), axis**2) <= radius**2


def loose_share(solid):
    """Share of the solid that is in no contact with its largest piece; voxels touch at faces."""
    labels, count = ndimage.label(solid)
    return 1 - np.bincount(labels.ravel())[1:].max() / solid.sum() if count else 1.0


def check(cells, inputs, truth):
    """Over all draws: porosity in the ball, what falls out of it, and layers (planes of voxels) without solid."""
    off, loose, empty = [], [], 0
    for cell in cells:
        body = ball(truth["radius"], truth["cells"], len(cell))
        part = body & np.tile(cell, [truth["cells"]] * 3)
        off.append(abs(1 - part.sum() / body.sum() - truth["porosity"]))
        loose.append(loose_share(part))
        empty += int((body.any(axis=(0, 1)) & ~part.any(axis=(0, 1))).sum())
    return {
        "largest error of porosity": float(max(off)),
        "loose share of solid": float(np.mean(loose)),
        "largest loose share": float(max(loose)),
        "empty layers": empty,
    }
