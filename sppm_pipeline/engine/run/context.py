"""The context that a running stage sees: random numbers, reports, progress and outputs."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import operator
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sppm_pipeline.engine.cache.identity import environment, program_digest
from sppm_pipeline.engine.cache.keys import key_of, recipe_key
from sppm_pipeline.engine.cache.store import Store
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.engine.process.budget import planning_memory, requested_memory
from sppm_pipeline.engine.process.interruption import check, current_stop
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.engine.run.outputs import RunFolder, Scratch
from sppm_pipeline.engine.strict_json import jsonable
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.size import ONE
from sppm_pipeline.nouns.storage import DamagedError
from sppm_pipeline.stage import Context

if TYPE_CHECKING:
    from sppm_pipeline.engine.run.crew import WorkerPool


def generator(seed: int, path: tuple[str, ...], key: tuple[int, ...]) -> np.random.Generator:
    """The generator of one draw: a function of the run's seed, the stage's path and a key, and of nothing else.

    The path of a stage in a pipeline is its id; in a recipe, the path of the stage that repeats the recipe, the
    recipe's name and attempt (``cell@2``), and the id. Seed, path and key are hashed together with their lengths in
    front, so that different draws can't share a generator.
    """
    # lengths in front, so that ("ab", "c") and ("a", "bc") differ
    words = [str(seed), str(len(path)), *path, *(str(operator.index(k)) for k in key)]
    text = "".join(f"{len(word)}:{word}" for word in words)
    entropy = int.from_bytes(hashlib.sha256(text.encode()).digest(), "little")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))


class StageLog:
    """Reports of the stages of one step of the pipeline, those of its recipes included.

    By address: `values`, and of stages of recipes `inner`: how often they ran, how long, and their last summary.
    `warnings` are pairs of address and message, each once. `drew` is True if random numbers were asked for; if
    not, the seed has no part in the result.
    """

    def __init__(self, monitor: Monitor, step: str) -> None:
        self._monitor = monitor
        self._step = step
        self._lock = threading.Lock()
        self.values: dict[str, dict[str, Any]] = {}
        self.warnings: list[tuple[str, str]] = []
        self.inner: dict[str, dict[str, Any]] = {}
        self.drew = False

    def report(self, stage: str, values: dict[str, Any]) -> None:
        """Keep numbers of a stage."""
        checked = {name: jsonable(value) for name, value in values.items()}
        with self._lock:
            self.values.setdefault(stage, {}).update(checked)

    def begin(self, stage: str) -> None:
        """Forget the numbers of the stage's last run."""
        with self._lock:
            self.values.pop(stage, None)

    def warn(self, stage: str, message: str) -> None:
        """Keep a warning and tell it, once."""
        with self._lock:
            # a recipe that is drawn a thousand times says the same a thousand times
            if (stage, message) in self.warnings:
                return
            self.warnings.append((stage, message))
        self._monitor.warning(stage, message)

    def progress(self, stage: str, done: float, total: float, what: str) -> None:
        """Pass progress on."""
        self._monitor.progress(self._step, stage != self._step, done, total, what)

    def ran(self, stage: str, name: str, made: str | None, seconds: float, summary: dict[str, Any]) -> None:
        """Note that a stage of a recipe has run."""
        with self._lock:
            entry = self.inner.setdefault(stage, {"id": stage, "stage": name, "made": made, "runs": 0, "seconds": 0.0})
            entry["runs"] += 1
            entry["seconds"] = round(entry["seconds"] + seconds, 6)
            entry["summary"] = summary


class RunContext(Context):
    """The context of one stage.

    `path` is that of `generator`, `address` what messages call the stage. The seed is private, as who asks for random
    numbers is noted. Without a `folder` there is nowhere to write, without a `store` nothing unfinished is kept, and
    without a `crew` all work is done in this process. `readers` is what `begin_readers` returns.
    """

    def __init__(
        self,
        *,
        seed: int,
        path: tuple[str, ...],
        address: str,
        threads: int,
        palette: Palette,
        log: StageLog,
        folder: RunFolder | Scratch | None,
        store: Store | None = None,
        crew: WorkerPool | None = None,
        begun: Any = None,
        readers: Callable[[], Sequence[Any]] = tuple,
    ) -> None:
        self._seed = seed
        self.begun = begun
        self._readers = readers
        self._store = store
        self._crew = crew
        if crew is not None:
            self.workers, self.worker_threads = crew.workers, crew.threads
        self.path = path
        self.address = address
        self.threads = threads
        self.palette = palette
        self.log = log
        self.folder = folder
        self.memory_limit = requested_memory()
        self._stop = current_stop()  # stages report from threads of their own, too

    @functools.cached_property
    def memory(self) -> int:  # type: ignore[override]
        """See `Context`; measured only for a stage that asks."""
        return planning_memory()

    def inside(self, recipe: str, attempt: int, id_: str, address: str, palette: Palette) -> RunContext:
        """The context of a stage of a recipe that this stage repeats."""
        return RunContext(
            seed=self._seed,
            path=(*self.path, f"{recipe}@{operator.index(attempt)}", id_),
            address=address,
            threads=self.threads,
            palette=palette,
            log=self.log,
            folder=self.folder,
            store=self._store,
            crew=self._crew,
        )

    def recipe_key(self, recipe: str, recipes: Mapping[str, Sequence[Step]], attempt: int) -> str | None:
        """The key under which what a recipe of this stage reports may be remembered; None without a cache."""
        wanted = self.palette
        plain = (wanted.interiors, wanted.colors) == (ONE.interiors, ONE.colors) and wanted.meetings is None
        if self._store is None or not plain:
            return None
        path = (*self.path, f"{recipe}@{operator.index(attempt)}")
        return recipe_key(recipe, recipes, path, self._seed)

    def rng(self, *key: int) -> np.random.Generator:
        check(self._stop)
        # without random numbers the seed is left out of the key of the cache
        self.log.drew = True
        return generator(self._seed, self.path, key)

    def report(self, **values: Any) -> None:
        check(self._stop)
        self.log.report(self.address, values)

    def progress(self, done: float, total: float, what: str = "") -> None:
        check(self._stop)
        self.log.progress(self.address, done, total, what)

    def warn(self, message: str) -> None:
        check(self._stop)
        self.log.warn(self.address, message)

    def map(self, function: Callable[[Any, Any], Any], items: Iterable[Any], common: Any = None) -> Iterator[Any]:
        check()
        if self._crew is None:
            return super().map(function, items, common)
        return self._crew.map(function, items, common)

    def begin_readers(self) -> Sequence[Any]:
        check(self._stop)
        return self._readers()

    def worth_workers(self, samples: float) -> bool:
        if self._crew is None:
            return super().worth_workers(samples)
        return self._crew.takes(samples)

    def shared_folder(self) -> Path | None:
        check()
        return None if self._crew is None else self._crew.folder()

    def remember(self, key: str, state: Any) -> None:
        """See `Context.remember`; stages call this on their way out of an interrupted run, too."""
        if self._store is None:
            return
        about = {"stage": self.address, "id": self.address, "seconds": 0.0, "random": False, "facts": {}}
        # state is a convenience: without it an interrupted stage begins again
        with contextlib.suppress(OSError):
            self._store.remove(_unfinished(key))
            if state is not None:
                self._store.put(_unfinished(key), {**about, "same_as": None}, value=state)

    def recall(self, key: str) -> Any:
        check(self._stop)
        if self._store is None:
            return None
        try:
            entry = self._store.find(_unfinished(key))
            return None if entry is None else self._store.load(entry)
        except (DamagedError, OSError):
            return None

    def hashed(self, name: str, sha256: str) -> None:
        if isinstance(self.folder, RunFolder):
            self.folder.hashed(name, sha256)

    def scratch(self) -> Path:
        return self.folder.temporary() if isinstance(self.folder, RunFolder) else super().scratch()

    def output(self, name: str) -> Path:
        check(self._stop)
        if self.folder is None:
            raise ConfigError(f"there is no run directory for the output {name!r}")
        return self.folder.claim(self.address, name)


def _unfinished(key: str) -> str:
    return key_of({"unfinished": key, "program": program_digest(), "environment": environment()})
