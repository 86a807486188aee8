"""Workflows of the forge are files that it reads, and what they call is there."""

from __future__ import annotations

import importlib.util
import itertools
import os
import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted(path for end in ("yml", "yaml") for path in (ROOT / ".github").rglob(f"*.{end}"))
WORKFLOWS = [path for path in FILES if path.parent.name == "workflows"]
OWN = re.compile(r"(?<![\w/.-])((?:\.ci|tests|docs|benchmarks|configs)/[\w./-]*\w)")
TARGETS = set(re.findall(r"(?m)^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8")))


def read(path):
    """With an error for a key that is there twice; `on` stays a word."""
    yaml = YAML(typ="safe", pure=True)
    return yaml.load(path)


def commands(workflow):
    """What the steps run."""
    for job in workflow["jobs"].values():
        yield from (step["run"] for step in job.get("steps", ()) if "run" in step)


def called(command):
    """Files of the repository that a command names, and targets of make."""
    return set(OWN.findall(command)), set(re.findall(r"(?:^|[;&|]\s*)make ([\w-]+)", command, re.M))


def test_what_a_command_calls_is_found():
    assert called("pip install uv && make lock && .ci/install") == ({".ci/install"}, {"lock"})
    assert called("make test\npython .ci/release.py --check || echo") == ({".ci/release.py"}, {"test"})
    assert called("pip install dist/sppm_pipeline-*.whl; sppm verify runs/quickstart") == (set(), set())


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_files_of_the_forge_are_yaml(path):
    assert isinstance(read(path), dict)


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_call_what_is_there(path):
    workflow = read(path)
    assert {"name", "on", "permissions", "jobs"} <= set(workflow)
    for job in workflow["jobs"].values():
        needed = job.get("needs", [])
        assert set([needed] if isinstance(needed, str) else needed) <= set(workflow["jobs"])
        assert "runs-on" in job or (ROOT / job["uses"]).is_file()
        for step in job.get("steps", ()):
            assert ("run" in step) != ("uses" in step)
            assert "run" in step or re.fullmatch(r"[\w.-]+/[\w.-]+@[\w./-]+", step["uses"])
            given = step.get("with", {})
            assert all((ROOT / given[key]).exists() for key in ("recipe-path", "cache-dependency-path") if key in given)
        used = set(re.findall(r"\$\{\{ matrix\.(\w+)", str(job)))
        assert used == set(job.get("strategy", {}).get("matrix", {}))
    for command in commands(workflow):
        plain = re.sub(r"\$\{\{.*?\}\}", "value", command)
        assert subprocess.run(["bash", "-n"], input=plain, text=True, check=False).returncode == 0, command
        files, targets = called(plain)
        assert targets <= TARGETS, command
        for file in files:
            assert (ROOT / file).is_file(), command
            if re.search(rf"(?:^|&&|;)\s*{re.escape(file)}", command):
                assert os.access(ROOT / file, os.X_OK), f"{file} is not executable"


def test_an_artifact_that_is_fetched_was_kept():
    steps = [step for path in WORKFLOWS for job in read(path)["jobs"].values() for step in job.get("steps", ())]
    kept = [s["with"].get("name", "") for s in steps if s.get("uses", "").startswith("actions/upload-artifact@")]
    fetched = [s["with"]["pattern"] for s in steps if s.get("uses", "").startswith("actions/download-artifact@")]
    known = {name.partition("-")[0] for name in kept}
    wanted = set(itertools.chain(*(re.findall(r"[{,](\w+)", pattern) for pattern in fetched)))
    assert wanted
    assert wanted <= known


def test_kernels_are_built_for_what_is_tested():
    """Each version of Python in the tests gets machine code; those that the project names are among them."""
    tested, built = (
        set(read(ROOT / f".github/workflows/{name}.yml")["jobs"][job]["strategy"]["matrix"]["python"])
        for name, job in (("tests", "tests"), ("wheels", "kernels"))
    )
    named = set(re.findall(r"Python :: (3\.\d+)", (ROOT / "pyproject.toml").read_text(encoding="utf-8")))
    assert tested == built
    assert named <= tested


def test_the_badge_says_the_share_of_lines():
    spec = importlib.util.spec_from_file_location("badge", ROOT / ".ci" / "badge.py")
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    picture = ElementTree.fromstring(made.badge(89.96))  # not rounded up
    assert picture.get("aria-label") == "coverage: 89 %"
    assert made.COLORS[1][1] in made.badge(89.96)
    assert made.COLORS[0][1] in made.badge(90.0)
