"""The plugin in one file runs, named by the configuration or on the command line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from sppm_pipeline.engine.cli.main import main


def test_runs_as_the_configuration_names_it(tmp_path: Path, root: Path) -> None:
    folder = tmp_path / "run"
    file = root / "examples" / "single_file_plugin.yaml"
    lower = ["-s", "extract.marching_cubes.resolution=12", "-s", "check.connectivity.resolution=12"]
    assert main(["run", str(file), "-o", str(folder), "-q", *lower]) == 0
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert record["stages"][0]["stage"] == "sample.uniform"
    assert record["stages"][0]["summary"]["pores"] == 40
    assert (folder / "cell.ply").stat().st_size > 1000


def test_runs_as_the_command_line_names_it(tmp_path: Path, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (root / "examples" / "single_file_plugin.yaml").read_text(encoding="utf-8")
    file = tmp_path / "without.yaml"
    file.write_text(re.sub(r"^plugins:.*\n", "", text, flags=re.MULTILINE), encoding="utf-8")
    assert main(["check", str(file)]) == 2
    assert "sample.uniform" in capsys.readouterr().err
    assert main(["check", str(file), "--plugin", str(root / "examples" / "uniform_sampler.py")]) == 0


def test_keeps_the_contract_of_samplers(root: Path) -> None:
    from sppm_pipeline.engine.plan.plugins import load_plugins
    from sppm_pipeline.testing.contracts import SamplerContract

    (plugin,) = load_plugins([], files=[root / "examples" / "uniform_sampler.py"], distributions=False).plugins
    uniform = plugin.stages["sample.uniform"]
    assert not isinstance(uniform, str)

    class Suite(SamplerContract):
        def stages(self):
            return [uniform(count=1), uniform(count=30)]

    tests = [name for name in dir(Suite) if name.startswith("test_")]
    assert len(tests) > 8
    for name in tests:
        getattr(Suite(), name)()
