"""What a plan takes from elsewhere: files that must be there, and columns that the table of a sweep can have."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from sppm_pipeline.engine.config.options import Option, options_of
from sppm_pipeline.engine.config.problems import did_you_mean, nearest, shown
from sppm_pipeline.engine.plan.planning import SWEEP_ID, Plan
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.errors import ConfigError

OWN_COLUMNS = ("run", "status", "error")
"""Columns of a sweep's table besides the parameters and the numbers of stages."""


def missing_inputs(plan: Plan, until: str | None = None) -> Iterator[ConfigError]:
    """An error for each input file that is not there, of the stages that run.

    Parameters
    ----------
    plan : Plan
    until : str, optional
        Id of the last stage of the pipeline to run.
    """
    ids = [step.id for step in plan.steps]
    steps = plan.steps[: ids.index(until) + 1] if until in ids else (*plan.steps, *plan.after)
    used, todo = list(steps), list(steps)
    handed: set[str] = set()
    while todo:
        new = set(todo.pop().recipes.values()) - handed
        handed |= new
        inside = [step for name in new for step in plan.recipes.get(name, ())]
        used, todo = used + inside, todo + inside
    for step in used:
        for option, value in _values(step):
            if isinstance(value, Path) and not value.exists():
                yield _error(step, option, f"there is no file or folder {str(value)!r}", _near(value))


def _near(path: Path) -> str | None:
    """What may have been meant by a path that is not there."""
    if not path.parent.is_dir():
        return f"there is no folder {str(path.parent)!r} either; paths start from the folder of the file"
    return did_you_mean(path.name, [other.name for other in path.parent.iterdir() if other.suffix == path.suffix])


def impossible_columns(plan: Plan, parameters: tuple[str, ...]) -> Iterator[ConfigError]:
    """An error for each column of the sweep's table that stages of `after` name and no run can make.

    Parameters
    ----------
    plan : Plan
    parameters : tuple of str
        Axes of the sweep.
    """
    known = (*OWN_COLUMNS, *parameters)
    stages = [step.id for step in plan.steps]
    for step in plan.after:
        if SWEEP_ID not in step.inputs.values():
            continue
        for option, value in _values(step):
            if not option.spec.column or not value or value in known:
                continue
            if not any(str(value).startswith(f"{stage}.") for stage in stages):
                near = nearest(str(value), known) or nearest(str(value).partition(".")[0], stages)
                hint = f"did you mean {near[0]}?" if near else None
                yield _error(
                    step,
                    option,
                    f"the table has no column {shown(value)}",
                    hint or f"there are {', '.join(known)}, and numbers of stages as STAGE.NAME: {', '.join(stages)}",
                )


def _values(step: Step) -> Iterator[tuple[Option, object]]:
    for name, option in options_of(type(step.stage)).items():
        value = getattr(step.stage, name)
        for one in value if isinstance(value, tuple) else (value,):
            yield option, one


def _error(step: Step, option: Option, message: str, hint: str | None) -> ConfigError:
    written = step.entry.options.get(option.name)
    where = written.node.where if written is not None else step.where
    return ConfigError(f"option {option.name!r}: {message}", where=where, hint=hint, stage=step.address)
