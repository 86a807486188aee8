"""Errors of conductivity and permeability on voxels: cells at 32 and 64 voxels along the edge against fine grids.

    python -m benchmarks.transport_grids [KEPT.json]

The cells are 14 of the 20 of `benchmarks.partial_voxels`. Limits are those of 64 and 96 voxels (void of `stiff`, whose
walls are thin: 144 and 192), by the order of each stage (2 for conductivity, 2.25 for permeability). What was computed
is kept in KEPT.json, if that is given, so that a run that was stopped goes on where it was; all takes about ten minutes
of one core.
Needs the structures: pip install ./plugins/sppm-structures
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

import sppm_pipeline as sppm
from benchmarks.partial_voxels import CELLS, RECIPES
from sppm_pipeline.features.flow.stages.homogenize_conductivity import HomogenizeConductivity
from sppm_pipeline.features.flow.stages.homogenize_permeability import ORDER, HomogenizePermeability
from sppm_pipeline.testing.plain_context import PlainContext

ALL = (
    *(one for one in CELLS if one[0] in ("paper", "stiff", "wide") and one[2:] == (1, 0.0)),
    *(one for one in CELLS if one[:2] in (("gyroid", 0.3), ("gyroid", 0.7), ("openfoam", 0.7), ("spinodoid", 0.7))),
    ("paper", 0.5, 1, 1e-3),
)
KINDS = ("solid", "void", "both", "flow")


def solve(field: sppm.ScalarField, kind: str, filling: float, **options: Any) -> Any:
    """The report of a grid."""
    if kind == "flow":
        return HomogenizePermeability(**options).run(PlainContext(), field)
    fluid: dict[str, Any] = {"fluid": filling} if kind == "both" else {}
    return HomogenizeConductivity(of=kind, **fluid, **options).run(PlainContext(), field)


def limit_of(field: sppm.ScalarField, kind: str, filling: float, thin: bool) -> float:
    """The mean along the axes, extrapolated from 64 and 96 voxels, behind thin walls 144 and 192."""
    counts = (144, 192) if thin else (64, 96)
    coarse, fine = (np.trace(solve(field, kind, filling, resolution=n, grids=1).k) / 3 for n in counts)
    return float(fine + (fine - coarse) / ((counts[1] / counts[0]) ** (ORDER if kind == "flow" else 2) - 1))


def errors_of(field: sppm.ScalarField, kind: str, filling: float, count: int, limit: float) -> list[float]:
    """Percent: the error of the default, its bar, the error of one grid; and 1 if the default warns of the grid."""
    report = solve(field, kind, filling, resolution=count)
    one = solve(field, kind, filling, resolution=count, grids=1)
    values = (np.trace(report.k), 3 * limit + np.trace(report.error), np.trace(one.k))
    warned = any("resol" in text for text in report.warnings)
    return [*(100 * (float(value) / 3 / limit - 1) for value in values), float(warned)]


def main() -> None:
    """Print the errors of each cell, and of each kind those of all that have no warning."""
    kept = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    known: dict[str, Any] = json.loads(kept.read_text()) if kept and kept.is_file() else {}

    def keep(key: str, found: Any) -> Any:
        known[key] = found
        if kept:
            kept.write_text(json.dumps(known, indent=1))
        return found

    rows: dict[tuple[str, int], list[list[float]]] = {}
    print("| cell | of | voxels | error | error bar | one grid | warned |")
    print("|---" * 7 + "|")
    for name, porosity, seed, filling in ALL:
        field = sppm.tune.porosity(recipe=RECIPES[name], target=porosity, seed=seed)
        for kind in ("both",) if filling else ("solid", "void", "flow"):
            key = f"{name} {porosity} {seed} {filling:g} {kind}"
            limit = known.get(key) or keep(key, limit_of(field, kind, filling, name == "stiff" and kind == "void"))
            for count in (32, 64):
                name_of = f"{key} {count}"
                row = known.get(name_of) or keep(name_of, errors_of(field, kind, filling, count, limit))
                rows.setdefault((kind, count), []).append(row)
                error, bar, one, warned = row
                words = f"{error:+.1f} | {bar:.1f} | {one:+.1f} | {'yes' if warned else ''}"
                print(f"| {key} | {count} | {words} |", flush=True)
    for (kind, count), found in sorted(rows.items(), key=lambda one: (KINDS.index(one[0][0]), one[0][1])):
        table = np.array(found)
        sure = table[table[:, 3] == 0]
        error, bar, one = np.abs(sure[:, :3]).T
        covered = int((np.abs(table[:, 0]) <= table[:, 1]).sum())
        print(f"{kind}, {count} voxels, {len(table)} cells, {len(table) - len(sure)} warned; of the others: ", end="")
        print(f"default {error.mean():.1f} {error.max():.1f}, one grid {one.mean():.1f} {one.max():.1f}; ", end="")
        print(f"{int((error <= 3).sum())} within 3, ", end="")
        print(f"{int((error <= 1).sum())} within 1 %; bars {bar.mean():.1f} %, {covered} of {len(table)} cover")


if __name__ == "__main__":
    main()
