"""Records that others can read: a schema, versions of all libraries, no path of this machine, units, archives."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
import sys
import zipfile
from pathlib import Path

import pytest

from sppm_pipeline.engine.cache.identity import imported_versions
from sppm_pipeline.engine.cli.main import main

SCHEMA = Path(sys.modules["sppm_pipeline"].__file__).parent / "engine" / "run" / "record.schema.json"
PIPELINE = """\
sppm: 1
name: ball
notes: {license: CC-BY-4.0, author: {name: A. Person, affiliation: A Laboratory}}
params: {part: PART}
pipeline:
  - {stage: read.mesh, path: "${part}", unit: mm}
  - {stage: write.mesh, path: again.ply}
"""
SWEEP = """\
sppm: 1
name: cells
params: {total: 8}
pipeline:
  - {stage: sample.dart_throwing, total: "${total}", edge: 3 mm}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.5 mm, tunnel_radius: 0.2 mm}
  - {stage: homogenize.voxel, resolution: 16, young: 1000, stress_unit: MPa, id: solid}
sweep: {total: [8, 9]}
"""


def run(folder: Path, name: str, *words: str) -> int:
    return main(["run", str(folder / name), "-q", "--no-cache", "--threads", "1", *words])


@pytest.fixture
def part(tmp_path):
    """A mesh in a folder beside that of the configuration, which names it absolutely."""
    (tmp_path / "parts").mkdir()
    ball = "sppm: 1\npipeline:\n- {stage: read.primitive, shape: ball, size: [6 mm, 6 mm, 6 mm]}\n"
    (tmp_path / "make.yaml").write_text(ball + "- {stage: write.mesh, path: ball.stl}\n")
    assert run(tmp_path, "make.yaml", "-o", str(tmp_path / "made")) == 0
    (tmp_path / "made" / "ball.stl").rename(tmp_path / "parts" / "ball.stl")
    (tmp_path / "job").mkdir()
    (tmp_path / "job" / "ball.yaml").write_text(PIPELINE.replace("PART", str(tmp_path / "parts" / "ball.stl")))
    return tmp_path


def test_records_keep_to_their_schema_and_name_no_absolute_path(part, capsys):
    from jsonschema import Draft202012Validator

    assert main(["schema", "--record"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert schema == json.loads(SCHEMA.read_text())
    Draft202012Validator.check_schema(schema)
    (part / "job" / "cells.yaml").write_text(SWEEP)
    assert run(part / "job", "cells.yaml", "-o", str(part / "sweep")) == 0
    assert run(part / "job", "ball.yaml", "-o", str(part / "run")) == 0
    (part / "parts" / "bad.stl").write_text("solid")
    assert run(part / "job", "ball.yaml", "-o", str(part / "broken"), "-p", f"part={part}/parts/bad.stl") == 3
    records = sorted(part.glob("*/run.json")) + sorted(part.glob("sweep/runs/*/run.json"))
    assert len(records) == 6
    for path in records:
        text = path.read_text()
        assert [error.message for error in Draft202012Validator(schema).iter_errors(json.loads(text))] == []
        assert str(part) not in text
    record = json.loads((part / "run" / "run.json").read_text())
    assert (record["config"]["folder"], record["file"]) == ("../job", "ball.yaml")
    assert record["config"]["params"] == {"part": "../parts/ball.stl"}
    wrong = json.loads((part / "broken" / "run.json").read_text())["error"]
    assert "bad.stl" in wrong["message"]
    broken = record | {"file": "/home/a.yaml", "status": "well"}
    assert len(list(Draft202012Validator(schema).iter_errors(broken))) == 2


def test_a_run_and_what_it_reads_move_together(part, tmp_path_factory):
    assert run(part / "job", "ball.yaml", "-o", str(part / "run")) == 0
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "all"
    shutil.move(part, elsewhere)
    assert run(elsewhere / "run", "run.json", "-o", str(elsewhere / "second")) == 0
    assert (elsewhere / "second" / "again.ply").read_bytes() == (elsewhere / "run" / "again.ply").read_bytes()


def test_versions_are_those_of_all_imported_distributions(part):
    assert run(part / "job", "ball.yaml", "-o", str(part / "run")) == 0
    found = json.loads((part / "run" / "run.json").read_text())["versions"]
    import numpy
    import pytest

    assert found["numpy"] == numpy.__version__
    assert found["pytest"] == pytest.__version__  # imported by this process, if not by the run
    assert {"pluggy", "ruamel-yaml", "scipy"} <= set(found)
    assert not any(name.startswith("_") or name in sys.stdlib_module_names for name in imported_versions())


def test_columns_of_a_sweep_state_type_and_unit(tmp_path):
    (tmp_path / "cells.yaml").write_text(SWEEP)
    assert run(tmp_path, "cells.yaml", "-o", str(tmp_path / "sweep")) == 0
    about = json.loads((tmp_path / "sweep" / "sweep.csv-metadata.json").read_text())
    columns = {column["titles"]: column for column in about["tableSchema"]["columns"]}
    with (tmp_path / "sweep" / about["url"]).open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(columns) == list(rows[0])
    assert columns["run"]["datatype"] == columns["status"]["datatype"] == "string"
    assert columns["total"]["datatype"] == "integer"
    for name, column in columns.items():
        if column["datatype"] != "string":
            [float(row[name]) for row in rows if row[name] != about["null"]]
    units = {name: column["schema:unitText"] for name, column in columns.items() if "schema:unitText" in column}
    assert units["solid.E.1"] == units["solid.C.4.4"] == "MPa"
    assert "solid.porosity" not in units


def test_a_bundle_runs_again_elsewhere_to_the_same_bytes(part, tmp_path_factory):
    archive = part / "ball.zip"
    assert run(part / "job", "ball.yaml", "-o", str(part / "run"), "--bundle", str(archive)) == 0
    first = archive.read_bytes()
    crate = tmp_path_factory.mktemp("crate")
    with zipfile.ZipFile(archive) as file:
        file.extractall(crate)
    shutil.rmtree(part / "parts")
    assert run(crate, "pipeline.yaml", "-o", str(crate / "again")) == 0
    assert (crate / "again" / "again.ply").read_bytes() == (crate / "run" / "again.ply").read_bytes()
    assert main(["verify", str(crate / "run")]) == 0
    graph = {one["@id"]: one for one in json.loads((crate / "ro-crate-metadata.json").read_text())["@graph"]}
    root, action = graph["./"], graph["#run"]
    assert graph["ro-crate-metadata.json"]["conformsTo"]["@id"] == "https://w3id.org/ro/crate/1.1"
    license, author = graph[root["license"]["@id"]], graph[action["agent"]["@id"]]
    assert (license["@id"], author["name"]) == ("https://spdx.org/licenses/CC-BY-4.0", "A. Person")
    assert graph[author["affiliation"]["@id"]] == {
        "@id": "#affiliation",
        "@type": "Organization",
        "name": "A Laboratory",
    }
    parts = {one["@id"] for one in root["hasPart"]}
    assert parts == {"pipeline.yaml", "inputs/ball.stl", "run/again.ply", "run/run.json", "run/SHA256SUMS"}
    assert {one["@id"] for one in action["result"]} == {name for name in parts if name.startswith("run/")}
    assert parts == {one["@id"] for one in action["result"] + action["object"]}
    for name in parts:
        data = (crate / name).read_bytes()
        assert graph[name]["sha256"] == hashlib.sha256(data).hexdigest()
        assert graph[name]["contentSize"] == str(len(data))
    assert first == archive.read_bytes()


def test_what_to_cite(tmp_path, capsys):
    (tmp_path / "job.yaml").write_text(
        "sppm: 1\npipeline:\n- {stage: sample.elimination, count: 20}\n- {stage: connect.mbdst}\n"
    )
    assert main(["cite", str(tmp_path / "job.yaml")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "[2] Z. Wang, L. Tian, X. Liu, A. Sharf, L. Lu: Stochastic Porous Microstructures" in said
    assert "[3] sample.elimination: C. Yuksel" in said
    assert "[4] connect.mbdst: M. Singh" in said
    assert main(["cite"]) == 0
    assert "[3]" not in capsys.readouterr().out
