"""``sppm find``: designs that meet conditions, by the atlas."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sppm_pipeline.features.design.atlas import FoundDesign


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument(
        "query", metavar="QUERY", help='conditions, such as "E_relative > 0.1, porosity = 0.7, strut > 0.3 mm"'
    )
    parser.add_argument("--cell", metavar="LENGTH", help="size of a cell, such as 4mm; lengths then are in mm")
    parser.add_argument("--count", type=int, default=5, metavar="N", help="designs that are shown at most (5)")
    order = parser.add_mutually_exclusive_group()
    for name, first in (("--minimize", "smallest"), ("--maximize", "largest")):
        order.add_argument(name, metavar="FORMULA", default="", help=f"order designs by a formula, the {first} first")
    more = "write a configuration for each design and a picture of all that fit"
    parser.add_argument("--output", type=Path, metavar="FOLDER", help=more)


def execute(args: Namespace) -> int:
    """Print the designs, and write what is asked for."""
    from sppm_pipeline.features.design.atlas import LENGTH_POWERS, PROPERTIES, searched

    found, all_ = searched(args.query, cell=args.cell, count=args.count, minimize=args.minimize, maximize=args.maximize)
    length = "mm" if args.cell else "cell"
    units = {0: "", 1: length, 2: f"{length}^2", -1: f"1/{length}"}
    for number, one in enumerate(found, 1):
        parameters = ", ".join(f"{name} {value:g}" for name, value in one.parameters.items())
        print(f"{number}. {one.family}: {parameters}, {one.total} pores a cell")
        for name in PROPERTIES:
            low, value, high = one.values[name]
            print(f"   {name:15} {value:10.4g}   {low:.4g} - {high:.4g} {units[LENGTH_POWERS[name]]}".rstrip())
    print(f"{len(all_['porosity'])} candidates meet the conditions; 90 % of cells lie in the bands")
    if args.output is not None:
        _write(args.output, args.query, found, all_)
    return 0


def _write(folder: Path, query: str, found: list[FoundDesign], candidates: Mapping[str, Any]) -> None:
    from sppm_pipeline.errors import InputError

    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise InputError(f"{folder} is no empty folder", hint="name another with --output")
    folder.mkdir(parents=True, exist_ok=True)
    for number, one in enumerate(found, 1):
        (folder / f"found_{number}.yaml").write_text(one.configuration(f"found_{number}"), encoding="utf-8")
    _draw(folder / "pareto.png", query, found, candidates)
    print(f"wrote {len(found)} configurations and pareto.png to {folder}")


def _draw(path: Path, query: str, found: list[FoundDesign], candidates: Mapping[str, Any]) -> None:
    """All candidates that meet the conditions, those that none beats in both properties, and the designs found."""
    import numpy as np

    from sppm_pipeline.features.design.atlas import PROPERTIES
    from sppm_pipeline.nouns.artifact import optional_module
    from sppm_pipeline.services.expression import names_in

    named = [name for name in PROPERTIES if name in names_in(query.replace(",", " "))]
    across, up = ([*named, *(name for name in ("E_relative", "permeability") if name not in named)])[:2]
    x, y = candidates[across], candidates[up]
    figure = optional_module("matplotlib.figure").Figure(figsize=(7, 6), layout="constrained")
    axes = figure.subplots()
    axes.loglog(x, y, ".", color="0.75", markersize=3, label="candidates that meet the conditions")
    order = np.argsort(-x, kind="stable")
    front = order[y[order] >= np.maximum.accumulate(y[order])]
    axes.step(x[front], y[front], where="post", color="0.3", label="none has more of both")
    for number, one in enumerate(found, 1):
        (x_low, x_, x_high), (y_low, y_, y_high) = one.values[across], one.values[up]
        bars = [[y_ - y_low], [y_high - y_]], [[x_ - x_low], [x_high - x_]]
        label = f"{number} {one.family}, {one.total} pores"
        axes.errorbar(x_, y_, *bars, fmt="o", markersize=10, capsize=2, label=label)
        axes.annotate(str(number), (x_, y_), color="white", fontsize=7, ha="center", va="center_baseline")
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)  # beside the points, which are close together
    figure.savefig(path, dpi=130)
