"""What a report shows of a sweep: its table, the data of the scatter, small multiples."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.run.outputs import SWEEP_RUNS
from sppm_pipeline.features.browser.live.page import json_block
from sppm_pipeline.features.browser.report.boxes import duration
from sppm_pipeline.features.browser.report.layers import outputs_of, pictures_of
from sppm_pipeline.features.browser.report.records import without_folders
from sppm_pipeline.nouns.artifact import shown
from sppm_pipeline.nouns.report import Box, readable
from sppm_pipeline.stage import FAMILIES

PICTURE_BYTES = 30_000
"""Bytes that the picture of a row may take."""

STATIC_ROWS = 200
"""Rows that stand in the page itself; its script shows the others and sorts them."""

MAX_COLUMNS = 24
MAX_ROWS = 10_000
TUNED = 0.02
"""Relative difference up to which a column shows that a parameter was reached, and nothing else."""

MULTIPLES = 120
"""Rows whose pictures are shown side by side."""


def sweep_context(path: Path, record: Mapping[str, Any], views: Mapping[str, bytes]) -> dict[str, Any]:
    """Data of a sweep, whose record has `runs`, for the template; `views` are view files by run."""
    runs: list[Mapping[str, Any]] = list(record["runs"])
    table = _table(path)
    params = list(dict.fromkeys(name for run in runs for name in run["params"]))
    tabled = _tabled(record["stages"])
    names = _names(table, params, list(tabled))
    rows = [[row.get(name) for name in names] for row in table[:MAX_ROWS]]
    done = sum(run["status"] == "done" for run in runs)
    failed = [run for run in runs if run.get("error")]
    reports = [f"{SWEEP_RUNS}/{run['run']}/report.html" for run in runs[:STATIC_ROWS]]
    units = {name: unit for name, unit in _units(path).items() if name in names}
    said = [readable(name if name in params else _last(name)) for name in names]
    words = [tabled.get(name, text) for name, (text, _) in zip(names, said, strict=True)]
    own = {*params, *tabled}
    words = [
        f"{word} ({name})" if words.count(word) > 1 and name not in own else word
        for word, name in zip(words, names, strict=True)
    ]
    axes = _axes(names, rows, params)
    first = [n for n in axes if names[n] in tabled] or axes
    x = next((n for n in axes if names[n] in params), first[0] if first else 0)
    ends = [0, *accumulate(len(data) for data in views.values())]
    head = {
        "names": names, "words": words, "units": [units.get(n) or u for n, (_, u) in zip(names, said, strict=True)],
        "axes": axes, "first": [x, next((n for n in first if n != x), x)], "params": params, "rows": len(rows),
        "base": {name: value for name, value in record["params"].items() if name not in params},
        "seed": record["seed"], "file": Path(str(record["file"])).name,
        "views": [[run, *span] for run, span in zip(views, pairwise(ends), strict=True)],
    }  # fmt: skip
    return {
        "boxes": [
            Box("runs", f"{done} of {len(runs)} done", "", done < len(runs)),
            Box("time", duration(record.get("seconds")), f"{record.get('threads', '?')} threads"),
        ],
        "names": names, "words": words, "units": head["units"],
        "rows": [[_cell(value) for value in row] for row in rows[:STATIC_ROWS]],
        "links": [link for link in reports if (path / link).is_file()], "count": len(table), "packed": _packed(rows),
        "head": json_block(head),
        "failed": [
            {"run": run["run"], "params": shown(run["params"]), "message": str(run["error"].get("message", ""))}
            for run in failed[:STATIC_ROWS]
        ],
        "multiples": _multiples(path, runs),
    }  # fmt: skip


def _tabled(stages: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Columns that a ``write.table`` after the sweep chose, and their headings or readable names."""
    found: dict[str, str] = {}
    for stage in stages:
        if stage["stage"] == "write.table":
            columns = list(stage["options"]["columns"])
            headings = stage["options"].get("headings") or [readable(_last(name))[0] for name in columns]
            found |= {str(name): str(text) for name, text in zip(columns, headings, strict=True)}
    return found


def _last(name: str) -> str:
    """The name of a column without its stage: ``E_relative``, and ``C 1 1`` of a list."""
    words = name.split(".")
    return " ".join(words[2:] if words[0] in FAMILIES and len(words) > 2 else words[1:] or words)


def _units(path: Path) -> dict[str, str]:
    try:
        columns = json.loads((path / "sweep.csv-metadata.json").read_bytes())["tableSchema"]["columns"]
        return {str(column["titles"]): str(column.get("schema:unitText", "")) for column in columns}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _axes(names: Sequence[str], rows: Sequence[Sequence[Any]], params: Sequence[str]) -> list[int]:
    """Columns of numbers that differ, parameters first; none that only shows that a parameter was reached."""
    columns = {n: [_float(row[n]) for row in rows] for n in range(len(names))}
    varied = [n for n in columns if len({v for v in columns[n] if v is not None}) > 1 and names[n] != "run"]
    given = [n for n in varied if names[n] in params]

    def tuned(n: int) -> bool:
        for other in given:
            pairs = [(a, b) for a, b in zip(columns[n], columns[other], strict=True) if a is not None and b is not None]
            if pairs and max(abs(a - b) for a, b in pairs) <= TUNED * max(abs(b) for _, b in pairs):
                return True
        found = [v for v in columns[n] if v is not None]
        return names[n].startswith("tune.") and max(found) - min(found) <= TUNED * max(map(abs, found))

    return given + [n for n in varied if n not in given and not tuned(n)]


def _table(path: Path) -> list[dict[str, Any]]:
    try:
        table = json.loads((path / "sweep.json").read_bytes())
    except (OSError, ValueError, RecursionError):
        return []
    return [without_folders(row) for row in table if isinstance(row, dict)] if isinstance(table, list) else []


def _names(table: Sequence[Mapping[str, Any]], params: Sequence[str], tabled: Sequence[str]) -> list[str]:
    """Columns that are shown: what names a row, those that were tabled, and of the others those that differ, the most
    asked for if many."""
    first = list(dict.fromkeys(("run", *params, *tabled, "status", "error")))
    columns = list(dict.fromkeys(name for row in table[:MAX_ROWS] for name in row))
    differ = [n for n in columns if n not in first and len({str(row.get(n)) for row in table[:MAX_ROWS]}) > 1]
    chosen = set(sorted(differ, key=_rank)[: max(0, MAX_COLUMNS - len(first))])
    return [name for name in first if name in columns] + [name for name in columns if name in chosen]


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


def _float(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def _multiples(path: Path, runs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The first picture of each row, small."""
    found: list[dict[str, Any]] = []
    budget = 1_400_000
    for run in runs[:: -(-len(runs) // MULTIPLES) or 1]:
        folder = path / SWEEP_RUNS / str(run["run"])
        try:
            stages = json.loads((folder / "run.json").read_bytes())["stages"]
            # none takes more than its share, so that all rows have one
            pictures = pictures_of(folder, outputs_of(folder, stages)[:8], PICTURE_BYTES, pixels=240)
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
        if pictures:
            budget -= len(pictures[0].source)
            found.append({"picture": pictures[0], "run": str(run["run"]), "params": shown(run["params"])})
        if budget < PICTURE_BYTES:
            break
    return found
