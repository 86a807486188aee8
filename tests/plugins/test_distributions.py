"""Each distribution under ``plugins/`` is found by the program, passes its own suite, and runs in a pipeline."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.plan.plugins import load_plugins

PLUGINS = sorted(path.parent for path in (Path(__file__).resolve().parents[2] / "plugins").glob("*/pyproject.toml"))
STAGES = {
    "lattice_points": {"sample.lattice_points"},
    "even_tiles": {"tile.even_interiors"},
    "structures": {
        "field.elastic_texture",
        "field.organic",
        "field.spinodoid",
        "field.stochastic_gyroid",
        "field.struts",
        "field.tpms",
        "field.voronoi_foam",
    },
    "pymeshlab": {"mesh.decimate", "mesh.remesh", "mesh.repair", "mesh.smooth"},
    "tetwild": {"mesh.tetwild"},
    "lib3mf": {"write.3mf_slices"},
    "cad": {"read.cad"},
    "dask": set(),
}
LICENSES = {"sppm-pymeshlab": ("GPL-3.0-or-later", "GNU GENERAL PUBLIC LICENSE")}
"""Distributions that can't have the licence of the program, as what they drive has another."""


@pytest.mark.parametrize("folder", PLUGINS, ids=lambda path: path.name)
def test_own_suite_passes(folder: Path) -> None:
    # a process of its own: the suite, with its own settings, is what somebody finds who gets this folder alone
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=500,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("folder", PLUGINS, ids=lambda path: path.name)
def test_says_how_it_is_found_and_licensed(folder: Path) -> None:
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    license, title = LICENSES.get(folder.name, ("BSD-3-Clause", "BSD 3-Clause License"))
    assert project["license"] == {"text": license}
    assert (folder / "LICENSE").read_text(encoding="utf-8").lstrip().startswith(title)
    installed = {entry.name: entry.value for entry in entry_points(group="sppm")}
    for name, module in project["entry-points"]["sppm"].items():
        assert installed[name] == module, "install it: pip install -e plugins/*"
    readme = (folder / "README.md").read_text(encoding="utf-8")
    for stage in set().union(*(STAGES[name] for name in project["entry-points"]["sppm"])):
        assert f"`{stage}`" in readme


def test_the_program_lists_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plugins", "--check", "--json"]) in (0, 4)
    listed = {plugin["name"]: plugin for plugin in json.loads(capsys.readouterr().out)}
    for name, stages in STAGES.items():
        assert set(listed[name]["stages"]) == stages
        assert listed[name]["error"] is None


def test_loading_them_imports_none_of_their_stages() -> None:
    code = (
        "import sys; from sppm_pipeline.engine.cli.main import main; main(['plugins']); "
        "print([m for m in sys.modules if m.startswith('sppm_') and '.' in m and not m.startswith('sppm_pipeline')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    assert STAGES.keys() <= {plugin.name for plugin in load_plugins().plugins}


def run(tmp_path: Path, file: Path, *options: str) -> dict[str, Any]:
    """Run a configuration through the program, at low resolution; the run record."""
    folder = tmp_path / "run"
    assert main(["run", str(file), "-o", str(folder), "-q", *options]) == 0
    record: dict[str, Any] = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert record["status"] == "done"
    return record


def summary(record: dict[str, Any], stage: str) -> dict[str, Any]:
    """The numbers of one stage."""
    return next(entry["summary"] for entry in record["stages"] if entry["id"] == stage)


def test_lattice_points_in_a_pipeline(tmp_path: Path, root: Path) -> None:
    file = root / "plugins" / "sppm-lattice-points" / "diamond.yaml"
    record = run(tmp_path, file, "--until", "check.connectivity", "-s", "check.connectivity.resolution=24")
    pores = summary(record, "sample.lattice_points")
    assert pores["pores"] == 64
    assert pores["smallest_distance"] >= (1 - 2 * 0.15) * 3**0.5 / 4 / 2
    assert summary(record, "connect.mst")["tunnels"] == 63
    assert summary(record, "check.connectivity")["void_components"] == 1
    assert "sppm-lattice-points" in json.dumps(record["plugins"])


def test_samplers_serve_tile_sets_with_pores_on_faces(tmp_path: Path) -> None:
    file = tmp_path / "tiles.yaml"
    file.write_text(
        """
sppm: 1
name: tiles
recipes:
  cell:
    - {stage: sample.mirrored_faces, count: 9, spacing: 0.2}
    - {stage: sample.lattice_points, lattice: body_centered, repeat: 2, jitter: 0.3}
    - {stage: connect.mbdst}
    - {stage: field.gaussian, pore_radius: 0.12, tunnel_radius: 0.05}
pipeline:
  - {stage: tileset.free_faces, recipe: cell, colors: 2, interiors: 27, resolution: 8, tolerance: 0.1}
  - {stage: tile.even_interiors, cells: [4, 4, 4]}
  - {stage: check.porosity, resolution: 8}
""",
        encoding="utf-8",
    )
    record = run(tmp_path, file)
    tiles = summary(record, "tileset.free_faces")
    assert tiles["pores_per_cell"] == pytest.approx(9 + 16, abs=1)  # the colors of a face differ by a pore or two
    laid = summary(record, "tile.even_interiors")
    assert 24 <= laid["interiors_used"] <= 27
    assert (laid["min_uses"], laid["max_uses"]) == (8, 8)  # of 6 x 6 x 6 cells, with those around the box
    assert laid["alike_across_faces"] == laid["alike_across_edges"] == laid["alike_across_corners"] == 0


def test_even_tiles_repeat_less_than_tiles_by_chance(tmp_path: Path, root: Path) -> None:
    file = root / "plugins" / "sppm-even-tiles" / "compare.yaml"
    one_set = tmp_path / "one_set.yaml"
    one_set.write_text(file.read_text(encoding="utf-8").split("sweep:")[0], encoding="utf-8")
    record = run(tmp_path, one_set, "-p", "cells=[3, 3, 3]", "-s", "tileset.free_faces.tolerance=0.05")
    chance, even = (summary(record, f"{rule}_order")["bragg_share"] for rule in ("by_chance", "evenly"))
    assert even < chance
