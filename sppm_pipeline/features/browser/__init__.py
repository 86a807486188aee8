"""What people look at: reports, the live view, the studio, charts, sheets and tables."""

from __future__ import annotations

from sppm_pipeline.hookspecs import Command, hookimpl

STAGES = {
    "write.view": "WriteView",
    "write.chart": "WriteChart",
    "write.bars": "WriteBars",
    "write.sheet": "WriteSheet",
    "write.table": "WriteTable",
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
        "report": Command(
            "write one HTML file that shows a run directory, to be mailed",
            f"{__name__}.report.command:configure",
            f"{__name__}.report.command:execute",
        ),
        "view": Command(
            "show a run directory in the browser",
            f"{__name__}.live.command:configure",
            f"{__name__}.live.command:execute",
        ),
        "studio": Command(
            "design a cell in the browser, and save it as a configuration",
            f"{__name__}.studio.command:configure",
            f"{__name__}.studio.command:execute",
        ),
    }
