"""The executor on real local clusters: its contract, workers that die, and places that are none."""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from concurrent.futures import BrokenExecutor, Future
from types import SimpleNamespace

import pytest
import sppm_dask.executor as places
from sppm_dask.executor import DaskExecutor

from sppm_pipeline.errors import ConfigError, NativeCrash, ResourceError
from sppm_pipeline.testing.contracts import ExecutorContract


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
    assert caught.value.hint == "pip install dask-jobqueue"


def test_a_task_that_the_scheduler_gives_up_says_so(cluster, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with DaskExecutor(1, cluster.scheduler_address) as executor:
        future = executor.submit(os.open, str(tmp_path / "pipe"), os.O_RDONLY)  # waits for a writer
        executor._client.cancel(list(executor._tasks._futures))
        assert isinstance(future.exception(timeout=600), ConnectionError)
        os.open(tmp_path / "pipe", os.O_RDWR)  # stays open: the worker may come to it later
        executor._client.close()
        with pytest.raises(BrokenExecutor, match="scheduler is gone"):
            executor.submit(int)


def test_a_cluster_without_workers_is_given_up(monkeypatch):
    monkeypatch.setattr("sppm_dask.executor.WITHOUT_WORKERS", 1.0)
    with DaskExecutor(1) as executor:
        assert executor.submit(int).result(timeout=600) == 0
        executor._client.cluster.scale(0)
        while executor._client.cluster.scheduler.workers:
            time.sleep(0.01)
        waiting = executor.submit(int)
        with pytest.raises(BrokenExecutor, match="all workers of the local Dask cluster died"):
            waiting.result(timeout=600)
        with pytest.raises(BrokenExecutor, match="none could be started again"):
            executor.submit(int)


def test_a_task_that_is_handed_out_while_the_cluster_is_given_up_is_refused(cluster, monkeypatch):
    with DaskExecutor(1, cluster.scheduler_address) as executor:
        submit = executor._tasks.submit

        def submitted(task):
            executor._broken = "given up"  # as the watch does, which has counted the open tasks already
            return submit(task)

        monkeypatch.setattr(executor._tasks, "submit", submitted)
        with pytest.raises(BrokenExecutor, match="given up"):
            executor.submit(int)
        assert not executor._open


def test_a_result_that_is_lost_with_the_scheduler_is_not_waited_for(cluster, monkeypatch):
    monkeypatch.setattr("sppm_dask.executor.SETTLED", 0.2)
    with DaskExecutor(1, cluster.scheduler_address) as executor:
        assert executor.submit(int).result(timeout=600) == 0
        waiting = Future()  # of which Dask says nothing
        executor._open.add(waiting)
        executor._client.close()
        with pytest.raises(ConnectionError, match="the Dask scheduler is gone"):
            waiting.result(timeout=600)


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
