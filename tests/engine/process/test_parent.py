"""The parent dies: nothing goes on without it, and its folder is removed by whoever comes next."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from sppm_pipeline.engine.process import exchange

PARENT = """
import os, sys, threading, time
sys.path.insert(0, sys.argv[1])

def fork():
    while not os.path.exists(sys.argv[2]):
        time.sleep(0.01)
    fork = os.fork()
    if fork == 0:
        time.sleep(600)
        os._exit(0)
    print(fork, flush=True)

if sys.argv[3] == "True":
    threading.Thread(target=fork, daemon=True).start()
from sppm_pipeline.engine.process import ArraySpec, run_native
run_native("evil_functions:descendants", {}, {"note": sys.argv[2], "then": "hang"},
           returns={"x": ArraySpec("float64", (3,))}, distribution="numpy", seconds=100)
"""


@pytest.fixture
def parent(functions, temporary, tmp_path, noted):
    """Start a process whose child hangs; the process, and the numbers of all below it."""
    started, forks = [], []

    def start(name="note", fork=False):
        process = subprocess.Popen(
            [sys.executable, "-c", PARENT, str(functions), str(tmp_path / name), str(fork)],
            env=os.environ | {"TMPDIR": str(temporary)},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        started.append(process)
        pids = noted(tmp_path / name)
        if fork:
            forks.append(int(process.stdout.readline()))
        return process, pids

    yield start
    for pid in forks:
        os.kill(pid, signal.SIGKILL)
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_no_orphans(parent, gone, number):
    process, pids = parent()
    process.send_signal(number)
    process.wait(60)
    assert gone(pids), "something goes on after its parent's death"


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of the death of a parent")
def test_no_orphans_though_a_fork_holds_the_life_line(parent, gone):
    process, pids = parent(fork=True)
    process.kill()
    process.wait(60)
    assert gone(pids)


def test_leftovers_of_the_dead_are_removed_those_of_the_living_are_not(parent, gone, temporary):
    dead, pids = parent("first")
    first = set(temporary.iterdir())
    assert len(first) == 1
    living, _ = parent("second")
    second = set(temporary.iterdir()) - first
    dead.kill()
    dead.wait()
    assert gone(pids)
    assert first <= set(temporary.iterdir())
    # nobody's, as others may make them: not ours to judge
    (temporary / f"{exchange.PREFIX}file").write_text("a file", encoding="utf-8")
    (temporary / f"{exchange.PREFIX}link").symlink_to(temporary.parent)
    (temporary / "else").mkdir()
    (next(iter(first)) / "work" / "closed").mkdir()
    (next(iter(first)) / "work" / "closed").chmod(0)
    with exchange.private_folder() as mine:
        names = {path.name for path in temporary.iterdir()}
    assert names == {f"{exchange.PREFIX}file", f"{exchange.PREFIX}link", "else", mine.name, *(p.name for p in second)}
    assert living.poll() is None


def test_folders_of_other_users_are_left_alone(temporary, monkeypatch):
    (temporary / f"{exchange.PREFIX}x").mkdir()
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    exchange.remove_leftovers()
    assert len(list(temporary.iterdir())) == 1
    monkeypatch.setattr(os, "geteuid", lambda: me)
    exchange.remove_leftovers()
    assert not list(temporary.iterdir())


def test_a_folder_taken_for_a_leftover_is_made_anew(temporary, monkeypatch):
    """Somebody removes the folder between its making and its locking."""
    import fcntl

    real, seen = fcntl.flock, []

    def late(lock, how):
        real(lock, how)
        if not seen:
            seen.append(next(temporary.iterdir()))
            seen[0].rmdir()

    monkeypatch.setattr(fcntl, "flock", late)
    with exchange.private_folder() as path:
        assert path.is_dir()
        assert path != seen[0]
    assert not list(temporary.iterdir())


STAGE = """
from dataclasses import dataclass
from typing import ClassVar
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.engine.process import ArraySpec, run_native
from sppm_pipeline.stage import Context, Stage, option

@dataclass(frozen=True, kw_only=True)
class Hang(Stage):
    \"\"\"Never ends.\"\"\"
    name: ClassVar[str] = "read.hang"
    note: str = option(help="a file")
    then: str = option(help="what to do")
    def run(self, context: Context) -> SurfaceMesh:
        run_native("evil_functions:descendants", {}, {"note": self.note, "then": self.then},
                   returns={"x": ArraySpec("float64", (3,))}, distribution="numpy", seconds=100)
        return SurfaceMesh([[0.0, 0, 0]], [[0, 0, 0]])
"""


@pytest.fixture
def program(functions, temporary, tmp_path, noted):
    """Start ``sppm run`` on a pipeline whose stage runs native code."""
    (tmp_path / "hang.py").write_text(STAGE, encoding="utf-8")
    (tmp_path / "hang.yaml").write_text(
        "sppm: 1\nname: hang\nparams: {note: a}\npipeline:\n  - {stage: read.hang, note: '${note}', then: hang}\n"
        f"sweep:\n  note: ['{tmp_path / 'note0'}', '{tmp_path / 'note1'}']\n",
        encoding="utf-8",
    )
    started = []

    def start(*words):
        command = [
            sys.executable,
            "-m",
            "sppm_pipeline",
            "run",
            "hang.yaml",
            "--plugin",
            "hang.py",
            "-o",
            "out",
            *words,
        ]
        environment = os.environ | {
            "TMPDIR": str(temporary),
            "PYTHONPATH": os.pathsep.join([str(functions), *sys.path]),
        }
        process = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("workers", [(), ("-j", "2", "--executor", "threads"), ("-j", "2", "--executor", "processes")])
def test_the_program_is_interrupted(program, tmp_path, gone, noted, number, code, workers):
    process = program(*workers)
    pids = noted(tmp_path / "note0") + (noted(tmp_path / "note1") if workers else [])
    process.send_signal(number)
    assert process.wait(90) == code
    assert gone(pids)


def test_a_crash_is_exit_code_6(program, tmp_path):
    text = (tmp_path / "hang.yaml").read_text(encoding="utf-8").split("sweep:")[0].replace("hang}", "crash}")
    (tmp_path / "hang.yaml").write_text(text, encoding="utf-8")
    process = program("-p", f"note={tmp_path / 'note0'}")
    _, said = process.communicate(timeout=600)
    assert process.returncode == 6
    assert "stage 'read.hang': numpy" in said
    assert "died by SIGABRT" in said
    assert "Traceback" not in said
