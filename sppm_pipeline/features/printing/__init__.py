"""Printing: what becomes of layers in the vat, repairs of traps, and printers' files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sppm_pipeline.hookspecs import Command, hookimpl
from sppm_pipeline.nouns.report import ReportSection

STAGES = {
    "tune.orientation": "TuneOrientation",
    "fix.drains": "FixDrains",
    "fix.fill": "FixFill",
    "check.print": "CheckPrint",
    "check.sizes": "CheckSizes",
    "slice.plate": "SlicePlate",
    "write.sl1": "WriteSl1",
    "write.goo": "WriteGoo",
    "write.nanodlp": "WriteNanodlp",
}
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}


@hookimpl
def sppm_report_sections(record: Mapping[str, Any]) -> list[ReportSection]:
    """What the check of the print and the writer of its layers found."""
    from sppm_pipeline.features.printing.print_section import print_sections

    return print_sections(record)


@hookimpl
def sppm_commands() -> dict[str, Command]:
    """The verbs of this feature."""
    return {
        "printers": Command(
            "list the printers and resins there are, or describe one",
            f"{__name__}.commands:configure",
            f"{__name__}.commands:execute",
        )
    }
