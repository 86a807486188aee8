"""Crushing: blocks of voxels compressed to large strains, and compression tests read, measured and compared."""

from __future__ import annotations

from sppm_pipeline import hookimpl

STAGES = {
    "read.compression": "ReadCompression", "tune.plateau": "TunePlateau", "measure.compression": "MeasureCompression",
    "crush.voxel": "CrushVoxel", "write.curves": "WriteCurves", "write.frames": "WriteFrames",
}  # fmt: skip
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}
