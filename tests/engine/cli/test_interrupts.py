"""Signals end a run at once, whatever it is doing, and leave nothing behind; whatever is ended can be gone on with."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from sppm_pipeline.engine.cache.identity import program_digest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes end with their parents on Linux only")

STAGES = '''
import ctypes, os, threading, time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.stage import Context, Stage, option

@dataclass(frozen=True)
class Number(Artifact):
    """A number."""
    value: float

@dataclass(frozen=True, kw_only=True)
class First(Stage):
    """Take a moment, so that the result is kept."""
    name: ClassVar[str] = "sample.first"
    def run(self, context: Context) -> Number:
        with Path("ran.txt").open("a") as file:
            file.write("first\\n")
        time.sleep(0.1)
        return Number(float(context.rng().random()))

@dataclass(frozen=True, kw_only=True)
class Busy(Stage):
    """Be busy for ten minutes, half a file written, unless there is nothing to wait for."""
    name: ClassVar[str] = "write.busy"
    how: str = option(help="with what")
    value: int = option(1, help="a number")
    def run(self, context: Context, number: Number) -> None:
        target = context.output("half.txt")
        target.write_text("half")
        if not Path("wait").exists():
            target.write_text(repr(number.value))
            return
        Path(f"pid-{os.getpid()}").touch()
        match self.how:
            case "python":
                end = time.monotonic() + 600
                while time.monotonic() < end:
                    pass
            case "progress":
                for i in range(60_000):
                    time.sleep(0.01)
                    context.progress(i, 60_000)
            case "kernel":  # compiled code without the interpreter's lock
                ctypes.CDLL(None).usleep(590_000_000)
            case "locked":  # compiled code that keeps the interpreter's lock
                ctypes.PyDLL(None).usleep(590_000_000)
            case "threads":
                with ThreadPoolExecutor(2) as pool:
                    list(pool.map(lambda i: ctypes.CDLL(None).usleep(590_000_000), range(4)))
            case "stubborn":
                while True:
                    try:
                        time.sleep(0.2)
                    except BaseException:
                        pass
            case "crash":
                os.abort()
            case "segfault":
                ctypes.string_at(0)
'''

CONFIG = """sppm: 1
name: busy
seed: 3
plugins: [stages.py]
params: {{value: 1}}
pipeline:
  - sample.first
  - {{stage: write.busy, how: {how}, value: "${{value}}"}}
"""


def program() -> str:
    """Digest of the program's sources as they are now."""
    return program_digest.__wrapped__()


def start(folder: Path, how: str, *words: str, sweep: bool = False) -> subprocess.Popen:
    (folder / "stages.py").write_text(STAGES)
    if not (folder / "program").exists():
        (folder / "program").write_text(program())
    text = CONFIG.format(how=how) + ("sweep: {value: [1, 2]}\n" if sweep else "")
    (folder / "busy.yaml").write_text(text)
    return subprocess.Popen(
        [sys.executable, "-m", "sppm_pipeline", "run", "busy.yaml", "-o", "out", "-q", *words],
        cwd=folder,
        env={**os.environ, "SPPM_CACHE": str(folder / "cache")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # shells turn it off for jobs that they start with &
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def wait_for(folder: Path, process: subprocess.Popen, count: int = 1) -> list[int]:
    """The processes in which stages are busy."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and process.poll() is None:
        pids = [int(path.name.removeprefix("pid-")) for path in folder.glob("pid-*")]
        if len(pids) >= count:
            return pids
        time.sleep(0.01)
    raise AssertionError(process.communicate())


def alive(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def gone(pids: list[int]) -> bool:
    deadline = time.monotonic() + 60
    while any(map(alive, pids)) and time.monotonic() < deadline:
        time.sleep(0.01)
    return not any(map(alive, pids))


def leftovers(folder: Path) -> list[str]:
    return [p.name for p in folder.rglob("*") if p.name.startswith((".staging", ".run.json")) or p.parent.name == "tmp"]


def finish(folder: Path, *words: str, sweep: bool = False) -> None:
    """The same command again ends, with what the first had finished."""
    (folder / "wait").unlink()
    before = (folder / "ran.txt").read_text().count("first")
    process = start(folder, "kernel", *words, sweep=sweep)
    _, err = process.communicate(timeout=400)
    assert process.returncode == 0, err
    assert json.loads((folder / "out" / "run.json").read_text())["status"] == "done"
    if (folder / "program").read_text() != program():
        pytest.skip("the program was edited since the first run began: another program keeps no results of this one")
    assert (folder / "ran.txt").read_text().count("first") == before
    assert leftovers(folder) == []


CODES = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.mark.parametrize(
    ("how", "number"),
    [
        ("python", signal.SIGINT),
        ("progress", signal.SIGTERM),
        ("kernel", signal.SIGINT),
        ("kernel", signal.SIGHUP),
        ("locked", signal.SIGTERM),
        ("threads", signal.SIGINT),
        ("stubborn", signal.SIGTERM),
    ],
)
def test_a_signal_ends_a_run_whatever_it_does(tmp_path, how, number):
    (tmp_path / "wait").touch()
    process = start(tmp_path, how)
    pids = wait_for(tmp_path, process)
    os.kill(process.pid, number)
    _, err = process.communicate(timeout=400)  # of the ten minutes that it would have taken
    assert process.returncode == CODES[number], err
    assert err.splitlines() == ["sppm: interrupted; the same command again goes on with the stages that had ended"]
    assert gone(pids)
    assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] == "interrupted"
    assert [p for p in leftovers(tmp_path) if p.startswith(".")] == []
    assert not (tmp_path / "out" / "half.txt").exists()
    if how == "kernel":
        finish(tmp_path)


def test_the_whole_group_is_interrupted_as_a_terminal_does(tmp_path):
    (tmp_path / "wait").touch()
    process = start(tmp_path, "kernel", "-j", "2", sweep=True)
    pids = wait_for(tmp_path, process, 2)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=400)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert gone(pids)
    for record in (tmp_path / "out").rglob("run.json"):
        assert json.loads(record.read_text())["status"] == "interrupted"
    assert [p for p in leftovers(tmp_path) if p.startswith(".")] == []
    finish(tmp_path, "-j", "2", sweep=True)


@pytest.mark.parametrize("executor", ["processes", "threads", "serial"])
def test_sweeps_end_at_once(tmp_path, executor):
    (tmp_path / "wait").touch()
    process = start(tmp_path, "kernel", "-j", "2", "--executor", executor, sweep=True)
    pids = wait_for(tmp_path, process)
    os.kill(process.pid, signal.SIGTERM)
    _, err = process.communicate(timeout=400)
    assert process.returncode == 143, err
    assert gone(pids)
    assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] == "interrupted"


@pytest.mark.parametrize("victim", ["parent", "child"])
@pytest.mark.parametrize("sweep", [False, True], ids=["run", "sweep"])
def test_nobody_outlives_a_kill(tmp_path, victim, sweep):
    (tmp_path / "wait").touch()
    process = start(tmp_path, "kernel", *(["-j", "2"] if sweep else []), sweep=sweep)
    pids = wait_for(tmp_path, process, 2 if sweep else 1)
    (child,) = (child.pid for child in psutil.Process(process.pid).children())
    os.kill(process.pid if victim == "parent" else child, signal.SIGKILL)
    _, err = process.communicate(timeout=400)
    assert process.returncode == (-9 if victim == "parent" else 137)
    assert gone([*pids, child])
    if victim == "child":
        assert "ended by SIGKILL" in err
        assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] == "interrupted"
    finish(tmp_path, *(["-j", "2"] if sweep else []), sweep=sweep)


@pytest.mark.parametrize(("how", "name"), [("crash", "SIGABRT"), ("segfault", "SIGSEGV")])
def test_a_crash_of_a_native_library_has_its_own_exit_code(tmp_path, how, name):
    (tmp_path / "wait").touch()
    process = start(tmp_path, how)
    _, err = process.communicate(timeout=400)
    assert process.returncode == 6
    assert f"a native library crashed ({name})" in err
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (record["status"], record["error"]["exit_code"]) == ("failed", 6)


def test_a_row_that_takes_the_whole_sweep_down_names_its_run(tmp_path):
    (tmp_path / "wait").touch()
    process = start(tmp_path, "segfault", sweep=True)
    _, err = process.communicate(timeout=400)
    assert process.returncode == 6
    assert "'write.busy' of run '0000'" in err
    assert "stages.py" in err
    assert "--executor processes" in err
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (record["status"], record["error"]["stage"]) == ("failed", "write.busy")
    assert "of run '0000'" in record["error"]["message"]
    # as the hint says: each row has its own error
    process = start(tmp_path, "segfault", "--executor", "processes", sweep=True)
    process.communicate(timeout=400)
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert [row["error"]["message"].count(f"run {row['run']!r}") for row in record["runs"]] == [1, 1]


def test_a_second_run_into_a_directory_is_refused(tmp_path):
    (tmp_path / "wait").touch()
    first = start(tmp_path, "kernel")
    wait_for(tmp_path, first)
    second = start(tmp_path, "kernel")
    _, err = second.communicate(timeout=400)
    assert second.returncode == 5
    assert "another run is writing into 'out'" in err
    assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] == "running"
    os.kill(first.pid, signal.SIGTERM)
    first.communicate(timeout=400)


def test_a_signal_that_was_turned_off_stays_so(tmp_path):
    (tmp_path / "wait").touch()

    def ignore():
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    (tmp_path / "stages.py").write_text(STAGES)
    (tmp_path / "busy.yaml").write_text(CONFIG.format(how="kernel"))
    process = subprocess.Popen(
        [sys.executable, "-m", "sppm_pipeline", "run", "busy.yaml", "-o", "out", "-q"],
        cwd=tmp_path,
        env={**os.environ, "SPPM_CACHE": "off"},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        preexec_fn=ignore,
        text=True,
    )
    wait_for(tmp_path, process)
    os.kill(process.pid, signal.SIGHUP)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(0.5)
    assert process.poll() is None
    os.kill(process.pid, signal.SIGTERM)
    _, err = process.communicate(timeout=400)
    assert process.returncode == 143
    assert err == "sppm: interrupted\n"


EARLY = """
import os, signal, time
from sppm_pipeline.engine.process import supervision
HOW
def work():
    time.sleep(8)
    return 0
os._exit(supervision.supervised(work, lambda words: print(words, flush=True), "interrupted", lambda *words: None))
"""
AT_THE_FORK = """
fork = os.fork
def forked():
    child = fork()
    os.kill(os.getpid(), signal.SIGINT)  # both, as a terminal does
    return child
os.fork = forked
"""
BEFORE_THE_WAIT = """
adopt = supervision.adopt_orphans
def adopted():
    os.kill(os.getpid(), signal.SIGINT)
    adopt()
supervision.adopt_orphans = adopted
"""


@pytest.mark.parametrize("how", [AT_THE_FORK, BEFORE_THE_WAIT])
def test_an_interrupt_at_the_very_beginning_is_not_lost(how):
    program = subprocess.Popen(
        [sys.executable, "-c", EARLY.replace("HOW", how)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert program.communicate(timeout=60) == ("interrupted\n", "")
    assert program.returncode == 130


def test_both_processes_may_be_told_to_end_before_there_are_handlers():
    text = EARLY.replace("HOW", AT_THE_FORK.replace("SIGINT", "SIGTERM"))
    # the child dies of it; the parent looks only then
    text = text.replace("def work", "supervision.adopt_orphans = lambda: time.sleep(1)\ndef work")
    program = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=60)
    assert (program.stdout, program.stderr, program.returncode) == ("interrupted\n", "", 143)
