"""For sppm_pipeline: my_purpose."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor

from sppm_pipeline import hookimpl


def _commands(workers: int) -> Executor:
    from my_plugin.commands import CommandExecutor

    return CommandExecutor(workers)


@hookimpl
def sppm_executors() -> dict[str, Callable[[int], Executor]]:
    """Our executors; each is called with the number of workers (`-j`)."""
    return {"my_word": _commands}
