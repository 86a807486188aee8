"""Blobs of PoreSpy: noise smoothed by a Gaussian, cut at the asked porosity; smoothed here across the faces."""

from __future__ import annotations

import numpy as np

NEEDS = ("porespy",)


def make(porosity, seed, n):
    """See README.md."""
    import porespy

    image = porespy.generators.blobs([n] * 3, porosity=porosity, blobiness=2, periodic=True, seed=seed)
    return ~np.asarray(image, bool)
