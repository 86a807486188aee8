"""Sweeps on real local clusters: same bytes as in serial, workers that die, and places that are none."""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from concurrent.futures import BrokenExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
import sppm_dask.executor as places
from sppm_dask.executor import DaskExecutor

from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.run.crew import Crew
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.engine.run.sweep import run_sweep
from sppm_pipeline.errors import ConfigError, NativeCrash, ResourceError
from sppm_pipeline.testing.contracts import ExecutorContract

STAGE = '''
import os, signal, time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from sppm_pipeline.data.pores import PoreSet
from sppm_pipeline.stage import Context, Stage, option

@dataclass(frozen=True, kw_only=True)
class Kill(Stage):
    """Kill the worker with the number that is asked for, once."""
    name: ClassVar[str] = "check.kill"
    seed: int = option(help="no worker dies of others than 5")
    def run(self, context: Context, pores: PoreSet) -> None:
        once = Path(__file__).with_name("once")
        if self.seed == 5 and not once.exists():
            once.write_text(str(os.getpid()))
            time.sleep(2)  # its nanny is to know that it runs, or starts no other
            os.kill(os.getpid(), signal.SIGKILL)
'''

SWEEP = """sppm: 1
params: {n: 1}
pipeline:
  - {stage: sample.dart_throwing, count: 8}
  - {stage: check.kill, seed: "${n}"}
  - {stage: connect.mst}
  - {stage: write.graph, path: graph.json}
sweep: {n: [1, 2, 3, 4, 5, 6, 7, 8]}
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
            time.sleep(2)  # its nanny is to know that it runs, or starts no other
            os.kill(os.getpid(), signal.SIGKILL)
        return image.tobytes()
'''

PART = """sppm: 1
pipeline:
  - {stage: sample.dart_throwing, total: 40}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.16, tunnel_radius: 0.04}
  - {stage: tile.periodic, cells: [2, 2, 2], cell: 2 mm}
  - {stage: slice.field, pixel: 0.1 mm}
  - {stage: write.raw}
"""


@pytest.fixture(scope="module")
def cluster():
    """Two workers of this machine, which executors can also find by the address of their scheduler."""
    with DaskExecutor(2) as executor:
        assert ", 2 workers" in executor.about
        yield executor._client.cluster


@pytest.mark.parametrize("test", [name for name in dir(ExecutorContract) if name.startswith("test_")])
def test_it_keeps_the_contract(cluster, test):
    class Suite(ExecutorContract):
        apart = True

        def executor(self, workers):
            return DaskExecutor(workers, cluster.scheduler_address)

    getattr(Suite(), test)()


def test_a_scheduler_file_names_the_cluster_and_arguments_are_not_those_of_dask(cluster, tmp_path):
    file = tmp_path / "scheduler.json"
    file.write_text(json.dumps({"address": cluster.scheduler_address}))
    with DaskExecutor(1, str(file)) as executor:
        assert executor.about.startswith(f"Dask at {cluster.scheduler_address}, ")
        assert executor.submit(dict, retries=2, workers="none").result(timeout=600) == {"retries": 2, "workers": "none"}
        twice = [executor.submit(time.perf_counter) for _ in range(2)]
        assert twice[0].result(timeout=600) != twice[1].result(timeout=600)
    with pytest.raises(RuntimeError, match="shut down"):
        executor.submit(int)


def test_a_task_that_kills_its_workers_says_so(cluster):
    with DaskExecutor(2, cluster.scheduler_address) as executor:
        error = executor.submit(os._exit, 3).exception(timeout=600)
        assert isinstance(error, NativeCrash)
        assert "died 2 times" in error.message


def test_workers_forget_results_that_were_taken(cluster):
    with DaskExecutor(2, cluster.scheduler_address) as executor:
        gc.collect()
        gc.disable()  # what is left to it may stay for minutes
        try:
            futures = [executor.submit(bytes, 1000) for _ in range(4)]
            assert [len(future.result(timeout=600)) for future in futures] == [1000] * 4
            futures.clear()
            deadline = time.monotonic() + 60
            while executor._client.futures and time.monotonic() < deadline:
                time.sleep(0.01)
            assert not executor._client.futures
        finally:
            gc.enable()


def test_places_that_are_none(monkeypatch):
    monkeypatch.setattr(places, "CONNECTING", "0.2s")
    with pytest.raises(ConfigError, match="dask:slrum is no address, no scheduler file and no queue"):
        DaskExecutor(1, "slrum")
    with pytest.raises(ResourceError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:9:"):
        DaskExecutor(1, "tcp://127.0.0.1:9")
    monkeypatch.setitem(sys.modules, "dask_jobqueue", None)
    with pytest.raises(ConfigError, match="dask:slurm needs dask-jobqueue") as caught:
        DaskExecutor(1, "slurm")
    assert "sppm-dask[jobqueue]" in caught.value.hint


def test_a_task_that_the_scheduler_gives_up_says_so(cluster, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with DaskExecutor(1, cluster.scheduler_address) as executor:
        future = executor.submit(os.open, str(tmp_path / "pipe"), os.O_RDONLY)  # waits for somebody who writes
        executor._client.cancel(list(executor._tasks._futures))
        assert isinstance(future.exception(timeout=600), ConnectionError)
        os.open(tmp_path / "pipe", os.O_RDWR)  # stays open: the worker may come to it later
        executor._client.close()
        with pytest.raises(BrokenExecutor, match="scheduler is gone"):
            executor.submit(int)


def test_a_queue_starts_as_many_jobs_as_are_asked_for(cluster, monkeypatch):
    asked = []

    class Queue:
        def __getattr__(self, name):
            return getattr(cluster, name)

        def __enter__(self):
            return self

        def __exit__(self, *error):
            asked.append("ended")

        def adapt(self, **limits):
            asked.append(limits)

    monkeypatch.setitem(sys.modules, "dask_jobqueue", SimpleNamespace(SLURMCluster=Queue))
    with DaskExecutor(7, "slurm") as executor:
        assert executor.about.endswith("at most 7 jobs of slurm")
    assert asked == [{"minimum_jobs": 1, "maximum_jobs": 7}, "ended"]


def outputs(folder: Path) -> dict[str, bytes]:
    """What the rows wrote, and the table."""
    files = [file for file in folder.rglob("*") if file.is_file() and file.name not in ("run.json", "SHA256SUMS")]
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


def test_a_sweep_survives_a_worker_that_is_killed_with_the_bytes_of_a_serial_one(cluster, tmp_path):
    (tmp_path / "kill.py").write_text(STAGE)
    (tmp_path / "once").write_text("not in serial")
    session = open_session(
        RunRequest("sweep.yaml", plugins=(str(tmp_path / "kill.py"),), text=SWEEP, folder=str(tmp_path))
    )
    found = []
    for to, executor in (("serial", "serial"), ("cluster", f"dask:{cluster.scheduler_address}")):
        folder = tmp_path / to
        record = run_sweep(session, session.plan(), folder, workers=2, executor=executor, threads=2)
        assert [row["status"] for row in record["runs"]] == ["done"] * 8
        found.append(outputs(folder))
        (tmp_path / "once").unlink()  # of the worker that has died
    assert found[0] == found[1]
    assert len(found[0]) == 8 + 2


def test_a_part_is_sliced_by_workers_with_the_bytes_of_one_process(cluster, tmp_path):
    (tmp_path / "raw.py").write_text(WRITER)
    (tmp_path / "once").write_text("not in serial")
    session = open_session(RunRequest("part.yaml", plugins=(str(tmp_path / "raw.py"),), text=PART))
    found = []
    for to, executor in (("serial", None), ("cluster", f"dask:{cluster.scheduler_address}")):
        path, crew = tmp_path / to, None
        if executor is not None:
            crew = Crew(session.plugins, path, executor=executor, workers=2, threads=2)
        record = run_plan(session.plan(), path, threads=2, crew=crew)
        found.append((outputs(path), record["stages"][-1]["summary"]))
        (tmp_path / "once").unlink()  # of the worker that has died
    assert found[0] == found[1]
    assert len(found[0][0]) == 40 + 2  # manifest.json and the overview
