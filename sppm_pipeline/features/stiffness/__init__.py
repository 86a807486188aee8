"""Elastic homogenization of voxels, and analysis of the stiffness tensor."""

from __future__ import annotations

from sppm_pipeline.hookspecs import hookimpl

STAGES = {
    "tune.stiffness": "TuneStiffness", "homogenize.realizations": "HomogenizeRealizations",
    "homogenize.voxel": "HomogenizeVoxel", "measure.onset": "MeasureOnset", "write.stiffness": "WriteStiffness",
}  # fmt: skip
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}


@hookimpl
def sppm_stage_aliases() -> dict[str, str]:
    """Former names."""
    return {"homogenize.realisations": "homogenize.realizations"}
