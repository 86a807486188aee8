"""Distance of the stiffness tensor of each cell to that asked for, by the voxel solver of sppm_pipeline."""

from __future__ import annotations

import numpy as np

import sppm_pipeline as sppm

WEIGHTS = np.sqrt([1, 1, 1, 2, 2, 2])
"""Of Voigt's order: with them the norm of a tensor does not depend on the axes (Mandel's basis)."""


def norm(tensor):
    """Frobenius norm of a stiffness (6, 6) in Voigt's order."""
    return float(np.linalg.norm(WEIGHTS[:, None] * tensor * WEIGHTS))


def stiffness(cell, poisson):
    """Of whole voxels, (6, 6)."""
    image = sppm.Voxels.from_array(cell.astype(np.uint8), periodic=True)
    return sppm.homogenize.voxel(image, poisson=poisson).stiffness


def halved(cell):
    """The cell with half as many voxels along an edge: solid where five of eight are, or four with the first."""
    parts = cell.reshape(len(cell) // 2, 2, len(cell) // 2, 2, len(cell) // 2, 2)
    count = parts.sum((1, 3, 5), dtype=int)
    return (count > 4) | ((count == 4) & parts[:, 0, :, 0, :, 0])


def check(cells, inputs, truth):
    """Means over the targets, and the worst; the error is the mean change from half as many voxels."""
    off, errors, porosity = [], [], []
    for cell, one in zip(cells, inputs, strict=True):
        target = np.array(one["stiffness"])
        fine, coarse = (stiffness(image, truth["poisson"]) for image in (cell, halved(cell)))
        off.append(norm(fine - target) / norm(target))
        errors.append(norm(fine - coarse) / norm(target))
        porosity.append(abs(1 - cell.mean() - one["porosity"]))
    return {
        "mean distance": float(np.mean(off)), "worst": max(off), "error": float(np.mean(errors)),
        "largest difference of porosity": float(max(porosity)),
    }  # fmt: skip
