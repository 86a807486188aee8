"""However a plugin ends, hangs or is left, the run is ended, the offender is named, and no success is claimed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="orphans are adopted on Linux only")

PLUGIN = '''
import ctypes, os, subprocess, sys, time
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.stage import Context, Stage

def sleep(*words):
    process = subprocess.Popen(["sleep", "600"], start_new_session=True, stdout=subprocess.DEVNULL)
    open("pid", "w").write(str(process.pid))

HOW = os.environ["HOW"]
if HOW.startswith("import "):
    open("busy", "w").close()
    exec(HOW.removeprefix("import "))

@dataclass(frozen=True)
class Numbers(Artifact):
    """Numbers."""
    values: np.ndarray

@dataclass(frozen=True, kw_only=True)
class Odd(Stage):
    """Do what the environment says."""
    name: ClassVar[str] = "sample.odd"
    def run(self, context: Context) -> Numbers:
        values = np.ones(3)
        open("busy", "w").close()
        exec(HOW.removeprefix("import ") if not HOW.startswith("import ") else "")
        return Numbers(np.array([None]) if HOW == "'objects'" else values)
'''
LOCKED = "ctypes.PyDLL(None).usleep(590_000_000)"


@pytest.fixture
def start(tmp_path):
    (tmp_path / "odd.py").write_text(PLUGIN)
    (tmp_path / "odd.yaml").write_text("sppm: 1\nplugins: [odd.py]\npipeline:\n  - sample.odd\n")

    def begin(how: str, *words: str, verb: str = "run") -> subprocess.Popen:
        words = ("-q", "-o", "out", *words) if verb == "run" else words
        return subprocess.Popen(
            [sys.executable, "-m", "sppm_pipeline", verb, "odd.yaml", *words],
            cwd=tmp_path,
            env={**os.environ, "SPPM_CACHE": "off", "HOW": how},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )

    return begin


STAGE = "odd.py: the stage 'sample.odd'"
IMPORT = "the import of the plugin "


@pytest.mark.parametrize(
    ("how", "code", "words"),
    [
        ("os._exit(0)", 4, f"{STAGE} ended the process (exit code 0)"),
        ("os._exit(143)", 4, f"{STAGE} ended the process (exit code 143)"),
        ("ctypes.string_at(0)", 6, f"(SIGSEGV), while this was running: the plugin {{folder}}/{STAGE}"),
        ("os.abort()", 6, f"(SIGABRT), while this was running: the plugin {{folder}}/{STAGE}"),
        ("raise MemoryError", 5, "odd.py: not enough memory"),
        ("os.close(1)", 4, "odd.py: closed the standard output"),
        ("os.close(2)", 4, "odd.py: closed the standard error"),
        ("sys.stdout.close()", 4, "odd.py: closed the standard error"),
        ("'objects'", 4, "an array of objects, which can't be kept: Numbers.values"),
    ],
)
def test_the_offender_and_its_stage_are_named(start, tmp_path, how, code, words):
    process = start(how)
    out, err = process.communicate(timeout=400)
    assert process.returncode == code, err
    assert words.format(folder=tmp_path) in err
    assert "odd.yaml:4:5: stage 'sample.odd': " in err
    assert "Traceback" not in err
    assert out == ""
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (record["status"], record["error"]["exit_code"], record["error"]["stage"]) == ("failed", code, "sample.odd")


def test_a_process_that_the_system_kills_is_interrupted_and_named(start, tmp_path):
    process = start("os.kill(os.getpid(), 9)")
    _, err = process.communicate(timeout=400)
    assert process.returncode == 137
    assert (
        f"ended by SIGKILL, perhaps because memory ran out, while this was running: the plugin {tmp_path}/{STAGE}"
        in err
    )
    assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] == "interrupted"


@pytest.mark.parametrize("verb", ["run", "check"])
@pytest.mark.parametrize(("how", "code"), [("os._exit(0)", 4), ("ctypes.string_at(0)", 6)])
def test_what_ends_at_its_import(start, tmp_path, verb, how, code):
    process = start(f"import {how}", verb=verb)
    _, err = process.communicate(timeout=400)
    assert process.returncode == code
    assert f"{IMPORT}{tmp_path}/odd.py" in err


@pytest.mark.parametrize("how", ["time.sleep(600)", LOCKED, f"import {LOCKED}", f"sleep(); {LOCKED}"])
def test_the_time_limit_ends_what_hangs(start, tmp_path, how):
    for limit in (3, 10, 100):
        process = start(how, "--time-limit", str(limit))
        _, err = process.communicate(timeout=400)
        assert process.returncode == 5
        if (tmp_path / "busy").exists():
            break  # else the machine is so slow that it was not even begun
    assert "the run took longer than --time-limit allows, while this was running: " in err
    assert (IMPORT if how.startswith("import") else STAGE) in err
    if not how.startswith("import"):
        assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] == "failed"


def test_the_supervisor_ends_a_stage_that_keeps_the_lock(start, tmp_path):
    process = start(LOCKED, "--stage-time", "0.1")  # and twelve seconds of patience
    _, err = process.communicate(timeout=400)
    assert process.returncode == 4
    assert f"a stage took longer than --stage-time allows, while this was running: the plugin {tmp_path}/{STAGE}" in err


def test_an_interrupt_ends_an_import_that_keeps_the_lock(start, tmp_path):
    process = start(f"import {LOCKED}", verb="check")
    while not (tmp_path / "busy").exists() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=400)
    assert process.returncode == 130
    assert err == "sppm: interrupted\n"


def test_a_process_that_is_left_behind_is_ended(start, tmp_path):
    process = start("sleep()")
    _, err = process.communicate(timeout=400)
    assert process.returncode == 0
    assert "a process that was left behind was ended" in err
    assert not psutil.pid_exists(int((tmp_path / "pid").read_text()))


def test_a_time_limit_needs_a_supervisor(capsys):
    from sppm_pipeline.engine.cli.main import main

    assert main(["run", "x.yaml", "--time-limit", "3"]) == 2
    assert "--time-limit needs a supervising process" in capsys.readouterr().err


def test_an_import_or_an_exit_handler_that_hangs_is_named_and_ended(start, tmp_path, monkeypatch):
    monkeypatch.setenv("SPPM_IMPORT_TIME", "8")
    atexit = "import __import__('atexit').register(time.sleep, 600)"
    with start("import " + LOCKED, verb="check") as process, start(atexit, verb="check") as other:
        _, said = process.communicate(timeout=120)
        _, told = other.communicate(timeout=120)
    assert process.returncode == other.returncode == 4
    assert "sppm: still importing: the plugin" in said
    assert "odd.py took longer than 8 s" in said
    assert "an exit handler of a plugin or a library took longer than 8 s" in told


def test_each_plugin_is_checked_in_a_child(tmp_path, monkeypatch):
    monkeypatch.setenv("SPPM_IMPORT_TIME", "8")
    (tmp_path / "hangs.py").write_text("import time\ntime.sleep(600)\n")
    (tmp_path / "dies.py").write_text("import os\nos._exit(0)\n")
    (tmp_path / "good.py").write_text("import sys\nprint('hello')\n")
    words = [word for name in ("hangs", "dies", "good") for word in ("--plugin", str(tmp_path / f"{name}.py"))]
    command = [sys.executable, "-m", "sppm_pipeline", "plugins", "--check", "--json", "--no-plugins", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200)
    assert done.returncode == 4
    errors = {os.path.basename(entry["name"]): entry["error"] for entry in json.loads(done.stdout)}
    assert "took longer than 8 s" in errors["hangs.py"]
    assert "ended the process" in errors["dies.py"]
    assert errors["good.py"] is None


def test_a_run_that_takes_more_memory_than_allowed_is_ended(start):
    with start("global held; held = np.ones(10**8); time.sleep(600)", "--memory", "500M") as process:
        _, said = process.communicate(timeout=120)
    assert process.returncode == 5
    assert "more than --memory allows" in said
    assert "'sample.odd'" in said


@pytest.mark.parametrize("verb", ["run", "check"])
def test_an_exception_whose_text_raises_or_holds_escapes_is_harmless(start, verb):
    kind = "type('Odd', (Exception,), {'__str__': lambda self: 1 / 0})()"
    escapes = "ValueError('\\x1b[2Jgone \\u202eabc')"
    for how, words in (
        (kind, "Odd: (no text: its __str__ raised ZeroDivisionError)"),
        (escapes, "\\x1b[2Jgone \\u202eabc"),
    ):
        raising = f"import def fail(): raise {how}\nfail()" if verb == "check" else f"raise {how}"
        with start(raising, verb=verb) as process:
            _, said = process.communicate(timeout=120)
        assert process.returncode == 4, said
        assert words in said
        assert "\x1b" not in said
