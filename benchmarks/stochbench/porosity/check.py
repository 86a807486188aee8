"""Porosity: what was asked for and what the voxels hold."""

from __future__ import annotations

import numpy as np


def check(cells, inputs, truth):
    """Largest and mean error."""
    errors = np.abs([1 - cell.mean() - one["porosity"] for cell, one in zip(cells, inputs, strict=True)])
    return {"largest error": float(errors.max()), "mean error": float(errors.mean())}
