"""The cell of the paper, by sppm_pipeline."""

from __future__ import annotations

import sppm_pipeline as sppm


def make(porosity, seed, n):
    """See README.md."""
    return sppm.cell("paper", porosity=porosity, seed=seed).to_numpy(n)
