"""The hooks through which stages, executors, verbs and observers reach the program; built-in ones use the same."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import pluggy

from sppm_pipeline.nouns.viewers import Viewer as Viewer

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace
    from concurrent.futures import Executor
    from pathlib import Path

    from sppm_pipeline.nouns.report import ReportSection
    from sppm_pipeline.stage import Stage, StageAlias

PROJECT = "sppm"
"""Name of the pluggy project; entry points of distributions stand in the group ``sppm``."""

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def sppm_stages() -> Mapping[str, type[Stage] | str]:  # type: ignore[empty-body]
    """Supply stages.

    Called once, when the program needs to know the stages there are. Returns a mapping from the stage's name
    (``family.name``) to its class, or to ``"module:Class"``, which is imported only when the stage is used;
    `stages_in` makes it of the files of a folder. An empty mapping means: no stages. Example::

        @hookimpl
        def sppm_stages():
            return {"sample.fcc": "sppm_fcc.sampler:FaceCenteredCubic"}
    """


def stages_in(package: str) -> Callable[[], dict[str, str]]:
    """The hook `sppm_stages` of a package with a folder ``stages``, whose files bear the names of the stages.

    ``stages/sample_fcc.py`` defines the class of ``sample.fcc``, and ``sppm_stages = stages_in(__name__)`` finds it.

    Examples
    --------
    >>> import sppm_pipeline as sppm
    >>> from sppm_pipeline.features import walls
    >>> sppm.nouns.stages_in(walls.__name__)()
    {'field.walls': 'sppm_pipeline.features.walls.stages.field_walls'}
    """

    @hookimpl
    def sppm_stages() -> dict[str, str]:
        folder = os.path.join(os.path.dirname(str(sys.modules[package].__file__)), "stages")
        files = [name.removesuffix(".py") for name in sorted(os.listdir(folder)) if name.endswith(".py")]
        # modules alone: the class is found by its `name` when the stage is used
        return {name.replace("_", ".", 1): f"{package}.stages.{name}" for name in files if name != "__init__"}

    return sppm_stages


@hookspec
def sppm_stage_aliases() -> Mapping[str, str | StageAlias]:  # type: ignore[empty-body]
    """Supply former names of stages, so that configurations written before a stage was renamed still run.

    Called once, together with `sppm_stages`. Returns a mapping from the former name to the current one, or to a
    `StageAlias` with the options that the former name implied. A user of a former name is shown the current one in a
    warning; lists and references show current names only. An empty mapping means: nothing was renamed. Example::

        @hookimpl
        def sppm_stage_aliases():
            return {"sample.fcc_lattice": "sample.fcc"}
    """


@dataclass(frozen=True)
class Command:
    """A verb of the command line.

    Attributes
    ----------
    help : str
        What it does, in a line that starts with a small letter.
    configure : function of `argparse.ArgumentParser`, or "module:function"
        Adds the verb's arguments.
    execute : function of `argparse.Namespace` that returns the exit code, or "module:function"
        Does the work; prints results on stdout, and raises `SppmError` for errors that the user can fix.
    before_run : function of a plan that returns ids of its stages, or "module:function"
        What ``sppm run --report`` calls of the verb `report` before a run; the results of these stages are kept.
    after_run : function of the run directory, the `argparse.Namespace` and the results, or "module:function"
        What ``sppm run --report`` calls of the verb `report` once the run has ended; prints nothing.
    """

    help: str
    configure: Callable[[ArgumentParser], None] | str
    execute: Callable[[Namespace], int] | str
    before_run: Callable[[Any], Sequence[str]] | str = ""
    after_run: Callable[[Path, Namespace, Mapping[str, Any]], None] | str = ""


@hookspec
def sppm_commands() -> Mapping[str, Command]:  # type: ignore[empty-body]
    """Supply verbs of the command line: ``sppm VERB ...``.

    Called with `sppm_stages` when plugins are loaded. Of installed plugins, that is also when a user asks for a verb
    that is not built in, or for ``sppm help --all``; ``sppm --help`` loads no plugin. Returns a mapping from the verb
    to a `Command`, whose functions may be given as ``"module:function"``, which is imported only when the verb is used.
    An empty mapping means: no verbs. A verb that is built in, or that another plugin supplies, is an error naming both.
    Example::

        @hookimpl
        def sppm_commands():
            return {"show": Command("show a run in a window", "sppm_show.cli:configure", "sppm_show.cli:execute")}
    """


@dataclass(frozen=True)
class Preset:
    """A recipe with a name, which configurations use without writing it down.

    Attributes
    ----------
    help : str
        What it is good for, in a sentence.
    stages : sequence of mappings
        Its entries as in a configuration; ``"${name}"`` stands for the value of a parameter.
    params : mapping of name to value
        Parameters and their defaults; `None` leaves the option that it stands for to the stage.
    """

    help: str
    stages: Sequence[Mapping[str, Any]]
    params: Mapping[str, Any] = field(default_factory=dict)


@hookspec
def sppm_presets() -> Mapping[str, Preset]:  # type: ignore[empty-body]
    """Supply recipes by name.

    Called once, together with `sppm_stages`. Returns a mapping from the name to a `Preset`. A configuration uses it by
    ``recipe: NAME``, or sets its parameters under a name of its own: ``recipes: {cell: {preset: NAME, total: 80}}``. A
    recipe of the configuration hides a preset of the same name. An empty mapping means: no presets. Example::

        @hookimpl
        def sppm_presets():
            stages = [{"stage": "sample.fcc", "count": "${count}"}, {"stage": "connect.mst"}, {"stage": "field.walls"}]
            return {"crystal": Preset("pores on a lattice", stages, {"count": 32})}
    """


@dataclass(frozen=True)
class StageEvent:
    """A stage of a pipeline has ended.

    Attributes
    ----------
    address : str
        Id of the stage.
    stage : str
        Its name, ``family.name``.
    made : str or None
        Type of the artifact that it made.
    seconds : float
    summary : mapping
        Its numbers, as in the run record; empty if it failed, unless it rejects what it got and leaves a report.
    record : mapping
        All that the run record says of it (options, inputs, outputs, warnings, recipes); empty whenever `summary` is
        because it failed.
    error : str or None
        What it failed with.
    from_cache : bool
        Whether its result was in the cache, so that it did not run.
    """

    address: str
    stage: str
    made: str | None
    seconds: float
    summary: Mapping[str, Any]
    record: Mapping[str, Any]
    error: str | None = None
    from_cache: bool = False

    @property
    def failed(self) -> bool:
        """True if it did not end well."""
        return self.error is not None


@hookspec
def sppm_stage_finished(event: StageEvent) -> None:
    """Observe the stages of a run.

    Called after every stage of a pipeline, and of the stages after a sweep, in the process that runs it: for the runs
    of a sweep, that may be a worker process, or one of several threads. Stages of a recipe have no events of their own;
    ``event.record["inner"]`` counts them. The result is ignored. What an observer raises becomes a warning that names
    the plugin, and it is not called again in this run; results never depend on observers. Example::

        @hookimpl
        def sppm_stage_finished(event):
            print(event.address, event.seconds, file=sys.stderr)
    """


@hookspec
def sppm_executors() -> Mapping[str, Callable[..., Executor]]:  # type: ignore[empty-body]
    """Supply executors for sweeps.

    Called once, when ``--executor NAME`` is resolved. Returns a mapping from the name to a function that takes the
    number of workers and returns a `concurrent.futures.Executor`; tasks and results are picklable. If it has a second
    parameter `where`, it is given what follows the colon in ``--executor NAME:WHERE``, or nothing. A future whose
    workers died ends with a `NativeCrash`, or with a `BrokenExecutor` if the executor can't go on. An attribute
    ``about`` of the executor is shown when the sweep begins; an attribute ``notify`` is set to a function that shows a
    message while rows wait. Example::

        @hookimpl
        def sppm_executors():
            return {"cluster": lambda workers: ClusterExecutor(max_workers=workers)}
    """


@hookspec
def sppm_live_views() -> Mapping[str, Viewer]:  # type: ignore[empty-body]
    """Supply what shows artifacts of other types than the plugin's own.

    Called once, together with `sppm_stages`. Returns a mapping from a type, as ``"module:Class"``, to the `Viewer` of
    it and of the types that derive from it; its functions may be given as ``"module:function"``. ``write.view``,
    reports and notebooks use it. A type of the plugin's own needs none: an artifact that derives from `Viewable` says
    which triangles stand for it, and `Artifact.picture` what notebooks show. An empty mapping means: no viewers.
    Example::

        @hookimpl
        def sppm_live_views():
            return {"sppm_fcc.lattice:Lattice": Viewer("sppm_fcc.view:view_file", "sppm_fcc.view:png")}
    """


@hookspec
def sppm_design_finders() -> Mapping[str, Callable[..., Any] | str]:  # type: ignore[empty-body]
    """Supply functions that find designs by their properties, for the chart in the studio.

    Called once, together with `sppm_stages`. Returns a mapping from a name to a function, which may be given as
    ``"module:function"``. It is called as `sppm_pipeline.find` is, ``find(query, cell="4 mm", count=80)``, and returns
    a sequence of what that returns: designs with `family`, `total`, `values` (of low, expected and high by property)
    and ``configuration(name)``. An empty mapping means: none. Example::

        @hookimpl
        def sppm_design_finders():
            return {"crystals": "sppm_fcc.atlas:find"}
    """


@hookspec
def sppm_report_sections(record: Mapping[str, Any]) -> Sequence[ReportSection]:  # type: ignore[empty-body]
    """Supply sections of the report of a run.

    Called by ``sppm report``, ``sppm view`` and ``sppm run --report`` with the record of the run, as ``run.json`` holds
    it, whether the run ended well or not. Returns the sections, which stand behind charts and pictures; those with
    boxes stand before the structure, and the boxes at the top. An empty sequence means: nothing to add. What a plugin
    raises is shown in the place of its sections. A box at the top, and charts of one result, need no hook; see
    `Artifact.report_boxes` and `Artifact.report_charts`. Example::

        @hookimpl
        def sppm_report_sections(record):
            found = [stage["summary"] for stage in record["stages"] if stage["stage"] == "check.crystal"]
            return [ReportSection("Crystal", rows=tuple(one.items())) for one in found]
    """


class Comparison(NamedTuple):
    """Two numbers of a run that must agree, such as the volume of the layers and of the mesh of one part.

    Attributes
    ----------
    quantity : str
        For people: ``"volume of layers.png and part.stl"``.
    found : float
        What was counted in the results.
    expected : float
        What was asked for, or counted in another way.
    tolerance : float
        Largest difference, in the unit of the numbers.
    unit : str
    """

    quantity: str
    found: float
    expected: float
    tolerance: float
    unit: str = ""

    @property
    def holds(self) -> bool:
        """Whether they agree; a number that is not finite agrees with nothing."""
        return abs(self.found - self.expected) <= self.tolerance

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.quantity}: {self.found:.5g}{unit}, expected {self.expected:.5g} +- {self.tolerance:.3g}{unit}"


@hookspec
def sppm_audit(record: Mapping[str, Any]) -> Sequence[Comparison]:  # type: ignore[empty-body]
    """Compare what a run has made, from the numbers that its stages report.

    Called once at the end of a run whose stages have all ended well, with what ``run.json`` will hold. Returns pairs of
    numbers that must agree; they must be computed from the record alone, so that an audit costs nothing. A pair that
    does not agree is a warning, and ends ``sppm run`` with exit code 3 unless the configuration says ``audit: warn``.
    An empty sequence means: nothing to compare. Example::

        @hookimpl
        def sppm_audit(record):
            found = [stage["summary"] for stage in record["stages"] if stage["stage"] == "sample.crystal"]
            return [Comparison("pores of the crystal", one["pores"], one["sites"], 0) for one in found]
    """
