"""Scans: images of micro-CT as fields, their statistics, twins made of them, and parts compared with their design."""

from __future__ import annotations

from sppm_pipeline.hookspecs import hookimpl

STAGES = {
    "read.scan": "ReadScan", "field.voxels": "FieldVoxels", "measure.statistics": "MeasureStatistics",
    "tune.match": "TuneMatch", "check.scan": "CheckScan", "print.simulate": "PrintSimulate",
    "write.statistics": "WriteStatistics",
}  # fmt: skip
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}
