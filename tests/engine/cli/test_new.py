"""What ``sppm new`` writes is valid, installed by its entry point, and passes its own tests."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.cli.new import DESIGNS, FORMER_KINDS, KINDS, PLUGINS_PAGE, TEMPLATES


def test_a_new_pipeline_is_a_valid_one(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "pipeline", "first"]) == 0
    assert main(["check", "first.yaml", "--no-plugins"]) == 0
    assert "first.ply" in Path("first.yaml").read_text()
    assert main(["new", "pipeline", "first"]) == 2
    assert "nothing is overwritten" in capsys.readouterr().err
    assert main(["new", "pipeline", "../x"]) == 2
    assert main(["new", "pipeline", "second", "--kind", "field"]) == 2
    assert "sppm new plugin second --kind field" in capsys.readouterr().err


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder with a plugin of each kind, and ``site`` with what an installation of them leaves."""
    folder = tmp_path_factory.mktemp("new")
    for kind in KINDS:
        root = folder / f"sppm-my-{kind}"
        assert main(["new", "plugin", root.name, "--kind", kind, "-o", str(folder)]) == 0
        project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
        information = folder / "site" / f"{root.name.replace('-', '_')}-{project['version']}.dist-info"
        information.mkdir(parents=True)
        (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0.1.0\n")
        entries = [f"{name} = {module}" for name, module in project["entry-points"]["sppm"].items()]
        (information / "entry_points.txt").write_text("\n".join(["[sppm]", *entries, ""]))
    return folder


@pytest.fixture(scope="module")
def outcomes(made) -> dict[str, list[str]]:
    """What became of the tests of each plugin: run together, as most of the time goes into imports."""
    report = made / "report.xml"
    (made / "pytest.ini").write_text("[pytest]\n")  # else the settings of the first plugin count for all
    roots = [str(made / f"sppm-my-{kind}") for kind in KINDS]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-W", "error", "-p", "no:cacheprovider", "--import-mode=importlib",
         f"--junitxml={report}", *roots],
        cwd=made, env=environment(made), capture_output=True, text=True, check=False,
    )  # fmt: skip
    found: dict[str, list[str]] = {kind: [] for kind in KINDS}
    for case in ElementTree.parse(report).iter("testcase"):
        kind = case.attrib["classname"].split(".")[0].removeprefix("sppm-my-")
        found[kind].append("".join(f"{case.attrib['name']}: {child.text}" for child in case))
    assert any(found.values()), done.stdout + done.stderr
    return found


def environment(made: Path, *more: str) -> dict[str, str]:
    """That of an installation."""
    folders = [str(made / "site"), *(str(made / f"sppm-my-{kind}") for kind in KINDS), *more]
    return {**os.environ, "PYTHONPATH": os.pathsep.join([*folders, *sys.path]), "PYTHONDONTWRITEBYTECODE": "1"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_plugin_is_found_and_passes_its_own_tests(kind, made, outcomes, monkeypatch, capsys):
    root = made / f"sppm-my-{kind}"
    monkeypatch.syspath_prepend(made / "site")
    monkeypatch.syspath_prepend(root)
    assert main(["check", str(root / "example.yaml"), "--allow-plugins", root.name]) == 0, capsys.readouterr().err
    family = KINDS[kind].family
    assert f"{family}.my_{kind}" in (root / "example.yaml").read_text()
    assert f"sppm.{kind}" not in (root / "README.md").read_text()
    for path in root.rglob("*.*"):
        if path.is_file() and path.suffix != ".pyc":
            assert not any(word in path.read_text() for word in ("my_word", "my_plugin", "my_module"))
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    assert project["license"] == {"text": "BSD-3-Clause"}
    assert f"authors of {root.name}" in (root / "LICENSE").read_text()
    assert project["dependencies"] == ["sppm-pipeline>=0.1,<0.4"]
    assert [outcome for outcome in outcomes[kind] if outcome] == []
    assert len(outcomes[kind]) > 3


def test_the_tests_of_a_new_plugin_run_before_it_is_installed(made):
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "without_jitter"],
        cwd=made / "sppm-my-sampler", capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout


@pytest.mark.parametrize("kind", FORMER_KINDS)
def test_a_kind_without_a_template_is_explained(kind, tmp_path, capsys):
    assert main(["new", "plugin", "mine", "--kind", kind, "-o", str(tmp_path)]) == 2
    path, _, anchor = PLUGINS_PAGE.partition("#")
    assert PLUGINS_PAGE in capsys.readouterr().err
    section = (
        (Path(__file__).parents[3] / path).read_text().partition(f"### {anchor.replace('-', ' ').capitalize()}\n")[2]
    )
    assert f"A **{'tile rule' if kind == 'tiler' else kind}** is" in section.replace("An", "A")
    assert not list(tmp_path.iterdir())


def test_names_that_would_not_do(made, capsys):
    assert main(["new", "plugin", "sppm-my-field", "-o", str(made)]) == 2
    assert "nothing is overwritten" in capsys.readouterr().err
    assert main(["new", "plugin", "sppm_pipeline", "-o", str(made)]) == 2


def test_each_kind_has_a_stage_that_is_short():
    assert {path.name for path in TEMPLATES.iterdir() if path.is_dir()} == {*KINDS, "plugin", "designs"}
    for kind, (_, place, _) in KINDS.items():
        module, _, name = place.partition(":")
        text = (TEMPLATES / kind / "my_plugin" / f"{module}.py").read_text()
        assert 10 <= len(text.partition(f"class {name}(")[2].splitlines()) <= 30


@pytest.fixture
def part(tmp_path) -> Path:
    (tmp_path / "parts").mkdir()
    path = tmp_path / "parts" / "my part.off"
    path.write_text("OFF\n4 4 0\n0 0 0\n30 0 0\n0 30 0\n0 0 30\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n")
    return path


@pytest.mark.parametrize("kind", DESIGNS)
@pytest.mark.parametrize(("printer", "writer"), [(None, "write.png"), ("elegoo_mars_4", "write.goo")])
def test_a_design_for_a_mesh_is_a_valid_one(kind, printer, writer, part, tmp_path, capsys):
    folder = tmp_path / "out"
    arguments = ["new", kind, str(part), "-o", str(folder), *(["--printer", printer] if printer else [])]
    assert main(arguments) == 0
    path = folder / f"my_part_{kind}.yaml"
    text = path.read_text()
    assert f"stage: {writer}" in text
    assert (printer or "pixel: 0.05 mm") in text
    assert f"name: my_part_{kind}\n" in text
    assert 'path: "../parts/my part.off"' in text
    assert main(["check", str(path), "--no-plugins"]) == 0, capsys.readouterr().err
    assert main(arguments) == 2
    assert "nothing is overwritten" in capsys.readouterr().err


def test_every_printer_has_a_writer(part, tmp_path):
    from sppm_pipeline.nouns import cards

    for name in sorted({card.format: name for name, card in cards().printers.items()}.values()):
        assert main(["new", "cage", str(part), "-o", str(tmp_path / name), "--printer", name]) == 0
        assert main(["check", str(tmp_path / name / "my_part_cage.yaml"), "--no-plugins"]) == 0


def test_designs_that_can_not_be(part, capsys):
    assert main(["new", "cage", str(part), "--printer", "inkjet"]) == 2
    assert "no printer 'inkjet'" in capsys.readouterr().err
    assert main(["new", "cage", "nothing.stl"]) == 2
    assert "is no file" in capsys.readouterr().err
