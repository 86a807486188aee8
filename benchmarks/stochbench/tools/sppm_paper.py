"""The cell of the paper, by sppm_pipeline."""

from __future__ import annotations

import sppm_pipeline as sppm

FEW = {"starts": 8, "evaluations": 16, "match": ["S2"], "hold_out": False}


def make(porosity, seed, n):
    """See README.md."""
    return sppm.cell("paper", porosity=porosity, seed=seed).to_numpy(n)


def twin(scan, seed):
    """See README.md: numbers of pores and radii are varied."""
    recipe = [
        sppm.sample.dart_throwing(total=60),
        sppm.connect.mbdst(degree=[3, 5], mode="greedy"),
        sppm.field.gaussian(pore_radius=0.04, tunnel_radius=0.03),
    ]
    image = sppm.Voxels.from_array(scan, periodic=True)
    vary = ["sample.dart_throwing.total", "field.gaussian.pore_radius"]
    match = sppm.tune.match(recipe=recipe, vary=vary, low=[30, 0.02], high=[120, 0.08], **FEW)
    return match(image, seed=seed).to_numpy(len(scan))
