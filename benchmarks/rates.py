"""Measure what stages cost for each unit of their size, and write the table that `sppm estimate` uses.

    python -m benchmarks.rates [NAME ...]     # all pipelines, or some; of other stages what the table says stays
    python -m benchmarks.rates --fit          # fit again what was measured

Each pipeline runs in several sizes in one process, the smallest first, to load libraries and compiled kernels. The
seconds of a stage are processor time on one thread, without those of its recipe; its memory is the peak that the kernel
reports from its start on, child processes included. A non-negative least-squares fit of relative errors turns them into
rates. Rates of stages of plugins are measured in the same way once a pipeline has them.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rate_pipelines import PIPELINES
from benchmarks.rate_watch import Watch, processor_time

ROOT = Path(__file__).resolve().parents[1]
ROWS = ROOT / "runs" / "rates"
"""What was measured, a file a pipeline."""


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
    from sppm_pipeline.engine.plan.estimate import estimate_steps
    from sppm_pipeline.engine.plan.session import RunRequest, open_session
    from sppm_pipeline.engine.run import runner, steps
    from sppm_pipeline.nouns.size import ONE

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
        if "mesh.vtu" in filled:
            write_hexahedra(folder / "mesh.vtu", 1 + number)
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
    from sppm_pipeline.method.part.primitive_meshes import torus_mesh
    from sppm_pipeline.services.formats import stl

    path.write_bytes(b"".join(stl.encode(*torus_mesh((0.0, 0.0, 0.0), 10.0, 4.0, segments, segments // 2))))


def write_hexahedra(path: Path, around: int) -> None:
    """A disk of hexahedra around a square core."""
    import meshio

    from sppm_pipeline.testing.hexahedral_meshes import o_grid

    points, elements = o_grid(4.0 * around, 2.0 * around, around, around, around, 4.0 * around)
    meshio.write(path, meshio.Mesh(points, [("hexahedron", elements)]))


def write_readings(path: Path, count: int) -> None:
    """Readings of a test machine."""
    way = np.linspace(0, 25, count)
    force = np.interp(way, [0, 1, 20, 25], [0, 4000, 5000, 12000])
    rows = "".join(f"{f:.3f},{d:.4f}\n" for f, d in zip(force, way, strict=True))
    path.write_text(f"Force (N),Displacement (mm)\n{rows}", encoding="utf-8")


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
            words = ["run", path, "-q", "--no-cache", "-o", Path(folder, "out"), "--threads", "1"]
            subprocess.run([sys.executable, "-m", "sppm_pipeline", *words], check=True, stdout=subprocess.DEVNULL)
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
    table = json.loads(TABLE.read_text(encoding="utf-8"))
    table |= {name: fitted(rows) for name, rows in by_name.items()}
    table["sppm"] = of_program(statistics.median(base for _, base in found))
    lines = [f"{json.dumps(name)}: {json.dumps(table[name])}" for name in sorted(table)]
    TABLE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
