"""Everything that is known before any work: the plan, the rows of the sweep, and whether they fit the machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sppm_pipeline.engine.config.problems import Problems
from sppm_pipeline.engine.plan.estimate import PlanEstimate, estimate_plan, refuse_what_cannot_fit
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.rates import Speed
from sppm_pipeline.engine.plan.session import Session
from sppm_pipeline.engine.run.runner import check_until
from sppm_pipeline.engine.run.sweep import Row, check_sweep, sweep_rows
from sppm_pipeline.errors import ConfigError

MAXIMUM_ROWS = 50
"""Rows of a sweep that are estimated; of more, evenly spread ones stand for all."""


def checked(session: Session, until: str | None = None) -> tuple[Plan, Sequence[Row]]:
    """The plan and the rows of its sweep, none if there is no sweep.

    Raises
    ------
    ConfigError
        With the errors of all of them.
    """
    problems = Problems()
    plan: Plan | None = None
    rows: Sequence[Row] = []
    try:
        plan = session.plan()
        check_until(plan, until)
    except ConfigError as error:
        problems.add(error)
    if session.configuration.sweep is not None:
        try:
            rows = sweep_rows(session.configuration.sweep, session.configuration.params)
            if plan is not None:
                check_sweep(session, rows)
        except ConfigError as error:
            problems.add(error)
    problems.raise_any()
    assert plan is not None
    return plan, rows


def estimates(
    session: Session, plan: Plan, rows: Sequence[Row], until: str | None = None, speed: Speed | None = None
) -> list[PlanEstimate]:
    """The estimate of the plan, or of the rows of its sweep."""
    if not rows:
        return [estimate_plan(plan, until=until, speed=speed)]
    step = -(-len(rows) // MAXIMUM_ROWS)
    return [estimate_plan(session.plan(row), until=until, speed=speed) for row in rows[::step]]


def refuse_unfit(
    session: Session, plan: Plan, rows: Sequence[Row], folder: Path, *, workers: int = 1, until: str | None = None
) -> None:
    """Raise `ResourceError` if the run or any of a sweep's can't fit into memory or onto the disk."""
    found = estimates(session, plan, rows, until)
    runs = max(1, len(rows))
    for estimate in found:
        refuse_what_cannot_fit(estimate, folder, workers=min(workers, runs))
    if runs > 1:
        total = sum(estimate.disk for estimate in found) / len(found) * runs
        largest = max(found, key=lambda estimate: estimate.disk)
        if largest.disk:
            refuse_what_cannot_fit(largest, folder, runs=round(total / largest.disk) or 1)
