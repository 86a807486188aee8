"""Label images, by which connected components are compared with those of other programs."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.method.connectivity.components import find_components, paint_runs


@pytest.fixture(scope="session")
def label():
    """Components of a phase as (nz, ny, nx) int32 labels from 1 on, by decreasing size, and their voxels."""

    def labels(mask, periodic=(True, True, True), connectivity=6):
        found = find_components(mask, periodic, connectivity)
        painted = np.zeros(found.runs.shape, np.int32)
        paint_runs(found.runs.rows, found.runs.bounds, found.of_run + np.int32(1), painted)
        return painted, found.sizes

    return labels
