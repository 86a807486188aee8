"""A configuration that is being designed: changed values, its text, and the cell that the engine makes of it."""

from __future__ import annotations

import dataclasses
import json
import os
import stat
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.cache.store import Store
from sppm_pipeline.engine.config.configuration import FORMAT, parse_configuration
from sppm_pipeline.engine.config.document import RECORD_KEY, compose, yaml_text
from sppm_pipeline.engine.config.problems import raise_problems
from sppm_pipeline.engine.files import write_whole
from sppm_pipeline.engine.plan.estimate import estimate_plan, unfit_problems
from sppm_pipeline.engine.plan.planning import Plan, make_plan
from sppm_pipeline.engine.plan.plugins import imported
from sppm_pipeline.engine.plan.session import RunRequest, Session, open_session
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.engine.process import interruption
from sppm_pipeline.engine.run.memory import run_in_memory
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.engine.strict_json import jsonable
from sppm_pipeline.errors import ConfigError, ConfigErrors, InputError, PluginError, ResourceError, SppmError, described
from sppm_pipeline.features.browser.live.page import head_of
from sppm_pipeline.features.browser.live.views import view_of
from sppm_pipeline.features.browser.studio.controls import Control, controls_of, places, with_values
from sppm_pipeline.features.browser.studio.parts import (
    output_of,
    part_numbers,
    printed_numbers,
    property_document,
    report_of,
    scratch_of,
    seconds_of_layers,
    surface_of,
)
from sppm_pipeline.features.browser.studio.preview import quick_steps
from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.part.part import Part

START = """\
# A periodic cell. `sppm run` draws it, and writes its surface and what it can bear.
sppm: 1
name: cell
seed: 1
params:
  pores: 95
pipeline:
  - {stage: sample.mirrored_faces, total: "${pores}", share: 0.5}
  - {stage: sample.dart_throwing, total: "${pores}"}
  - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
  - {stage: field.gaussian, pore_radius: 0.1075, tunnel_radius: 0.023, level: 0.25}
  - {stage: check.connectivity, islands: keep}
  - {stage: extract.marching_cubes}
  - {stage: write.mesh, path: cell.stl}
  - {stage: homogenize.voxel}
"""
"""The configuration that a page begins with if no file is named: 95 pores, a third of the volume solid."""

SAMPLES = 400_000
"""Samples of fields that the browser does not sum itself, in about 1 s."""

PART_SAMPLES = 900_000
"""Samples of a part as it will be, 0.6 mm apart in a cube of 60 mm; its preview has `SAMPLES`, as it must be quick."""

CACHE = 10**9
"""Bytes of results that are kept while the page is open, so that going back is quick."""

RESOLUTION = 32
"""Voxels along a cell edge for stiffness and connectivity while the user waits, about 0.3 s; twice as many take eight
times as long."""

NUMBERS = (
    {"stage": "check.connectivity", "id": "connectivity", "resolution": RESOLUTION, "islands": "keep", "from": "cell"},
    {"stage": "homogenize.voxel", "id": "elastic", "resolution": RESOLUTION, "from": "cell"},
)


class Superseded(Exception):
    """A newer request has replaced this one."""


class Changed(InputError):
    """The file is no longer what was read or saved."""


@dataclasses.dataclass(frozen=True)
class Target:
    """Result of a configuration that can be shown: of a stage, or of a recipe drawn alone."""

    recipe: str
    step: str
    makes: tuple[type, ...]

    @property
    def name(self) -> str:
        """Name on the page and in its requests."""
        return f"recipe {self.recipe}" if self.recipe else self.step


class Design:
    """A configuration, what may be changed of it, and the cell last made; `file` is the one that may be saved to.

    The file of the request need not exist if that has a text; nor need `file` if it is `fresh`. `SppmError` if the
    configuration can't be read, or makes nothing that can be shown.
    """

    def __init__(self, request: RunRequest, file: Path | None, threads: int, *, fresh: bool = False) -> None:
        if request.text is None:
            request = dataclasses.replace(request, text=_text_of(request), folder=str(Path(request.file).parent))
        self.request = request
        self.text = request.text or ""
        self.file = file
        self.threads = threads
        self._saved: str | None = None if fresh else self.text
        self._session = open_session(request)
        plan = self._session.plan()
        self.name = plan.name
        self.targets = targets_of(plan)
        if not self.targets:
            raise ConfigError(
                "no stage of the configuration makes a field, so that there is nothing to be shown",
                hint="add a stage such as `field.gaussian`, or leave the file out to begin with a cell",
            )
        self.is_part = all(issubclass(kind, Part) for kind in self.targets[0].makes)
        known = places(self.text)
        self.controls: dict[str, list[Control]] = {
            target.name: controls_of(plan, _in_play(plan, target), self._session.registry, known)
            for target in self.targets
        }
        self._engine = threading.Lock()
        self._saving = threading.Lock()
        self._newest = interruption.Stop()
        self._asking = threading.Lock()
        self._last: tuple[tuple[str, str], Any, dict[str, Any]] | None = None
        self._scratch = scratch_of(self)
        self._store = Store(self._scratch / "cache", CACHE)
        self._drains: tuple[tuple[float, ...], ...] = ()
        self._ran: tuple[str, Plan, Path, dict[str, Any]] | None = None

    def found(self, conditions: str, cell: str | None, count: int) -> list[Any]:
        """Designs that meet conditions, at most `count` of each plugin that finds some."""
        designs: list[Any] = []
        for plugin in self._session.registry.plugins.plugins:
            for name, target in plugin.finders.items():
                find = imported(plugin, f"the finder {name!r}", target)
                try:
                    designs += find(conditions, cell=cell, count=count)
                except SppmError:
                    raise
                except Exception as error:
                    raise PluginError(f"{plugin}: the finder {name!r} raised {described(error)}") from error
        return designs

    def text_with(self, changes: Mapping[str, Any]) -> str:
        """The configuration with other values, by the keys of controls."""
        keys = {control.key: control for controls in self.controls.values() for control in controls}
        for key in changes:
            if key not in keys:
                raise ConfigError(f"nothing called {key!r} can be changed here")
        compose(changes, "changes")  # what no file can hold, such as half a character, has no place in a text either
        same = {key for key, value in changes.items() if value is None and not keys[key].written}
        return with_values(self.text, {key: value for key, value in changes.items() if key not in same})

    def cell(self, changes: Mapping[str, Any], target: str, *, quick: bool = False) -> tuple[dict[str, Any], bytes]:
        """Text, numbers and view file of the changed configuration; `SppmError` or `Superseded` if there is none.

        With `quick` a part is filled with one block of cells that is repeated, and has the drains that were found last.
        """
        with self._turn():
            return self._cell(changes, target, quick)

    def numbers(self, changes: Mapping[str, Any], target: str) -> dict[str, Any]:
        """Connectivity and stiffness of the cell, or stiffness and permeability of the infill of a part, which take
        longer; of tilings and tile sets there are none.
        """
        with self._turn():
            made, said = self._exact(changes, target)
            if isinstance(made, Part):
                return self._part_properties(said)
            if isinstance(made, (TileSet, Tiling)):
                return {}
            return self._measured({"sppm": FORMAT, "name": "numbers", "pipeline": [*NUMBERS]}, {"cell": made})

    def run(self, changes: Mapping[str, Any], *, long: bool = False) -> dict[str, Any]:
        """What the whole configuration says of the print; how long it would take if that is long and not asked for."""
        with self._turn():
            text = self.text_with(changes)
            if not long and not (self._ran and self._ran[0] == text):
                expected = seconds_of_layers(self._with_text(text).plan())
                if expected is not None:
                    return {"expected_s": expected / self.threads}
            return printed_numbers(self._run(text)[2])

    def file_of(self, changes: Mapping[str, Any], target: str, what: str) -> tuple[str, bytes]:
        """Name and content of the "stl", "picture", "print" file or "report" of the changed configuration."""
        with self._turn():
            made, said = self._exact(changes, target)
            if not isinstance(made, Part):
                raise ConfigError("files are made of a part; run the configuration for others")
            if what == "stl":
                with tempfile.TemporaryDirectory(dir=self._scratch) as folder:
                    strut = said["part"].get("sizes", {}).get("strut")
                    path = surface_of(made, strut, Path(folder), self.name, self.threads)
                    return path.name, path.read_bytes()
            plan, place, record = self._run(said["yaml"])
            return (
                (f"{self.name}.html", report_of(place, made))
                if what == "report"
                else output_of(plan, record, place, what)
            )

    def save(self, changes: Mapping[str, Any], *, anyway: bool = False) -> str:
        """Write the changed configuration to its file.

        `Changed` if that is no longer what was read or saved, unless it is to be replaced `anyway`; `InputError` if
        there is no file, `SppmError` if something is wrong with the values.
        """
        if self.file is None:
            raise InputError(
                "the page was not started with a file", hint="download it, or name a file to `sppm studio`"
            )
        text = self.text_with(changes)
        self._with_text(text).plan()
        with self._saving:  # of two pages that save at once, the second must see what the first has written
            try:
                there: str | None = yaml_text(self.file)
            except SppmError:
                there = None
            if there != self._saved and not anyway:
                raise Changed(f"{str(self.file)!r} was changed by someone else since it was read")
            _replace(self.file, text)
            self._saved = text
        return text

    def _cell(self, changes: Mapping[str, Any], name: str, quick: bool = False) -> tuple[dict[str, Any], bytes]:
        started = time.perf_counter()
        target = self._target(name)
        text = self.text_with(changes)
        plan = self._with_text(text).plan()
        group = plan.recipes[target.recipe] if target.recipe else plan.steps
        steps, last = _needed(group, target.step), target.step
        short = quick_steps(steps) if quick else None
        if short is not None:
            steps, last = short, short[-1].id
        alone = dataclasses.replace(plan, steps=steps, plugins=())
        # what is too large for this machine is refused before it runs
        raise_problems(unfit_problems([estimate_plan(alone)], Path(".")))
        memory = run_in_memory(alone, threads=self.threads, store=self._store)
        made = memory.result(last)
        if isinstance(made, Part):
            if short is not None:
                made = dataclasses.replace(made, drains=tuple(dict.fromkeys((*made.drains, *self._drains))))
            else:
                self._drains = made.drains
        fine = PART_SAMPLES if isinstance(made, Part) and short is None else SAMPLES
        view = view_of(made, samples=fine, threads=self.threads)
        head = head_of(view)
        entries = memory.record["stages"]
        summary = jsonable(entries[-1]["summary"])
        warnings = [words for entry in entries for words in entry.get("warnings", ())]
        drained = any(step.stage.name == "fix.drains" for step in steps)  # advice that is followed already
        said = {
            "yaml": text, "digest": made.digest(), "porosity": head["porosity"], "quick": short is not None,
            "numbers": {key: summary[key] for key in ("pores", "tunnels") if key in summary},
            "warnings": [] if short else [words for words in warnings if not (drained and "`fix.drains`" in words)],
        }  # fmt: skip
        if isinstance(made, Part):
            said["part"] = part_numbers(plan, made, entries, self.threads)
        if short is None:
            self._last = (text, name), made, said
        return {**said, "seconds": round(time.perf_counter() - started, 3)}, view

    def _target(self, name: str) -> Target:
        return next((target for target in self.targets if target.name == name), self.targets[0])

    def _exact(self, changes: Mapping[str, Any], name: str) -> tuple[Any, dict[str, Any]]:
        """What the target makes, and its numbers; most often it was shown just before."""
        if self._last is None or self._last[0] != (self.text_with(changes), name):
            self._cell(changes, name)
        assert self._last is not None
        return self._last[1], self._last[2]

    def _part_properties(self, said: Mapping[str, Any]) -> dict[str, Any]:
        """Stiffness and permeability of scattered cells like those of the part; empty for others."""
        plan = self._with_text(said["yaml"]).plan()
        laid = [step for step in plan.steps if step.stage.name == "tile.scattered"]
        if len(laid) != 1 or laid[0].inputs.get("grading") is not None:
            return {}
        document = property_document(said["yaml"], laid[0], said["part"].get("sizes", {}))
        return self._measured(document, {})

    def _measured(self, document: Mapping[str, Any], available: Mapping[str, Any]) -> dict[str, Any]:
        configuration, _ = parse_configuration(compose(document, "numbers"), Path("numbers"), ".")
        kinds = {id_: (type(made),) for id_, made in available.items()}
        plan = make_plan(configuration, self._session.registry, available=kinds)
        record = run_in_memory(plan, threads=self.threads, store=self._store, available=available).record
        return {entry["id"]: jsonable(entry["summary"]) for entry in record["stages"]}

    def _run(self, text: str) -> tuple[Plan, Path, dict[str, Any]]:
        """The whole configuration, run into a folder that is kept until another text is run."""
        if self._ran is None or self._ran[0] != text:
            self._ran = None
            plan = self._with_text(text).plan()
            raise_problems(unfit_problems([estimate_plan(plan)], self._scratch))
            folder = Path(tempfile.mkdtemp(dir=self._scratch))
            record = run_plan(plan, folder / "run", threads=self.threads, store=self._store)
            self._ran = text, plan, folder / "run", record
        return self._ran[1:]

    def _with_text(self, text: str) -> Session:
        """The session with another text; plugins stay as they were loaded."""
        request = dataclasses.replace(self._session.request, text=text)
        configuration, unread = request.read()
        return dataclasses.replace(self._session, request=request, configuration=configuration, unread=unread)

    def faults(self, error: SppmError, changes: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Errors, each with the key of its control where that is known, and the stage."""
        try:
            at = {(p.line, p.column): key for key, p in reversed(tuple(places(self.text_with(changes)).items()))}
        except SppmError:
            at = {}
        errors: Iterable[SppmError] = error.errors if isinstance(error, ConfigErrors) else (error,)
        return [
            {
                "key": at.get((one.where.line, one.where.column), "") if one.where else "", "stage": one.stage or "",
                "message": one.message, "hint": one.hint or "",
            }
            for one in errors
        ]  # fmt: skip

    def _turn(self) -> AbstractContextManager[None]:
        """One request at the engine; that before it is asked to stop, and does not begin if it has not begun."""
        with self._asking:  # here, so that an older one can't ask a newer one to stop
            self._newest.request()
            self._newest = stop = interruption.Stop()
        return self._at_engine(stop)

    @contextmanager
    def _at_engine(self, stop: interruption.Stop) -> Iterator[None]:
        with self._engine, interruption.within(stop):
            if stop.requested:
                raise Superseded
            try:
                yield
            except KeyboardInterrupt:
                raise Superseded from None


def _replace(file: Path, text: str) -> None:
    """Replace the text of a file, which keeps its permissions; of a link, that of the file it leads to."""
    target = file.resolve()
    there = target.stat() if target.exists() else None
    if there is not None and there.st_nlink > 1:  # a new file would be known by one of its names only
        try:
            target.write_text(text, encoding="utf-8", newline="")
        except OSError as error:
            raise ResourceError(f"can't write {str(target)!r}: {error.strerror}") from error
    else:
        write_whole(target, text, mode=None if there is None else stat.S_IMODE(there.st_mode))


def targets_of(plan: Plan) -> list[Target]:
    """Targets, the best first: a part of a mesh or scattered cells, a cell, a recipe's, a tile set, any other field."""
    shown = (ScalarField, TileSet)
    found = [
        Target(recipe, step.id, step.makes)
        for recipe, group in [("", plan.steps), *plan.recipes.items()]
        for step in (group if not recipe else group[-1:])
        if step.makes
        and all(issubclass(kind, shown) for kind in step.makes)
        and not step.stage.name.startswith("check.")  # passes on what it is given
    ]

    def rank(target: Target) -> int:
        def makes(*kinds: type) -> bool:
            return all(issubclass(kind, kinds) for kind in target.makes)

        if target.recipe:
            return 1
        if filled and makes(Part):
            return 0
        return 0 if makes(Microstructure) else 2 if makes(TileSet) else 4 if makes(Tiling, Part) else 3

    # of a file of one's own the part is wanted, and not the cells in it
    filled = any(step.stage.name in ("read.mesh", "read.cad", "tile.scattered") for step in plan.steps)
    last = {target.name: target for target in found}
    return sorted(last.values(), key=lambda target: (rank(target), -found.index(target)))


def _needed(steps: Sequence[Step], last: str) -> tuple[Step, ...]:
    """The steps that one depends on, and itself."""
    wanted = {last}
    for step in reversed(steps):
        if step.id in wanted:
            wanted |= {source for source in step.inputs.values() if source is not None}
    return tuple(step for step in steps if step.id in wanted)


def _in_play(plan: Plan, target: Target) -> list[Step]:
    """All steps that what is shown depends on, those of a recipe before the stage that repeats it."""
    found: list[Step] = []

    def visit(steps: Iterable[Step]) -> None:
        for step in steps:
            for name in step.recipes.values():
                visit(plan.recipes[name])
            if step not in found:
                found.append(step)

    visit(_needed(plan.recipes[target.recipe] if target.recipe else plan.steps, target.step))
    return found


def _text_of(request: RunRequest) -> str:
    """The text of a configuration file; of a run record, that of the configuration in it."""
    text = yaml_text(Path(request.file))
    if not text.lstrip().startswith("{") or f'"{RECORD_KEY}"' not in text[:200]:
        return text
    import io

    from ruamel.yaml import YAML

    written = io.StringIO()
    config = json.loads(Path(request.file).read_bytes())["config"]
    folder = Path(request.file).resolve().parent / config["folder"]  # which a record has relative to itself
    YAML().dump(config | {"folder": os.path.abspath(folder)}, written)
    return written.getvalue()
