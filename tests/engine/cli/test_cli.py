"""The verbs, their results, and every exit code. Most run in this process, which is what they would do in their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import sppm_pipeline
from sppm_pipeline.engine.cli.commands import built_in_commands
from sppm_pipeline.engine.cli.main import EXIT_CODES, main
from sppm_pipeline.engine.plan.session import find_configuration
from sppm_pipeline.engine.run import crew
from sppm_pipeline.errors import (
    ConfigError,
    DesignError,
    InputError,
    NativeCrash,
    PluginError,
    ResourceError,
    SppmError,
    WiringError,
)
from sppm_pipeline.stage import Stage

SYNTHETIC = str(Path(__file__).parents[2] / "synthetic.py")

DESIGN = """sppm: 1
name: demo
seed: 3
params: {factor: 2.0}
pipeline:
  - {stage: sample.random, count: 4}
  - {stage: field.scale, factor: "${factor}"}
  - write.number
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo.yaml").write_text(DESIGN)
    return tmp_path


def sppm(*words: str) -> int:
    """Run a verb with the synthetic stages and no others of strangers."""
    return main([words[0], *words[1:], "--no-plugins", "--plugin", SYNTHETIC])


def start(*words: str, **how) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "sppm_pipeline.engine.cli.main", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **how,
    )  # fmt: skip


# --- the way in --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("words", [[], ["--help"], ["-h"]])
def test_help_lists_every_verb(words, capsys):
    assert main(words) == 0
    out = capsys.readouterr().out
    assert all(f"\n  {verb} " in out for verb in built_in_commands())
    assert "exit codes" in out


@pytest.mark.parametrize("verb", built_in_commands())
def test_every_verb_has_help(verb, capsys):
    assert main([verb, "--help"]) == 0
    assert f"usage: sppm {verb}" in capsys.readouterr().out


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"sppm {sppm_pipeline.__version__}\n"


@pytest.mark.parametrize(("verb", "words"), [("rnu", "did you mean 'run'"), ("zzz", "`sppm --help`")])
def test_an_unknown_verb(verb, words, capsys):
    assert main([verb]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["run"],
        ["run", "x", "--nope"],
        ["run", "x", "-j", "0"],
        ["run", "x", "-j", "two"],
        ["run", "x", "--seed", "-1"],
        ["graph", "x", "-f", "svg"],
    ],
)
def test_a_wrong_command_line(words, capsys):
    assert main(words) == 2
    assert "usage: sppm" in capsys.readouterr().err


# --- run ---------------------------------------------------------------------------------------------------------


def test_run_writes_a_directory_and_prints_a_summary(here, capsys):
    assert sppm("run", "demo.yaml") == 0
    out = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in out] == ["sample.random", "field.scale", "write.number", "done"]
    assert "value" in out[0]
    assert out[-1].endswith("runs/demo")
    assert (here / "runs" / "demo" / "number.txt").exists()


def test_run_as_json(here, capsys):
    assert (
        sppm("run", "demo.yaml", "-o", "there", "--json", "-p", "factor=3", "--seed", "9", "-s", "random.count=2") == 0
    )
    record = json.loads(capsys.readouterr().out)
    assert record == json.loads((here / "there" / "run.json").read_text())
    assert record["params"] == {"factor": 3}
    assert record["seed"] == 9
    assert record["stages"][0]["options"] == {"count": 2}


def test_a_record_runs_again(here, capsys):
    assert sppm("run", "demo.yaml", "-o", "a") == 0
    assert sppm("run", "a/run.json", "-o", "b") == 0
    assert (here / "a" / "number.txt").read_bytes() == (here / "b" / "number.txt").read_bytes()


def test_until_and_dry_run(here, capsys):
    assert sppm("run", "demo.yaml", "-n") == 0
    assert not (here / "runs").exists()
    assert "number: from sample.random" in capsys.readouterr().out
    assert sppm("run", "demo.yaml", "-n", "--until", "nope") == 2
    assert sppm("run", "demo.yaml", "--until", "field.scale") == 0
    assert not (here / "runs" / "demo" / "number.txt").exists()


def test_the_quiet_are_warned_and_hear_nothing_else(here, capsys):
    (here / "warned.yaml").write_text(DESIGN + "  - {stage: check.limit, soft: true, maximum: 0, from: field.scale}\n")
    assert sppm("run", "warned.yaml", "-q") == 0
    assert capsys.readouterr().err == "sppm: warning: stage 'check.limit': larger than 0\n"
    (here / "plain.yaml").write_text(DESIGN)
    assert sppm("run", "plain.yaml", "-q") == 0
    assert capsys.readouterr().err == ""


def test_a_sweep_from_the_command_line(here, capsys):
    (here / "sweep.yaml").write_text(DESIGN + "sweep: {factor: [1, 2], seed: [1, 2]}\n")
    assert sppm("check", "sweep.yaml") == 0
    assert "a sweep of 4 runs" in capsys.readouterr().out
    assert sppm("run", "sweep.yaml", "-j", "2", "--executor", "threads") == 0
    assert "4 of 4 runs" in capsys.readouterr().out
    assert len((here / "runs" / "demo" / "sweep.csv").read_text().splitlines()) == 5


def test_a_single_run_has_workers(here, capsys):
    (here / "layers.yaml").write_text(
        "sppm: 1\npipeline:\n  - {stage: read.primitive, shape: box, size: [3 mm, 2 mm, 2 mm]}\n"
        "  - {stage: slice.mesh, pixel: 0.1 mm}\n  - {stage: write.png, path: slices}\n"
    )
    assert sppm("run", "layers.yaml", "-o", "one", "--no-cache") == 0
    assert "goes on alone" not in capsys.readouterr().err
    assert sppm("run", "layers.yaml", "-o", "few", "--no-cache", "-j", "2") == 0  # not worth it
    err = capsys.readouterr().err
    assert "works on" not in err
    assert err.count("sppm: this process goes on alone: its work is too little for processes of their own") == 1
    assert sppm("run", "layers.yaml", "-o", "crew", "--no-cache", "-j", "2", "--executor", "processes") == 0
    err = capsys.readouterr().err
    assert err.count("sppm: works on 2 processes") == 1
    assert "goes on alone" not in err
    one, few, workers = (
        {file.name: file.read_bytes() for file in (here / to).rglob("*") if file.is_file() and file.name != "run.json"}
        for to in ("one", "few", "crew")
    )
    assert one == few == workers
    assert len(one) == 20 + 3  # manifest.json, the overview, SHA256SUMS
    assert sppm("run", "layers.yaml", "--executor", "proceses") == 2
    assert "there is no executor 'proceses'" in capsys.readouterr().err
    assert sppm("run", "layers.yaml", "--executor", "threads:there") == 2


def test_processes_that_nobody_named_are_for_work_that_is_worth_it(here, capsys, monkeypatch):
    """By predicted seconds, or by samples where these are unknown; stages without layers have no say."""
    layers = (
        "sppm: 1\npipeline:\n  - {stage: read.primitive, shape: box, size: [2 mm, 2 mm, 2 mm]}\n"
        "  - {stage: slice.mesh, pixel: 0.1 mm}\n  - {stage: write.png, path: slices}\n"
    )
    (here / "layers.yaml").write_text(layers)
    (here / "plain.yaml").write_text(DESIGN)
    words, at_work = "this process goes on alone", "works on 2 processes"

    def said(file="layers.yaml", **constants):
        with monkeypatch.context() as patch:
            for name, value in constants.items():
                patch.setattr(crew, name, value)
            assert sppm("run", file, "--no-cache", "-j", "2") == 0
        err = capsys.readouterr().err
        return words in err, at_work in err

    assert said() == (True, False)
    assert said(MIN_SECONDS=1e-3) == (False, True)
    monkeypatch.setattr("sppm_pipeline.method.stages.slice_mesh.SliceMesh.estimate", Stage.estimate)
    assert said(MIN_SECONDS=1e-3) == (True, False)  # seconds are unknown, and samples are 8000
    assert said(MIN_SAMPLES=8001) == (True, False)
    assert said(MIN_SAMPLES=8000) == (False, True)
    assert said("plain.yaml", MIN_SAMPLES=8001) == (False, False)


def test_a_sweep_with_failures(here, capsys):
    text = DESIGN.replace('factor: "${factor}"', "factor: 2").replace(
        "write.number", '{stage: check.limit, maximum: "${factor}"}'
    )
    (here / "sweep.yaml").write_text(text + "sweep: {factor: [100, 200]}\n")
    assert sppm("run", "sweep.yaml", "-q") == 0
    (here / "sweep.yaml").write_text(text + "sweep: {factor: [100, 1e-9]}\n")
    capsys.readouterr()
    assert sppm("run", "sweep.yaml") == 3
    assert "run 0001 (factor=1e-09) failed: " in capsys.readouterr().out
    assert sppm("run", "sweep.yaml", "-q", "--keep-going") == 3
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "sppm: run 0001 (factor=1e-09) failed: " in captured.err
    assert sppm("run", "sweep.yaml", "-q", "--ignore-failed") == 0
    assert sppm("run", "sweep.yaml", "-k", "--ignore-failed") == 2


def test_quiet_prints_nothing_on_stdout(here, capsys):
    for words in (["-q"], ["-q", "-n"]):
        assert sppm("run", "demo.yaml", *words) == 0
        assert capsys.readouterr().out == ""
    assert sppm("run", "demo.yaml", "-q", "--json") == 0
    assert json.loads(capsys.readouterr().out)["status"] == "done"


FAILURES = [("value", 4), ("design", 3), ("missing", 3), ("disk", 5), ("memory", 5), ("escape", 2), ("wrong_type", 4)]


@pytest.mark.parametrize(("how", "code"), FAILURES)
def test_exit_codes_of_failing_stages(here, capsys, how, code):
    (here / "bad.yaml").write_text(f"sppm: 1\npipeline: [{{stage: check.fail, how: {how}}}]\n")
    assert sppm("run", "bad.yaml", "--json", "-q") == code
    captured = capsys.readouterr()
    assert captured.err.startswith("sppm: bad.yaml:2:20: stage 'check.fail': ")
    assert "Traceback" not in captured.err
    assert json.loads(captured.out)["error"]["exit_code"] == code


def test_the_traceback_is_shown_on_demand(here, capsys):
    (here / "bad.yaml").write_text("sppm: 1\npipeline: [check.fail]\n")
    assert sppm("run", "bad.yaml", "--debug") == 4
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert "ValueError: this stage always fails" in err


def test_several_errors_are_counted(here, capsys):
    (here / "bad.yaml").write_text("sppm: 1\nname: 3\nseed: x\n")
    assert sppm("check", "bad.yaml") == 2
    err = capsys.readouterr().err.splitlines()
    assert err[0] == "sppm: 3 errors"
    assert [line.split(":")[1] for line in err[1:] if line.startswith("bad.yaml")] == ["1", "2", "3"]


def test_an_interrupt_in_a_stage(here, capsys):
    (here / "bad.yaml").write_text("sppm: 1\npipeline: [{stage: check.fail, how: interrupt}]\n")
    assert sppm("run", "bad.yaml") == 130
    assert os.listdir(here / "runs" / "bad") == ["run.json"]


def test_a_directory_that_is_no_run_is_left_alone(here, capsys):
    (here / "mine").mkdir()
    (here / "mine" / "file").write_text("")
    assert sppm("run", "demo.yaml", "-o", "mine") == 2
    assert "nothing of yours is overwritten" in capsys.readouterr().err


def test_a_bug_of_ours_is_one_line(here, capsys, monkeypatch):
    def broken(*args, **kwargs):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("sppm_pipeline.engine.run.runner.run_plan", broken)
    assert sppm("run", "demo.yaml") == 1
    err = capsys.readouterr().err
    assert "internal error: ZeroDivisionError: oh" in err
    assert "Traceback" not in err


# --- other verbs -------------------------------------------------------------------------------------------------


def test_check_prints_the_wiring_or_the_resolved_configuration(here, capsys):
    assert sppm("check", "demo.yaml") == 0
    assert "number: from sample.random" in capsys.readouterr().out
    assert sppm("check", "demo.yaml", "--json") == 0
    assert json.loads(capsys.readouterr().out)["pipeline"][1]["factor"] == "${factor}"


def test_explain_a_file_or_a_stage(here, capsys):
    assert sppm("explain", "demo.yaml") == 0
    assert "factor = 2.0" in capsys.readouterr().out
    assert sppm("explain", "field.scale") == 0
    assert "Multiply a number." in capsys.readouterr().out
    assert sppm("explain", "field.scael") == 2


def test_stages_all_of_a_family_or_one(here, capsys):
    assert sppm("stages") == 0
    everything = capsys.readouterr().out
    assert "sample.dart_throwing" in everything
    assert f"[the plugin {SYNTHETIC}]" in everything
    assert sppm("stages", "sample", "--json") == 0
    names = [entry["name"] for entry in json.loads(capsys.readouterr().out)]
    assert "sample.random" in names
    assert all(name.startswith("sample.") for name in names)
    assert sppm("stages", "read.varied") == 0
    assert "Options" in capsys.readouterr().out
    assert sppm("stages", "read.vareid") == 2


def test_schema_and_graph_and_plugins(here, capsys):
    assert sppm("schema") == 0
    assert "read.varied" in json.loads(capsys.readouterr().out)["$defs"]
    for form in ("text", "dot", "mermaid"):
        assert sppm("graph", "demo.yaml", "-f", form) == 0
        assert "field.scale" in capsys.readouterr().out
    assert sppm("plugins") == 0
    assert "sppm_pipeline.method (built in)" in capsys.readouterr().out
    (here / "bad.py").write_text("raise ValueError('no')")
    assert sppm("plugins", "--check", "--plugin", "bad.py", "--json") == 4
    assert "ValueError: no" in json.loads(capsys.readouterr().out)[-2]["error"]


def test_doctor_finds_what_is_wrong(here, capsys):
    assert sppm("doctor") == 0
    out = capsys.readouterr().out
    assert all(word in out for word in ("Python", "numpy", "numba", "kernel cache", "processors"))
    assert "BAD" not in out
    (here / "bad.py").write_text("raise ValueError('no')")
    assert sppm("doctor", "--plugin", "bad.py", "--json") == 1
    assert [f["what"] for f in json.loads(capsys.readouterr().out) if not f["ok"]] == ["plugin bad.py"]


def test_each_kind_of_error_has_its_exit_code():
    kinds = [SppmError, ConfigError, InputError, PluginError, ResourceError, NativeCrash, WiringError, DesignError]
    for kind, code in zip(kinds, [1, 2, 3, 4, 5, 6, 2, 3], strict=True):
        error = kind("what went wrong")
        assert (error.exit_code, str(error)) == (code, "what went wrong")
        assert f"{code} " in EXIT_CODES


def test_configurations_by_name():
    example = find_configuration("quickstart")
    assert example.name == "quickstart.yaml"
    with pytest.raises(ConfigError, match="did you mean 'quickstart'"):
        find_configuration("quickstrat")


def test_configurations_by_path(here):
    assert find_configuration("demo.yaml") == Path("demo.yaml")
    with pytest.raises(ConfigError, match=r"did you mean 'demo\.yaml'"):
        find_configuration("dmeo.yaml")


# --- processes ---------------------------------------------------------------------------------------------------


HEAVY = ("numpy", "scipy", "numba", "networkx", "PIL", "trimesh", "ruamel", "pluggy")


@pytest.mark.parametrize(
    ("words", "forbidden"),
    [
        (["--help"], HEAVY[:-1]),  # the verbs of features come through a hook
        (["run", "--help"], HEAVY[:-1]),
        (
            ["check", "demo.yaml", "--no-plugins", "--plugin", SYNTHETIC],
            ("scipy", "numba", "networkx", "PIL", "trimesh"),
        ),
        (["stages"], ("scipy", "numba", "networkx", "PIL", "trimesh")),
    ],
    ids=["help", "verb help", "check", "stages"],
)
def test_what_is_not_needed_is_not_imported(here, words, forbidden):
    code = (
        f"import sys; from sppm_pipeline.engine.cli.main import main; main({words!r}); print('loaded:', *sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in done.stdout.splitlines()[-1].split()}
    assert loaded & set(forbidden) == set()


def test_results_and_progress_have_their_own_streams(here):
    process = start("check", "nothing.yaml")
    out, err = process.communicate()
    assert (process.returncode, out) == (2, "")
    assert err.startswith("sppm: ")


def test_a_reader_that_leaves_is_no_failure(here):
    process = start("schema")
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    assert process.wait() == 0
    assert err == ""


SLEEPER = """
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from sppm_pipeline.stage import Context, Stage, option

@dataclass(frozen=True, kw_only=True)
class Sleep(Stage):
    '''Write half a file, and wait to be ended.'''
    name: ClassVar[str] = "write.sleep"
    value: int = option(1, help="a number")

    def run(self, context: Context) -> None:
        context.output("half.txt").write_text("half")
        Path(f"started{self.value}").touch()
        time.sleep(600)
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("sweep", ["", "sweep: {v: [1, 2]}\n"])
def test_signals_end_a_run_cleanly(here, number, code, sweep):
    (here / "sleeper.py").write_text(SLEEPER)
    (here / "sleep.yaml").write_text(
        "sppm: 1\nplugins: [sleeper.py]\nparams: {v: 1}\npipeline: [{stage: write.sleep, value: '${v}'}]\n" + sweep
    )
    process = start("run", "sleep.yaml", "-o", "out", "-j", "2", start_new_session=True)
    deadline = time.monotonic() + 120
    while not list(here.glob("started*")) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(process.pid, number)
    _, err = process.communicate(timeout=400)
    assert process.returncode == code, err
    assert err.endswith("sppm: interrupted\n"), err
    assert "Traceback" not in err
    assert not (here / "out" / "half.txt").exists()
    assert not list((here / "out").glob(".staging*"))
    assert json.loads((here / "out" / "run.json").read_text())["status"] == "interrupted"


def test_stages_are_listed_by_what_they_are_for(capsys):
    assert main(["stages"]) == 0
    text = capsys.readouterr().out
    groups = [text.index(title) for title in ("Everyday:", "Paper:", "Research:", "presets,")]
    assert groups == sorted(groups)
    for name, group in (("read.mesh", 0), ("write.sl1", 0), ("connect.mbdst", 1), ("homogenize.voxel", 2)):
        assert groups[group] < text.index(f"\n  {name} ") < groups[group + 1]
    assert main(["stages", "write"]) == 0
    assert "Everyday" not in capsys.readouterr().out
