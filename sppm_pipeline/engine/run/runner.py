"""The life of a run, from top to bottom.

`run_plan` opens the run directory, runs the steps of the plan, and seals the record. `StepRunner.run` takes one step
after the other: is its result kept (`_cached`)? was it made by an earlier run (`_earlier`)? else its inputs are brought
together, it runs under its contract, its outputs are put into place, and the cache keeps what is worth it (`_fresh`).
Then the step is recorded and reported (`_live`).
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.config.options import options_of
from sppm_pipeline.engine.plan.estimate import learn
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.wiring import Step, last_uses
from sppm_pipeline.engine.process.interruption import check
from sppm_pipeline.engine.process.resident import PeakWatch
from sppm_pipeline.engine.run.context import RunContext, StageLog
from sppm_pipeline.engine.run.events import Monitor, Observers
from sppm_pipeline.engine.run.outputs import RunFolder, Scratch
from sppm_pipeline.engine.run.record import Entry, Recorder, entry_of
from sppm_pipeline.engine.run.steps import RecipeSteps, is_strict, run_step, summary_of
from sppm_pipeline.engine.run.verification import finished_run
from sppm_pipeline.errors import SppmError
from sppm_pipeline.hookspecs import StageEvent
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.stage import Rejected

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.session import CacheSession
    from sppm_pipeline.engine.cache.store import Store
    from sppm_pipeline.engine.run.crew import WorkerPool


def available_threads() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_plan(
    plan: Plan,
    path: Path,
    *,
    threads: int,
    until: str | None = None,
    monitor: Monitor | None = None,
    store: Store | None = None,
    about: str = "",
    key: str | None = None,
    earlier: StepRunner | None = None,
    crew: WorkerPool | None = None,
    kept: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Run the pipeline up to the stage `until`, and write ``run.json`` into the run directory, also when a stage fails.

    Without a `store`, every stage runs and nothing is kept; `about` is the name under which the cache remembers this
    run for `sppm explain`. `key` is the digest of all that the run depends on: with a store, a finished run of the same
    key in `path` that is sound to the byte is taken as it is. `earlier` is of a run of the same plan in memory; its
    stages that write nothing are not run again. `crew`, to whom stages hand parts of their work, is ended with the run.
    `kept` has ids of steps, whose results are put in their places, also of a run that fails, as far as it came.

    Returns the record. An `SppmError` says what stopped the run; its attribute ``record`` holds the record.
    """
    steps = plan.until(until)
    monitor = monitor or Monitor()
    if store is not None and key is not None and (finished := finished_run(path, key)) is not None:
        return finished
    with Recorder(plan, path, threads=threads, until=until, monitor=monitor) as recorder:
        if key is not None:
            recorder.extra["key"] = key
        if crew is not None:
            crew.warn = recorder.warn
        # workers end before the record is sealed, as they write into the run directory
        with contextlib.nullcontext() if crew is None else contextlib.closing(crew):
            runner = StepRunner(
                steps=steps,
                recipes=plan.recipes,
                seed=plan.seed,
                threads=threads,
                folder=recorder.folder,
                monitor=monitor,
                observers=Observers([recorder, monitor], plan.plugins, recorder.warn),
                store=store,
                about=about,
                checkpoint=recorder.checkpoint,
                earlier=earlier,
                crew=crew,
                keep=kept or (),
            )
            try:
                runner.run()
                for id_ in kept or ():
                    with contextlib.suppress(SppmError):  # the run has ended well without it
                        runner.result(id_)
            finally:
                if kept is not None:
                    kept |= {id_: runner._results.get(id_) for id_ in kept}
        # only a run whose stages have all ended well has results that can be compared
        recorder.audit()
    return recorder.record


def only_writes(step: Step) -> bool:
    """True if a step makes nothing but files; one whose file may be left out is there for what it reports."""
    outputs = [option for option in options_of(type(step.stage)).values() if option.spec.output]
    return not step.makes and any(option.default is not None for option in outputs)


@dataclass(eq=False, kw_only=True)
class StepRunner:
    """Runs steps in order; knows what they made, and what is to be recorded of each (`entries`).

    A step whose result is in the cache does not run, and the result is only loaded if a later step needs it. Results
    that no later step needs are freed, but for those to `keep`. Outputs go into the `folder`; with a `Scratch`, they
    are thrown away, and steps that only write are left out. `available` are results, by id, that are there before the
    first step; `checkpoint` is called before outputs are moved to their places. For the others see `run_plan`.
    """

    steps: Sequence[Step]
    recipes: RecipeSteps
    seed: int
    threads: int
    folder: RunFolder | Scratch
    monitor: Monitor
    observers: Observers
    store: Store | None = None
    about: str = ""
    available: Mapping[str, Any] = field(default_factory=dict)
    checkpoint: Callable[[], None] = lambda: None
    keep: Collection[str] = ()
    earlier: StepRunner | None = None
    crew: WorkerPool | None = None

    def __post_init__(self) -> None:
        self.entries: list[dict[str, Any]] = []
        self._steps = {step.id: step for step in self.steps}
        self._facts: dict[str, dict[str, Any]] = {}
        self._begun: dict[str, Any] = {}
        # steps that gave away what they made, and those that took it, with their share of the seconds it took
        self._handed_on: dict[str, float] = {}
        self._results = dict(self.available)
        self._cache: CacheSession | None = None
        if self.store is not None:
            from sppm_pipeline.engine.cache.session import CacheSession

            self._cache = CacheSession(
                self.store, self.monitor.warning, seed=self.seed, recipes=self.recipes, about=self.about
            )
            for id_, artifact in self.available.items():
                self._cache.given(id_, artifact.digest())

    def run(self) -> None:
        """Run all steps, and notify monitor and observers of each, the one that fails included."""
        steps = list(self._steps.values())
        needless: set[str] = set()
        try:
            for number, (step, done) in enumerate(zip(steps, last_uses(steps), strict=True), 1):
                check()
                self.monitor.stage_started(step.id, number, len(steps))
                self._live(step)
                # after the last step all results go with this object
                needless |= done - set(self.keep)
                if number < len(steps):
                    for id_ in needless:
                        self._results.pop(id_, None)
            if self._cache is not None:
                # time that one stage has spent on the work of another says nothing about either
                # the cache learns from stages that ran alone only
                own = [entry for entry in self.entries if entry["id"] not in self._handed_on]
                learn(self._cache.store, steps, self.recipes, own)
        finally:
            if self._cache is not None:
                self._cache.close()

    def _live(self, step: Step) -> None:
        """The life of a stage: taken from the cache or an earlier run, or run; recorded, and reported."""
        started = time.perf_counter()
        try:
            if isinstance(self.folder, Scratch) and only_writes(step):
                facts: dict[str, Any] = {}
                about = {"id": step.id, "stage": step.stage.name, "made": None, "seconds": 0.0}
                entry: Entry = {**about, "skipped": True, "summary": {}}
            else:
                with PeakWatch() as memory:
                    kept = self._cached(step)
                    made = self.earlier._facts.get(step.id) if self.earlier is not None else None
                    reused = made if made is not None and not made["wrote"] else None  # what wrote has to write here
                    # in the order of their cost: the cache, an earlier run in memory, the stage itself
                    facts = kept or reused or self._fresh(step)
                self._facts[step.id] = facts
                entry = entry_of(step, facts, time.perf_counter() - started, memory.mb, cached=kept is not None)
        except Exception as error:
            self._report(step, {}, time.perf_counter() - started, error)
            raise
        # a rejected draw is recorded as well, with the report that it leaves
        self.entries.append(entry)
        rejection: Rejected | None = facts.get("rejection")
        self._report(step, entry, entry["seconds"], rejection)
        if rejection is not None:
            raise rejection

    def _report(self, step: Step, entry: Entry, seconds: float, error: Exception | None) -> None:
        self.observers.stage_finished(
            StageEvent(
                address=step.address,
                stage=step.stage.name,
                made=entry.get("made"),
                seconds=seconds,
                summary=MappingProxyType(entry.get("summary", {})),
                record=MappingProxyType(entry),
                error=None if error is None else str(error),
                from_cache=entry.get("cached", False),
            )
        )

    def _cached(self, step: Step) -> dict[str, Any] | None:
        """Cached facts of a step whose outputs are there or could be written again."""
        entry = self._cache.look_up(step, (step.id,)) if self._cache is not None else None
        if entry is None or self._cache is None:
            return None
        facts = dict(entry.facts)
        outputs = facts["outputs"]
        facts["wrote"] = bool(outputs)
        if outputs:
            # a run in memory shows results, and has no place for files
            if isinstance(self.folder, Scratch):
                facts["outputs"] = []
            elif not self.folder.holds(step.address, outputs) and not self._cache.restore(
                step, self.folder, outputs, self.checkpoint
            ):
                return None
        # a warning belongs to the result, whenever that was computed
        for at, message in facts["warnings"]:
            self.monitor.warning(at, message)
        return facts

    def _fresh(self, step: Step) -> dict[str, Any]:
        """Run a step; what the record says of it, also if it rejects what it got and leaves a report."""
        # inputs, and the stage under its contract
        log = StageLog(self.monitor, step.address)
        inputs = self._inputs(step)
        started = time.perf_counter()
        made, rejection = None, None
        try:
            made = self._made(step, inputs, log, self.folder, lambda: self._readers(step))
        except Rejected as error:
            # a report of why it was rejected is all that a failed check leaves
            if not error.keep_outputs or isinstance(self.folder, Scratch):
                raise
            rejection = error
        facts: dict[str, Any] = {
            "made": None if made is None else type(made).__name__,
            "summary": summary_of(made, log.values.get(step.address, {}), step),
            "warnings": [list(warning) for warning in log.warnings],
            "outputs": [],
            "inner": list(log.inner.values()),
        }
        takers = [id_ for id_ in self._begun if step.id in self._steps[id_].inputs.values()]
        whole = not takers or getattr(made, "is_whole", True)
        if not whole:
            self._handed_on |= dict.fromkeys(takers, (time.perf_counter() - started) / len(takers)) | {step.id: 0.0}
        # outputs
        wrote = bool(self.folder.pending())
        files: list[tuple[str, Path]] = []
        if isinstance(self.folder, Scratch):
            self.folder.discard()
        elif wrote:
            try:
                self.checkpoint()
                facts["outputs"] = self.folder.commit(rejection.stage if rejection is not None else None)
            except SppmError as error:
                error.where, error.stage = step.where, step.address
                raise
            files = [(output["path"], self.folder.path / output["path"]) for output in facts["outputs"]]
        if rejection is not None:
            return {**facts, "wrote": wrote, "rejection": rejection}
        # cache
        if self._cache is not None and not (wrote and isinstance(self.folder, Scratch)):
            # what was taken from another stage while it was made can't be had without that stage
            seconds = time.perf_counter() - started + self._handed_on.get(step.id, 0.0)
            self._cache.keep(
                step, facts, made if whole else None, inputs, outputs=files, seconds=seconds, drew=log.drew
            )
        self._results[step.id] = made
        return {**facts, "wrote": wrote}

    def _inputs(self, step: Step) -> dict[str, Any]:
        return {port: self.result(source) if source else None for port, source in step.inputs.items()}

    def result(self, id_: str) -> Any:
        """The result of a step: still there, loaded, or made again because only its summary was kept."""
        if id_ not in self._results:
            self._results[id_] = self._recovered(self._steps[id_])
        return self._results[id_]

    def _recovered(self, step: Step) -> Any:
        """The result of a step that ran before this run, or in it and was not kept in memory."""
        id_ = step.id
        if isinstance(self.folder, Scratch) and only_writes(step):
            return None
        if self.earlier is not None:
            return self.earlier.result(id_)
        assert self._cache is not None
        same_as = self._cache.same_as(id_)
        made = self.result(source) if same_as and (source := step.inputs[same_as]) else self._cache.load(id_)
        # its summary was worth keeping, the artifact was not: compute it again, without a word
        if made is None and step.makes:
            inputs = self._inputs(step)
            scratch = self.folder.scratch()
            # its warnings and progress were shown when its summary was made
            log = StageLog(Monitor(), step.address)
            started = time.perf_counter()
            try:
                made = self._made(step, inputs, log, scratch)
            finally:
                scratch.discard()
            self._cache.keep_again(step, made, inputs, time.perf_counter() - started)
        return made

    def _made(
        self,
        step: Step,
        inputs: Mapping[str, Any],
        log: StageLog,
        folder: RunFolder | Scratch,
        readers: Callable[[], Sequence[Any]] = tuple,
    ) -> Any:
        try:
            return run_step(step, step.stage, inputs, self._context(step, log, folder, readers), self.recipes)
        finally:
            if self.crew is not None:
                self.crew.forget()

    def _context(
        self, step: Step, log: StageLog, folder: RunFolder | Scratch, readers: Callable[[], Sequence[Any]] = tuple
    ) -> RunContext:
        return RunContext(
            seed=self.seed,
            path=(step.id,),
            address=step.address,
            threads=self.threads,
            palette=Palette(),
            log=log,
            folder=folder,
            store=None if self._cache is None else self._cache.store,
            crew=self.crew,
            begun=self._begun.pop(step.id, None),
            readers=readers,
        )

    def _readers(self, step: Step) -> Sequence[Any]:
        """Begin all steps that read what a step makes; see `Context.begin_readers`."""
        readers = [other for other in self._steps.values() if step.id in other.inputs.values()]
        if isinstance(self.folder, Scratch) or step.id in self.keep or self.earlier is not None or is_strict():
            return ()
        # a reader with a second input would have to wait for it, and a plugin may keep what it is handed
        if any(len(other.inputs) > 1 or not other.owner.builtin for other in readers):
            return ()
        if not step.owner.builtin:  # a plugin's stage may be built upon one that asks, and look at what that makes
            return ()
        begun = []
        for other in readers:
            log = StageLog(self.monitor, other.address)
            # one reader that needs the whole artifact makes all of them wait for it
            taker = other.stage.begin(self._context(other, log, self.folder))
            if taker is None:
                return ()
            begun.append(taker)
        self._begun |= {other.id: taker for other, taker in zip(readers, begun, strict=True)}
        return begun

    def close(self) -> None:
        """Release what loading results from the cache has opened."""
        if self._cache is not None:
            self._cache.store.close()
