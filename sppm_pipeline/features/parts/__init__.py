"""Parts under load: load cases, simulation of the part that will be printed, and densities that suit the load."""

from __future__ import annotations

from sppm_pipeline.hookspecs import hookimpl

STAGES = {"load.case": "AddLoadCase", "simulate.part": "SimulatePart", "optimize.density": "OptimizeDensity"}
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}
