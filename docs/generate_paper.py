"""Write the page that goes through the paper figure by figure, and the tables of results on other pages.

Usage: ``python docs/generate_paper.py`` writes both from the numbers in ``docs/results``; ``--check`` only lists what
is stale (exit code 1); ``--run [NAME ...]`` runs the configurations, all or those named, and stores their numbers and
pictures first (``make paper``); ``--recompute [NAME ...]`` runs the rows that each configuration calls cheap again, and
compares them with the stored numbers, as the tests do.

All that belongs to a figure or table stands in the map `notes` of its configuration:

* `figure`, `title`, `paper` (what the paper's panel shows), `panels` (pictures of the run), `differs`;
* `numbers`: what is compared. Each `says` what it is and takes one `column` of the runs, of all rows or those `where`
  columns have given values, ``*`` for any ending. `take` is mean (the default), mean reciprocal (0 of rows without a
  number, which is infinite), least, largest, deviation (of single draws), relative deviation, largest from mean (of
  the same value of the column `over`), squared correlation (of these means with `over`), exponent (of the relative
  deviation over the volume of boxes of `over` cells along an edge) or size for 5 % (the edge where it is 0.05). `paper`
  is the paper's number or its range, `within` the tolerance, relative to the number or to the end of the range;
* `keep`: columns that are stored beside those that numbers and tables take;
* `tables`: by the name in a page's mark ``<!-- results: NAME -->``, up to ``<!-- end of results -->``: `rows` and
  `columns`, each with a `head`. A cell takes the column `row.column` of the rows `where` both say; a row may be `from`
  another configuration, and a column be divided by that named as `over`. Tables of the paper stand on its page;
* `cheap`: numbers of the rows that are computed again by tests, or all; `without`, stages that cost much and that no
  number of theirs needs; `cheap_params`, values of parameters with which a single run makes these rows;
* `needs`: mesh, if one has to be given with ``--mesh``;
* `table`: a CSV file of the run, if the rows are not those of the sweep.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import csv
import functools
import hashlib
import io
import json
import math
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
PICTURES = ROOT / "docs" / "pictures" / "paper"
PAGE = ROOT / "docs" / "explanation" / "reproduce-the-paper.md"

PAPER = (
    "paper/kernels", "paper/levels", "paper/regions", "paper/trees", "paper/process", "tileset_27",
    "paper/worked_example", "porosity_map", "paper/gap", "paper/slices", "paper/target_porosity",
    "periodic_vs_stochastic", "stiffness_map", "paper/assemblies", "representative_volume",
    "graded_bar", "table_mesh_free", "paper/table_mesh", "paper/compression",
    "bunny",
)  # fmt: skip
"""Configurations of the paper's figures and tables, in its order."""

DESIGNS = tuple(f"designs/{name}" for name in ("implant_core", "insole", "filter", "damper", "light_panel"))
"""Worked designs of docs/howto/which-numbers.md."""

OTHERS: tuple[str, ...] = (
    "tables/paper_cell", "tables/stiffest_cells", "tables/tile_rules", "tables/network", "tables/spheres",
    "tables/walls_grid", "tables/struts", "tables/onset", "tables/volume", "tables/conduction",
    "tables/stiffest_density", "how_random", "stiffest_grid", "tables/scattered_even", "compare_structures",
    *DESIGNS,
)  # fmt: skip
"""Further configurations whose results are stored, for tables of other pages."""

RUN = (*PAPER, *OTHERS)
"""All that are run; numbers of each are stored."""

RELATIVE = 2e-4
"""Difference of a number that is computed again, over the number: solvers are right to 1e-4 of the stiffness."""

MARK = re.compile(r"(<!-- results: (\S+) -->\n)(.*?)(<!-- end of results -->)", re.DOTALL)
NOTICE = "<!-- Written by docs/generate_paper.py from configurations and docs/results; edit those, not this page. -->"
HEAD = """# Reproduce the paper

{notice}

Each figure and table of *Stochastic Porous Microstructures*: panels of this program beside what the paper's show, and
its numbers. Those of several draws are means with their standard errors; "within" is the tolerance that stands in the
configuration, and where the paper prints no number there is none to agree with. [How this program reads the
paper](paper.md) discusses the text.

```bash
make paper
```

runs all configurations of this page, and of the tables of results on other pages, and writes them. Those of this page
that have numbers here took {minutes} minutes of processor time. Tests compute a part of each again, and compare.
"""


class Stored(NamedTuple):
    """Numbers of the runs of a configuration."""

    recipe: str  # digest of what was run
    seconds: float  # processor time
    rows: list[dict[str, Any]]


@functools.cache
def _document_of(name: str) -> dict[str, Any]:
    return dict(YAML(typ="safe").load((ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8")))


def document_of(name: str) -> dict[str, Any]:
    """A configuration as it stands in its file."""
    return copy.deepcopy(_document_of(name))


def notes_of(name: str) -> dict[str, Any]:
    """What a configuration says about its results."""
    return dict(document_of(name)["notes"])


def recipe_of(name: str) -> str:
    """Digest of all that enters the runs of a configuration: its stages, but not what it says about the results."""
    document = document_of(name)
    kept = {key: value for key, value in document.items() if key not in ("notes", "after")}
    files = [(ROOT / "configs" / name).parent / plugin for plugin in document.get("plugins", ())]
    text = json.dumps(kept, sort_keys=True) + "".join(file.read_text(encoding="utf-8") for file in files)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def file_of(name: str) -> Path:
    """Where the numbers of a configuration are stored."""
    return RESULTS / f"{name.rpartition('/')[2]}.json"


def stored(name: str) -> Stored:
    """The stored numbers of a configuration."""
    document = json.loads(file_of(name).read_text(encoding="utf-8"))
    return Stored(document["recipe"], document["seconds"], document["rows"])


# running


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Numbers and words of a summary by the names of columns."""
    if isinstance(value, Mapping):
        entries: Iterable[tuple[Any, Any]] = value.items()
    elif isinstance(value, list):
        entries = enumerate(value, 1)
    else:
        return {prefix: value}
    found: dict[str, Any] = {}
    for key, entry in entries:
        found |= flat(entry, f"{prefix}.{key}" if prefix else str(key))
    return found


def rows_of(name: str, folder: Path) -> list[dict[str, Any]]:
    """All rows of a run: of the table that the notes name, of a sweep, or the one of a single run."""
    table = notes_of(name).get("table")
    if table:
        with (folder / table).open(encoding="utf-8") as file:
            return [{key: number_of(word) for key, word in row.items()} for row in csv.DictReader(file)]
    if (folder / "sweep.json").is_file():
        rows = json.loads((folder / "sweep.json").read_text(encoding="utf-8"))
        if failed := [row for row in rows if row["status"] not in ("done", "cached")]:
            raise RuntimeError(f"{name}: {len(failed)} runs failed, the first: {failed[0]}")
        rows = [row | ran(folder / "runs" / str(row["run"])) for row in rows]
        return [{key: ",".join(map(str, v)) if isinstance(v, list) else v for key, v in row.items()} for row in rows]
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    row: dict[str, Any] = {}
    for stage in record["stages"]:
        row |= flat(stage["summary"], stage["id"])
    return [row | ran(folder)]


def ran(folder: Path) -> dict[str, float]:
    """What a run took: seconds, and megabytes of its files."""
    record = folder / "run.json"
    if not record.is_file():  # a sweep keeps one record
        return {}
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file() and file != record)
    return {"run.seconds": json.loads(record.read_text(encoding="utf-8"))["seconds"], "run.megabytes": size / 1e6}


def number_of(word: str) -> Any:
    """The number that a word of a CSV file is, or the word."""
    try:
        return float(word)
    except ValueError:
        return word


def wanted_columns(name: str) -> list[str]:
    """Columns that numbers and tables of a configuration take, and axes of its sweep."""
    document = document_of(name)
    notes = document["notes"]
    found = list(notes.get("keep", ()))
    sweep = document.get("sweep", {})
    found += list(sweep if isinstance(sweep, dict) else dict.fromkeys(key for row in sweep for key in row))
    for entry in notes.get("numbers", ()):
        found += [entry["column"], *entry.get("where", {}), *([entry["over"]] if "over" in entry else [])]
    for table in notes.get("tables", {}).values():
        for row in table["rows"]:
            if "from" not in row:
                found += [column_of(row, column) for column in table["columns"]] + list(row.get("where", {}))
        found += [column["over"] for column in table["columns"] if "over" in column]
        found += [key for column in table["columns"] for key in column.get("where", {})]
    return list(dict.fromkeys(found))


def run(name: str, folder: Path, rows: Sequence[int] | None = None, more: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Run a configuration, or only some rows of its sweep and without stages that cost much; its rows."""
    path = ROOT / "configs" / f"{name}.yaml"
    if rows is not None:
        document = document_of(name)
        notes = document.pop("notes")
        document.pop("after", None)
        document["folder"] = str(path.parent)
        without, wanted = set(notes.get("without", ())), wanted_columns(name)
        document["pipeline"] = [
            entry for entry in document["pipeline"]
            if entry.get("id", entry["stage"]) not in without and not only_drawn(entry, notes, wanted)
        ]  # fmt: skip
        if "sweep" in document:
            axes = list(document["sweep"]) if isinstance(document["sweep"], dict) else list(document["sweep"][0])
            document["sweep"] = [{axis: axis_value(stored(name).rows[n][axis]) for axis in axes} for n in rows]
        path = folder / f"{path.stem}.yaml"
        with path.open("w", encoding="utf-8") as file:
            YAML(typ="safe").dump(document, file)
    output = folder / "run"
    words = ["run", str(path), "-q", "-o", str(output), "--audit", "warn", "--no-cache", "--trust", *more]
    for key, value in (notes_of(name).get("cheap_params", {}) if rows is not None else {}).items():
        words += ["-p", f"{key}={value}"]
    if rows is None:
        subprocess.run([sys.executable, "-m", "sppm_pipeline", *words], check=True, cwd=ROOT)
    else:  # in this process, as libraries take a second to load
        from sppm_pipeline.engine.cli.main import main as sppm

        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            code = sppm(words)
        if code:
            raise RuntimeError(f"{name}: sppm run ended with {code}:\n{said.getvalue()}")
    return rows_of(name, output)


def only_drawn(entry: Mapping[str, Any], notes: Mapping[str, Any], wanted: Iterable[str]) -> bool:
    """True of a stage that writes something of which no number is stored."""
    numbers = any(column.startswith(f"{entry.get('id', entry['stage'])}.") for column in wanted)
    return entry["stage"].startswith("write.") and not numbers and entry.get("path") != notes.get("table", "")


def axis_value(value: Any) -> Any:
    """The value of an axis of a sweep, of which lists are stored as text."""
    return [int(word) for word in value.split(",")] if isinstance(value, str) and "," in value else value


def store(name: str, more: Sequence[str]) -> None:
    """Run a configuration; keep the numbers and pictures that are shown."""
    from resource import RUSAGE_CHILDREN, getrusage

    sys.path.insert(0, str(ROOT / "docs"))
    from generate_gallery import reduced  # the same colors and sizes

    before = getrusage(RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as scratch:
        rows = run(name, Path(scratch), more=more)
        used = getrusage(RUSAGE_CHILDREN)
        for panel in notes_of(name).get("panels", ()):
            PICTURES.mkdir(parents=True, exist_ok=True)
            data = Path(scratch, "run", panel["file"] if isinstance(panel, dict) else panel).read_bytes()
            (PICTURES / picture_of(name, panel)).write_bytes(reduced(data))
    columns = wanted_columns(name)
    if missing := [column for column in columns if all(column not in row for row in rows)]:
        raise RuntimeError(f"{name}: no run has a column {missing[0]!r}; there are {sorted(rows[0])}")
    document = {
        "recipe": recipe_of(name),
        "seconds": round(used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime, 1),
        "rows": [{key: significant(row[key]) for key in columns if row.get(key) is not None} for row in rows],
    }
    RESULTS.mkdir(exist_ok=True)
    text = json.dumps(document, indent=1).replace("\n   ", " ").replace("{ ", "{").replace("\n  }", "}")
    file_of(name).write_text(text + "\n", encoding="utf-8")


def picture_of(name: str, panel: Any) -> str:
    """Name of a picture in the folder of the page."""
    file = panel["file"] if isinstance(panel, dict) else panel
    return f"{name.rpartition('/')[2]}-{Path(file).parent.name + '-' if '/' in file else ''}{Path(file).stem}.png"


def significant(value: Any) -> Any:
    """A number with six significant digits."""
    return float(f"{value:.6g}") if isinstance(value, float) and math.isfinite(value) else value


# numbers


def rows_where(rows: Sequence[Mapping[str, Any]], where: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Rows in which columns have given values."""

    def fits(value: Any, wanted: Any) -> bool:
        if isinstance(wanted, str) and wanted.endswith("*"):
            return str(value).startswith(wanted[:-1])
        return bool(value == wanted)

    return [row for row in rows if all(fits(row.get(key), v) for key, v in where.items())]


def chosen(rows: Sequence[Mapping[str, Any]], column: str, where: Mapping[str, Any]) -> list[float]:
    """Values of a column in the rows where others have given values."""
    found = [row[column] for row in rows_where(rows, where) if column in row]
    if not found:
        raise ValueError(f"no row has {column!r} where {dict(where)}")
    return [float(value) for value in found]


class Measured(NamedTuple):
    """A number with its standard error, None of a single draw or of what is no mean."""

    value: float
    error: float | None
    draws: int


def measured(rows: Sequence[Mapping[str, Any]], entry: Mapping[str, Any]) -> Measured:
    """A number of the notes."""
    values = chosen(rows, entry["column"], entry.get("where", {}))
    n, take = len(values), entry.get("take", "mean")
    if take == "mean reciprocal":
        every = [row.get(entry["column"], math.inf) for row in rows_where(rows, entry["where"])]
        return measured([{"inverse": 1 / value} for value in every], {"column": "inverse"})
    mean = math.fsum(values) / n
    deviation = math.sqrt(math.fsum((v - mean) ** 2 for v in values) / (n - 1)) if n > 1 else 0.0
    if take in ("exponent", "size for 5 %"):
        return fall_of_spread(rows, entry, n)
    if "over" in entry and take not in ("largest from mean", "squared correlation"):
        below = chosen(rows, entry["over"], entry.get("where", {}))
        ratios = [{"ratio": a / b} for a, b in zip(values, below, strict=True)]
        return measured(ratios, {"column": "ratio", "take": take})
    if take == "mean":
        return Measured(mean, deviation / math.sqrt(n) if n > 1 else None, n)
    if take == "largest from mean":
        return Measured(max(map(abs, from_means(rows, entry))), None, n)
    if take == "squared correlation":
        return Measured(squared_correlation(rows, entry), None, n)
    single = {"least": min(values), "largest": max(values), "deviation": deviation}
    return Measured(single[take] if take in single else deviation / abs(mean), None, n)


def fall_of_spread(rows: Sequence[Mapping[str, Any]], entry: Mapping[str, Any], draws: int) -> Measured:
    """The exponent with which the relative deviation falls with the volume, or the edge at which it is 0.05.

    A straight line through the logarithms, each weighted by its draws: that of a deviation of n draws has the variance
    1 / (2 n - 2), whence the error of the exponent.
    """
    where = entry.get("where", {})
    points = []
    for edge in sorted({row[entry["over"]] for row in rows if all(row.get(k) == v for k, v in where.items())}):
        values = chosen(rows, entry["column"], {**where, entry["over"]: edge})
        if len(values) > 1:
            mean = math.fsum(values) / len(values)
            spread = math.sqrt(math.fsum((v - mean) ** 2 for v in values) / (len(values) - 1)) / abs(mean)
            points.append((3 * math.log(edge), math.log(spread), 2.0 * (len(values) - 1)))
    weight = math.fsum(w for _, _, w in points)
    x, y = (math.fsum(point[a] * point[2] for point in points) / weight for a in (0, 1))
    xx = math.fsum(w * (a - x) ** 2 for a, _, w in points)
    slope = math.fsum(w * (a - x) * (b - y) for a, b, w in points) / xx
    if entry["take"] == "exponent":
        return Measured(-slope, 1 / math.sqrt(xx), draws)
    return Measured(math.exp((x + (math.log(0.05) - y) / slope) / 3), None, draws)


def from_means(rows: Sequence[Mapping[str, Any]], entry: Mapping[str, Any]) -> list[float]:
    """Differences of a column's values from the mean of those with the same value of the column `over`."""
    found = []
    for place in sorted({row[entry["over"]] for row in rows}):
        values = chosen(rows, entry["column"], {entry["over"]: place})
        found += [value - math.fsum(values) / len(values) for value in values]
    return found


def squared_correlation(rows: Sequence[Mapping[str, Any]], entry: Mapping[str, Any]) -> float:
    """R² of the line through the means of a column over another."""
    places = sorted({row[entry["over"]] for row in rows})
    means = []
    for place in places:
        values = chosen(rows, entry["column"], {entry["over"]: place})
        means.append(math.fsum(values) / len(values))
    x, y = (math.fsum(numbers) / len(places) for numbers in (places, means))
    xy = math.fsum((a - x) * (b - y) for a, b in zip(places, means, strict=True))
    xx, yy = (math.fsum((v - m) ** 2 for v in values) for values, m in ((places, x), (means, y)))
    return xy**2 / (xx * yy)


def agreement(found: Measured, entry: Mapping[str, Any]) -> str:
    """Whether a number agrees with the paper's; empty if the paper has none."""
    if "paper" not in entry:
        return ""
    ends = entry["paper"] if isinstance(entry["paper"], list) else [entry["paper"]] * 2
    room = entry["within"]
    low, high = ends[0] - abs(ends[0]) * room, ends[1] + abs(ends[1]) * room
    return "yes" if low <= found.value <= high else "**no**"


def text_of(found: Measured, digits: int = 3) -> str:
    """A number as it is printed: as many decimals as the error has digits, two."""
    if found.error is None or found.error == 0:
        whole = float(found.value).is_integer() and abs(found.value) < 1e6
        return f"{found.value:.0f}" if whole else f"{found.value:.{digits}g}"
    decimals = max(0, 1 - math.floor(math.log10(found.error)))
    decimals = min(decimals, 5)
    return f"{found.value:.{decimals}f} ± {found.error:.{decimals}f}"


# pages


def page() -> str:
    """The page of the paper."""
    minutes = sum(stored(name).seconds for name in PAPER) / 60
    lines = [HEAD.format(notice=NOTICE, minutes=f"{minutes:.0f}")]
    for name in PAPER:
        lines += section(name)
    lines += ["Further measurements are in [`benchmarks/`](../../benchmarks/README.md).", ""]
    return "\n".join(lines)


def section(name: str) -> list[str]:
    """The lines of one figure or table."""
    notes = notes_of(name)
    lines = [f"## {notes['figure']}: {notes['title']}", ""]
    found = stored(name)
    for panel in notes.get("panels", ()):
        says = panel["says"] if isinstance(panel, dict) else Path(panel).stem.replace("_", " ")
        lines.append(f"![{says}](../pictures/paper/{picture_of(name, panel)})")
    lines += ["", f"The paper: {notes['paper']}.", "", f"`sppm run {command_of(name)}`", ""]
    if "numbers" in notes:
        lines += ["| | here | the paper | within | agrees |", "|---|---|---|---|---|"]
        for entry in notes["numbers"]:
            got = measured(found.rows, entry)
            paper, within = entry.get("paper", ""), entry.get("within")
            said = " to ".join(f"{v:g}" for v in paper) if isinstance(paper, list) else str(paper)
            of = f" ({got.draws} draws)" if got.draws > 1 else ""
            room = "" if within is None else f"{within:.3g}" if within == 0 else f"{100 * within:.3g} %"
            lines.append(f"| {entry['says']}{of} | {text_of(got)} | {said} | {room} | {agreement(got, entry)} |")
        lines.append("")
    for table in notes.get("tables", {}).values():
        lines += [table_text(name, table).strip(), ""]
    if "differs" in notes:
        lines += [notes["differs"].strip(), ""]
    return lines


def command_of(name: str) -> str:
    """How a configuration is named after ``sppm run``."""
    return f"configs/{name}.yaml" if "/" in name else name


def column_of(row: Mapping[str, Any], column: Mapping[str, Any]) -> str:
    """The column of the runs that a cell of a table takes."""
    return ".".join(part for part in (row.get("of", ""), column["column"]) if part)


def table_text(name: str, table: Mapping[str, Any]) -> str:
    """A table of results as Markdown, and where it is from."""
    columns = table["columns"]
    lines = ["", f"| {table.get('corner', '')} | " + " | ".join(column["head"] for column in columns) + " |"]
    lines.append("|" + "---|" * (len(columns) + 1))
    draws: set[int] = set()
    for row in table["rows"]:
        cells, rows = [], stored(row.get("from", name)).rows
        for column in columns:
            where = {**row.get("where", {}), **column.get("where", {})}
            entry = {**column, "column": column_of(row, column), "where": where}
            entry |= {"take": row["take"]} if "take" in row else {}
            try:
                found = measured(rows, entry)
            except ValueError:
                cells.append("")
                continue
            draws.add(found.draws)
            found = found._replace(error=None) if column.get("plain") else found
            cells.append(text_of(found, column.get("digits", 3)))
        lines.append(f"| {row['head']} | " + " | ".join(cells) + " |")
    most = max(draws)
    several = " to ".join(map(str, dict.fromkeys((min(draws), most))))
    many = f"means of {several} draws ± standard error"
    said = many if most > 1 else "one draw"
    lines += ["", f"[`{Path(name).name}.yaml`](../../configs/{name}.yaml), {said}.", ""]
    return "\n".join(lines)


def all_tables() -> dict[str, str]:
    """Text of every table by the name in its mark."""
    found = {}
    for name in RUN:
        for key, table in notes_of(name).get("tables", {}).items():
            found[key] = table_text(name, table)
    return found


def written_pages() -> dict[Path, str]:
    """Text of all pages that hold results."""
    tables, found = all_tables(), {PAGE: page()}
    used = set()
    for path in sorted((ROOT / "docs").rglob("*.md")):
        text = path.read_text(encoding="utf-8")
        if "<!-- results: " in text and path != PAGE:
            used |= {match[2] for match in MARK.finditer(text)}
            found[path] = MARK.sub(lambda match: match[1] + tables[match[2]] + match[4], text)
    own = {key for name in PAPER for key in notes_of(name).get("tables", {})}
    if unused := set(tables) - used - own:
        raise ValueError(f"no page shows the table {sorted(unused)[0]!r}")
    return found


def stale() -> list[str]:
    """What differs from the configurations and the stored numbers."""
    old = [f"docs/results/{file_of(name).name}" for name in RUN if stored(name).recipe != recipe_of(name)]
    pages = [path for path, text in written_pages().items() if path.read_text(encoding="utf-8") != text]
    return old + [path.relative_to(ROOT).as_posix() for path in pages]


def differences(name: str, folder: Path) -> list[str]:
    """Compute the cheap rows of a configuration again; what differs from the stored numbers."""
    cheap = notes_of(name)["cheap"]
    kept = stored(name).rows
    old = kept if cheap == "all" else [kept[n] for n in cheap]
    try:
        new = run(name, folder, range(len(kept)) if cheap == "all" else cheap)
    except RuntimeError as error:
        return [str(error)]
    found = []
    for n, (before, after) in enumerate(zip(old, new, strict=False)):
        shared = [key for key in before if key in after and not key.startswith("run.")]
        if not any(isinstance(before[key], float | int) for key in shared):
            found.append(f"{name}, row {n}: nothing to compare")
        for key in shared:
            a, b = before[key], after[key]
            if isinstance(a, float | int) and isinstance(b, float | int):
                same = abs(a - b) <= RELATIVE * abs(a) + 1e-9
            else:
                same = a == (",".join(map(str, b)) if isinstance(b, list) else b)
            if not same:
                found.append(f"{name}, row {n}: {key} is {b}, {a} is stored")
    return found if len(new) >= len(old) else [*found, f"{name}: {len(new)} rows in place of {len(old)}"]


def main() -> int:
    """Run what is asked for, and write the pages."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only list what is stale")
    parser.add_argument("--run", nargs="*", metavar="NAME", help="run configurations first: all, or these")
    parser.add_argument("--mesh", type=Path, metavar="FILE", help="closed mesh for the configurations that need one")
    parser.add_argument("--recompute", nargs="*", metavar="NAME", help="compute cheap rows again and compare")
    arguments = parser.parse_args()
    if arguments.run is not None:
        for name in arguments.run or (*PAPER, *OTHERS):
            begun = time.monotonic()
            if (needed := notes_of(name).get("needs")) and arguments.mesh is None:
                print(f"{name}: left out, needs --{needed}")
                continue
            store(name, ["-p", f"{needed}={arguments.mesh.resolve()}"] if needed else [])
            print(f"{name}: {time.monotonic() - begun:.0f} s", flush=True)
    if arguments.recompute is not None:
        found = []
        for name in arguments.recompute or [n for n in RUN if "cheap" in notes_of(n)]:
            with tempfile.TemporaryDirectory() as scratch:
                found += differences(name, Path(scratch))
        print("\n".join(found) or "all numbers are as stored")
        return 1 if found else 0
    if arguments.check:
        old = stale()
        print("\n".join(old) or "all is up to date")
        return 1 if old else 0
    if missing := [name for name in RUN if not file_of(name).is_file()]:
        print(f"nothing is written, as there are no numbers of {', '.join(missing)}")
        return 1
    for path, text in written_pages().items():
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
