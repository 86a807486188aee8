"""The executor keeps the contract of executors, and its own promises."""

from __future__ import annotations

import os
import time
from concurrent.futures import BrokenExecutor

import pytest
from my_plugin.commands import CommandExecutor

from sppm_pipeline.testing.contracts import ExecutorContract


class TestCommandExecutor(ExecutorContract):
    def executor(self, workers):
        return CommandExecutor(workers)


def test_each_task_has_a_process_of_its_own():
    with CommandExecutor(2) as executor:
        tasks = [executor.submit(os.getpid) for _ in range(2)]
        assert len({os.getpid(), *(task.result() for task in tasks)}) == 3


def test_a_command_that_dies_is_an_error():
    with CommandExecutor(1) as executor, pytest.raises(BrokenExecutor, match="code 3"):
        executor.submit(os._exit, 3).result()


def test_commands_end_when_they_are_canceled():
    executor = CommandExecutor(1)
    future = executor.submit(time.sleep, 600)
    while not future.running():
        time.sleep(0.01)
    executor.shutdown(cancel_futures=True)
    assert isinstance(future.exception(), BrokenExecutor)
