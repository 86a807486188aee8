"""Same input, same bytes: for any number of threads, in another process, in another place."""

import hashlib
import os
import subprocess
import sys

import pytest

YAML = """sppm: 1
name: all
audit: warn
seed: 11
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: 30, share: 0.45}
    - {stage: sample.dart_throwing, total: 30}
    - {stage: connect.mbdst, degree: [2, 5]}
    - {stage: field.gaussian, pore_radius: 0.13, tunnel_radius: 0.04, pore_spread: 0.1, tunnel_spread: 0.1}
  cloud:
    - {stage: sample.dart_throwing, total: 30}
    - {stage: connect.mbdst, degree: [2, 5], mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.13, tunnel_radius: 0.04, pore_spread: 0.1, tunnel_spread: 0.1}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.6, resolution: 24, tolerance: 0.01}
  - {stage: check.connectivity, resolution: 16}
  - {stage: write.graph, path: graph.json}
  - {stage: extract.marching_cubes, id: cell_mesh, resolution: 12}
  - {stage: write.mesh, id: cell_obj, path: cell.obj}
  - {stage: tileset.free_faces, recipe: cell, porosity: 0.6, colors: 2, interiors: 4, resolution: 12, tolerance: 0.05}
  - {stage: write.picture, id: sheet, path: sheet.png, resolution: 6}
  - {stage: read.primitive, shape: torus_knot, size: [12 mm, 12 mm, 6 mm], facets: 24}
  - {stage: tile.free_faces, cell: 3 mm}
  - {stage: fill.implicit, skin: 0.4 mm}
  - {stage: slice.field, pixel: 0.3 mm, gray: 2}
  - {stage: write.png, id: fast, path: gray}
  - {stage: slice.field, id: thin, pixel: 0.31 mm, layer: 0.2 mm}
  - {stage: write.png, id: exact, path: binary}
  - {stage: write.picture, id: view, path: part.png, resolution: 6, image_size: [160, 120]}
  - {stage: extract.marching_cubes, id: part_mesh, resolution: 8}
  - {stage: write.mesh, id: part_stl, path: part.stl}
  - {stage: write.mesh, id: part_ply, path: part.ply}
  - {stage: tile.fresh, recipe: cell, cells: [2, 2, 1], cell: 3 mm, porosity: 0.6, resolution: 12}
  - {stage: slice.field, id: fresh_layers, resolution: 10}
  - {stage: write.png, id: fresh_png, path: fresh}
  - {stage: tile.scattered, recipe: cloud, cells: [3, 2, 1], cell: 3 mm, porosity: 0.6, resolution: 12}
  - {stage: slice.field, id: scattered_layers, resolution: 10}
  - {stage: write.png, id: scattered_png, path: scattered}
"""

RUN = """
import sys
from pathlib import Path
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.built_in import BUILTINS as built_in
session = open_session(RunRequest(sys.argv[1], built_in, (), False))
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
    assert {"graph.json", "cell.obj", "sheet.png", "gray/00000.png", "binary/manifest.json", "part.png", "part.stl",
            "part.ply", "fresh/00009.png", "scattered/00009.png"} <= set(expected)  # fmt: skip
    # two threads, in another process and another place
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


SMALL = """sppm: 1
name: small
audit: warn
seed: 3
params: {porosity: 0.6}
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: 24, share: 0.45}
    - {stage: sample.dart_throwing, total: 24}
    - {stage: connect.mbdst, degree: [2, 4]}
    - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.05, pore_spread: 0.1}
pipeline:
  - {stage: tileset.wang_3color, colors: 2, recipe: cell, porosity: "${porosity}", resolution: 12, tolerance: 0.05}
  - {stage: read.primitive, shape: ball, size: [8 mm, 8 mm, 8 mm], facets: 24}
  - {stage: tile.wang_3color, cell: 2.5 mm}
  - {stage: fill.implicit, skin: 0.3 mm}
  - {stage: slice.field, pixel: 0.25 mm}
  - {stage: write.png, path: slices}
  - {stage: extract.marching_cubes, resolution: 8}
  - {stage: write.mesh, path: part.obj}
"""


def program(folder, *words, cwd=None, **environment):
    """Run the command line in a process of its own; digests of what it wrote."""
    command = [
        sys.executable,
        "-m",
        "sppm_pipeline.engine.cli.main",
        "run",
        str(folder / "small.yaml"),
        "-q",
        "--no-plugins",
    ]
    done = subprocess.run(
        [*command, *words], capture_output=True, text=True, cwd=cwd, env={**os.environ, **environment}, check=False
    )
    assert done.returncode == 0, done.stderr


SURROUNDINGS = {
    "threads of BLAS": {"OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "4", "PYTHONHASHSEED": "1"},
    "German, far east": {"LC_ALL": "de_DE.UTF-8", "TZ": "Pacific/Kiritimati", "PYTHONHASHSEED": "4242"},
    "Turkish, far west": {"LC_ALL": "tr_TR.UTF-8", "TZ": "Etc/GMT+12", "PYTHONUTF8": "0"},
    "plain C": {"LC_ALL": "C", "TZ": "Asia/Kathmandu", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
}


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """A folder with the configuration, and digests of a plain run."""
    folder = tmp_path_factory.mktemp("reference")
    (folder / "small.yaml").write_text(SMALL)
    program(folder, "-o", str(folder / "out"), "--threads", "1", cwd=folder, PYTHONHASHSEED="0")
    return folder, digests(folder / "out")


@pytest.mark.parametrize("around", SURROUNDINGS)
def test_surroundings_change_no_byte(reference, around, tmp_path):
    folder, expected = reference
    assert len(expected) > 30
    place = tmp_path / "ein Ort, \u00e4"
    place.mkdir()
    threads = "4" if around == "threads of BLAS" else "2"
    program(folder, "-o", "out", "--threads", threads, cwd=place, **SURROUNDINGS[around])
    assert digests(place / "out") == expected


def test_runs_side_by_side_change_no_byte(tmp_path):
    (tmp_path / "small.yaml").write_text(SMALL + "sweep: {porosity: [0.55, 0.6], seed: [3]}\n")
    for jobs, executor in (("1", "serial"), ("4", "threads"), ("2", "processes")):
        program(tmp_path, "-o", f"out{jobs}{executor}", "-j", jobs, "--executor", executor, cwd=tmp_path)
    first, *others = (
        {name: digest for name, digest in digests(path).items() if name.startswith("runs/") and "seconds" not in name}
        for path in sorted(tmp_path.glob("out*"))
    )
    assert len(first) > 60
    assert all(other == first for other in others)


def test_names_of_case_and_sort_order_do_not_follow_the_language(monkeypatch):
    """In Turkish the capital of i is not I; nothing that is compared may ask the language."""
    import locale

    from sppm_pipeline.engine.config.names import folded, output_parts

    before = locale.setlocale(locale.LC_ALL)
    for name in ("tr_TR.UTF-8", "de_DE.UTF-8", "C"):
        try:
            locale.setlocale(locale.LC_ALL, name)
        except locale.Error:
            continue
        try:
            assert folded(output_parts("FILE.I")) == ("file.i",)
            assert f"{1.5:g} {float('2.5'):g}" == "1.5 2.5"
        finally:
            locale.setlocale(locale.LC_ALL, before)
