"""Same input, same bytes: for any number of threads, in another process, in another place."""

import hashlib
import subprocess
import sys

YAML = """sppm: 1
name: all
seed: 11
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: 30, share: 0.45}
    - {stage: sample.dart_throwing, total: 30}
    - {stage: connect.mbdst, degree: [2, 5], mode: lp_fix}
    - {stage: field.gaussian, pore_radius: 0.13, tunnel_radius: 0.04, pore_spread: 0.1, tunnel_spread: 0.1}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.6, resolution: 24, tolerance: 0.01}
  - {stage: check.connectivity, resolution: 16}
  - {stage: write.graph, path: graph.json}
  - {stage: extract.marching_cubes, id: cell_mesh, resolution: 12}
  - {stage: write.obj, path: cell.obj}
  - {stage: tileset.free_faces, recipe: cell, porosity: 0.6, colors: 2, interiors: 4, resolution: 12, tolerance: 0.05}
  - {stage: write.picture, id: sheet, path: sheet.png, resolution: 6}
  - {stage: read.primitive, shape: torus_knot, size: [12 mm, 12 mm, 6 mm], facets: 24}
  - {stage: tile.free_faces, cell: 3 mm}
  - {stage: fill.implicit, skin: 0.4 mm}
  - {stage: slice.field, pixel: 0.3 mm, grey: 2}
  - {stage: write.png, id: fast, path: grey}
  - {stage: slice.field, id: thin, pixel: 0.31 mm, layer: 0.2 mm}
  - {stage: write.png, id: exact, path: binary}
  - {stage: write.picture, id: view, path: part.png, resolution: 6, size: [160, 120]}
  - {stage: extract.marching_cubes, id: part_mesh, resolution: 8}
  - {stage: write.stl, path: part.stl}
  - {stage: write.ply, path: part.ply}
  - {stage: tile.fresh, recipe: cell, cells: [2, 2, 1], cell: 3 mm, porosity: 0.6, resolution: 12}
  - {stage: slice.field, id: fresh_layers, resolution: 10}
  - {stage: write.png, id: fresh_png, path: fresh}
"""

RUN = """
import sys
from pathlib import Path
from sppm_pipeline.engine.runner import run_plan
from sppm_pipeline.engine.session import Order, open_session
session = open_session(Order(sys.argv[1], ("sppm_pipeline.stages", "sppm_pipeline.engine.executors"), (), False))
run_plan(session.plan(), Path(sys.argv[2]), threads=2)
"""


def digests(folder):
    """Of all outputs; the run record itself holds times."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "run.json"
    }


def test_threads_and_processes_change_no_byte(run_yaml, tmp_path):
    _, one = run_yaml(YAML, threads=1, to="one")
    expected = digests(one)
    assert {"graph.json", "cell.obj", "sheet.png", "grey/00000.png", "binary/manifest.json", "part.png", "part.stl",
            "part.ply", "fresh/00009.png"} <= set(expected)  # fmt: skip
    _, two = run_yaml(YAML, threads=2, to="two")
    assert digests(two) == expected
    (tmp_path / "elsewhere").mkdir()
    arguments = [sys.executable, "-c", RUN, str(tmp_path / "config.yaml"), str(tmp_path / "elsewhere" / "run")]
    done = subprocess.run(arguments, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert digests(tmp_path / "elsewhere" / "run") == expected


def test_another_seed_makes_another_part(run_yaml):
    short = YAML[: YAML.index("  - {stage: write.graph")] + "  - {stage: write.graph, path: graph.json}\n"
    _, one = run_yaml(short, to="one")
    _, other = run_yaml(short, seed=12, to="other")
    assert digests(one) != digests(other)
