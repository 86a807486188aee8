"""A voxel physics in 60 lines of a stranger, who has the public services alone, agrees with the one built in."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.plan.plugins import import_file

PLUGIN = Path(__file__).with_name("conduction") / "conduction.py"
RUN = """\
sppm: 1
pipeline:
  - {stage: sample.dart_throwing, total: 20}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.08}
  - {stage: homogenize.conduct, resolution: 16, id: own}
  - {stage: homogenize.conductivity, resolution: 16, of: solid, grids: 1, id: built_in, precision: double,
     residual: 1.0e-8}
"""


def test_it_is_short_and_imports_public_names_alone():
    text = PLUGIN.read_text(encoding="utf-8")
    assert sum(bool(line.strip()) for line in text.splitlines()) <= 60
    imported = [node for node in ast.walk(ast.parse(text)) if isinstance(node, (ast.Import, ast.ImportFrom))]
    names = {alias.name if isinstance(node, ast.Import) else node.module for node in imported for alias in node.names}
    assert {name for name in names if name.startswith("sppm")} == {"sppm_pipeline"}
    used = {
        node.attr
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Attribute) and vars(node.value).get("id") == "num"
    }
    assert used <= set(sppm.numerics.__all__)


def test_laminates_exactly():
    conductivity = import_file(PLUGIN).conductivity
    k = np.ones((8, 8, 8))
    k[:2] = 3
    assert np.allclose(conductivity(k), np.diag([1.5, 1.5, 1 / (0.25 / 3 + 0.75)]), atol=1e-7)
    assert np.allclose(conductivity(k.transpose(2, 0, 1), (0.1, 0.2, 0.4)), np.diag([1.5, 1.2, 1.5]), atol=1e-7)
    assert np.allclose(conductivity(np.full((5, 6, 7), 0.3)), 0.3 * np.eye(3), atol=1e-9)


def test_it_runs_beside_the_one_built_in_and_agrees(tmp_path):
    (tmp_path / "run.yaml").write_text(RUN, encoding="utf-8")
    words = ["-o", str(tmp_path / "run"), "-q", "--no-cache", "--plugin", str(PLUGIN)]
    assert main(["run", str(tmp_path / "run.yaml"), *words]) == 0
    stages = {
        stage["id"]: stage["summary"] for stage in json.loads((tmp_path / "run" / "run.json").read_text())["stages"]
    }
    own, built_in = np.array(stages["own"]["k"]), np.array(stages["built_in"]["k"])
    assert own.trace() > 0.05
    assert np.allclose(own, built_in, atol=1e-5)


def test_against_the_operator_of_the_program_on_random_bricks():
    from sppm_pipeline.features.flow.numerics.conduction import conductivity as built_in

    k, edges = np.random.default_rng(1).random((12, 16, 10)) + 0.1, (0.3, 0.2, 0.5)
    expected = built_in(k, edges, tolerance=1e-10, precision=np.float64).conductivity
    assert import_file(PLUGIN).conductivity(k, edges) == pytest.approx(expected, abs=1e-9)
