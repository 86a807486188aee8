"""The board: what a user waits for, in whole processes with nothing kept, all in one run.

    python -m benchmarks.board [NAMES ...] [--runs 3] [--scale] [--write]     # --write: into benchmarks/README.md
    python -m benchmarks.board --one 64 0.7 TOLD.json               # one cell's stiffness, in this process

Names choose rows that contain one of them; with --scale there are those of scale, minutes each, too.
`pip install muGrid` for the other solver of the stiffness.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import sppm_pipeline as sppm
from benchmarks.homogenization import PASSES, bandwidth
from benchmarks.measure import Run, between_marks, median, pipeline_command, run
from sppm_pipeline.features.stiffness.numerics.elasticity import stiffness
from sppm_pipeline.services.elastic.voigt import lame

ROOT = Path(__file__).parents[1]
PAGE, MARK = ROOT / "benchmarks" / "README.md", "<!-- benchmarks.board -->"
POROSITIES = (0.5, 0.7, 0.85)

RECIPE = """sppm: 1
seed: 2
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: 68, share: 0.6}
    - {stage: sample.dart_throwing, total: 68}
    - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.03}
pipeline:
"""
CELLS = "cells: [8, 8, 8], cell: 5 mm"
TILES = f"""  - {{stage: tileset.wang_3color, recipe: cell, porosity: 0.7}}
  - {{stage: tile.wang_3color, {CELLS}}}
"""
LAYERS = "  - {stage: slice.field, pixel: 0.05 mm}\n  - {stage: write.png, path: slices}\n"
VOXELS = 800**3
"""Those of the layers of a cube of 40 mm at 0.05 mm."""

BOXES = {
    "27 tiles": TILES,
    "fresh cells": f"  - {{stage: tile.fresh, recipe: cell, {CELLS}, porosity: 0.7}}\n",
    "scattered pores": f"  - {{stage: tile.scattered, recipe: cell, {CELLS}, porosity: 0.7}}\n",
    "scattered pores, porosity from 0.6 to 0.8": (
        "  - {stage: grade.table, of: porosity, values: [[0, 0.6], [40, 0.8]], along: x}\n"
        f"  - {{stage: tile.scattered, recipe: cell, {CELLS}}}\n"
    ),
}


SCALE_CELLS = 22
"""Along an edge of the largest cube: 2200 samples, 1.06e10 in all."""

SWEEP_ROWS = 11 * 909
"""Rows of the paper's figure of porosity over the number of pores, with so many seeds for each number."""


class Row(NamedTuple):
    """A line of the board."""

    what: str
    spent: Run
    unit: str  # of work: what a voxel takes, or how near it is to a limit


def rows(runs: int, names: list[str], scale: bool, scratch: Path) -> Iterator[Row]:
    """Measure all rows that are asked for, one by one."""

    def wanted(what: str) -> bool:
        return not names or any(name in what for name in names)

    def of_file(text: str) -> list[str]:
        path = scratch / "board.yaml"
        path.write_text(text, encoding="utf-8")
        return pipeline_command(path, scratch / "out")

    quickstart = pipeline_command(ROOT / "configs" / "quickstart.yaml", scratch / "out")
    if wanted(what := "quickstart, first run"):
        with tempfile.TemporaryDirectory() as empty:
            yield Row(what, run(["env", f"XDG_CACHE_HOME={empty}", *quickstart]), "kernels are compiled")
    if wanted(what := "quickstart, warm"):
        yield Row(what, median(quickstart, runs), "")
    for name, stages in BOXES.items():
        if wanted(what := f"layers of 40 mm at 0.05 mm, {name}"):
            spent = median(of_file(RECIPE + stages + LAYERS), runs)
            yield Row(what, spent, f"{1e9 * spent.cpu / VOXELS:.1f} ns a voxel")
    table = (ROOT / "configs" / "table_mesh_free.yaml").read_text(encoding="utf-8").split("\nsweep:")[0]
    units = table.replace("cells: [3, 3, 3]", "cells: [8, 8, 8]")
    ours = None
    if wanted(what := "512 units of 32^3, layers"):
        ours = median(of_file(units), runs)
        yield Row(what, ours, f"{1e9 * ours.cpu / (512 * 32**3):.0f} ns a voxel")
    if wanted(what := "512 units of 32^3, layers, a script with NumPy, SciPy and Pillow"):
        spent = median([sys.executable, "-m", "benchmarks.rivals.obvious_mesh_free", "8", str(scratch / "rival")], 1)
        yield Row(what, spent, f"{spent.cpu / ours.cpu:.0f} times ours" if ours else "")
    for kind in ("ply", "stl", "obj"):
        if wanted(what := f"512 units of 32^3, mesh, {kind.upper()}"):
            tail = (
                f"  - {{stage: extract.marching_cubes, resolution: 32}}\n  - {{stage: write.mesh, path: out.{kind}}}\n"
            )
            yield Row(what, median(of_file(units.split("  - {stage: slice.field")[0] + tail), runs), "")
    speed = bandwidth()
    for voxels in (64, 128, 256):
        for porosity in POROSITIES:
            if wanted(what := f"stiffness of a cell, {voxels}^3, porosity {porosity}"):
                told = scratch / "one.json"
                command = [sys.executable, "-m", "benchmarks.board", "--one", str(voxels), str(porosity), str(told)]
                spent = median(command, runs if voxels < 256 else 1)
                solver, iterations = json.loads(told.read_text(encoding="utf-8"))
                limit = iterations * voxels**3 * PASSES * 12 / speed
                yield Row(what, spent, f"solver {solver:.2g} s, {solver / limit:.1f} times what memory allows")
    if importlib.util.find_spec("muGrid") and wanted(what := "stiffness of a cell, 64^3, porosity 0.5, muGrid"):
        told = scratch / "one.json"
        command = [sys.executable, "-m", "benchmarks.board", "--one", "64", "0.5", str(told), "--mugrid"]
        yield Row(what, median(command, 1), "")

    if not scale:
        return
    for name in ("27 tiles", "scattered pores"):
        stages = BOXES[name].replace("[8, 8, 8]", f"[{SCALE_CELLS}, {SCALE_CELLS}, {SCALE_CELLS}]")
        spent = run(of_file(RECIPE + stages + LAYERS))
        each = 1e9 * spent.cpu / (100 * SCALE_CELLS) ** 3
        yield Row(f"layers of 110 mm at 0.05 mm, {name}", spent, f"{each:.2f} ns a voxel")
    sweep = (ROOT / "configs" / "porosity_map.yaml").read_text(encoding="utf-8").split("\nafter:")[0]
    spent = run(of_file(sweep.replace("to: 50", f"to: {SWEEP_ROWS // 11}").replace("resolution: 40", "resolution: 16")))
    yield Row(f"a sweep of {SWEEP_ROWS} rows", spent, f"{1e3 * spent.cpu / SWEEP_ROWS:.1f} ms a row")


def one(voxels: int, porosity: float, told: Path, mugrid: bool) -> None:
    """Solve for the stiffness of a cell of the paper's preset; writes processor seconds and iterations of all cases."""
    solid = np.ascontiguousarray(sppm.cell("paper", porosity=porosity, seed=1).voxels(voxels).values > 0, np.float32)
    lam, mu = lame(solid, np.float32(0.3))
    started = time.process_time()
    if mugrid:
        from benchmarks.rivals.mugrid_homogenization import mugrid_stiffness

        mugrid_stiffness(np.asfortranarray(lam.T, np.float64), np.asfortranarray(mu.T, np.float64), 1e-6, np.float64)
        iterations = 0
    else:
        iterations = sum(case.iterations for case in stiffness(lam, mu).solved)
    told.write_text(json.dumps([time.process_time() - started, iterations]), encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--scale", action="store_true")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--one", nargs=3)
    parser.add_argument("--mugrid", action="store_true")
    args = parser.parse_args()
    if args.one:
        one(int(args.one[0]), float(args.one[1]), Path(args.one[2]), args.mugrid)
        return
    lines = ["| what | CPU s | s in all | peak MB | |", "|---|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as folder:
        for what, spent, unit in rows(args.runs, args.names, args.scale, Path(folder)):
            lines.append(f"| {what} | {spent.cpu:.2f} | {spent.wall:.2f} | {spent.peak:.0f} | {unit} |")
            print(lines[-1], flush=True)
    load = os.getloadavg()[0]
    lines += ["", f"Python {platform.python_version()}, {os.cpu_count()} cores, load {load:.1f} at the end."]
    if args.write:
        between_marks(PAGE, MARK, "\n".join(lines))


if __name__ == "__main__":
    main()
