"""Run the example configurations and variants, and compare estimates with what they took.

    python tests/endurance/estimates.py [NAME ...]

Memory and disk have to be right within a factor of 2, the processor time within 3. It takes some minutes and is not
part of the test suite; tests/cli/test_estimate.py holds a short form.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parents[2]
KNOT = """sppm: 1
pipeline:
  - {stage: read.primitive, shape: torus_knot, size: [46 mm, 60 mm, 60 mm], facets: 200}
  - {stage: write.mesh, path: knot.ply}
"""
CELL = """sppm: 1
seed: 3
pipeline:
  - {stage: sample.mirrored_faces, edge: 2, total: 42, share: 0.6}
  - {stage: sample.dart_throwing, total: 42}
  - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
  - {stage: field.gaussian, omega: 20, mu: 20, level: 0.25}
"""
OWN = {
    "homogenization": """
  - {stage: homogenize.voxel, resolution: 64}
  - {stage: write.stiffness}
  - {stage: homogenize.conductivity, resolution: 64}
  - {stage: extract.voxels, resolution: 64}
  - {stage: write.voxels, id: npy, path: voxels.npy}
  - {stage: write.voxels, id: tiff, path: voxels.tiff}
  - {stage: write.voxels, id: vti, path: voxels.vti}
  - {stage: check.sizes}
""",
    "boolean": """
  - {stage: read.primitive, shape: ball, size: [12 mm, 12 mm, 12 mm], facets: 60}
  - {stage: tile.periodic, cell: 4 mm}
  - {stage: fill.boolean, resolution: 48}
  - {stage: check.mesh}
  - {stage: write.mesh, id: off, path: mesh.off}
  - {stage: write.mesh, id: glb, path: mesh.glb}
  - {stage: write.mesh, id: threemf, path: mesh.3mf}
  - {stage: slice.mesh, pixel: 0.05 mm}
  - {stage: write.png}
""",
    "tetrahedra": """
  - {stage: mesh.isosurface_stuffing, resolution: 24}
  - {stage: write.volume_mesh, id: vtu, path: mesh.vtu}
  - {stage: write.volume_mesh, id: inp, path: mesh.inp}
  - {stage: write.volume_mesh, id: msh, path: mesh.msh}
  - {stage: homogenize.tet}
""",
}
"""Configurations of our own, on one cell, for stages that no example has."""

CASES = {
    "quickstart": ["quickstart"],
    "quickstart small cells": ["quickstart", "-p", "cell=3 mm", "-p", "porosity=0.5"],
    "quickstart extract": ["quickstart", "-s", "part_picture.resolution=8"],
    "wang_part": ["wang_part"],
    "wang_part small cells": ["wang_part", "-p", "cell=3 mm", "-p", "porosity=0.5"],
    "cell": ["cell"],
    "tileset_27": ["tileset_27"],
    "table 3^3": ["table_mesh_free", "-p", "cells=[3, 3, 3]"],
    "table 8^3": ["table_mesh_free", "-p", "cells=[8, 8, 8]"],
    "table 8^3 at 64": ["table_mesh_free", "-p", "cells=[8, 8, 8]", "-s", "slice.field.resolution=64"],
    "porosity_map": ["porosity_map", "-p", "pores=66", "--seed", "1"],
    "periodic_vs_stochastic": ["periodic_vs_stochastic", "-p", "cells=[4, 4, 4]"],
    "bunny": ["bunny", "-p", "mesh=KNOT"],
    "bunny, coarse": ["bunny", "-p", "mesh=KNOT", "-p", "voxels=50"],
    "stiffness_map": ["stiffness_map", "-p", "porosity=0.5", "--seed", "1"],
    "representative_volume": ["representative_volume", "-p", "samples=2", "-p", "assemblies=[1, 2]"],
    **{name: [name] for name in OWN},
}


def sppm(*words: str) -> tuple[str, float]:
    """What was printed, and the most memory in bytes that the program and its child processes held together."""
    command = [sys.executable, "-m", "sppm_pipeline.engine.cli.main", *words, "--no-plugins"]
    most = 0.0
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = subprocess.Popen(command, stdout=out, stderr=err, text=True, cwd=ROOT)
        while process.poll() is None:
            most = max(most, held_by(process.pid))
            time.sleep(0.02)
        for file in (out, err):
            file.seek(0)
        if process.returncode:
            raise SystemExit(f"{' '.join(words)}: {err.read()}")
        return out.read(), most


def held_by(pid: int) -> float:
    """Bytes resident in a process and in all that descend from it."""
    held = 0.0
    with contextlib.suppress(psutil.NoSuchProcess):  # it has ended
        process = psutil.Process(pid)
        for one in (process, *process.children(recursive=True)):
            with contextlib.suppress(psutil.NoSuchProcess):
                held += one.memory_info().rss
    return held


def compare(words: list[str], folder: Path) -> dict[str, tuple[float, float]]:
    """Quantity -> (estimate, true)."""
    file = ROOT / "configs" / f"{words[0]}.yaml"
    if words[0] in OWN:
        file = folder / "own.yaml"
        file.write_text(CELL + OWN[words[0]].lstrip("\n"))
    words = [
        str(file),
        *(w.replace("KNOT", str(folder / "knot.ply")) for w in words[1:]),
    ]
    estimate = json.loads(sppm("estimate", *words, "--json")[0])
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    printed, held = sppm("run", *words, "-q", "--no-cache", "--threads", "1", "-o", str(folder / "run"), "--json")
    record = json.loads(printed)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    size = sum(file.stat().st_size for file in (folder / "run").rglob("*") if file.is_file())
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {
        "memory MB": (estimate["memory_bytes"] / 1e6, max(held / 1e6, record["peak_memory_mb"])),
        "disk MB": (estimate["disk_bytes"] / 1e6, size / 1e6),
        "seconds": (estimate["seconds"], seconds),
    }


def main(names: list[str]) -> int:
    os.environ |= {"OMP_NUM_THREADS": "1", "SPPM_CACHE": "off"}
    wrong = 0
    with tempfile.TemporaryDirectory() as place:
        (Path(place) / "knot.yaml").write_text(KNOT)
        sppm("run", str(Path(place) / "knot.yaml"), "-q", "-o", str(Path(place) / "knot"))
        for name in names or list(CASES):
            folder = Path(place) / name.replace(" ", "_")
            folder.mkdir()
            (folder / "knot.ply").symlink_to(Path(place) / "knot" / "knot.ply")
            for what, (estimate, true) in compare(CASES[name], folder).items():
                low, high = (1 / 3, 3.0) if what == "seconds" else (0.5, 2.0)
                good = low <= estimate / true <= high
                wrong += not good
                print(f"{name:24s} {what:10s} estimate {estimate:9.3f} true {true:9.3f} ratio {estimate / true:5.2f}"
                      + ("" if good else "  OUTSIDE"), flush=True)  # fmt: skip
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
