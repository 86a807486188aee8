"""The section of reports on a print: the verdict first, then numbers of the check and of the writer, worst layers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from sppm_pipeline.nouns.artifact import shown
from sppm_pipeline.nouns.report import Box, ReportSection, is_number, readable

_OF_STACK = ("verdict", "pixels", "layers", "pixel_mm", "layer_mm", "printer")
_OF_JOB = (
    "printer", "verified_on_hardware", "resin", "resin_measured", "resin_ml", "resin_g", "print_time_s", "resin_price",
)  # fmt: skip
_PICTURES = {"check.print": ("marked.png", "layers.png", "throats.png"), "fix.drains": ("drains.png",)}


def print_sections(record: Mapping[str, Any]) -> list[ReportSection]:
    """A section on the last check and the last printer's file of a run; none of a run with neither."""
    stages = record["stages"]
    checked = next((stage for stage in reversed(stages) if stage["stage"] == "check.print"), None)
    written = next((stage for stage in reversed(stages) if "verified_on_hardware" in stage["summary"]), None)
    if checked is None and written is None:
        return []
    check, job = ({} if stage is None else stage["summary"] for stage in (checked, written))
    verdict, boxes = str(check.get("verdict", "")), []
    if checked is not None:
        first, _, more = verdict.partition("; ")
        first = re.split(r" of | \(", first)[0]
        bad = bool(checked.get("rejected") or check.get("traps") or check.get("floating_parts"))
        boxes.append(Box("print", "rejected" if checked.get("rejected") else first, more, bad))
    # what is not known of the file, as there is none, may be known of the check
    known = {name: value for name, value in {**check, **job}.items() if value is not None}
    resin = [_said(name, known[name])[1] for name in ("resin_ml", "resin_g") if name in known]
    boxes += [Box("resin", ", ".join(resin), str(job.get("resin", "")))] if resin else []
    boxes += [Box("print time", _said("print_time_s", known["print_time_s"])[1])] if "print_time_s" in known else []
    price = known.get("resin_price", known.get("price"))
    boxes += [Box("price of the resin", f"{price:.2f}", "in the currency of its card")] if is_number(price) else []
    names = [name for name in check if name not in (*_OF_STACK, *_OF_JOB)] + [name for name in _OF_JOB if name in known]
    rows = [_said(name, known[name]) for name in names if name in known]
    pictures = [
        f"{output['path']}/{name}"
        for stage in (checked, *(stage for stage in stages if stage["stage"] == "fix.drains"))
        for output in (stage or {}).get("outputs", ())
        for name in _PICTURES[stage["stage"]]
    ]
    text = verdict or f"Layers for {job['printer']}; no `check.print` has looked at them."
    return [ReportSection("Print", text, rows, pictures=pictures, boxes=boxes)]


def _said(name: str, value: Any) -> tuple[str, str]:
    """A number with its unit; times of more than an hour in hours."""
    words, unit = readable(name)
    if unit == "s" and is_number(value):
        return words, f"{value / 3600:.2f} h" if value >= 3600 else f"{value / 60:.0f} min"
    if unit in ("ml", "g") and is_number(value):
        return words, f"{value:.3g} {unit}"
    return words, f"{'yes' if value is True else 'no' if value is False else shown(value)} {unit}".rstrip()
