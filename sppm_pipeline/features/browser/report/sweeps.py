"""The table, charts and small multiples of a sweep."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.run.outputs import SWEEP_RUNS
from sppm_pipeline.features.browser.live.page import json_block
from sppm_pipeline.features.browser.report.boxes import duration, line_chart
from sppm_pipeline.features.browser.report.layers import outputs_of, pictures_of
from sppm_pipeline.features.browser.report.records import without_folders
from sppm_pipeline.nouns.artifact import shown
from sppm_pipeline.nouns.report import Box, Curve
from sppm_pipeline.stage import FAMILIES

STATIC_ROWS = 200
"""Rows that stand in the page itself; its script shows the others and sorts them."""

MAX_COLUMNS = 24
MAX_ROWS = 10_000
MAX_CHARTS = 6
MAX_POINTS = 2_000
MULTIPLES = 48
"""Rows whose pictures are shown side by side."""


def sweep_context(path: Path, record: Mapping[str, Any]) -> dict[str, Any]:
    """Data of a sweep, whose record has `runs`, for the template."""
    runs: list[Mapping[str, Any]] = list(record["runs"])
    table = _table(path)
    params = list(runs[0]["params"]) if runs else []
    names = _names(table, params)
    rows = [[row.get(name) for name in names] for row in table[:MAX_ROWS]]
    done = sum(run["status"] == "done" for run in runs)
    failed = [run for run in runs if run.get("error")]
    reports = [f"{SWEEP_RUNS}/{run['run']}/report.html" for run in runs[:STATIC_ROWS]]
    return {
        "boxes": [
            Box("runs", f"{done} of {len(runs)} done", "", done < len(runs)),
            Box("time", duration(record.get("seconds")), f"{record.get('threads', '?')} threads"),
        ],
        "names": names, "rows": [[_cell(value) for value in row] for row in rows[:STATIC_ROWS]],
        "links": [link for link in reports if (path / link).is_file()], "count": len(table), "packed": _packed(rows),
        "head": json_block({"names": names, "rows": len(rows)}),
        "failed": [
            {"run": run["run"], "params": shown(run["params"]), "message": str(run["error"].get("message", ""))}
            for run in failed[:STATIC_ROWS]
        ],
        "charts": _charts(names, rows, params), "multiples": _multiples(path, runs),
    }  # fmt: skip


def _table(path: Path) -> list[dict[str, Any]]:
    try:
        table = json.loads((path / "sweep.json").read_bytes())
    except (OSError, ValueError, RecursionError):
        return []
    return [without_folders(row) for row in table if isinstance(row, dict)] if isinstance(table, list) else []


def _names(table: Sequence[Mapping[str, Any]], params: Sequence[str]) -> list[str]:
    """Columns that are shown: what names a row, and of the others those that differ, the most asked for if many."""
    first = ("run", *params, "status", "error")
    columns = list(dict.fromkeys(name for row in table[:MAX_ROWS] for name in row))
    differ = [n for n in columns if n not in first and len({str(row.get(n)) for row in table[:MAX_ROWS]}) > 1]
    chosen = set(sorted(differ, key=_rank)[: MAX_COLUMNS - len(first)])
    return [name for name in columns if name in first or name in chosen]


def _rank(name: str) -> int:
    """Rank of a column: low for the results most sweeps are run for, which are charted first."""
    words = ("porosity", "E_relative", "k_mean", "E", "nu", "xi", "volume_mm3", "solid_volume_mm3", "removed_share")
    first, *rest = name.split(".")
    own = rest[1:] if first in FAMILIES and len(rest) > 1 else rest  # without the stage, which may be tune.porosity
    return next((i for i, word in enumerate(words) if word in own), len(words))


def _cell(value: Any) -> str:
    return "" if value is None else shown(value)


def _packed(rows: Sequence[Sequence[Any]]) -> str:
    """All rows for the script, numbers to nine digits."""
    plain = [[float(f"{v:.9g}") if isinstance(v, float) else v for v in row] for row in rows]
    data = json.dumps(plain, separators=(",", ":"), ensure_ascii=False).encode()
    return base64.b64encode(gzip.compress(data, compresslevel=9, mtime=0)).decode()


def _charts(names: Sequence[str], rows: Sequence[Sequence[Any]], params: Sequence[str]) -> list[str]:
    """Columns over the parameter that takes the most values: those that are asked for most come first."""
    columns = {name: [_float(row[i]) for row in rows] for i, name in enumerate(names)}
    counts = {name: len({v for v in columns[name] if v is not None}) for name in params if name in columns}
    along = max((name for name in counts if name != "seed"), key=lambda name: counts[name], default=None)
    if along is None or counts[along] < 2:
        return []
    # a column of one value makes no chart
    numbers = [n for n in names if n not in params and len({v for v in columns[n] if v is not None}) > 1]
    numbers.sort(key=_rank)
    # every n-th row: more points than pixels only make the page large
    step = -(-len(rows) // MAX_POINTS)
    drawn = []
    for name in numbers[:MAX_CHARTS]:
        pairs = [(x, y) for x, y in zip(columns[along], columns[name], strict=True) if x is not None and y is not None]
        curve = Curve([x for x, _ in pairs[::step]], [y for _, y in pairs[::step]], points=True)
        drawn.append(line_chart([curve], along, name))
    return [chart for chart in drawn if chart]


def _float(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def _multiples(path: Path, runs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The first picture of each row, small."""
    found: list[dict[str, Any]] = []
    budget = 700_000
    for run in runs[:MULTIPLES]:
        folder = path / SWEEP_RUNS / str(run["run"])
        try:
            stages = json.loads((folder / "run.json").read_bytes())["stages"]
            # no picture takes more than an eighth of what is left, so that many rows have one
            pictures = pictures_of(folder, outputs_of(folder, stages)[:8], budget // 8, pixels=240)
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
        if pictures:
            budget -= len(pictures[0].source)
            found.append({"picture": pictures[0], "run": str(run["run"]), "params": shown(run["params"])})
        if budget < 20_000:
            break
    return found
