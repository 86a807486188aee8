"""What type checkers, editors and `help` know of stages: from their options and ports."""

import inspect
import pydoc
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.cli.stubs import stub_text
from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.engine.plan.registry import Registry

ROOT = Path(sppm.__file__).parents[1]
CODE = """
import sppm_pipeline as sppm

pores = sppm.sample.dart_throwing(total=66, share=0.55, seed=1)
throw = sppm.sample.dart_throwing(total=66, share=0.55)
graph: sppm.TunnelGraph = sppm.connect.mbdst(pores, mode="greedy", seed=1)
cell: sppm.Microstructure = sppm.field.gaussian(pore_radius="0.5 mm", tunnel_radius=0.04)(graph)
E = sppm.homogenize.voxel(resolution=64)(cell).C[0, 0]
ball: sppm.SurfaceMesh = sppm.read.primitive(shape="ball", size=[1, 2, 3])
wide = sppm.cell("paper", porosity=0.6, seed=1, pore_radius=0.13, hold="pore_radius")
tuned = sppm.tune.porosity(target=sppm.param("porosity"), recipe=[throw, sppm.connect.mbdst()])
files = [path.name for path in sppm.write.mesh(ball, path="ball.stl")]
"""
MISTAKES = {
    "sppm.smaple.dart_throwing(total=66)": "smaple",
    "sppm.sample.dart_throwing(totl=66, seed=1)": "totl",
    'sppm.sample.dart_throwing(total="many", seed=1)': "str",
    "sppm.step.connect.mbdst(modes='greedy')": "modes",
    "sppm.connect.mbdst(cell, seed=1)": "Microstructure",
    "sppm.field.gaussian(pore_radius=0.1)(pores)": "PoreSet",
    "throw.centers": "centers",
    'sppm.cell("paper", seed=1, radius=0.1)': "radius",
    'sppm.cell("paper", seed=1, total="many")': "str",
    "sppm.connect.mbdst(pores, mode='greedyy')": "mbdst",
}


def test_the_stub_in_the_package_is_that_of_the_stages(capsys, tmp_path):
    text = stub_text(Registry(load_plugins(distributions=False)))
    file = ROOT / "sppm_pipeline" / "engine" / "api" / "stages.pyi"
    assert file.read_text(encoding="utf-8") == text, "sppm stubs > sppm_pipeline/engine/api/stages.pyi"
    assert main(["stubs"]) == 0
    assert capsys.readouterr().out == text
    assert main(["stubs", "--plugins", "-o", str(tmp_path)]) == 0
    found = tmp_path / "sppm_pipeline-stubs"
    assert (found / "py.typed").read_text() == "partial\n"
    with_plugins = (found / "engine" / "api" / "stages.pyi").read_text(encoding="utf-8")
    assert set(text.split()) - set(with_plugins.split()) == {"Any"}  # the family crush, which plugins alone fill
    assert "\ncrush: Any\n" in text
    assert "\ncrush: _Crush\n" in with_plugins


def errors_of(command, tmp_path):
    """The lines that a type checker finds fault with."""
    file = tmp_path / "script.py"
    file.write_text(CODE + "\n".join(MISTAKES) + "\n", encoding="utf-8")
    found = subprocess.run([*command, str(file)], capture_output=True, text=True, cwd=ROOT).stdout
    lines = [line for line in found.splitlines() if ": error:" in line or " - error:" in line]
    by_line: dict[int, str] = {}
    for line in lines:
        number = int(line.split("script.py:")[1].split(":")[0])
        by_line[number] = by_line.get(number, "") + line
    return by_line, found


CHECKERS = {"mypy": [sys.executable, "-m", "mypy"], "pyright": ["pyright", "--pythonpath", sys.executable]}


@pytest.mark.parametrize("checker", CHECKERS)
def test_mistakes_are_found_before_anything_runs(checker, tmp_path):
    command = CHECKERS[checker]
    if not shutil.which(command[0]):
        pytest.skip(f"{checker} is not installed")
    errors, text = errors_of(command, tmp_path)
    first = CODE.count("\n") + 1
    assert sorted(errors) == list(range(first, first + len(MISTAKES))), text
    if checker == "mypy":
        for line, word in zip(sorted(errors), MISTAKES.values(), strict=True):
            assert word in errors[line]


def test_stages_that_start_and_draw_random_numbers_say_so():
    registry = Registry(load_plugins(distributions=False))
    starting = [cls for cls in map(registry.get, registry) if all(port.optional for port in signature_of(cls).ports)]
    drawing = {c.name for c in starting if "context.rng" in inspect.getsource(sys.modules[c.__module__])}
    random = {cls.name for cls in starting if cls.is_random}
    assert {"sample.dart_throwing", "sample.mirrored_faces"} <= drawing <= random
    assert "read.primitive" not in random


def test_help_lists_options_with_unit_bounds_and_default():
    text = pydoc.plain(pydoc.render_doc(sppm.field.gaussian))
    assert text.splitlines()[0].endswith("function gaussian in module sppm_pipeline")
    assert "graph : TunnelGraph" in text
    assert "level : a number, at least 0.001, at most 0.999; default 0.25" in text
    assert "pore_radius : a length in cell size" in text
    listed = pydoc.plain(pydoc.render_doc(sppm.fix))
    for name in ("drains", "fill"):
        assert re.search(rf"{name}\(\s*\*artifacts", listed)  # from Python 3.13 on, long lines are broken


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("sppm.sa", "sample"),
        ("sppm.crush.v", "voxel"),
        ("sppm.sample.dart", "dart_throwing"),
        ("sppm.step.sam", "sample"),
        ("sppm.step.sample.dart", "dart_throwing"),
        ("sppm.sample.dart_throwing(sh", "share="),
        ("sppm.step.sample.dart_throwing(sh", "share="),
    ],
)
def test_completion_without_jedi(text, wanted):
    from IPython.core.completer import IPCompleter, provisionalcompleter
    from IPython.core.interactiveshell import InteractiveShell

    shell = InteractiveShell.instance()
    completer = IPCompleter(shell=shell, namespace={"sppm": sppm}, use_jedi=False)
    with provisionalcompleter():
        found = [one.text for one in completer.completions(text, len(text))]
    assert any(word.endswith(wanted) for word in found), found


def test_dir_offers_nothing_that_fails():
    for family in (name for name in dir(sppm.step)):
        for word in dir(getattr(sppm.step, family)):
            if family != "load":  # `sppm.load` reads run directories
                assert callable(getattr(getattr(sppm, family), word))
            assert callable(getattr(getattr(sppm.step, family), word))
    for name in dir(sppm):
        assert getattr(sppm, name) is not None
