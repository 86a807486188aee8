"""The wheel and the source archive are whole: the program runs from a wheel, in another folder."""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", str(folder)],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    return folder


@pytest.fixture(scope="module")
def environment(built, tmp_path_factory) -> Path:
    """A fresh environment with nothing but the wheel, which borrows the libraries it depends on."""
    folder = tmp_path_factory.mktemp("fresh") / "env"
    venv.create(folder, symlinks=True)
    (wheel,) = built.glob("*.whl")
    here, libraries = sysconfig.get_path("purelib"), sysconfig.get_path("purelib", vars={"base": str(folder)})
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--target", libraries, str(wheel)],
        check=True, capture_output=True,
    )  # fmt: skip
    borrowed = [here, *(line for file in Path(here).glob("*.pth") for line in file.read_text().splitlines())]
    folders = [line for line in borrowed if os.path.isdir(line) and not (Path(line) / "pyproject.toml").exists()]
    (Path(libraries) / "borrowed.pth").write_text("\n".join(folders) + "\n")
    return folder


def run(environment: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(environment / "bin" / "python"), "-m", "sppm_pipeline", *arguments],
        cwd=folder, capture_output=True, text=True, timeout=600,
        env={**os.environ, "SPPM_CACHE": str(folder / "cache")},  # a report takes the field of its live view from there
    )  # fmt: skip


def test_the_wheel_runs_the_quickstart_from_another_folder(environment, tmp_path):
    found = run(
        environment, tmp_path, "run", "quickstart", "-q", "--until", "write.png", "--report",
        "-s", "read.primitive.size=[8 mm, 8 mm, 8 mm]", "-s", "slice.field.pixel=0.2 mm",
        "-s", "tile.scattered.resolution=16", "-s", "fill.implicit.islands=remove", "--audit", "warn",
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    record = json.loads((tmp_path / "runs" / "quickstart" / "run.json").read_text())
    assert record["status"] == "done"
    assert len(list((tmp_path / "runs" / "quickstart" / "slices").glob("*.png"))) == 40
    report = (tmp_path / "runs" / "quickstart" / "report.html").read_text(encoding="utf-8")
    assert 'id="live-canvas"' in report
    where = subprocess.run(
        [str(environment / "bin" / "python"), "-c", "import sppm_pipeline; print(sppm_pipeline.__file__)"],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert Path(where.stdout.strip()).is_relative_to(environment)


def test_each_example_is_found_by_name(environment, tmp_path):
    code = "import sys; from sppm_pipeline.engine.plan.session import find_configuration as find\n"
    code += "for name in sys.argv[1:]: print(find(name))"
    names = [file.stem for folder in ("configs", "examples") for file in sorted((ROOT / folder).glob("*.yaml"))]
    found = subprocess.run(
        [str(environment / "bin" / "python"), "-c", code, *names], cwd=tmp_path, capture_output=True, text=True
    )
    assert found.stderr == ""
    paths = [Path(line) for line in found.stdout.split()]
    assert [path.stem for path in paths] == names
    assert all(path.is_relative_to(environment) for path in paths)
    checked = run(environment, tmp_path, "check", "single_file_plugin")
    assert checked.returncode == 0, checked.stderr


def test_the_archives_are_complete(built):
    (wheel,), (source,) = built.glob("*.whl"), built.glob("*.tar.gz")
    inside = zipfile.ZipFile(wheel).namelist()
    assert {f"sppm_pipeline/{name}" for name in ("py.typed", "engine/api/stages.pyi", "engine/plan/rates.json")} <= set(
        inside
    )
    assert any(name.endswith("licenses/LICENSE") for name in inside)
    for folder in ("configs", "examples"):
        for file in (ROOT / folder).iterdir():
            assert file.is_dir() or f"sppm_pipeline/{folder}/{file.name}" in inside
    data = [
        ROOT / "sppm_pipeline" / name
        for name in (
            "engine/cli/templates",
            "features/browser/live/assets",
            "features/browser/report/assets",
            "features/browser/report/templates",
            "features/browser/studio",
        )
    ]
    files = [file for folder in data for file in folder.rglob("*.*")]
    written = {f.relative_to(ROOT).as_posix() for f in files if f.is_file() and f.suffix != ".pyc"}
    assert len(written) > 38
    assert written <= set(inside)
    metadata = zipfile.ZipFile(wheel).read(next(n for n in inside if n.endswith("METADATA"))).decode()
    assert "License-Expression: BSD-3-Clause" in metadata
    assert "Description-Content-Type: text/markdown" in metadata
    with tarfile.open(source) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True).stdout.split("\n")
    missing = {name for name in tracked if name and (ROOT / name).exists()} - names
    assert missing == set()


def test_lower_bounds_are_those_that_are_tested():
    """`make test-oldest` installs what the project promises to work with."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = [*project["dependencies"], *itertools.chain(*project["optional-dependencies"].values())]
    bounds = dict(re.fullmatch(r"([\w.-]+)>=([\d.]+)", one).groups() for one in needed)
    lines = (line.partition("#")[0].strip() for line in (ROOT / "tests" / "oldest.txt").read_text().splitlines())
    tested = dict(line.split("==") for line in lines if line)
    assert {name: bounds.get(name) for name in tested if name != "pyparsing"} == {
        name: version for name, version in tested.items() if name != "pyparsing"
    }
    assert {re.match(r"[\w.-]+", one)[0] for one in project["dependencies"]} <= set(tested)
