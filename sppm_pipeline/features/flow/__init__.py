"""Flow and transport: permeability, acoustics and conductivity of a cell, and its pore network."""

from __future__ import annotations

from sppm_pipeline import hookimpl

STAGES = {
    "homogenize.conductivity": "HomogenizeConductivity", "homogenize.permeability": "HomogenizePermeability",
    "homogenize.acoustics": "HomogenizeAcoustics", "write.flow": "WriteFlow", "write.absorption": "WriteAbsorption",
    "write.network": "WriteNetwork",
}  # fmt: skip
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}
