"""Printing: what becomes of layers in the vat, repairs of traps, and printers' files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from sppm_pipeline.hookspecs import Command, hookimpl, stages_in

if TYPE_CHECKING:
    from sppm_pipeline.nouns.report import ReportSection  # which loads numpy

sppm_stages = stages_in(__name__)
GROUPS = {"": "everyday"}


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
