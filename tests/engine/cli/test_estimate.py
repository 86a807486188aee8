"""``sppm estimate``: estimated against run, refusals, and what is unknown."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from dataclasses import fields
from pathlib import Path

import pytest

from sppm_pipeline.built_in import PLUGIN_OF
from sppm_pipeline.engine.cli.arguments import size
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.plan import estimate
from sppm_pipeline.engine.process import budget
from sppm_pipeline.nouns.size import Size
from tests.built_in import DOCUMENTED, STAGES

CONFIGS = Path(__file__).resolve().parents[3] / "configs"

PART = """sppm: 1
name: part
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: 40, share: 0.5}
    - {stage: sample.dart_throwing, total: 40}
    - {stage: connect.mbdst, mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.12, tunnel_radius: 0.04}
pipeline:
  - {stage: tileset.free_faces, recipe: cell, colors: 1, interiors: 2, porosity: 0.6, resolution: 16, tolerance: 0.05}
  - {stage: read.primitive, shape: ball, size: [12 mm, 12 mm, 12 mm], facets: 40}
  - {stage: tile.free_faces, cell: 3 mm}
  - {stage: fill.implicit}
  - {stage: slice.field, pixel: 0.1 mm}
  - {stage: write.png}
  - {stage: extract.marching_cubes, resolution: 24}
  - {stage: write.mesh, path: mesh.ply}
"""


STIFF = """sppm: 1
name: stiff
pipeline:
  - {stage: sample.mirrored_faces, edge: 2, total: 42, share: 0.6}
  - {stage: sample.dart_throwing, total: 42}
  - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
  - {stage: field.gaussian, omega: 20, mu: 20, level: 0.25}
  - {stage: homogenize.voxel, resolution: 32}
  - {stage: write.stiffness, image_size: [400, 300]}
  - {stage: mesh.isosurface_stuffing, resolution: 16}
  - {stage: write.volume_mesh}
  - {stage: extract.voxels, resolution: 48}
  - {stage: write.voxels, path: voxels.tiff}
  - {stage: extract.marching_cubes, resolution: 32}
  - {stage: write.mesh, path: mesh.3mf}
"""

PLATE = """sppm: 1
name: plate
pipeline:
  - {stage: read.primitive, shape: box, size: [200 mm, 200 mm, 1 mm]}
  - {stage: slice.mesh, pixel: 0.02 mm}
  - {stage: write.png, path: slices, sheet: 0}
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "part.yaml").write_text(PART)
    (tmp_path / "stiff.yaml").write_text(STIFF)
    return tmp_path


def sppm(*words: str) -> int:
    return main([*words, "--allow-plugins", ",".join(DOCUMENTED)])


def estimated(capsys, *words: str) -> dict:
    assert sppm("estimate", *words, "--json") == 0
    return json.loads(capsys.readouterr().out)


WITH_PLUGINS = {
    "compare_structures",
    "crush_structures",
    "property_map",
    "published_curves",
    "stiffest",
    "stiffest_grid",
    "walls_stiffness",
}
"""Examples whose structures come from a distribution, which need not say what they will take."""


@pytest.mark.parametrize(
    "path", sorted(p for p in CONFIGS.glob("*.yaml") if p.stem not in WITH_PLUGINS), ids=lambda path: path.stem
)
def test_every_stage_of_every_example_is_estimated(path, here, capsys):
    words = ["-p", f"mesh={mesh(here)}"] if path.stem == "bunny" else []
    found = estimated(capsys, str(path), *words)
    assert found["unknown"] == []
    assert found["memory_bytes"] > 1e8
    assert found["seconds"] > 0.5
    assert not (here / "runs").exists()


def mesh(folder: Path) -> Path:
    from sppm_pipeline.method.part.primitive_meshes import box_mesh
    from sppm_pipeline.services.formats import stl

    path = folder / "box.stl"
    path.write_bytes(b"".join(stl.encode(*box_mesh((0.0, 0.0, 5.0), (10.0, 10.0, 10.0)))))
    return path


@pytest.mark.parametrize("name", ["part.yaml", "stiff.yaml"])
def test_estimates_come_true(here, capsys, name):
    """In a process of its own, as the peak of memory belongs to a process."""
    command = [sys.executable, "-m", "sppm_pipeline.engine.cli.main", "run", name, "-q", "-o", "out"]
    command += ["--allow-plugins", ",".join(DOCUMENTED)]
    for _ in range(2):  # compiling kernels, if it is the first time, takes memory that is not the run's
        subprocess.run([*command, "--threads", "1"], check=True, cwd=here, stdout=subprocess.DEVNULL)
    found = estimated(capsys, name)
    assert found["unknown"] == []
    record = json.loads((here / "out" / "run.json").read_text())
    written = sum(file.stat().st_size for file in (here / "out").rglob("*") if file.is_file())
    assert 0.5 < found["disk_bytes"] / written < 2
    assert 0.5 < found["memory_bytes"] / (record["peak_memory_mb"] * 1e6) < 2
    told = {stage["id"]: stage for stage in found["stages"]}
    for stage in record["stages"]:
        if stage["id"] == "slice.field":
            assert told["write.png"]["layers"] == stage["summary"]["layers"]
    estimates = {stage["id"]: stage["disk_bytes"] for stage in found["stages"]}
    for stage in record["stages"]:
        if size_ := sum(output["bytes"] for output in stage.get("outputs", ())):
            assert 0.4 < estimates[stage["id"]] / size_ < 2.5, stage["id"]


def test_costs_grow_with_the_work(here, capsys):
    small = estimated(capsys, "part.yaml", "-s", "marching_cubes.resolution=16")
    large = estimated(capsys, "part.yaml", "-s", "marching_cubes.resolution=64")
    assert large["memory_bytes"] > small["memory_bytes"]
    assert large["disk_bytes"] > 5 * small["disk_bytes"]
    until = estimated(capsys, "part.yaml", "--until", "write.png")
    assert [stage["id"] for stage in until["stages"]][-1] == "write.png"


def test_as_text(here, capsys):
    assert sppm("estimate", "part.yaml") == 0
    out = capsys.readouterr().out
    assert "120 layers" in out
    assert "in all: " in out


@pytest.mark.parametrize("verb", ["estimate", "run"])
def test_too_little_memory_is_refused_before_any_work(here, capsys, verb):
    assert sppm(verb, "part.yaml", "-s", "marching_cubes.resolution=800", "--memory", "2G") == 5
    err = capsys.readouterr().err
    assert "part.yaml:16:13: stage 'extract.marching_cubes': about " in err
    assert "the limit given by --memory is 2.15 GB" in err
    assert "hint: lower `resolution`, or slice without a mesh" in err
    assert not (here / "runs").exists()
    assert "SPPM_MEMORY" not in os.environ


def test_each_worker_of_a_single_run_takes_memory_of_its_own(here, capsys):
    (here / "plate.yaml").write_text(PLATE)
    assert sppm("run", "plate.yaml", "-n") == 0
    assert sppm("run", "plate.yaml", "--memory", "700M", "-j", "4", "--executor", "processes") == 5
    err = capsys.readouterr().err
    assert "stage 'write.png': about " in err
    assert "(4 workers and the program itself)" in err
    assert "hint: slice with a larger `pixel` or `layer`" in err
    assert not (here / "runs").exists()
    assert sppm("run", "plate.yaml", "--memory", "700M", "-j", "4", "--executor", "serial", "-n") == 0


@pytest.mark.parametrize("verb", ["estimate", "run"])
def test_too_small_a_disk_is_refused_before_any_work(here, capsys, verb, monkeypatch):
    monkeypatch.setattr("sppm_pipeline.engine.plan.estimate.free_disk", lambda folder: 1000)
    assert sppm(verb, "part.yaml", "-o", "there") == 5
    err = capsys.readouterr().err
    assert "would be written; free where 'there' lies are 1 kB" in err
    assert "choose another place with -o" in err
    assert not (here / "there").exists()


def test_a_sweep_counts_all_its_runs(here, capsys):
    text = PART.replace("name: part", "name: part\nparams: {n: 16}").replace("resolution: 24", 'resolution: "${n}"')
    (here / "sweep.yaml").write_text(text + "sweep: {n: [16, 24, 32]}\n")
    one = [estimated(capsys, "sweep.yaml", "-p", f"n={n}") for n in (16, 24, 32)]
    found = estimated(capsys, "sweep.yaml")
    assert found["runs"] == 3
    assert found["disk_bytes"] == pytest.approx(sum(row["disk_bytes"] for row in one), rel=1e-6)
    start = estimate.table()["sppm"]["seconds"]["1"] + found["compiling_seconds"]  # once, as the rows share a process
    assert found["seconds"] == pytest.approx(sum(row["seconds"] for row in one) - 2 * start, abs=3e-3)


def test_work_for_years_is_refused_by_its_size(here, capsys, monkeypatch):
    monkeypatch.setattr("sppm_pipeline.engine.plan.estimate.free_disk", lambda folder: 10**10)  # of 60 GB
    assert sppm("run", "part.yaml", "-s", "slice.field.pixel=1 um", "-s", "slice.field.layer=0.01 um") == 5
    assert "slice with a larger `pixel` or `layer`" in capsys.readouterr().err


def test_a_stage_whose_estimate_fails_runs_anyway(here, capsys, monkeypatch):
    from sppm_pipeline.method.stages.read_primitive import ReadPrimitive

    unknown = [
        lambda self, palette: 1 / 0,
        lambda self, palette: "much",
        lambda self, palette: None,
        lambda self, palette: Size(triangles=float("nan")),
        lambda self, palette: Size(triangles=-1.0),
        lambda self, palette: Size().body,
    ]
    mistakes = [lambda self: Size(), lambda self, palette: palette.none, lambda self, palette: {}["key"]]
    for method in unknown + mistakes:
        monkeypatch.setattr(ReadPrimitive, "estimate", method)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            found = estimated(capsys, "part.yaml")
        # a mistake is named with its stage, and not again for what follows from it
        named = {str(one.message).split(" raised ")[0] for one in said}
        assert named == ({"the estimate of 'read.primitive' (read.primitive)"} if method in mistakes else set())
        assert "read.primitive" in found["unknown"]
        assert "tileset.free_faces" not in found["unknown"]
        # what follows from its size is unknown, too
        assert {"tile.free_faces", "fill.implicit", "write.png", "write.mesh"} <= set(found["unknown"])
    with pytest.warns(RuntimeWarning, match="mistake in"):
        assert sppm("run", "part.yaml", "-q", "--until", "read.primitive") == 0


CELL = """sppm: 1
name: cell
recipes:
  cell:
    - {stage: sample.dart_throwing, edge: 2 mm, total: 40, spacing: 0.1}
    - {stage: connect.mbdst}
    - {stage: field.gaussian, pore_radius: 0.6, tunnel_radius: 0.04}
pipeline:
  - {stage: sample.dart_throwing, edge: 2 mm, total: 40, spacing: 0.1}
  - {stage: connect.mbdst}
  - {stage: field.gaussian, pore_radius: 0.6, tunnel_radius: 0.04}
  - {stage: tune.property, recipe: cell, of: x.y, target: 0.5, vary: field.gaussian.pore_radius, low: 0.1, high: 0.3}
"""


@pytest.mark.parametrize("verb", ["check", "estimate", "run"])
def test_options_that_do_not_fit_the_cell_are_refused_where_they_stand(here, capsys, verb):
    """Errors that a stage raises once it knows its cell; not of a recipe whose options another stage replaces."""
    (here / "cell.yaml").write_text(CELL)
    assert sppm(verb, "cell.yaml") == 2
    said = capsys.readouterr().err
    assert "cell.yaml:11:13: stage 'field.gaussian': the length 0.6 has no unit and counts in cell sizes" in said
    assert "write `0.6 mm`, or `0.6 cell` if it is 0.6 cell sizes" in said
    assert "cell.yaml:7" not in said
    assert not (here / "runs").exists()
    (here / "cell.yaml").write_text(CELL.replace("0.6, ", "0.2, "))
    assert sppm("check", "cell.yaml") == 0
    (here / "cell.yaml").write_text(PART.replace("pore_radius: 0.12", "pore_radius: 0.12 mm"))
    assert sppm("check", "cell.yaml") == 2
    said = capsys.readouterr().err
    assert "stage 'cell.field.gaussian': the length 0.12 mm has a physical unit, but the cell has no physical" in said
    sweep = CELL.split("recipes:")[0] + "params: {r: 0.2}\nsweep: {r: [0.2, 0.7]}\n"
    pipeline = "pipeline:" + CELL.split("pipeline:")[1].rpartition("  - ")[0].replace("0.6", '"${r}"')
    (here / "cell.yaml").write_text(sweep + pipeline)
    assert sppm("check", "cell.yaml") == 2
    assert "the length 0.7 has no unit" in capsys.readouterr().err


PLUGIN = CONFIGS.parent / "examples" / "uniform_sampler.py"


def test_a_stage_without_rates_is_named_in_the_total(here, capsys):
    """Its size is known, as the family tells it, and so is everything after it."""
    text = PART.replace("sample.dart_throwing, total: 40", "sample.uniform, count: 20")
    (here / "own.yaml").write_text(text)
    assert main(["estimate", "own.yaml", "--plugin", str(PLUGIN)]) == 0
    out = capsys.readouterr().out
    assert out.rstrip().endswith("; unknown: cell.sample.uniform")
    assert "in all: at least " in out
    assert main(["estimate", "own.yaml", "--plugin", str(PLUGIN), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["unknown"] == ["cell.sample.uniform"]
    assert found["disk_bytes"] > 1e6
    assert main(["run", "own.yaml", "--plugin", str(PLUGIN), "-s", "marching_cubes.resolution=800", "--memory=2G"]) == 5


def test_a_machine_is_learned_from_its_cache(here, capsys, monkeypatch):
    """A run says what stages take here; the next estimate of the same run says the same."""
    monkeypatch.setenv("SPPM_CACHE", str(here / "cache"))
    monkeypatch.setattr(estimate, "has_compiled", lambda: False)  # other tests in this process may have
    words = ["part.yaml", "--until", "write.png"]
    assert sppm("run", *words, "-q", "--threads", "1", "-o", "out") == 0
    record = {stage["id"]: stage for stage in json.loads((here / "out" / "run.json").read_text())["stages"]}
    after = {stage["id"]: stage for stage in estimated(capsys, *words)["stages"]}
    for name, stage in record.items():
        assert after[name]["seconds"] == pytest.approx(stage["seconds"], rel=1e-2, abs=2e-4), name
        memory = after[name]["memory_bytes"] / (1e6 * stage["peak_memory_mb"])
        assert memory == pytest.approx(estimate.MARGIN, rel=5e-3), name
    monkeypatch.setenv("SPPM_CACHE", "off")
    assert {stage["id"]: stage for stage in estimated(capsys, *words)["stages"]} != after


def test_the_run_that_is_nearest_in_size_counts():
    seen = [estimate.Seen(1.0, 2.0, 1e8, 2e8), estimate.Seen(8.0, 4.0, 8e8, 8e8), estimate.Seen(1.01, 3.0, 1e8, 0.0)]
    seconds, memory = estimate.by_history(seen, 1.0, 1.5e8)
    assert seconds == pytest.approx(3.0 / 1.01)  # the latest of two of this size
    assert memory == pytest.approx(3e8 * estimate.MARGIN)  # one had compiled
    seconds, memory = estimate.by_history(seen, 16.0, 4e8)
    assert seconds == 8.0
    assert memory == pytest.approx(4e8 * estimate.MARGIN)
    assert estimate.by_history([], 5.0, 6.0) == (5.0, 6.0)


def test_what_is_remembered_stays_small(tmp_path):
    from sppm_pipeline.engine.cache.store import Store

    store = Store(tmp_path)
    for number in range(40):
        estimate.remember(store, [("a", estimate.Seen(2.0**number, 1.0, 1e8, 1e8))])
    assert len(estimate.history_of(store)["a"]) == estimate.MAX_SEEN
    file = tmp_path / estimate.HISTORY
    before = file.stat().st_mtime_ns
    estimate.remember(store, [("a", estimate.Seen(2.0**39, 1.01, 1e8, 1.001e8))])  # which says the same
    assert file.stat().st_mtime_ns == before


def test_compiling_counts_where_kernels_are_missing(here, capsys, monkeypatch):
    from sppm_pipeline.engine.plan import kernels

    monkeypatch.setattr(kernels, "is_kept", lambda place, count: True)
    warm = estimated(capsys, "part.yaml")
    for module in (kernels, estimate):  # of all kinds of arguments, and of any
        monkeypatch.setattr(module, "is_kept", lambda place, count: False)
    monkeypatch.setenv(kernels.SWITCH, "off")  # the run compiles in its own process
    cold = estimated(capsys, "part.yaml")
    assert warm["compiling_seconds"] == 0.0
    assert cold["seconds"] == pytest.approx(warm["seconds"] + cold["compiling_seconds"], abs=2e-3)
    assert cold["compiling_seconds"] > 5
    assert cold["memory_bytes"] == warm["memory_bytes"] + estimate.COMPILER.memory
    assert sppm("estimate", "part.yaml") == 0
    assert "once, to compile kernels)" in capsys.readouterr().out
    monkeypatch.setenv(kernels.SWITCH, "on")  # processes beside it
    assert estimated(capsys, "part.yaml")["memory_bytes"] == warm["memory_bytes"]


def test_the_table_of_rates_fits_the_program():
    """Each entry belongs to a stage, each rate to a unit, and none is negative."""
    columns, units = {"seconds", "memory", "kept", "disk"}, {field.name for field in fields(Size)}
    formats = ("stl", "ply", "obj", "off", "3mf", "glb", "vtu", "inp", "msh", "npy", "tiff", "vti")
    names = {*STAGES, *PLUGIN_OF, *(f"write.{extension}" for extension in formats)}
    for name, entry in estimate.table().items():
        assert name == "sppm" or name in names or name.rpartition(".")[0] in names, name
        assert set(entry) == columns
        for found in entry.values():
            assert set(found) <= units | {"1", "stages"}
            assert all(rate > 0 for rate in found.values())


@pytest.mark.parametrize(
    ("text", "count"),
    [("1", 1), ("800M", 800 * 2**20), ("1.5G", 3 * 2**29), ("2 GiB", 2**31), ("64 kb", 2**16), ("1T", 2**40)],
)
def test_sizes(text, count):
    assert size(text) == count


@pytest.mark.parametrize("text", ["", "x", "-1", "0", "nan", "1e9", "5Q", "9" * 400, "99999999999T", "0.1"])
def test_sizes_that_make_no_sense(text, capsys):
    assert main(["run", "x.yaml", f"--memory={text}"]) == 2
    assert "expected a size" in capsys.readouterr().err


def test_the_smallest_limit_counts(monkeypatch):
    monkeypatch.setenv(budget.MEMORY, "1000")
    assert budget.allowed_memory() == (1000, "the limit given by --memory")
    assert budget.planning_memory() == 1000
    monkeypatch.setenv(budget.MEMORY, "nonsense")
    limit, words = budget.allowed_memory()
    assert limit > 10**6
    assert words != "the limit given by --memory"


def test_free_space_of_a_folder_that_is_not_there_yet(tmp_path):
    assert budget.free_disk(tmp_path / "a" / "b") == pytest.approx(budget.free_disk(tmp_path), rel=0.05)


def test_format_bytes():
    assert [budget.format_bytes(n) for n in (0, 999, 1000, 2.5e6, 3e9, 4e15)] == [
        "0 bytes", "999 bytes", "1 kB", "2.5 MB", "3 GB", "4e+03 TB"
    ]  # fmt: skip
