"""The worker: calls the function. Run as a script in the private folder, by `supervisor`.

Its arguments are the number of the supervising process, the file descriptor of the progress pipe and the private
folder, which holds ``job.json`` and ``arrays/``. It leaves ``returned/`` and, last, ``outcome.json``.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any


def main() -> None:
    """Limit this process, call the function, write what it returned or raised, and end without taking anything down."""
    supervisor, progress, folder = int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    _limit(job["memory"])
    # after the limit, so that imports count; the script's own folder never was in the path
    sys.path[:] = job["path"]
    from sppm_pipeline.engine.process.tree import die_with_parent

    die_with_parent(supervisor)
    outcome = _outcome(job, folder, progress)
    text = json.dumps(outcome)
    (folder / "outcome.part").write_text(text, encoding="utf-8")
    # in one step, so that a child that dies leaves no half result
    (folder / "outcome.part").rename(folder / "outcome.json")
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # the library may have closed it
            stream.flush()
    # native libraries like to crash when they are taken down; all that matters is on disk
    os._exit(0)


def _limit(memory: int) -> None:
    """Bound the memory; no core dumps."""
    import resource

    # what is reserved but not used does not count on Linux with this limit; others know only the other one
    kind = resource.RLIMIT_DATA if sys.platform == "linux" else resource.RLIMIT_AS
    for which, value in ((kind, memory), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(which)[1]
        most = value if hard == resource.RLIM_INFINITY else min(value, hard)
        with contextlib.suppress(OSError, ValueError):  # macOS refuses limits below what is already in use
            resource.setrlimit(which, (most, most))
    if sys.platform == "linux":  # should the system run out of memory all the same, this process is the one to end
        with contextlib.suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")


def _outcome(job: dict[str, Any], folder: Path, progress: int) -> dict[str, Any]:
    """Call the function; its values, or the error it raised, as JSON."""
    try:
        return {"values": _call(job, folder, progress)}
    except MemoryError:
        return {"memory": True}
    except SystemExit as exit:
        return {"raised": "SystemExit", "message": f"called sys.exit({exit.code!r:.100})"}
    except BaseException as error:
        return _described(error)


def _described(error: BaseException) -> dict[str, Any]:
    """Class, message and hint; of our own errors the nearest class that the parent knows."""
    from sppm_pipeline import errors

    if isinstance(error, errors.SppmError):
        known = next(cls.__name__ for cls in type(error).__mro__ if getattr(errors, cls.__name__, None) is cls)
        return {"known": known, "message": error.message[:4000], "hint": error.hint and error.hint[:4000]}
    described = {"raised": type(error).__name__, "message": str(error)[:4000]}
    if isinstance(error, ModuleNotFoundError) and error.name:
        described["module"] = error.name
    return described


def _call(job: dict[str, Any], folder: Path, progress: int) -> Any:
    import importlib

    import numpy as np

    from sppm_pipeline.engine.process.exchange import connect, write_arrays

    connect(progress)
    arrays = {name: np.load(folder / "arrays" / f"{name}.npy", allow_pickle=False) for name in job["arrays"]}
    module, _, name = job["function"].partition(":")
    function = getattr(importlib.import_module(module), name)
    returned = function(arrays, job["options"])
    if not isinstance(returned, tuple) or len(returned) != 2 or not all(isinstance(part, dict) for part in returned):
        raise TypeError(f"must return a dict of arrays and a dict of values, returned {returned!r:.100}")
    made, values = returned
    if set(made) != set(job["returns"]):
        raise TypeError(f"must return the arrays {sorted(job['returns'])}, returned {sorted(map(str, made))}")
    into = folder / "returned"
    into.mkdir(exist_ok=True)
    write_arrays(into, made)
    json.dumps(values, allow_nan=False)  # a value that JSON does not know is an error of this function
    return values


if __name__ == "__main__":
    main()
