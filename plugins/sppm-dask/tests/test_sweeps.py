"""Whole runs on real local clusters: long sweeps, deadly rows, other versions, lost schedulers, cancel, and slabs."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import ClassVar

import dask
import pytest
from distributed import Client, LocalCluster
from sppm_dask.executor import LOCAL

from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.process import containment
from sppm_pipeline.engine.run.crew import WorkerPool
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.engine.run.executors import WorkerOptions
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.engine.run.sweep import run_sweep
from sppm_pipeline.errors import ConfigError

os.environ["SPPM_TRUST"] = tempfile.gettempdir()  # where the stages below are written

STAGE = '''
import os, signal, time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from sppm_pipeline import Context, PoreSet, Stage, option
from sppm_pipeline.engine.process import containment

containment.GRACE, containment.LAST = 0.5, 0.5

@dataclass(frozen=True, kw_only=True)
class Trouble(Stage):
    """Do to the row what a file says: kill its worker, once or each time, or wait until the file is gone."""
    name: ClassVar[str] = "check.trouble"
    row: int = option(help="number of the row")
    def run(self, context: Context, pores: PoreSet) -> None:
        once, always, waits = (Path(__file__).with_name(f"{word}-{self.row}") for word in ("once", "always", "waits"))
        if once.exists() or always.exists():
            once.unlink(missing_ok=True)
            # Dask starts no worker again that dies before its nanny, which looks now and then, knows that it runs
            time.sleep(5)
            os.kill(os.getpid(), signal.SIGKILL)
        while waits.exists():
            time.sleep(0.02)
        if Path(__file__).with_name(f"stops-{self.row}").exists():
            os.kill(os.getpid(), signal.SIGSTOP)
            time.sleep(2)  # another thread may be the one that takes the signal, some time later
'''

SWEEP = """sppm: 1
name: troubled
params: {n: 0}
plugins: [trouble.py]
pipeline:
  - {stage: sample.dart_throwing, count: 8}
  - {stage: connect.mst}
  - {stage: check.trouble, row: "${n}"}
  - {stage: write.graph, path: graph.json}
sweep: {n: {from: 0, to: LAST, step: 1}}
"""


WRITER = '''
import os, signal, time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from sppm_pipeline import LayerWriter, option

@dataclass(frozen=True, kw_only=True)
class WriteRaw(LayerWriter):
    """Raw layers; the first worker to encode one dies of it."""
    name: ClassVar[str] = "write.raw"
    suffix: ClassVar[str] = ".raw"
    path: str = option("layers", help="folder to write", output=True)

    def encode(self, image, stack):
        once = Path(__file__).with_name("once")
        if not once.exists():
            once.write_text(str(os.getpid()))
            time.sleep(5)  # its nanny is to know that it runs, or starts no other
            os.kill(os.getpid(), signal.SIGKILL)
        return image.tobytes()
'''

PART = """sppm: 1
pipeline:
  - {stage: sample.dart_throwing, total: 40}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.16, tunnel_radius: 0.04}
  - {stage: tile.periodic, cells: [2, 2, 2], cell: 2 mm}
  - {stage: slice.field, pixel: 0.1 mm, islands: remove}
  - {stage: write.raw}
"""


def prepare(folder: Path, rows: int, *trouble: str) -> Path:
    (folder / "trouble.py").write_text(STAGE)
    file = folder / "troubled.yaml"
    file.write_text(SWEEP.replace("LAST", str(rows - 1)))
    for name in trouble:
        (folder / name).touch()
    return file


@contextlib.contextmanager
def two_workers():
    """A cluster of two workers, as the executor starts them."""
    with (
        dask.config.set(LOCAL),
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=100) as cluster,
    ):
        yield cluster


@pytest.fixture(scope="module")
def shared():
    """The cluster of `lasting`."""
    with two_workers() as cluster:
        yield cluster


@pytest.fixture
def lasting(shared):
    """Two workers of several tests, which may kill some: others take their places, or are started here."""
    with contextlib.suppress(TimeoutError):
        shared.wait_for_workers(2, timeout=20)
        return shared
    shared.scale(0)
    while shared.scheduler.workers:
        time.sleep(0.05)
    shared.scale(2)
    shared.wait_for_workers(2, timeout=120)
    return shared


def swept(file: Path, to: str, executor: str, *, cache: Path | None = None, monitor: Monitor | None = None):
    """The record and the folder of a sweep."""
    session = open_session(RunRequest(str(file)))
    folder = file.parent / to
    record = run_sweep(
        session,
        session.plan(),
        folder,
        WorkerOptions(workers=2, executor=executor, threads=2, cache=cache),
        monitor=monitor,
    )
    return record, folder


def outputs(folder: Path) -> dict[str, bytes]:
    """Files of the rows, and the table."""
    files = [file for file in folder.rglob("*") if file.is_file() and file.name not in ("run.json", "SHA256SUMS")]
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


def table_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "sweep.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def statuses(record) -> list[str]:
    return [row["status"] for row in record["runs"]]


# what a worker is made to run
ANOTHER_PROGRAM = """
from sppm_pipeline.engine.run import workers
workers.own_digest, workers.program_digest = workers.program_digest, lambda: "0" * 64
"""
THEIR_OWN = """
from sppm_pipeline.engine.run import workers
workers.program_digest = workers.own_digest
"""


def test_forty_rows_have_the_bytes_of_a_serial_sweep_though_a_worker_is_killed(lasting, tmp_path):
    file = prepare(tmp_path, 40)
    serial, alone = swept(file, "serial", "serial")
    (tmp_path / "once-21").touch()
    record, folder = swept(file, "cluster", f"dask:{lasting.scheduler_address}")
    assert not (tmp_path / "once-21").exists()  # the worker has died
    assert statuses(serial) == statuses(record) == ["done"] * 40
    assert outputs(alone) == outputs(folder)
    assert len(outputs(alone)) == 40 + 3


def test_a_deadly_row_fails_alone(lasting, tmp_path):
    file = prepare(tmp_path, 6, "always-2")
    record, folder = swept(file, "out", f"dask:{lasting.scheduler_address}")
    assert record["status"] == "failed"
    assert statuses(record) == ["done", "done", "failed", "done", "done", "done"]
    assert record["runs"][2]["error"]["exit_code"] == 6
    assert record["runs"][2]["attempts"] == 3
    assert [bool(row["error"]) for row in table_of(folder)] == [False, False, True, False, False, False]


def test_a_stopped_row_is_ended_once_and_named(lasting, tmp_path, monkeypatch):
    file = prepare(tmp_path, 4, "stops-1")
    monkeypatch.setenv(containment.STAGE_TIME, "20")  # which the workers, started before, have not inherited
    record, folder = swept(file, "out", f"dask:{lasting.scheduler_address}")
    assert statuses(record) == ["done", "failed", "done", "done"]
    assert record["runs"][1]["attempts"] == 1
    assert "the stage 'check.trouble' took longer than the 20 seconds" in table_of(folder)[1]["error"]


def test_workers_that_are_gone_are_reported(lasting, tmp_path, monkeypatch):
    monkeypatch.setattr("sppm_dask.executor.WITHOUT_WORKERS", 1.0)
    file = prepare(tmp_path, 2)

    class Noting(Monitor):
        messages: ClassVar[list[str]] = []

        def warning(self, stage, message):
            self.messages.append(message)
            lasting.scale(2)

    address = lasting.scheduler_address
    lasting.scale(0)
    while lasting.scheduler.workers:
        time.sleep(0.05)
    record, _ = swept(file, "out", f"dask:{address}", monitor=Noting())
    assert statuses(record) == ["done"] * 2
    assert [message for message in Noting.messages if "has had no workers for 1 s; the runs wait" in message]


def test_a_scheduler_that_is_gone_prints_no_traceback(tmp_path):
    file = prepare(tmp_path, 4, "waits-3")
    ready = tmp_path / "scheduler.json"
    serving = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*serving, "--scheduler-file", str(ready)], **quiet) as scheduler:
        while not ready.exists():
            time.sleep(0.05)
        work = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(ready), "--nthreads", "1"]
        with subprocess.Popen([*work, "--local-directory", str(tmp_path), "--death-timeout", "60"], **quiet) as worker:
            command = [sys.executable, "-m", "sppm_pipeline", "run", str(file), "-o", str(tmp_path / "out")]
            command += ["--executor", f"dask:{ready}", "--no-cache"]
            with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
                done = [tmp_path / "out" / "runs" / f"{row:04}" / "run.json" for row in range(3)]
                while not all(_has_ended(record) for record in done) and process.poll() is None:
                    time.sleep(0.05)
                scheduler.kill()
                (tmp_path / "waits-3").unlink()
                out, said = process.communicate(timeout=300)
            worker.terminate()
    assert "Traceback" not in said + out
    assert "scheduler is gone" in said + out
    assert process.returncode == 4
    assert len(table_of(tmp_path / "out")) == 4


def run_everywhere(client: Client, code: str) -> None:
    """Run code in all workers; where one of them is just being replaced, in all of them again."""
    for _ in range(5):
        with contextlib.suppress(OSError):
            client.run(exec, code)
            return
        time.sleep(2)
    client.run(exec, code)


def test_workers_with_another_program_are_refused(lasting, tmp_path):
    file = prepare(tmp_path, 3)
    with Client(lasting, set_as_default=False) as client:
        run_everywhere(client, ANOTHER_PROGRAM)
        try:
            with pytest.raises(ConfigError, match="sppm_pipeline with the digest 000000000000 instead of"):
                swept(file, "out", f"dask:{lasting.scheduler_address}")
        finally:
            run_everywhere(client, THEIR_OWN)
    assert ["is not that of" in row["error"] for row in table_of(tmp_path / "out")] == [True] * 3


def test_a_scheduler_that_goes_leaves_a_table_and_the_sweep_goes_on_later(tmp_path):
    file = prepare(tmp_path, 8)
    _, alone = swept(file, "serial", "serial")
    for row in range(5, 8):
        (tmp_path / f"waits-{row}").touch()

    class Closing(Monitor):
        ended = 0

        def row_finished(self, done, total, result):
            self.ended += 1
            if self.ended == 4:
                threading.Thread(target=cluster.close, daemon=True).start()

    cache = tmp_path / "cache"
    with two_workers() as cluster:
        record, folder = swept(file, "out", f"dask:{cluster.scheduler_address}", cache=cache, monitor=Closing())
    assert statuses(record)[5:] == ["failed"] * 3
    assert statuses(record).count("done") >= 4
    assert all("scheduler is gone" in row["error"] for row in table_of(folder)[5:])
    for row in range(5, 8):
        (tmp_path / f"waits-{row}").unlink()
    record, folder = swept(file, "out", "processes", cache=cache)
    assert statuses(record) == ["done"] * 8
    assert outputs(alone) == outputs(folder)


def test_a_canceled_sweep_leaves_nobody_behind_and_goes_on(tmp_path):
    file = prepare(tmp_path, 8)
    _, alone = swept(file, "serial", "serial")
    for row in range(4, 8):
        (tmp_path / f"waits-{row}").touch()
    command = [sys.executable, "-m", "sppm_pipeline", "run", str(file), "-o", str(tmp_path / "out"), "-q"]
    command += ["-j", "2", "--executor", "dask", "--cache", str(tmp_path / "cache")]
    records = [tmp_path / "out" / "runs" / f"{row:04}" / "run.json" for row in range(4)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        deadline = time.monotonic() + 180
        while not all(_has_ended(record) for record in records) and time.monotonic() < deadline:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        assert process.wait(120) == 130
    assert not _session(process.pid)
    for row in range(4, 8):
        (tmp_path / f"waits-{row}").unlink()
    again = subprocess.run([*command, "--json"], capture_output=True, text=True, timeout=600, check=True)
    record = json.loads(again.stdout)
    assert statuses(record) == ["done"] * 8
    assert outputs(tmp_path / "out") == outputs(alone)


def test_a_part_is_sliced_by_workers_with_the_bytes_of_one_process(lasting, tmp_path):
    (tmp_path / "raw.py").write_text(WRITER)
    (tmp_path / "once").write_text("not in serial")
    session = open_session(RunRequest("part.yaml", plugins=(str(tmp_path / "raw.py"),), text=PART))
    found = []
    for to, executor in (("serial", None), ("cluster", f"dask:{lasting.scheduler_address}")):
        path, crew = tmp_path / to, None
        if executor is not None:
            crew = WorkerPool(session.plugins, path, WorkerOptions(workers=2, executor=executor, threads=2))
        record = run_plan(session.plan(), path, threads=2, crew=crew)
        found.append((outputs(path), record["stages"][-1]["summary"]))
        (tmp_path / "once").unlink()  # of the worker that has died
    assert found[0] == found[1]
    assert len(found[0][0]) == 40 + 2  # manifest.json and the overview


def _has_ended(record: Path) -> bool:
    try:
        return json.loads(record.read_bytes())["status"] == "done"
    except (OSError, ValueError):
        return False


def _session(leader: int) -> list[int]:
    """Processes of a session that are still there."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == leader and fields[0] != "Z":
            found.append(int(status.parent.name))
    return found
