"""Elastic homogenization of voxels, and analysis of the stiffness tensor."""

from __future__ import annotations

from sppm_pipeline.hookspecs import hookimpl, stages_in

sppm_stages = stages_in(__name__)


@hookimpl
def sppm_stage_aliases() -> dict[str, str]:
    """Former names."""
    return {"homogenize.realisations": "homogenize.realizations"}
