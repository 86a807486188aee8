"""The life of a check, from top to bottom: read, plan, wire, estimate, report.

Each phase returns what it made and what is wrong, and none raises for what the user can mend; `checked` reports the
problems of all phases together, so that one look at the messages is enough to mend a file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from sppm_pipeline.engine.config.problems import Problems, raise_problems
from sppm_pipeline.engine.plan.estimate import NONE_SEEN, History, PlanEstimate, estimate_plan, unfit_problems
from sppm_pipeline.engine.plan.inputs import TableNames, missing_inputs
from sppm_pipeline.engine.plan.planning import Drafts, Plan, draft_plan, wire_plan
from sppm_pipeline.engine.plan.session import Row, Session
from sppm_pipeline.errors import ConfigError, SppmError

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
