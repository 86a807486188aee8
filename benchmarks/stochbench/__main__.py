"""``python -m benchmarks.stochbench``: run tools on tasks and print a table."""

from __future__ import annotations

import argparse
import importlib.util
import json
import time
import warnings
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

from benchmarks.measure import between_marks

HERE = Path(__file__).parent
MARK = "<!-- python -m benchmarks.stochbench --write -->"


def load(path: Path) -> ModuleType:
    """A tool or a checker, by its file."""
    spec = importlib.util.spec_from_file_location(f"stochbench_{path.parent.name}_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def tools() -> dict[str, ModuleType]:
    """Tools whose modules are installed, by name."""
    found = {path.stem: load(path) for path in sorted((HERE / "tools").glob("*.py"))}
    return {
        name: tool for name, tool in found.items() if all(map(importlib.util.find_spec, getattr(tool, "NEEDS", ())))
    }


def tasks() -> dict[str, Path]:
    """Folders of tasks, by name."""
    return {path.parent.name: path.parent for path in sorted(HERE.glob("*/task.json"))}


def asked(folder: Path) -> tuple[str, dict[str, Any]]:
    """The function of a tool that a task calls, and what the task says."""
    task = json.loads((folder / "task.json").read_text(encoding="utf-8"))
    return task.get("asks", "make"), task


def run(tool: ModuleType, folder: Path) -> dict[str, Any]:
    """The numbers of a tool in a task, and the seconds that it took to make the cells."""
    name, task = asked(folder)
    check, truth = load(folder / "check.py"), task["truth"]
    given = [
        {**one, "scan": check.scans.scan(**one["scan"], radius=truth["radius"], balls=truth["balls"])}
        if "scan" in one else one for one in task["inputs"]
    ]  # fmt: skip
    began = time.process_time()
    cells = [getattr(tool, name)(**one) for one in given]
    seconds = time.process_time() - began
    for cell, one in zip(cells, task["inputs"], strict=True):
        n = one.get("n") or one["scan"]["n"]
        if cell.shape != (n,) * 3 or cell.dtype != bool:
            raise ValueError(f"a cell of {one} is {cell.shape} {cell.dtype}, and must be ({n},)*3 bool")
    return {**check.check(cells, task["inputs"], truth), "CPU s": round(seconds, 1)}


def as_table(task: str, rows: dict[str, dict[str, Any]]) -> str:
    """The numbers of all tools in a task; a tool that needs other programs with their versions."""
    heads = list(next(iter(rows.values())))
    lines = [f"\n{task}\n", f"| tool | {' | '.join(heads)} |", f"|---|{'---|' * len(heads)}"]
    for tool, row in rows.items():
        needs = [f"{one} {metadata.version(one)}" for one in getattr(load(HERE / "tools" / f"{tool}.py"), "NEEDS", ())]
        shown = (f"{value:.4g}" if isinstance(value, float) else str(value) for value in row.values())
        lines.append(f"| {' of '.join([f'`{tool}`', *needs])} | {' | '.join(shown)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tool", action="append", choices=list(tools()))
    parser.add_argument("--task", action="append", choices=list(tasks()))
    parser.add_argument("--write", action="store_true", help="put the tables into README.md")
    args = parser.parse_args()
    warnings.simplefilter("ignore")  # a tool may say what it had to change to reach a porosity
    text = ""
    for name, folder in tasks().items():
        if args.task and name not in args.task:
            continue
        able = {tool: module for tool, module in tools().items() if hasattr(module, asked(folder)[0])}
        rows = {tool: run(module, folder) for tool, module in able.items() if not args.tool or tool in args.tool}
        if not rows:
            continue
        table = as_table(name, rows)
        print(table, flush=True)
        text += table
    if args.write:
        between_marks(HERE / "README.md", MARK, text)


if __name__ == "__main__":
    main()
