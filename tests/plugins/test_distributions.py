"""Each distribution under ``plugins/`` is found by the program, passes its own suite, and runs in a pipeline."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

import sppm_pipeline as sppm
from sppm_pipeline import built_in
from sppm_pipeline.engine.api.functions import family_of, step_families
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.plan import installed
from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.stage import FAMILIES

ROOT = Path(__file__).resolve().parents[2]
PLUGINS = sorted(path.parent for path in (ROOT / "plugins").glob("*/pyproject.toml"))
COLLECTED = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]
"""How the tests of this repository are run: those of large plugins among them, file by file."""
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
    "tetrahedra": {
        "check.volume_mesh",
        "homogenize.tet",
        "mesh.boundary",
        "mesh.isosurface_stuffing",
        "read.volume_mesh",
        "write.volume_mesh",
    },
    "tetwild": {"mesh.tetwild"},
    "lib3mf": {"write.3mf_beams", "write.3mf_slices"},
    "cad": {"read.cad"},
    "crushing": {
        "crush.voxel",
        "measure.compression",
        "read.compression",
        "tune.plateau",
        "write.curves",
        "write.frames",
    },
    "dask": set(),
}
LICENSES = {"sppm-pymeshlab": ("GPL-3.0-or-later", "GNU GENERAL PUBLIC LICENSE")}
"""Distributions that can't have the licence of the program, as what they drive has another."""


@pytest.mark.parametrize("folder", PLUGINS, ids=lambda path: path.name)
def test_own_suite_passes(folder: Path) -> None:
    # a process of its own: the suite, with its own settings, is what somebody finds who gets this folder alone
    # a suite that is run file by file beside the others is only looked at
    apart = ["--collect-only"] if f"plugins/{folder.name}/tests" in COLLECTED["testpaths"] else []
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *apart],
        cwd=folder,
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
    found = {entry.name: entry.value for entry in entry_points(group="sppm")}
    for name, module in project["entry-points"]["sppm"].items():
        assert found[name] == module, "install it: pip install -e plugins/*"
    readme = (folder / "README.md").read_text(encoding="utf-8")
    for stage in set().union(*(STAGES[name] for name in project["entry-points"]["sppm"])):
        assert f"`{stage}`" in readme


def test_the_program_knows_whose_a_stage_is() -> None:
    owners = {f"sppm-{name.replace('_', '-')}": stages for name, stages in STAGES.items() if stages}
    assert {name: set(stages) for name, stages in built_in.PLUGINS.items()} == owners
    former = {f"sppm-{one.name}": set(one.aliases) for one in load_plugins().plugins if one.aliases and not one.builtin}
    assert {name: owners[name] | former.get(name, set()) for name in owners} == {
        owner: {name for name, of in built_in.PLUGIN_OF.items() if of == owner} for owner in owners
    }
    assert all(name in import_module(module).__all__ for name, module in built_in.TYPES.items())


WITHOUT = "which is not installed: `pip install {0}`, or `pip install ./plugins/{0}` in a clone"


@pytest.fixture
def without_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if sppm-crushing and sppm-tetrahedra were not installed."""
    everything = installed.entry_points
    left = lambda group: [one for one in everything(group) if one.name not in ("crushing", "tetrahedra")]  # noqa: E731
    monkeypatch.setattr(installed, "entry_points", left)


@pytest.mark.parametrize(
    ("plugin", "pipeline"),
    [
        ("sppm-crushing", "crush.voxel"),
        (
            "sppm-crushing",
            "{stage: crush.voxel, id: a}, {stage: measure.compression, from: a}, {stage: write.curves, from: a}",
        ),
        ("sppm-crushing", "{stage: read.compression, path: a.csv}"),
        ("sppm-tetrahedra", "mesh.isosurface_stuffing, check.volume_mesh, write.volume_mesh"),
        ("sppm-tetrahedra", "{stage: read.volume_mesh, path: a.vtu}, write.vtu, write.inp, write.msh"),
    ],
)
@pytest.mark.usefixtures("without_plugins")
def test_a_stage_of_a_plugin_that_is_not_there_says_what_to_install(plugin: str, pipeline: str) -> None:
    with pytest.raises(sppm.ConfigError) as caught:
        open_session(RunRequest("a.yaml", text=f"sppm: 1\npipeline: [{pipeline}]\n")).plan()
    lines = str(caught.value).splitlines()
    assert all("there is no stage '" in line for line in lines[:-1])
    # once, however many of its stages are used
    assert lines[-1] == f"  hint: part of the plugin {plugin}, {WITHOUT.format(plugin)}"


def test_a_stage_of_a_plugin_that_is_switched_off_says_so() -> None:
    for found, words in ({"distributions": False}, "--no-plugins"), ({"allowed": ["sppm-cad"]}, "--allow-plugins"):
        with pytest.raises(sppm.ConfigError, match=f"part of the plugin sppm-crushing, which is .*{words}"):
            Registry(load_plugins(**found)).get("crush.voxel")


@pytest.mark.usefixtures("without_plugins")
def test_python_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sppm_pipeline.engine.api.functions.registry", lambda: Registry(load_plugins()))
    family_of.cache_clear()
    for family in (family_of("crush"), step_families().crush):
        assert not hasattr(family, "voxel")
        with pytest.raises(sppm.ConfigError, match="there is no stage 'crush\\.voxel'") as caught:
            family.voxel(resolution=8)
        assert WITHOUT.format("sppm-crushing") in str(caught.value)
    family_of.cache_clear()
    for name in FAMILIES:  # the face keeps those that it has shown
        vars(sppm).pop(name, None)
    with pytest.raises(AttributeError, match=r"it is sppm_crushing.CrushedBody, .*`pip install sppm-crushing`"):
        getattr(sppm.nouns, "CrushedBody")  # noqa: B009
    with pytest.raises(AttributeError, match=r"it is sppm_tetrahedra.VolumeMesh, .*`pip install sppm-tetrahedra`"):
        getattr(sppm.nouns, "VolumeMesh")  # noqa: B009


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
    # a report repeats stages of plugins that are installed, but none that a run brings along
    assert main(["report", str(tmp_path / "run")]) == 0
    assert 'id="live-canvas"' in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


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
