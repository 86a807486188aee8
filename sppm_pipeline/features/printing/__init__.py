"""Printing: what becomes of layers in the vat, repairs of traps, and printers' files."""

from __future__ import annotations

from sppm_pipeline.hookspecs import Command, hookimpl

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
def sppm_commands() -> dict[str, Command]:
    """The verbs of this feature."""
    return {
        "printers": Command(
            "list the printers and resins there are, or describe one",
            f"{__name__}.commands:configure",
            f"{__name__}.commands:execute",
        )
    }
