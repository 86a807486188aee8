"""Measure what stages cost for each unit of their size, and write the table that `sppm estimate` uses.

    python -m benchmarks.rates [NAME ...]     # all pipelines, or some; of the others what was measured last counts
    python -m benchmarks.rates --fit          # fit again what was measured

Each pipeline runs in several sizes in one process, the smallest first, to load libraries and compiled kernels. The
seconds of a stage are processor time on one thread, without those of its recipe; its memory is the peak that the kernel
reports from its start on, child processes included. A non-negative least-squares fit of relative errors turns them into
rates. Rates of stages of plugins are measured in the same way once a pipeline has them.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
ROWS = ROOT / "runs" / "rates"
"""What was measured, a file a pipeline."""

CELL = """
  - {stage: sample.mirrored_faces, edge: 2, total: $n, share: 0.5}
  - {stage: sample.dart_throwing, total: $n}
  - {stage: connect.mbdst, degree: [3, 5], mode: $mode}
  - {stage: field.gaussian, omega: $omega, mu: $omega, level: 0.25}
"""
TILES = """
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: $n, share: 0.5}
    - {stage: sample.dart_throwing, total: $n}
    - {stage: connect.mbdst, mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.12, tunnel_radius: 0.04}
pipeline:
"""
SIZES = {"n": (42, 42, 70, 100), "omega": (20, 20, 25, 30), "mode": ("greedy",) * 4}
ONE_CELL = {"n": (42,) * 5, "omega": (20,) * 5, "mode": ("greedy",) * 5}
"""Pores, parameters and modes; the first run warms up and is not counted."""

PIPELINES: dict[str, tuple[str, dict[str, tuple[Any, ...]]]] = {
    **{
        f"connect {mode}": (
            "pipeline:" + CELL,
            {"n": (42, 30, 66, 110), "omega": (20, 20, 30, 30), "mode": (mode,) * 4},
        )
        for mode in ("greedy", "lp_fix", "exact")
    },
    "neighbors": (
        """pipeline:
  - {stage: sample.dart_throwing, total: $n}
  - {stage: connect.relative_neighbors}
""",
        {"n": (100, 100, 1000, 3000)},
    ),
    "samplers": (
        """pipeline:
  - {stage: sample.elimination, count: $n}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.1, tunnel_radius: 0.03}
""",
        SIZES,
    ),
    "hyperuniform": (
        """pipeline:
  - {stage: sample.hyperuniform, count: $n, stealth: 0.5, spacing: 0.1}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.1, tunnel_radius: 0.03}
""",
        SIZES,
    ),
    "walls": (
        """pipeline:
  - {stage: sample.dart_throwing, total: $n}
  - {stage: connect.mst}
  - {stage: field.walls}
""",
        {"n": (100, 100, 1000, 5000)},
    ),
    "checks": (
        "pipeline:" + CELL + """
  - {stage: check.porosity, resolution: $r}
  - {stage: check.connectivity, resolution: $r}
  - {stage: check.sizes, resolution: $r}
  - {stage: write.graph}
  - {stage: write.network, resolution: $r, cell: 5 mm}
  - {stage: write.picture, resolution: $r, image_size: [$p, $p]}
  - {stage: extract.phases, resolution: $r, coating: 0.05, filling: true}
  - {stage: extract.voxels, resolution: $r}
  - {stage: write.npy}
  - {stage: write.tiff}
  - {stage: write.vti}
""",
        {**SIZES, "r": (32, 32, 64, 100), "p": (300, 300, 700, 1200)},
    ),
    "meshes": (
        "pipeline:" + CELL + """
  - {stage: extract.marching_cubes, resolution: $r}
  - {stage: check.mesh}
  - {stage: write.stl}
  - {stage: write.ply}
  - {stage: write.obj}
  - {stage: write.off}
  - {stage: write.glb}
  - {stage: write.glb, id: smooth, path: smooth.glb, normals: true}
  - {stage: write.3mf}
  - {stage: write.picture, resolution: $r}
  - {stage: read.mesh, path: $mesh}
""",
        {**SIZES, "r": (24, 24, 40, 64), "mesh": ("mesh.stl",) * 4},
    ),
    "level set": (
        "pipeline:" + CELL + "  - {stage: extract.manifold_sdf, resolution: $r}\n",
        {**SIZES, "r": (12, 12, 16, 24)},
    ),
    "tetrahedra": (
        "pipeline:" + CELL + """
  - {stage: mesh.isosurface_stuffing, resolution: $r, order: $order}
  - {stage: write.vtu}
  - {stage: write.inp}
  - {stage: write.msh}
  - {stage: mesh.boundary}
""",
        {**ONE_CELL, "r": (12, 12, 20, 28, 16), "order": (1, 1, 1, 1, 2)},
    ),
    "stiffness of tetrahedra": (
        "pipeline:" + CELL + """
  - {stage: mesh.isosurface_stuffing, resolution: $r, order: $order}
  - {stage: homogenize.tet}
""",
        {**ONE_CELL, "r": (8, 8, 12, 16, 10), "order": (1, 1, 1, 1, 2)},
    ),
    "homogenization": (
        "pipeline:" + CELL + """
  - {stage: homogenize.voxel, resolution: $r}
  - {stage: write.stiffness, image_size: [$p, $p]}
  - {stage: homogenize.conductivity, resolution: $r}
""",
        {**SIZES, "r": (16, 24, 32, 64), "p": (300, 300, 600, 900)},
    ),
    "flow": (
        "pipeline:" + CELL + """
  - {stage: homogenize.permeability, resolution: $r}
  - {stage: write.flow, image_size: [$p, $p]}
  - {stage: homogenize.acoustics, resolution: $r, cell: 5 mm}
  - {stage: write.absorption}
""",
        {**SIZES, "r": (16, 16, 24, 40), "p": (300, 300, 600, 900)},
    ),
    "tuning": (
        "recipes:\n  cell:" + CELL + """pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.55, resolution: $r}
  - {stage: tune.porosity, id: counted, recipe: cell, target: 0.55, resolution: $r, fit_count: true}
  - {stage: tune.retry, recipe: cell}
  - {stage: tune.stiffness, recipe: cell, target: 0.25, resolution: $h, vary: field.gaussian.level, low: 0.1, high: 0.6,
     accuracy: 0.1}
  - {stage: homogenize.realizations, recipe: cell, resolution: $h, draws: 2}
  - {stage: write.chart, x: cells, y: E_x}
  - {stage: write.table, columns: [cells, E_x]}
  - {stage: write.bars, label: sample, columns: [E_x]}
""",
        {**SIZES, "r": (16, 16, 24, 40), "h": (8, 12, 16, 24)},
    ),
    "property": (
        "recipes:\n  cell:" + CELL + """  - {stage: check.porosity, resolution: $r}
pipeline:
  - {stage: tune.property, recipe: cell, of: check.porosity.porosity, target: 0.5, vary: field.gaussian.level, low: 0.1,
     high: 0.6, accuracy: 0.4}
""",
        {**SIZES, "r": (8, 8, 12, 16)},
    ),
    "tile sets": (
        TILES + """
  - {stage: tileset.wang_3color, id: wang, recipe: cell, colors: $c, porosity: 0.6, resolution: $r, tolerance: 0.05}
  - {stage: write.picture, id: sheet, path: sheet.png, resolution: $r}
  - {stage: tile.wang_3color, cells: [$k, $k, $k], cell: 5 mm}
  - {stage: check.residual_periodicity}
  - {stage: check.porosity, resolution: 16}
  - {stage: write.picture, id: tiling, path: tiling.png, resolution: $r}
  - {stage: slice.field, resolution: $r}
  - {stage: write.png, sheet: $s}
  - {stage: slice.field, id: uneven, pixel: $pixel}
  - {stage: write.png, id: uneven_layers, path: uneven, from: uneven, sheet: 0}
  - {stage: tile.periodic, cells: [$k, $k, $k], cell: 5 mm, from: wang}
  - {stage: extract.unit_cell, resolution: $r}
  - {stage: write.3mf}
  - {stage: write.glb}
  - {stage: tileset.free_faces, recipe: cell, colors: 1, interiors: $k, porosity: 0.6, resolution: $r, tolerance: 0.05}
  - {stage: tile.free_faces, cells: [$k, $k, $k], cell: 5 mm}
  - {stage: slice.field, id: free, resolution: $r}
  - {stage: write.png, id: free_layers, path: free, from: free, sheet: 0}
  - {stage: tileset.corner_colors, recipe: cell, colors: 2, porosity: 0.6, resolution: $r, tolerance: 0.05}
  - {stage: tile.corner_colors, cells: [$k, $k, $k], cell: 5 mm}
  - {stage: tile.fresh, recipe: cell, cells: [$c, $c, $c], cell: 5 mm, porosity: 0.6, resolution: 16}
  - {stage: tile.scattered, recipe: cell, cells: [$c, $c, $c], cell: 5 mm, porosity: 0.6, resolution: 16}
""",
        {
            "n": (42, 42, 60, 72),
            "c": (1, 2, 2, 3),
            "r": (16, 16, 24, 32),
            "k": (2, 3, 4, 6),
            "s": (0, 0, 3, 6),
            "pixel": ("0.33 mm", "0.33 mm", "0.17 mm", "0.13 mm"),
        },
    ),
    "graded": (
        TILES + """
  - {stage: grade.table, of: porosity, along: x, values: [[0, 0.5], [30, 0.7]]}
  - {stage: tile.graded, recipe: cell, cells: [$c, $c, 1], cell: 5 mm, resolution: $r}
  - {stage: tune.local_porosity, resolution: $r}
  - {stage: check.local_porosity, resolution: $r}
""",
        {"n": (42, 42, 60, 72), "c": (1, 2, 3, 4), "r": (16, 24, 32, 40)},
    ),
    "fresh cells": (
        TILES + """
  - {stage: tile.fresh, recipe: cell, cells: [$c, $c, $c], cell: 5 mm, periodic: true}
  - {stage: tile.fresh, id: tuned, recipe: cell, cells: [$c, $c, $c], cell: 5 mm, periodic: true, porosity: 0.6,
     resolution: 16}
""",
        {"n": (42, 42, 60, 72), "c": (2, 4, 8, 12)},
    ),
    "maps": (
        TILES + """
  - {stage: read.primitive, shape: ball, size: [20, 20, 20], facets: $f}
  - {stage: grade.table, of: stress, along: x, values: [[-10, 0], [10, 40]]}
  - {stage: grade.distance, of: depth}
  - {stage: grade.formula, of: weight, formula: "smoothstep(2, 8, x) + 0*depth*stress"}
  - {stage: grade.stiffness, of: soft, wanted: stress, values: [[0.3, 9], [0.8, 1]]}
  - {stage: tileset.free_faces, id: one, recipe: cell, colors: 1, interiors: 2, resolution: 16}
  - {stage: tileset.free_faces, id: two, recipe: cell, colors: 1, interiors: 2, resolution: 16}
  - {stage: tileset.join, from: {first: one, second: two}}
  - {stage: tile.joined, cells: [$k, $k, 2], cell: 3 mm}
  - {stage: tile.free_faces, id: box, cells: [$k, $k, 2], cell: 3 mm, periodic: true}
  - {stage: field.blend, probes: $p, from: {first: box, second: box}}
  - {stage: warp.cylinder, inner_radius: 4 mm, from: box}
  - {stage: warp.sphere, inner_radius: 4 mm, from: box}
""",
        {"n": (42, 42, 60, 72), "f": (32, 32, 64, 128), "k": (2, 3, 6, 10), "p": (30000, 30000, 200000, 1000000)},
    ),
    "parts": (
        TILES + """
  - {stage: tileset.wang_3color, recipe: cell, porosity: 0.6, resolution: 16, tolerance: 0.05, colors: 2}
  - {stage: read.primitive, shape: torus_knot, size: [$k mm, $k mm, $k mm], facets: $f}
  - {stage: tile.wang_3color, cell: 4 mm}
  - {stage: fill.implicit}
  - {stage: write.view, grid_samples: $v}
  - {stage: slice.field, pixel: $pixel}
  - {stage: write.png}
  - {stage: write.picture, resolution: $r}
  - {stage: extract.marching_cubes, resolution: $r}
  - {stage: write.stl}
  - {stage: slice.mesh, pixel: $pixel}
  - {stage: write.png, id: mesh_layers, path: mesh_layers}
  - {stage: slice.field, id: even, resolution: $r, from: fill.implicit}
  - {stage: write.png, id: even_layers, path: even, from: even}
  - {stage: check.print, from: even}
""",
        {"n": (42, 42, 60, 72), "k": (8, 8, 12, 18), "f": (32, 32, 64, 96), "r": (16, 16, 24, 32),
         "v": (100_000, 100_000, 1_000_000, 3_500_000),
         "pixel": ("0.2 mm", "0.2 mm", "0.1 mm", "0.08 mm")},
    ),
    "repairs": (
        TILES + """
  - {stage: tileset.wang_3color, recipe: cell, porosity: 0.6, resolution: 16, tolerance: 0.05, colors: 2}
  - {stage: read.primitive, shape: box, size: [$k mm, $k mm, $h mm]}
  - {stage: tile.wang_3color, cell: 4 mm}
  - {stage: fill.implicit, skin: 0.6 mm}
  - {stage: fix.drains, most: 3}
  - {stage: fix.fill, voxel: $pixel}
  - {stage: tune.orientation}
""",
        {"n": (42, 42, 60, 72), "k": (8, 8, 12, 18), "h": (6, 6, 20, 12),
         "pixel": ("0.2 mm", "0.2 mm", "0.15 mm", "0.1 mm")},
    ),
    "booleans": (
        TILES + """
  - {stage: tileset.wang_3color, recipe: cell, porosity: 0.6, resolution: 16, tolerance: 0.05, colors: 2}
  - {stage: read.primitive, shape: ball, size: [$k mm, $k mm, $k mm], facets: $f}
  - {stage: tile.wang_3color, cell: 4 mm}
  - {stage: fill.boolean, resolution: $r, from: {field: tile.wang_3color, domain: read.primitive}}
  - {stage: read.primitive, id: tool, shape: cylinder, size: [2 mm, 2 mm, 30 mm]}
  - {stage: fill.combine, operation: difference, from: {mesh: fill.boolean, tool: tool}}
""",
        {"n": (42, 42, 60, 72), "k": (8, 8, 12, 12), "f": (32, 32, 64, 64), "r": (12, 16, 32, 48)},
    ),
    "crushing": (
        """recipes:
  cell:
    - {stage: sample.dart_throwing, total: $n}
    - {stage: connect.mst}
    - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.06}
  tuned:
    - {stage: tune.porosity, recipe: cell, target: 0.5, resolution: 24, tolerance: 0.01}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.6, resolution: 24, tolerance: 0.01}
  - {stage: crush.voxel, id: crush, resolution: $h, rate: 0.02, yield_stress: 0.02}
  - {stage: write.frames, from: crush, image_size: [$w, $w]}
  - {stage: tune.plateau, recipe: tuned, resolution: $h, rate: 0.02, yield_stress: 0.02, low: 0.4, high: 0.7, first: 3,
     target: 0.003, accuracy: 0.49}
""",
        {"n": (20, 20, 20, 20), "h": (8, 10, 16, 24), "w": (100, 200, 400, 300)},
    ),
    "curves": (
        """pipeline:
  - {stage: read.compression, path: test.csv, size: [45, 45, 45]}
  - {stage: measure.compression}
  - {stage: write.curves, measures: true}
""",
        {"unused": (1, 2, 3, 4)},
    ),
}  # fmt: skip

COUNTS = {"pores", "tunnels", "triangles", "copies", "tetrahedra", "nodes", "mid_nodes"}
UNITS = {
    "seconds": None,
    "memory": COUNTS | {"cells", "pixels", "resident"},
    "kept": COUNTS | {"cells", "voxels"},
    "disk": COUNTS | {"voxels", "outline", "layers", "pixels"},
}
"""Units that each column is fitted to; seconds to all but `resident`."""

FLOOR = {"seconds": 0.01, "memory": 2e6, "kept": 1e4, "disk": 200.0}
"""Errors below these do not matter."""


def measure(name: str, folder: Path) -> tuple[list[dict[str, Any]], float]:
    """Run a pipeline in all sizes; name, units and costs of each stage of each run but the first.

    Also the memory of the program with all libraries, before the first stage of the last run.
    """
    from sppm_pipeline.data.size import ONE
    from sppm_pipeline.engine.plan.estimate import estimate_steps
    from sppm_pipeline.engine.plan.session import RunRequest, open_session
    from sppm_pipeline.engine.run import runner, steps

    watch = Watch()
    watch.around(runner, steps)
    text, values = PIPELINES[name]
    rows = []
    for number, row in enumerate(zip(*values.values(), strict=True)):
        filled = text
        for key, value in sorted(zip(values, row, strict=True), key=lambda pair: -len(pair[0])):
            filled = filled.replace(f"${key}", str(value))
        if "mesh.stl" in filled:
            write_mesh(folder / "mesh.stl", 64 * 2**number)
        if "test.csv" in filled:
            write_readings(folder / "test.csv", 1000 * 8**number)
        path = folder / "pipeline.yaml"
        path.write_text("sppm: 1\nseed: 5\n" + filled, encoding="utf-8")
        plan = open_session(RunRequest(str(path), distributions=False)).plan()
        watch.found.clear()
        watch.base = 0.0
        record = runner.run_plan(plan, folder / "run", threads=1)
        disk = {stage["id"]: sum(o["bytes"] for o in stage.get("outputs", ())) for stage in record["stages"]}
        for found in estimate_steps(plan.steps, plan.recipes, ONE, 0.0, {}):
            if found.size is None:
                raise SystemExit(f"{name}: the size of {found.step.id} is unknown")
            if number:
                costs = {**watch.found[found.step.id], "disk": disk[found.step.id]}
                rows.append({"name": found.step.stage.rated_as, "units": found.size.units(), **costs})
    return rows, watch.base


def write_mesh(path: Path, segments: int) -> None:
    """A mesh to be read."""
    from sppm_pipeline.formats import stl
    from sppm_pipeline.numerics.domain.primitive_meshes import torus_mesh

    path.write_bytes(b"".join(stl.encode(*torus_mesh((0.0, 0.0, 0.0), 10.0, 4.0, segments, segments // 2))))


def write_readings(path: Path, count: int) -> None:
    """Readings of a test machine."""
    way = np.linspace(0, 25, count)
    force = np.interp(way, [0, 1, 20, 25], [0, 4000, 5000, 12000])
    rows = "".join(f"{f:.3f},{d:.4f}\n" for f, d in zip(force, way, strict=True))
    path.write_text(f"Force (N),Displacement (mm)\n{rows}", encoding="utf-8")


class Watch:
    """Measures each stage of a run that is no part of a recipe."""

    def __init__(self) -> None:
        self.found: dict[str, dict[str, float]] = {}
        self.base = 0.0
        self._inner: list[float] = []
        self._children = 0.0
        self._libc = ctypes.CDLL(None)
        threading.Thread(target=self._watch_children, daemon=True).start()

    def around(self, *modules: Any) -> None:
        """Measure what the function that runs a stage does, in all modules that call it."""
        run_step = modules[0].run_step

        def measured(step: Any, stage: Any, inputs: Any, *rest: Any) -> Any:
            outer = not self._inner
            if outer:
                gc.collect()
                self._libc.malloc_trim(0)
                Path("/proc/self/clear_refs").write_text("5")
                before, self._children = memory("VmRSS"), 0.0
                self.base = self.base or before
            self._inner.append(0.0)
            started = processor_time()
            made = run_step(step, stage, inputs, *rest)
            took = processor_time() - started
            own = took - self._inner.pop()
            if not outer:
                self._inner[-1] += took
                return made
            peak = memory("VmHWM") - before + self._children
            self.found[step.id] = {"seconds": own, "memory": peak, "kept": kept(made, inputs)}
            return made

        for module in modules:
            module.run_step = measured

    def _watch_children(self) -> None:
        while True:
            self._children = max(self._children, held_by_children("self"))
            time.sleep(0.01)


def held_by_children(process: str) -> float:
    """Bytes resident in all processes that descend from one."""
    total = 0.0
    try:
        for task in Path(f"/proc/{process}/task").iterdir():
            for child in (task / "children").read_text().split():
                pages = int(Path(f"/proc/{child}/statm").read_text().split()[1])
                total += pages * os.sysconf("SC_PAGE_SIZE") + held_by_children(child)
    except (OSError, IndexError):  # it has ended
        pass
    return total


def processor_time() -> float:
    """Seconds of this process and of the child processes that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def memory(what: str) -> float:
    """Bytes resident now, or at most since the last reset."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024.0 * next(int(line.split()[1]) for line in lines if line.startswith(what))


def kept(made: Any, inputs: dict[str, Any]) -> float:
    """Bytes of an artifact without those of artifacts that it refers to."""
    from sppm_pipeline.data.storage import NotStorable, stored_bytes
    from sppm_pipeline.fields.scalar_field import ScalarField
    from sppm_pipeline.fields.slice_stack import SliceStack

    if made is None or any(made is given for given in inputs.values()):
        return 0.0
    try:
        refers = isinstance(made, (ScalarField, SliceStack))
        others = [stored_bytes(given) for given in inputs.values() if given is not None and refers]
        return max(0.0, float(stored_bytes(made) - sum(others)))
    except NotStorable:
        return 0.0


def fitted(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Rates of one stage: each column over the units that it depends on."""
    from scipy.optimize import nnls

    table = {}
    for column, allowed in UNITS.items():
        present = sorted({unit for row in rows for unit in row["units"]} - {"resident" if allowed is None else ""})
        units = ["1", *(unit for unit in present if allowed is None or unit in allowed)]
        counts = np.array([[row["units"].get(unit, 0.0) if unit != "1" else 1.0 for unit in units] for row in rows])
        found = np.array([row[column] for row in rows])
        weight, scale = 1 / np.maximum(np.abs(found), FLOOR[column]), np.maximum(counts.max(0), 1e-300)
        rates, _ = nnls(counts / scale * weight[:, None], found * weight)
        table[column] = {u: float(f"{r:.3g}") for u, r in zip(units, rates / scale, strict=True) if r > 0}
    return table


def of_program(base: float) -> dict[str, dict[str, float]]:
    """The program itself: a run of next to nothing, and bytes of the program with its libraries."""
    with tempfile.TemporaryDirectory() as folder:
        records = []
        for count in (1, 5):
            path = Path(folder, "run.yaml")
            stage = "  - {stage: read.primitive, id: s%d, shape: box, size: [1 mm, 1 mm, 1 mm]}\n"
            path.write_text("sppm: 1\npipeline:\n" + "".join(stage % i for i in range(count)), encoding="utf-8")
            before = processor_time()
            subprocess.run([sys.executable, "-m", "sppm_pipeline.cli.main", "run", path, "-q", "--no-cache", "-o",
                            Path(folder, "out"), "--threads", "1"], check=True, stdout=subprocess.DEVNULL)  # fmt: skip
            records.append((processor_time() - before, Path(folder, "out", "run.json").stat().st_size))
    each = (records[1][1] - records[0][1]) / 4
    disk = {"1": round(records[0][1] - each), "stages": round(each)}
    memory = {"1": float(f"{base:.3g}")}
    return {"seconds": {"1": round(records[0][0], 2)}, "memory": memory, "kept": {}, "disk": disk}


def main(names: list[str]) -> None:
    """Measure in a process for each pipeline, fit, and write the table."""
    from sppm_pipeline.engine.plan.rates import TABLE

    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "SPPM_CACHE": "off"}
    if names[:1] == ["--measure"]:
        with tempfile.TemporaryDirectory() as folder:
            print(json.dumps(measure(names[1], Path(folder))))
        return
    ROWS.mkdir(parents=True, exist_ok=True)
    for name in () if names == ["--fit"] else names or PIPELINES:
        print(name, file=sys.stderr, flush=True)
        command = [sys.executable, "-m", "benchmarks.rates", "--measure", name]
        done = subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        (ROWS / f"{name}.json").write_text(done.stdout.splitlines()[-1])
    found = [json.loads(path.read_text()) for path in sorted(ROWS.iterdir())]
    by_name: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for rows, _ in found:
        for row in rows:
            by_name[row["name"]].append(row)
    table = {name: fitted(rows) for name, rows in by_name.items()}
    table["sppm"] = of_program(statistics.median(base for _, base in found))
    lines = [f"{json.dumps(name)}: {json.dumps(table[name])}" for name in sorted(table)]
    TABLE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
