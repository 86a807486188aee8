"""Stiffness, by the voxel solver of sppm_pipeline on the voxels of each tool."""

from __future__ import annotations

import numpy as np

import sppm_pipeline as sppm


def check(cells, inputs, truth):
    """Means over the seeds on the finer grid; the error is the mean change from the coarser one."""
    found = []
    for cell in cells:
        report = sppm.homogenize.voxel(sppm.Voxels.from_array(cell.astype(np.uint8), periodic=True), grids=1)
        numbers = report.summary()
        bound = numbers["bounds"]["hashin_shtrikman_young"][1]
        found.append([numbers["isotropic"]["E"] / bound, numbers["universal_anisotropy"]])
    coarse, fine = np.array(found[0::2]), np.array(found[1::2])
    share, index = fine.mean(axis=0).tolist()
    return {"E over the bound": share, "error": float(np.abs(fine - coarse)[:, 0].mean()), "A^U": index}
