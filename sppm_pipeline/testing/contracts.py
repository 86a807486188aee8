"""Promises of every stage, as suites to inherit from::

class TestMySampler(SamplerContract):
    def stages(self):
        return [MySampler(count=20), MySampler(count=1)]
"""

from __future__ import annotations

import os
import time
from abc import abstractmethod
from concurrent.futures import BrokenExecutor, Executor

from sppm_pipeline.errors import NativeCrash
from sppm_pipeline.testing.design_contracts import ConnectorContract, SamplerContract, TilerContract
from sppm_pipeline.testing.result_contracts import FieldContract, HomogenizerContract, SlicerContract, WriterContract
from sppm_pipeline.testing.stage_contract import StageContract

__all__ = [
    "ConnectorContract",
    "ExecutorContract",
    "FieldContract",
    "HomogenizerContract",
    "SamplerContract",
    "SlicerContract",
    "StageContract",
    "TilerContract",
    "WriterContract",
]


class ExecutorContract:
    """Expectations of sweeps on an executor."""

    apart = False
    """Tasks run in other processes than the one that submits them."""

    @abstractmethod
    def executor(self, workers: int) -> Executor:
        """A new one, as the hook `sppm_executors` makes it."""

    def test_results_belong_to_their_tasks(self) -> None:
        """In any order of their ends."""
        with self.executor(2) as executor:
            futures = [executor.submit(pow, base, exp=2) for base in range(5)]
            assert [future.result(timeout=60) for future in futures] == [0, 1, 4, 9, 16]
            assert list(executor.map(divmod, (7, 9), (2, 5), timeout=60)) == [(3, 1), (1, 4)]

    def test_an_error_is_that_of_its_task(self) -> None:
        """Type and message arrive, and the next task is done."""
        with self.executor(1) as executor:
            bad, good = executor.submit(int, "no number"), executor.submit(int, "3")
            error = bad.exception(timeout=60)
            assert isinstance(error, ValueError)
            assert "no number" in str(error)
            assert good.result(timeout=60) == 3

    def test_nothing_goes_on_after_the_end(self) -> None:
        """Tasks that are canceled don't run, those that run have ended, and it may be shut down twice."""
        executor = self.executor(1)
        futures = [executor.submit(time.sleep, 0.02) for _ in range(9)]
        for future in futures:
            future.cancel()
        executor.shutdown(wait=True)
        assert all(future.done() for future in futures)
        executor.shutdown(wait=True)

    def test_a_worker_that_dies_is_heard_of(self) -> None:
        """By an error that says so, whether the executor goes on (`NativeCrash`) or breaks down (`BrokenExecutor`)."""
        if self.apart:
            with self.executor(1) as executor:
                error = executor.submit(os._exit, 3).exception(timeout=60)
                assert isinstance(error, (BrokenExecutor, NativeCrash))
                if isinstance(error, NativeCrash):
                    assert executor.submit(pow, 2, 3).result(timeout=60) == 8
