"""The table of a sweep: the numbers that its runs left, a row for each run."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from sppm_pipeline.nouns.report import Report

if TYPE_CHECKING:
    from sppm_pipeline.engine.plan.wiring import Step

MAX_LISTED = 6
"""Longest list whose numbers get columns of their own: vectors, and the rows and columns of a stiffness matrix."""


def numbers_of(stages: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Numbers in the summaries of a run record's stages, as ``<stage id>.<name>``; truth values as 1 and 0.

    Those of short lists are counted from 1, row by row: ``E.1``, ``C.4.4``.
    """
    return {f"{stage['id']}.{name}": value for stage in stages for name, value in _numbers(stage.get("summary", {}))}


def _numbers(summary: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    for name, value in summary.items():
        if isinstance(value, (bool, int, float)):
            yield name, int(value) if isinstance(value, bool) else value
        elif isinstance(value, dict):
            yield from ((f"{name}.{inner}", number) for inner, number in _numbers(value))
        elif isinstance(value, list) and len(value) <= MAX_LISTED:
            listed = {str(number): one for number, one in enumerate(value, 1) if not isinstance(one, dict)}
            yield from ((f"{name}.{inner}", number) for inner, number in _numbers(listed))


def units_of(steps: Sequence[Step], stages: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Units of the numbers in the summaries of a run record's stages, as the reports that were made declare them."""
    makes = {step.id: [kind for kind in step.makes if issubclass(kind, Report)] for step in steps}
    found: dict[str, str] = {}
    for stage in stages:
        summary = stage.get("summary", {})
        for one in (entry for kind in makes.get(stage["id"], ()) for entry in kind.entries() if entry.unit):
            unit = one.unit.replace("{unit}", str(summary.get("unit") or ""))
            begin = ".".join(one.path)
            names = [name for name, _ in _numbers(summary) if name == begin or name.startswith(f"{begin}.")]
            found |= {f"{stage['id']}.{name}": unit for name in names if unit}
    return found


def columns_of(runs: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Columns ``run``, the parameters, ``status``, ``error``, then the numbers in the order in which they appear."""
    params = list(dict.fromkeys(name for run in runs for name in run["params"]))
    numbers = list(dict.fromkeys(name for run in runs for name in run["columns"]))
    columns: dict[str, list[Any]] = {"run": [run["run"] for run in runs]}
    columns |= {name: [run["params"].get(name) for run in runs] for name in params}
    columns["status"] = [run["status"] for run in runs]
    columns["error"] = [run["error"]["message"] if run["error"] else None for run in runs]
    return columns | {name: [run["columns"].get(name) for run in runs] for name in numbers}


def rows_of(columns: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """The table as a list of rows."""
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def csv_metadata(columns: Mapping[str, Sequence[Any]], units: Mapping[str, str]) -> dict[str, Any]:
    """What the columns of ``sweep.csv`` are, as CSV on the Web (W3C, 2015) has it: type and unit of each."""
    described = []
    for name, values in columns.items():
        kinds = {type(value) for value in values if value is not None}
        number = kinds and kinds <= {int, float, bool}
        kind = ("integer" if kinds <= {int} else "number") if number and name != "run" else "string"
        column: dict[str, Any] = {"titles": name, "datatype": kind, "required": False}
        described.append(column | ({"schema:unitText": units[name]} if name in units else {}))
    schema = {"columns": described}
    return {"@context": "http://www.w3.org/ns/csvw", "url": "sweep.csv", "null": "", "tableSchema": schema}


def csv_text(columns: Mapping[str, Sequence[Any]]) -> str:
    """The table as CSV; lists as JSON, nothing as an empty field."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in rows_of(columns):
        writer.writerow([json.dumps(v) if isinstance(v, (list, dict, bool)) else v for v in row.values()])
    return text.getvalue()
