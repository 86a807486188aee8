"""One cell of walls and struts with a tensor of its own, by `tune.tensor` of sppm_pipeline."""

from __future__ import annotations

import numpy as np

import sppm_pipeline as sppm

STRUTS = 0.3
"""Share of struts that the search starts with."""


def like(stiffness, porosity, seed, n):
    """See README.md."""
    target, unknown = np.array(stiffness), np.zeros((6, 6))
    design = sppm.nouns.StiffnessDesign(
        recipe="dialed", options=(("struts", STRUTS),), porosity=porosity, stretch=np.ones(3), rotation=np.eye(3),
        stiffness=target, target=target, mean_error=unknown, draw_error=unknown, distance=0.0, floor=0.0,
        grid_error=0.0, draws=3,
    )  # fmt: skip
    return sppm.tune.tensor(recipe="dialed", design=design, seed=seed, max_distance=1.0).to_numpy(n)
