"""Running stages and recipes in unit tests, without a configuration."""

from __future__ import annotations

import pickle
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.config.configuration import StageEntry
from sppm_pipeline.engine.config.document import Node
from sppm_pipeline.engine.config.names import output_parts
from sppm_pipeline.engine.config.problems import raise_problems
from sppm_pipeline.engine.plan.plugins import Plugin
from sppm_pipeline.engine.plan.wiring import Draft, wire
from sppm_pipeline.engine.run.context import RunContext, StageLog
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.engine.run.steps import StepRecipe
from sppm_pipeline.engine.run.workers import name_of
from sppm_pipeline.errors import Position
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.storage import load_value, save_value
from sppm_pipeline.stage import Stage


class _Recorder(Monitor):
    def __init__(self) -> None:
        self.progress_calls: list[tuple[float, float, str]] = []

    def progress(self, stage: str, inner: bool, done: float, total: float, what: str) -> None:
        self.progress_calls.append((done, total, what))


class PlainContext(RunContext):
    """A context for a stage that is run by itself.

    Parameters
    ----------
    seed : int
    threads : int
    palette : Palette, optional
        One interior and one color if omitted.
    directory : Path, optional
        Where outputs go, at once and without staging; a temporary folder, removed with the context, if omitted.
    stage : str
        The id that the stage is given.
    workers : int
        How many workers the stage finds. They are none, but what it has mapped is written, sent and received as if they
        were, and the first item is done twice, as one whose worker has died.

    Attributes
    ----------
    directory : Path
    reported : dict
    warnings : list of str
    progress_calls : list of (done, total, what)
    asked_for_workers : bool
        Whether the stage has looked for workers.
    """

    def __init__(
        self,
        seed: int = 0,
        *,
        threads: int = 1,
        palette: Palette | None = None,
        directory: Path | None = None,
        stage: str = "stage",
        workers: int = 0,
    ) -> None:
        self._monitor = _Recorder()
        self._workers = workers
        self.asked_for_workers = False
        super().__init__(
            seed=seed,
            path=(stage,),
            address=stage,
            threads=threads,
            palette=palette or Palette(),
            log=StageLog(self._monitor, stage),
            folder=None,
        )
        self._directory = directory

    @property
    def workers(self) -> int:
        """See `Context.workers`."""
        self.asked_for_workers = True
        return self._workers

    @workers.setter
    def workers(self, workers: int) -> None:
        self._workers = workers

    def map(self, function: Callable[[Any, Any], Any], items: Iterable[Any], common: Any = None) -> Iterator[Any]:
        """See `Context.map`; with `workers` all that is mapped travels to this process."""
        if not self.workers:
            return super().map(function, items, common)
        # raises for what workers of another process could not import
        name_of(function)
        return self._traveling(function, items, common)

    def _traveling(self, function: Callable[[Any, Any], Any], items: Iterable[Any], common: Any) -> Iterator[Any]:
        if common is not None:
            with tempfile.TemporaryDirectory(prefix="sppm-") as folder:
                # what can't be stored fails here, not only with real workers
                files = save_value(common, Path(folder))
                common = load_value(Path(folder), {file.name: file for file in files})
        for number, item in enumerate(items):
            sent = pickle.dumps(item)
            # a function that keeps something between items gives another result the second time
            if not number:
                function(common, pickle.loads(sent))
            yield pickle.loads(pickle.dumps(function(common, pickle.loads(sent))))

    def shared_folder(self) -> Path | None:
        """See `Context.shared_folder`."""
        if not self.workers:
            return None
        folder = Path(tempfile.mkdtemp(prefix="sppm-"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        return folder

    @property
    def directory(self) -> Path:
        """Folder of the outputs."""
        if self._directory is None:
            self._directory = Path(tempfile.mkdtemp(prefix="sppm-"))
            weakref.finalize(self, shutil.rmtree, self._directory, ignore_errors=True)
        return self._directory

    @property
    def reported(self) -> Mapping[str, Any]:
        """Numbers that the stage reported."""
        return self.log.values.get(self.address, {})

    @property
    def warnings(self) -> list[str]:
        """Warnings of the stage and of those of its recipes."""
        return [message for _, message in self.log.warnings]

    @property
    def progress_calls(self) -> list[tuple[float, float, str]]:
        """The calls of `progress`, in order."""
        return self._monitor.progress_calls

    def output(self, name: str) -> Path:
        """A path in `directory`, under the same rules as in a run."""
        path = self.directory.joinpath(*output_parts(name))
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


def recipe_of(*stages: Stage, name: str = "recipe") -> StepRecipe:
    """A recipe made of stages, wired by type as in a configuration; `WiringError` if one lacks an input."""
    where = Position(name, 1, 1)
    owner = Plugin("the test")
    drafts: list[Draft | None] = []
    for stage in stages:
        count = sum(draft is not None and draft.entry.name == stage.name for draft in drafts)
        entry = StageEntry(
            id=stage.name if not count else f"{stage.name}#{count + 1}",
            recipe=name,
            stage=Node(stage.name, where),
            where=where,
            explicit_id=False,
            options={},
            sources=None,
            recipes=None,
        )
        drafts.append(Draft(entry, type(stage), stage, owner))
    wired, problems = wire(drafts, {})
    raise_problems(problems)
    return StepRecipe(name, {name: wired.steps})
