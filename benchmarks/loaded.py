"""Cubes of 8^3 scattered cells under a load, voxel by voxel, with and without solving by itself what is slow.

Usage: ``python -m benchmarks.loaded [--write] [VOXELS A CELL ...]``. A cube is held at its base and pressed at its top.
Each line is a process of its own on one thread; the coarsest grid is solved both ways, finer ones as `simulate.part`
does. `--write` puts the table into docs/features/parts.md.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

from benchmarks.measure import between_marks
from sppm_pipeline import Pipeline
from sppm_pipeline.features.parts import material
from sppm_pipeline.services.elastic.loaded import HeldBody, Loaded

PAGE = Path(__file__).resolve().parents[1] / "docs" / "features" / "parts.md"
MARK = "<!-- benchmarks.loaded -->\n"
RADII = ((0.11, 0.03), (0.12, 0.0325))
SEEDS = (1, 2, 3)
HEAD = (
    "| voxels | porosity | seed | iterations, by cycles alone | processor time | iterations | processor time | memory |"
)

CUBE = """
sppm: 1
seed: {seed}
recipes:
  cell:
    - {{stage: sample.mirrored_faces, total: 68, share: 0.6}}
    - {{stage: sample.dart_throwing, total: 68}}
    - {{stage: connect.mbdst, degree: [3, 5], mode: greedy}}
    - {{stage: field.gaussian, pore_radius: {pore}, tunnel_radius: {tunnel}}}
pipeline:
  - {{stage: read.primitive, id: box, shape: box, size: [32 mm, 32 mm, 32 mm]}}
  - {{stage: load.case, from: {{part: box}}, fix: ["plane z at low"], force: ["0 0 -100 N on plane z at high"]}}
  - {{stage: tile.scattered, recipe: cell, cell: 4 mm, from: {{cover: box}}}}
  - {{stage: fill.implicit, from: {{domain: box}}}}
  - {{stage: simulate.part, from: {{part: box}}, resolution: {voxels}, grids: 1, young: 1400, poisson: 0.35}}
"""


def measured(voxels: int, radii: tuple[float, float], seed: int, local: bool) -> dict[str, Any]:
    """Iterations, processor seconds of the solver, largest memory of this process in GB, compliance and porosity."""
    seen: dict[str, Any] = {}
    solve, simulated = HeldBody.solve, material.simulated

    def timed(body: HeldBody, *args: Any, **options: Any) -> Loaded:
        if not options.pop("local", True):  # a box within a body
            return solve(body, *args, **options, local=False)
        start = time.process_time()
        found = solve(body, *args, **options, local=local)
        seen.update(iterations=found.solved.iterations, cpu=time.process_time() - start)
        return found

    def noted(context: Any, model: material.Model, *args: Any, **options: Any) -> Any:
        seen["porosity"] = 1 - float(model.mass.mean() / model.mass.max())
        result = simulated(context, model, *args, **options)
        seen["compliance"] = result[0].compliance
        return result

    where = "sppm_pipeline.features.parts.stages.simulate_part.simulated"
    with (
        TemporaryDirectory() as folder, mock.patch.object(HeldBody, "solve", timed), mock.patch(where, noted),
    ):  # fmt: skip
        file = Path(folder) / "cube.yaml"
        file.write_text(CUBE.format(seed=seed, pore=radii[0], tunnel=radii[1], voxels=voxels))
        Pipeline.from_yaml(file).run(Path(folder) / "out", threads=1, cache=False)
    return {**seen, "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6}


def main(words: list[str] | None = None) -> None:
    """Measure, print and, if asked, write the table."""
    parser = argparse.ArgumentParser(prog="benchmarks.loaded", description=__doc__)
    parser.add_argument("voxels", nargs="*", type=int, default=[16, 32])
    parser.add_argument("--write", action="store_true", help="write the table to the page")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    found = parser.parse_args(words)
    if found.one:
        print(json.dumps(measured(*json.loads(found.one))))
        return
    lines = [HEAD, "|---" * 8 + "|"]
    print(lines[0], flush=True)
    for voxels in found.voxels:
        for radii in RADII:
            for seed in SEEDS if voxels == min(found.voxels) else SEEDS[:1]:
                both = [True, False] if voxels == min(found.voxels) else [True]
                made = {}
                for local in both:
                    one = json.dumps([voxels, radii, seed, local])
                    command = [sys.executable, "-m", "benchmarks.loaded", "--one", one]
                    made[local] = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
                new, old = made[True], made.get(False)
                plain = f"{old['iterations']} | {old['cpu']:.1f}" if old else "|"
                lines.append(
                    f"| {8 * voxels}^3 | {new['porosity']:.2f} | {seed} | {plain} | {new['iterations']} | "
                    f"{new['cpu']:.1f} | {new['memory']:.2f} GB |"
                )
                print(lines[-1], flush=True)
                if old and abs(new["compliance"] / old["compliance"] - 1) > 2e-3:
                    raise SystemExit(f"compliances are {new['compliance']:g} and {old['compliance']:g}")
    if found.write:
        between_marks(PAGE, MARK, "\n".join(lines))


if __name__ == "__main__":
    main()
