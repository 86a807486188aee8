"""Plugins that are half finished or mean harm, as installed distributions: each is named, everything else works."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import textwrap
import time

import pytest

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.process import containment
from sppm_pipeline.errors import PluginError

HEAD = """
import os, sys, time
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from sppm_pipeline.hookspecs import hookimpl
from sppm_pipeline.stage import Context, Stage, option
from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.method.nouns.pores import PoreSet

@hookimpl
def sppm_stages():
    return {"sample.strange": Strange}
"""
STAGE = (
    HEAD
    + """
@dataclass(frozen=True, kw_only=True)
class Strange(Stage):
    \"\"\"Strange pores.\"\"\"
    name: ClassVar[str] = "sample.strange"
    count: int = option(3, help="how many", minimum=0, maximum=10)

    def run(self, context: Context) -> PoreSet:
        points = np.random.default_rng(0).random((self.count, 3))
BODY
        return PoreSet(cell=Cell(1.0), centers=points, piece=np.zeros(len(points), np.int32), interiors=1)
"""
)
NUMBER = [0]


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Install a distribution: metadata, an entry point and one module.

    Plugins that are installed for other tests are left out: each takes a process in every ``plugins --check``.
    """
    entries = []

    def make(source: str, *, name: str = "sppm-strange", target: str = "", entry: str = "strange") -> str:
        NUMBER[0] += 1
        module = f"strange_module_{NUMBER[0]}"
        site = tmp_path / "site"
        info = site / f"{name.replace('-', '_')}-2.5.dist-info"
        info.mkdir(parents=True, exist_ok=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 2.5\n")
        (info / "entry_points.txt").write_text(f"[sppm]\n{entry} = {target or module}\n")
        (site / f"{module}.py").write_text(source)
        monkeypatch.syspath_prepend(site)
        importlib.invalidate_caches()
        entries.append(entry)
        monkeypatch.setenv("SPPM_PLUGINS", ",".join(entries))
        return module

    return make


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "strange.yaml").write_text("sppm: 1\npipeline:\n  - {stage: sample.strange}\n")
    (tmp_path / "plain.yaml").write_text(
        "sppm: 1\npipeline:\n  - {stage: read.primitive, shape: box, size: [1, 1, 1]}\n"
    )
    return tmp_path


def body(text: str) -> str:
    return STAGE.replace("BODY", textwrap.indent(textwrap.dedent(text), " " * 8))


NAMED = "sppm-strange 2.5 (plugin 'strange')"

IMPORTS = {
    "raises": ("raise ValueError('no')", "ValueError: no"),
    "raises with many lines": ("raise ValueError('a\\nb\\nc')", "ValueError: a"),
    "syntax": ("x = (\n", "SyntaxError"),
    "missing": ("import no_such_module_anywhere", "the module 'no_such_module_anywhere' is not installed"),
    "exit": ("import sys; sys.exit(0)", "tried to end the program (SystemExit: 0)"),
    "exit with text": ("raise SystemExit('bye')", "tried to end the program (SystemExit: 'bye')"),
    "interrupt": ("raise KeyboardInterrupt", "raised KeyboardInterrupt, though there was no interrupt"),
    "odd exception": ("class Odd(BaseException): pass\nraise Odd('x')", "raised Odd: x"),
    "recursion": ("def f(): f()\nf()", "RecursionError"),
    "memory": ("raise MemoryError", "MemoryError"),
    "not utf-8": ("x = '\\xff'\nraise UnicodeDecodeError('utf-8', b'\\xff', 0, 1, 'bad')", "UnicodeDecodeError"),
}


@pytest.mark.parametrize("how", IMPORTS)
def test_a_plugin_that_cannot_be_imported_is_named_and_breaks_nothing(here, install, capsys, how):
    source, words = IMPORTS[how]
    install(source)
    assert main(["run", "plain.yaml", "-q"]) == 0
    err = capsys.readouterr().err
    assert NAMED in err
    assert words in err
    assert "Traceback" not in err
    assert main(["plugins", "--check"]) == 4
    out = capsys.readouterr().out
    assert words in out
    assert "sppm_pipeline.method (built in)\n" in out
    assert main(["stages"]) == 0
    assert main(["doctor"]) == 1
    assert main(["check", "strange.yaml"]) == 4
    assert f"{NAMED} could not be loaded and may supply it" in capsys.readouterr().err


BROKEN = {
    "unknown hook": ("@hookimpl\ndef sppm_stage():\n    return {}\n", "unknown hook 'sppm_stage'"),
    "unknown argument": ("@hookimpl\ndef sppm_stages(color):\n    return {}\n", "color"),
    "hook raises": ("@hookimpl\ndef sppm_stages():\n    return 1 / 0\n", "sppm_stages raised ZeroDivisionError"),
    "hook exits": ("@hookimpl\ndef sppm_stages():\n    raise SystemExit(3)\n", "sppm_stages tried to end the program"),
    "hook gives a list": ("@hookimpl\ndef sppm_stages():\n    return ['read.x']\n", "must return a map of names"),
    "hook gives numbers": ("@hookimpl\ndef sppm_stages():\n    return {'read.x': 3}\n", "must name classes"),
    "another interface": (
        "SPPM_API_VERSION = 99\n",
        "written for version 99 of the interface, this program has version 1",
    ),
    "an odd interface": ("SPPM_API_VERSION = 'new'\n", "written for version 'new' of the interface"),
    "shadows a built-in": (
        "@hookimpl\ndef sppm_stages():\n    return {'read.mesh': 'x:Y'}\n",
        "the stage 'read.mesh' comes from sppm itself and from sppm-strange 2.5",
    ),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_plugin_that_breaks_the_hooks_is_an_error_that_names_it(here, install, capsys, how):
    source, words = BROKEN[how]
    install("from sppm_pipeline.hookspecs import hookimpl\n" + source)
    assert main(["run", "plain.yaml", "-q"]) == 4
    err = capsys.readouterr().err
    assert words in err
    assert "sppm-strange 2.5 (plugin 'strange')" in err
    assert "Traceback" not in err
    assert main(["run", "plain.yaml", "-q", "--no-plugins"]) == 0
    assert main(["run", "plain.yaml", "-q", "--allow-plugins", ""]) == 0
    assert main(["plugins"]) == 0
    assert main(["plugins", "--check"]) == 4
    assert words in capsys.readouterr().out


def test_two_plugins_with_one_stage(here, install, capsys):
    install(body("pass"))
    install(body("pass"), name="sppm-other", entry="zother")
    assert main(["run", "plain.yaml"]) == 4
    err = capsys.readouterr().err
    assert "'sample.strange' comes from sppm-strange 2.5 (plugin 'strange') and from sppm-other 2.5" in err
    assert main(["run", "strange.yaml", "-q", "--allow-plugins", "sppm_strange"]) == 0


STAGES = {
    "not a stage": (HEAD + "class Strange: pass\n", "is no subclass of Stage"),
    "abstract": (STAGE.replace("def run(", "def walk(").replace("BODY", ""), "does not implement run"),
    "another name": (
        STAGE.replace('"sample.strange"\n    count', '"sample.stranger"\n    count').replace("BODY", ""),
        "has the name 'sample.stranger'",
    ),
    "no option": (
        STAGE.replace('option(3, help="how many", minimum=0, maximum=10)', "3").replace("BODY", ""),
        "'count' of Strange is not declared",
    ),
    "an option YAML can't say": (STAGE.replace("count: int", "count: dict").replace("BODY", ""), "can't express"),
    "no annotation": (STAGE.replace(" -> PoreSet", "").replace("BODY", ""), "does not say what it makes"),
    "late import exits": (HEAD.replace("Strange}", "'strange_late:X'}"), "tried to end the program"),
}


@pytest.mark.parametrize("how", STAGES)
def test_a_stage_that_breaks_the_contract_disturbs_only_those_who_use_it(here, install, capsys, how):
    source, words = STAGES[how]
    install(source)
    (here / "site" / "strange_late.py").write_text("raise SystemExit")
    assert main(["run", "plain.yaml", "-q"]) == 0
    assert main(["check", "strange.yaml"]) == 4
    err = capsys.readouterr().err
    assert words in err
    assert NAMED in err
    assert "'sample.strange'" in err
    assert main(["stages"]) == 0
    assert "BROKEN" in capsys.readouterr().out
    assert main(["stages", "--json"]) == 0
    assert any(words in stage.get("error", "") for stage in json.loads(capsys.readouterr().out))
    assert main(["plugins", "--check"]) == 4
    assert main(["schema"]) == 0


RUNS = {
    "raises": ("raise KeyError('x')", "raised KeyError: 'x'"),
    "exits": ("sys.exit(0)", "tried to end the program (SystemExit: 0)"),
    "interrupts": ("raise KeyboardInterrupt", "raised KeyboardInterrupt, though there was no interrupt"),
    "another type": ("return 3", "made int, but announces PoreSet"),
    "nothing": ("return None", "made NoneType, but announces PoreSet"),
    "not a number": ("points[1, 2] = np.nan", "must be finite"),
    "infinite": ("points[0, 0] = np.inf", "must be finite"),
    "flat": ("points = points[:, :2]", "pore centers have the shape (3, 2), expected (n, 3)"),
    "one too few": (
        "return PoreSet(cell=Cell(1.0), centers=points, piece=np.zeros(1, np.int32), interiors=1)",
        "contradicts itself",
    ),
    "outside": (
        "return PoreSet(cell=Cell(1.0), centers=points, piece=np.full(3, 7, np.int32), interiors=1)",
        "contradicts itself",
    ),
    "beside the cell": ("points += 1", "pore centers lie in the cell, from 0 to 1 (cell sizes), got 1.0"),
    "twins": ("points[2] = points[0]", "pores 0 and 2 of piece 0 are one: both lie at (0."),
    "turned": ("points = points.T[:, :2]", "pore centers have the shape (3, 2), expected (n, 3)"),
    "halves for numbers": (
        "return PoreSet(cell=Cell(1.0), centers=points, piece=np.full(3, 0.5), interiors=1)",
        "the pieces of pores are whole numbers, got 0.5",
    ),
    "recursion": ("def f(): f()\nf()", "raised RecursionError"),
    "an output not written": ("context.output('x')", "announced but not written"),
    "a report that is no JSON": ("context.report(x=object())", "raised"),
    "generator": ("raise GeneratorExit", "raised GeneratorExit"),
}


@pytest.mark.parametrize("how", RUNS)
def test_whatever_a_stage_of_a_plugin_does_is_its_fault(here, install, capsys, how):
    text, words = RUNS[how]
    install(body(text))
    assert main(["run", "strange.yaml", "-q"]) == 4
    err = capsys.readouterr().err
    assert words in err
    assert "strange.yaml:3:13" in err
    assert "'sample.strange'" in err
    assert "sppm-strange 2.5" in err or how == "an output not written"
    assert "Traceback" not in err
    assert os.listdir(here / "runs" / "strange") == ["run.json"]


def test_what_a_plugin_prints_does_not_mix_with_results(here, install, capsys):
    install("print('at import')\n" + body("print('in run')"))
    assert main(["run", "strange.yaml", "-q", "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["status"] == "done"
    assert "at import" in captured.err
    assert "in run" in captured.err


def test_a_plugin_that_moves_elsewhere_is_brought_back(here, install):
    install("import os\nos.chdir('/')\n" + body("os.chdir('/tmp')"))
    assert main(["run", "strange.yaml", "-q", "-o", "out"]) == 0
    assert (here / "out" / "run.json").exists()
    assert os.getcwd() == str(here)


def test_a_stage_cannot_take_the_interrupt_handler(here, install, capsys):
    """Runs go on in a thread of their own, where Python allows nobody to."""
    import signal

    before = signal.getsignal(signal.SIGINT)
    install(body("import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)"))
    assert main(["run", "strange.yaml", "-q"]) == 4
    assert "sppm-strange 2.5 (plugin 'strange'): raised ValueError: signal only works" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGINT) is before


def test_a_plugin_that_takes_the_interrupt_handler_gives_it_back():
    import signal

    before = signal.getsignal(signal.SIGINT)
    with containment.contained(PluginError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    assert signal.getsignal(signal.SIGINT) is before


MUTATING = STAGE.replace("def run(self, context: Context)", "def run(self, context: Context, pores: PoreSet)")
BOTH = "sppm: 1\npipeline:\n  - {stage: sample.elimination, count: 5}\n  - {stage: sample.strange}\n"


def test_an_input_cannot_be_written_to(here, install, capsys):
    install(MUTATING.replace("BODY", "        pores.centers[0, 0] = 0.5"))
    (here / "both.yaml").write_text(BOTH)
    assert main(["run", "both.yaml", "-q"]) == 4
    assert "read-only" in capsys.readouterr().err


def test_in_contract_mode_a_forced_change_of_an_input_is_found(here, install, capsys):
    install(MUTATING.replace("BODY", "        pores.centers.setflags(write=True); pores.centers[0, 0] = 0.5"))
    (here / "both.yaml").write_text(BOTH)
    assert main(["run", "both.yaml", "-q", "--contract"]) == 4
    assert "changed its input pores" in capsys.readouterr().err.replace("'", "")
    assert "SPPM_CONTRACT" not in os.environ


@pytest.mark.parametrize(
    "text",
    ["while True: time.sleep(0.05)", "while True: pass",
     "while True:\n    try: time.sleep(0.05)\n    except Exception: pass"],
)  # fmt: skip
def test_a_stage_that_hangs_is_ended(here, install, capsys, text):
    install(body(text))
    assert main(["run", "strange.yaml", "-q", "--stage-time", "0.3"]) == 4
    err = capsys.readouterr().err
    assert "the stage 'sample.strange' took longer than the 0.3 seconds" in err
    assert "sppm-strange 2.5" in err
    assert os.listdir(here / "runs" / "strange") == ["run.json"]


@pytest.mark.parametrize(
    "text",
    ["time.sleep(600)", "while True:\n    try:\n        time.sleep(600)\n    except BaseException:\n        pass"],
)
def test_a_stage_that_cannot_be_interrupted_ends_the_process(here, install, text):
    install(body("context.output('half').write_text('half')\n" + text))
    code = (
        "import sys; import sppm_pipeline.engine.process.containment as c; c.GRACE = 0.3\n"
        "from sppm_pipeline.engine.cli.main import leave; sys.argv = ['sppm', *sys.argv[1:]]; leave()"
    )
    words = ["run", "strange.yaml", "-q", "--stage-time", "0.3"]
    path = os.pathsep.join([str(here / "site"), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-c", code, *words], env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True,
        timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 4
    assert "took longer than the 0.3 seconds" in done.stderr
    assert "the process is ended" in done.stderr
    assert "sppm: strange.yaml:3:13: stage 'sample.strange': sppm-strange 2.5" in done.stderr
    assert os.listdir(here / "runs" / "strange") == ["run.json"]
    record = json.loads((here / "runs" / "strange" / "run.json").read_text())
    assert (record["status"], record["error"]["exit_code"]) == ("failed", 4)
    assert "took longer" in record["error"]["message"]


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf", "x", "1e9999", "9" * 400])
def test_times_that_make_no_sense(value, capsys):
    assert main(["run", "x.yaml", f"--stage-time={value}"]) == 2


def test_the_limit_holds_on_other_threads(monkeypatch):
    import threading

    monkeypatch.setenv(containment.STAGE_TIME, "0.2")
    caught: list[BaseException] = []

    def work():
        try:
            with containment.limited("somebody", builtin=False):
                while True:
                    time.sleep(0.01)
        except PluginError as error:
            caught.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(60)
    assert len(caught) == 1


def test_plugins_are_listed_without_being_imported(here, install, capsys):
    module = install("raise ValueError('imported')")
    assert main(["plugins"]) == 0
    captured = capsys.readouterr()
    assert f"strange (sppm-strange 2.5, {module})" in captured.out
    assert "imported" not in captured.err
    assert module not in sys.modules
    assert main(["plugins", "--json"]) == 0
    assert {"name": "strange", "distribution": "sppm-strange", "version": "2.5", "target": module, "builtin": False,
            "error": None} in json.loads(capsys.readouterr().out)  # fmt: skip


@pytest.mark.parametrize("words", [["--no-plugins"], ["--allow-plugins", ""], ["--allow-plugins", "lattice_points"]])
def test_what_is_not_allowed_is_not_imported(here, install, words):
    module = install(body("pass"))
    assert main(["run", "plain.yaml", "-q", *words]) == 0
    assert module not in sys.modules
    assert main(["run", "plain.yaml", "-q", "--allow-plugins", "strange"]) == 0
    assert module in sys.modules


def test_the_environment_can_hold_the_list(here, install, monkeypatch):
    module = install(body("pass"))
    monkeypatch.setenv("SPPM_PLUGINS", "")
    assert main(["check", "strange.yaml"]) == 2
    assert module not in sys.modules
    monkeypatch.setenv("SPPM_PLUGINS", "SPPM.Strange")
    assert main(["check", "strange.yaml"]) == 0


def test_a_name_that_is_not_installed(here, install, capsys):
    install(body("pass"))
    assert main(["check", "strange.yaml", "--allow-plugins", "sppm-strangr"]) == 2
    assert "did you mean 'sppm-strange'" in capsys.readouterr().err


def test_files_that_a_configuration_names_need_a_place_on_the_list(here):
    (here / "mine.py").write_text("raise ValueError('imported')")
    (here / "named.yaml").write_text("plugins: [mine.py]\n" + (here / "plain.yaml").read_text())
    assert main(["check", "named.yaml"]) == 4
    assert main(["check", "named.yaml", "--allow-plugins", "mine.py"]) == 4
    assert main(["check", "named.yaml", "--allow-plugins", ""]) == 0
    assert main(["check", "named.yaml", "--no-plugins"]) == 0


def test_a_broken_entry_point(here, install, capsys):
    install("", target="not a module at all!!")
    assert main(["run", "plain.yaml", "-q"]) == 0
    assert NAMED in capsys.readouterr().err


def test_numbers_of_nouns_of_a_plugin_are_looked_at(here, install, capsys):
    source = STAGE.replace("-> PoreSet", "-> Values").replace("BODY", "        return Values(np.array([1.0, np.nan]))")
    artifact = (
        "@dataclass(frozen=True, eq=False)\nclass Values(Artifact):\n    values: np.ndarray\n\n"
        "@dataclass(frozen=True, kw"
    )
    install(source.replace("@dataclass(frozen=True, kw", artifact))
    assert main(["run", "strange.yaml", "-q"]) == 4
    assert "not finite: Values.values[1] is nan (1 of 2" in capsys.readouterr().err
