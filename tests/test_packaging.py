"""The wheel and the source archive are whole: the program runs from a wheel, in another folder."""

from __future__ import annotations

import email
import importlib.util
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

from sppm_pipeline.engine.plan.kernels import kernels_of, listed_kernels, stages_of
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.services.jit import compiling, machine_code
from sppm_pipeline.services.jit.kernel_cache import kernel_cache_folder, source_of

ROOT = Path(__file__).resolve().parents[1]
_spec = importlib.util.spec_from_file_location("release", ROOT / ".ci" / "release.py")
release = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(release)
OWN = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
"""What programs of the fresh environment inherit: no folder of these sources."""
KNOWN = {"repository": "https://forge.example/sppm/sppm_pipeline", "contact": "security@sppm.example"}


def build(folder: Path) -> Path:
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", str(folder)],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    return folder


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    return build(tmp_path_factory.mktemp("dist"))


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
        # a report takes the field of its live view from the cache
        env={**OWN, "SPPM_CACHE": str(folder / "cache"), "NUMBA_CACHE_DIR": str(folder / "kernels")},
    )  # fmt: skip


@pytest.fixture(scope="module")
def shipped(environment) -> set[str]:
    """Kernels of the quickstart, as `package.module:name`, whose machine code is made here and installed there."""
    if not machine_code.usable() or machine_code.target() != machine_code.LEVEL:
        return set()
    plan = open_session(RunRequest(str(ROOT / "configs" / "quickstart.yaml"))).plan()
    kernels = kernels_of(stages_of(plan), listed_kernels())
    libraries = Path(sysconfig.get_path("purelib", vars={"base": str(environment)}))
    folder = libraries / machine_code.SHIPPED
    folder.mkdir(mode=0o755)
    (folder / "__init__.py").touch()
    for kernel in kernels:
        source, name = source_of(kernel.place)
        there = kernel_cache_folder(source)
        if len(list(there.glob(f"{name}-*.code"))) < len(kernel.signatures):
            compiling.compile_kernel(kernel.place, kernel.signatures)
        for file in there.glob(f"{name}-*.code"):
            shutil.copy(file, folder)
    return {kernel.place for kernel in kernels}


def test_the_wheel_runs_the_quickstart_from_another_folder(environment, shipped, tmp_path):
    """Its kernels have the machine code that was made of the sources here, but for those of one run."""
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
        cwd=tmp_path, capture_output=True, text=True, check=True, env=OWN,
    )  # fmt: skip
    assert Path(where.stdout.strip()).is_relative_to(environment)
    compiled = {file.name.partition("-")[0] for file in (tmp_path / "kernels").rglob("*.code")}
    assert compiled
    assert compiled.isdisjoint(place.partition(":")[2] for place in shipped)


def test_each_example_is_found_by_name(environment, tmp_path):
    code = "import sys; from sppm_pipeline.engine.plan.session import find_configuration as find\n"
    code += "for name in sys.argv[1:]: print(find(name))"
    names = [file.stem for folder in ("configs", "examples") for file in sorted((ROOT / folder).glob("*.yaml"))]
    found = subprocess.run(
        [str(environment / "bin" / "python"), "-c", code, *names],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=OWN,
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
        for file in (ROOT / folder).rglob("*"):
            if "__pycache__" in file.parts:
                continue
            assert file.is_dir() or f"sppm_pipeline/{file.relative_to(ROOT).as_posix()}" in inside
    data = [
        ROOT / "sppm_pipeline" / name
        for name in (
            "features/browser/live/assets",
            "features/browser/report/assets",
            "features/browser/report/templates",
            "features/browser/studio",
        )
    ]
    files = [file for folder in data for file in folder.rglob("*.*")]
    written = {f.relative_to(ROOT).as_posix() for f in files if f.is_file() and f.suffix != ".pyc"}
    assert len(written) > 15
    assert written <= set(inside)
    metadata = zipfile.ZipFile(wheel).read(next(n for n in inside if n.endswith("METADATA"))).decode()
    assert "License-Expression: BSD-3-Clause" in metadata
    assert "Description-Content-Type: text/markdown" in metadata
    with tarfile.open(source) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True).stdout.split("\n")
    missing = {name for name in tracked if name and (ROOT / name).exists()} - names
    assert missing == set()


def test_a_second_build_is_the_same_bytes(built, tmp_path):
    again = build(tmp_path)
    names = sorted(file.name for file in built.iterdir())
    assert names == sorted(file.name for file in again.iterdir())
    assert all((built / name).read_bytes() == (again / name).read_bytes() for name in names)


def links_of(text: str) -> list[str]:
    return [found["target"] for found in release._LINK.finditer(text)]


def test_no_link_of_the_readme_dies_in_an_index(built):
    """Relative links of README.md lead nowhere there: they become absolute, or text while no address is known."""
    (wheel,) = built.glob("*.whl")
    archive = zipfile.ZipFile(wheel)
    name = next(name for name in archive.namelist() if name.endswith("METADATA"))
    metadata = email.message_from_bytes(archive.read(name))
    assert all(re.match(r"https?:|#", target) for target in links_of(metadata.get_payload()))
    source, version = (ROOT / "README.md").read_text(encoding="utf-8"), release.version_of(ROOT)
    text = release.readme(source, release.settings(ROOT) | KNOWN, version)
    absolute = links_of(text)
    assert len(absolute) == len(links_of(source)) > 40
    assert f"{KNOWN['repository']}/raw/v{version}/docs/pictures/turning.png" in absolute
    assert f"{KNOWN['repository']}/blob/v{version}/docs/explanation/paper.md#graded-structures" in absolute
    assert all(target.startswith("https://") for target in absolute)
    bare = release.readme(source, release.settings(ROOT) | {"repository": ""}, version)
    assert links_of(bare) == []
    assert "CHANGELOG.md" in bare


def test_addresses_stand_in_one_place():
    known = release.settings(ROOT) | KNOWN
    assert release.urls(release.settings(ROOT) | {"repository": ""}, "0.1.0") == {}
    urls = release.urls(known, "0.1.0")
    assert urls["Repository"] == KNOWN["repository"]
    assert urls["Changelog"].endswith("/blob/v0.1.0/CHANGELOG.md")
    assert {path.read_text(encoding="utf-8") == text for path, text in release.written(ROOT)} == {True}
    filled = {path.name: text for path, text in release.written(ROOT, known | {"paper_arxiv": "2501.01234"})}
    assert all("security@sppm.example" in filled[name] for name in ("SECURITY.md", "CODE_OF_CONDUCT.md"))
    assert f'repository-code: "{KNOWN["repository"]}"' in filled["CITATION.cff"]
    assert "doi: 10.48550/arXiv.2501.01234" in filled["CITATION.cff"]


def test_a_release_without_addresses_is_refused(tmp_path):
    for name in (*release.MARKED, ".ci/project.toml", "pyproject.toml", "sppm_pipeline/__init__.py", "CHANGELOG.md"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    settings, changes = tmp_path / ".ci" / "project.toml", tmp_path / "CHANGELOG.md"
    text = re.sub(r'(?m)^(repository|contact) = ".*?"', r'\1 = ""', settings.read_text(encoding="utf-8"))
    settings.write_text(text, encoding="utf-8")
    found = release.problems(tmp_path)
    assert ".ci/project.toml: repository is empty" in found
    assert ".ci/project.toml: contact is empty" in found
    for name, value in KNOWN.items():
        text = text.replace(f'{name} = ""', f'{name} = "{value}"')
    settings.write_text(text, encoding="utf-8")
    version = release.version_of(tmp_path)
    changes.write_text(re.sub(r"(?m)^## \[.*$", f"## [{version}] - 2026-12-01", changes.read_text(encoding="utf-8")))
    assert any("is stale" in line for line in release.problems(tmp_path))
    for path, new in release.written(tmp_path):
        path.write_text(new, encoding="utf-8")
    assert release.problems(tmp_path, tag=f"v{version}") == []
    assert "\ndate-released: 2026-12-01\n" in (tmp_path / "CITATION.cff").read_text(encoding="utf-8")
    assert release.problems(tmp_path, tag="v9.0.0") == [f"the tag v9.0.0 is not v{version}"]
    settings.write_text(text.replace("security@", "security at "), encoding="utf-8")
    assert any("contact is neither" in line for line in release.problems(tmp_path))


def test_what_continuous_integration_installs_is_all_that_is_needed():
    """Each requirement is in the lock, with hashes, and so is each of the recipe for conda with the same bound."""
    lock = (ROOT / ".ci" / "lock.txt").read_text(encoding="utf-8")
    locked = set(re.findall(r"(?m)^([\w.-]+)(?:\[.*?\])?==\S+.*\\$", lock))
    assert len(locked) == len(set(re.findall(r"(?m)^([\w.-]+)(?:\[.*?\])?==", lock))) > 50
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = [*project["dependencies"], *itertools.chain(*project["optional-dependencies"].values())]
    own = {"sppm-pipeline"}
    for plugin in (ROOT / "plugins").glob("*/pyproject.toml"):
        distribution = tomllib.loads(plugin.read_text())["project"]
        needed += distribution["dependencies"]
        own.add(distribution["name"])
    names = {re.match(r"[\w.-]+", one)[0].lower().replace(".", "-") for one in needed} - {"pyvista"}
    assert names - own - locked == set()
    recipe = (ROOT / ".ci" / "conda" / "recipe.yaml").read_text(encoding="utf-8").replace(" >=", ">=")
    assert all(f"- {one}\n" in recipe for one in project["dependencies"])
    assert f'version: "{project["version"]}"' in recipe


def test_lower_bounds_are_those_that_are_tested():
    """`make test-oldest` installs what the project promises to work with."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = [*project["dependencies"], *itertools.chain(*project["optional-dependencies"].values())]
    tetrahedra = tomllib.loads((ROOT / "plugins" / "sppm-tetrahedra" / "pyproject.toml").read_text())["project"]
    needed += [one for one in tetrahedra["dependencies"] if "<" not in one]
    bounds = dict(re.fullmatch(r"([\w.-]+)>=([\d.]+)", one).groups() for one in needed)
    lines = (line.partition("#")[0].strip() for line in (ROOT / "tests" / "oldest.txt").read_text().splitlines())
    tested = dict(line.split("==") for line in lines if line)
    assert {name: bounds.get(name) for name in tested if name != "pyparsing"} == {
        name: version for name, version in tested.items() if name != "pyparsing"
    }
    assert {re.match(r"[\w.-]+", one)[0] for one in project["dependencies"]} <= set(tested)
