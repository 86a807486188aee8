"""Runs of a sweep as commands of their own, by which a cluster's scheduler can start them."""

from __future__ import annotations

import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

LAUNCHER: list[str] = []
"""What starts a command elsewhere, for instance ``["srun", "--ntasks=1"]``; nothing: on this machine."""

SHARED: Path | None = None
"""A folder that all machines see; the temporary folder of this one if None."""


class CommandExecutor(ThreadPoolExecutor):
    """Each worker is a thread that starts a command for a task and waits for its end."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self._running: set[subprocess.Popen[bytes]] = set()
        self._ended = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Queue a task: anything that can be pickled."""
        return super().submit(self._run, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End; with `cancel_futures` commands that still run are ended, too."""
        if cancel_futures:
            super().shutdown(wait=False, cancel_futures=True)
            self._ended = True
            for process in list(self._running):
                process.terminate()
        super().shutdown(wait=wait)

    def _run(self, *task: Any) -> Any:
        """Run one task and hand on what it returned or raised."""
        with tempfile.TemporaryDirectory(dir=SHARED) as folder:
            (Path(folder) / "task").write_bytes(pickle.dumps(task))
            process = subprocess.Popen([*LAUNCHER, sys.executable, "-P", __file__, folder])
            self._running.add(process)
            try:
                if self._ended:
                    process.terminate()
                code = process.wait()
            finally:
                self._running.discard(process)
            if code:
                raise BrokenExecutor(f"a command ended with code {code}")
            result, error = pickle.loads((Path(folder) / "result").read_bytes())
        if error is not None:
            raise error
        return result


def main(folder: Path) -> None:
    """Do the task that lies in a folder."""
    function, args, kwargs = pickle.loads((folder / "task").read_bytes())
    try:
        result = (function(*args, **kwargs), None)
    except Exception as error:
        result = (None, error)
    (folder / "result").write_bytes(pickle.dumps(result))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
