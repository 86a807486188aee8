"""The life of a check, from top to bottom: read, plan, wire, estimate, report.

Each phase returns what it made and what is wrong, and none raises for what the user can mend; `checked` reports the
problems of all phases together, so that one look at the messages is enough to mend a file.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePath
from typing import NamedTuple

from sppm_pipeline.engine.config.options import Option, options_of
from sppm_pipeline.engine.config.problems import Problems, raise_problems, shown
from sppm_pipeline.engine.plan.estimate import NONE_SEEN, History, PlanEstimate, estimate_plan, unfit_problems
from sppm_pipeline.engine.plan.planning import SWEEP_ID, Drafts, Plan, draft_plan, wire_plan
from sppm_pipeline.engine.plan.session import Row, Session
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.errors import ConfigError, SppmError, did_you_mean, meant, near_names
from sppm_pipeline.stage import Stage

MAX_CHECKED = 1000
"""Rows of a sweep that are planned before any work, 1 ms each; of more, evenly spread ones stand for all."""

MAX_ESTIMATED = 50
"""Rows of a sweep that are estimated. Means over fifty rows are within a few percent of those over all; a factor of two
changes the time of a check by some hundredths of a second."""


class Checked(NamedTuple):
    """A configuration without faults."""

    plan: Plan  # without a row of the sweep
    rows: Sequence[Row]  # all rows of the sweep; none of a single run
    estimates: list[PlanEstimate]  # of the plan, or of rows that stand for all


def checked(
    session: Session,
    until: str | None = None,
    *,
    inputs: bool = True,
    folder: Path | None = Path("."),
    jobs: int = 1,
    history: History = NONE_SEEN,
) -> Checked:
    """Check a configuration before any work; all errors are raised together, those of memory and disk if there are no
    others.

    `inputs` says whether input files must be there, `folder` where the run will write, which must suffice, and so must
    the memory of this machine; None estimates nothing. `jobs` rows of a sweep run at the same time.
    """
    rows, unread = read(session)
    drafts, unfit = plan(session)
    wired, loose = wire(drafts, until, inputs=inputs)
    problems = [*unread, *unfit, *loose]
    # a fault of the configuration would come back with each row
    if rows and not problems:
        problems = vary(session, wired, rows, until, inputs=inputs)
    estimates: list[PlanEstimate] = []
    late: list[SppmError] = []
    if folder is not None and not problems:
        estimates, late = estimate(session, wired, rows, until, folder, jobs, history)
    raise_problems([*problems, *late])
    return Checked(wired, rows, estimates)


def read(session: Session) -> tuple[Sequence[Row], Problems]:
    """The rows of the sweep; the rest of the configuration was read when the session was opened."""
    try:
        return session.rows, session.unread
    except ConfigError as error:
        return [], [*session.unread, error]


def plan(session: Session, row: Row | None = None) -> tuple[Drafts, Problems]:
    """The stages of the run, or of a row of its sweep, with their options."""
    return draft_plan(session.configuration, session.registry, session.request.overrides, row)


def wire(drafts: Drafts, until: str | None, *, inputs: bool) -> tuple[Plan, Problems]:
    """The stages joined by their ports, and whether `until` and the input files are there."""
    wired, problems = wire_plan(drafts)
    if problems:
        return wired, problems
    try:
        steps = wired.until(until)
    except ConfigError as error:
        if not drafts.single:  # rows may have other stages
            return wired, [error]
        steps = wired.steps
    return wired, missing_inputs(wired, steps) if inputs else []


def vary(session: Session, base: Plan, rows: Sequence[Row], until: str | None, *, inputs: bool) -> Problems:
    """Errors in values of a sweep, and in names of columns and files that stages of `after` use.

    In a grid each value is tried once, with the first values of the other parameters; in a table each row. Of more
    than `MAX_CHECKED` a part is tried.
    """
    made = TableNames(tuple(rows[0]))
    sweep = session.configuration.sweep
    if sweep is not None and isinstance(sweep.value, dict):
        first = rows[0]
        # each value once, as options are read one by one and combinations may be many
        rows = [row for row in rows if sum(row[name].node is not first[name].node for name in row) <= 1]
    if len(rows) > MAX_CHECKED:
        rows = [*rows[: -1 : -(-len(rows) // MAX_CHECKED)], rows[-1]]
    problems: Problems = []
    for row in rows:
        drafts, unfit = plan(session, row)
        wired, loose = wire(drafts, until, inputs=inputs)
        problems += [*unfit, *loose]
        made.add(wired)
    return problems or made.impossible(base)


def estimate(
    session: Session,
    base: Plan,
    rows: Sequence[Row],
    until: str | None,
    folder: Path,
    jobs: int = 1,
    history: History = NONE_SEEN,
) -> tuple[list[PlanEstimate], list[SppmError]]:
    """Estimates of the run, or of evenly spread rows of its sweep; options that a run would refuse, else an error if
    it can't fit."""
    if not rows:
        found = [estimate_plan(base, until=until, history=history)]
    else:
        # rounded up, so that there are never more
        step = -(-len(rows) // MAX_ESTIMATED)
        found = [estimate_plan(session.plan(row), until=until, history=history, of_sweep=True) for row in rows[::step]]
    unfit: list[SppmError] = [error for one in found for stage in one.stages for error in stage.unfit]
    return found, unfit or [*unfit_problems(found, folder, runs=max(1, len(rows)), workers=jobs)]


OWN_COLUMNS = ("run", "status", "error")
"""Columns of a sweep's table besides the parameters and the numbers of stages."""


def missing_inputs(plan: Plan, steps: Sequence[Step]) -> Problems:
    """An error for each input file that is not there or would be read without end, of `steps` that run; after all of
    the pipeline, the stages of `after` do.
    """
    used = [*steps, *(plan.after if len(steps) == len(plan.steps) else ())]
    handed: dict[str, None] = {}
    for step in used:  # which grows by the stages of the recipes that these are handed
        new = [name for name in dict.fromkeys(step.recipes.values()) if name not in handed]
        handed |= dict.fromkeys(new)
        used += [inner for name in new for inner in plan.recipes.get(name, ())]
    problems = []
    for step in used:
        for option, value in _values(step):
            if isinstance(value, Path) and not value.exists():
                problems.append(_error(step, option, f"there is no file or folder {str(value)!r}", _near(value)))
            elif isinstance(value, Path) and not (value.is_file() or value.is_dir()):
                problems.append(
                    _error(step, option, f"{str(value)!r} is a pipe or a device", "give the path of a file")
                )
    return problems


def _near(path: Path) -> str | None:
    """Hint for a path that does not exist."""
    if not path.parent.is_dir():
        return f"there is no folder {str(path.parent)!r} either; paths start from the folder of the file"
    return did_you_mean(path.name, [other.name for other in path.parent.iterdir() if other.suffix == path.suffix])


class TableNames:
    """Names that the table of a sweep can have: its axes, columns, as far as stages declare numbers, and files of its
    runs.
    """

    def __init__(self, parameters: tuple[str, ...]) -> None:
        self._own = (*OWN_COLUMNS, *parameters)
        self._numbers: dict[str, frozenset[str] | None] = {}
        self._files: set[str] | None = set()

    def add(self, plan: Plan) -> None:
        """The plan of a row; rows may choose other stages and recipes."""
        for step in plan.steps:
            found = declared_numbers(type(step.stage), step.owner.builtin, step.makes)
            before = self._numbers.get(step.id, found)
            self._numbers[step.id] = None if found is None or before is None else before | found
        recipes = [step for steps in plan.recipes.values() for step in steps]
        for step in (*plan.steps, *recipes):
            if not step.owner.builtin:  # a plugin's stage may name its files as it likes
                self._files = None
            elif self._files is not None:
                self._files |= {str(value) for option, value in _values(step) if option.spec.output and value}

    def impossible(self, plan: Plan) -> Problems:
        """An error for each column or file that stages of `after` name and no run can make."""
        problems: Problems = []
        for step in plan.after:
            for option, value in _values(step) if SWEEP_ID in step.inputs.values() else ():
                name = str(value)
                if option.spec.column and value and not self._has_column(name):
                    problems.append(_error(step, option, f"the table has no column {shown(name)}", self._hint(name)))
                elif option.spec.run_file and value and not self._has_file(name):
                    hint = did_you_mean(name, self._files or ()) or "`path` of a stage of the pipeline names a file"
                    problems.append(_error(step, option, f"no run writes a file {shown(name)}", hint))
        return problems

    def _has_column(self, column: str) -> bool:
        ids = [id_ for id_ in self._numbers if column.startswith(f"{id_}.")]
        return column in self._own or any(
            (declared := self._numbers[id_]) is None or is_declared(column[len(id_) + 1 :], declared) for id_ in ids
        )

    def _has_file(self, name: str) -> bool:
        """True if an option names it; or begins its name, as some stages write further files beside the one."""
        return self._files is None or any(name.startswith(str(PurePath(file).with_suffix(""))) for file in self._files)

    def _hint(self, column: str) -> str:
        numbers = sorted(f"{id_}.{name}" for id_, names in self._numbers.items() for name in names or ())
        if near := near_names(column, (*self._own, *numbers)):
            return meant(near)
        id_ = next((id_ for id_ in self._numbers if column.startswith(f"{id_}.")), None)
        if id_ is not None:
            return f"numbers of {id_}: {', '.join(sorted(self._numbers[id_] or ()))}"
        if near := near_names(column.partition(".")[0], self._numbers):
            return meant(near)
        return f"there are {', '.join(self._own)}, and numbers of stages as STAGE.NAME: {', '.join(self._numbers)}"


@functools.cache
def declared_numbers(cls: type[Stage], builtin: bool, makes: tuple[type, ...]) -> frozenset[str] | None:
    """Places of the numbers in the summary of a stage; None if the stage or a type of its result declares none.

    A plugin's stage may report more than the class that it derives from, so what it inherits does not count.
    """
    stated = [cls.reported if builtin else vars(cls).get("reported"), *(vars(kind).get("reported") for kind in makes)]
    found: set[str] = set()
    for places in stated:
        if places is None:
            return None
        for place in places:
            parts = [
                [str(i + 1) for i in range(int(part[1:]))] if part.startswith("#") else [part]
                for part in place.split(".")
            ]
            found.update(map(".".join, itertools.product(*parts)))
    return frozenset(found)


def is_declared(number: str, declared: frozenset[str]) -> bool:
    """True if a place in a summary is among those of `declared_numbers`."""
    return number in declared or any(place.endswith("*") and number.startswith(place[:-1]) for place in declared)


def _values(step: Step) -> Iterator[tuple[Option, object]]:
    for name, option in options_of(type(step.stage)).items():
        value = getattr(step.stage, name)
        for one in value if isinstance(value, tuple) else (value,):
            yield option, one


def _error(step: Step, option: Option, message: str, hint: str | None) -> ConfigError:
    written = step.entry.options.get(option.name)
    where = written.node.where if written is not None else step.where
    return ConfigError(f"option {option.name!r}: {message}", where=where, hint=hint, stage=step.address)
