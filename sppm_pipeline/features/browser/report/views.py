"""Source of the live view of a report: a file of ``write.view``, or the last field of the run, from the cache."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.cache.session import CacheSession
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.engine.run.memory import run_in_memory
from sppm_pipeline.errors import SppmError
from sppm_pipeline.features.browser.live.data import SUFFIX, head_of
from sppm_pipeline.features.browser.live.views import SAMPLES, view_of
from sppm_pipeline.nouns.artifact import Viewable
from sppm_pipeline.nouns.report import Report
from sppm_pipeline.nouns.viewers import viewer_of

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.store import Store

QUICK = 3.0
"""Seconds; stages that took less in the run are repeated for a report, slower ones only with `--remake`."""

REMAKE = "`sppm report --remake` runs again what it needs, or add `- {stage: write.view}` to the pipeline"


def live_view(
    path: Path,
    record: Mapping[str, Any],
    outputs: Sequence[Mapping[str, Any]],
    request: RunRequest,
    *,
    store: Store | None,
    threads: int,
    remake: bool = False,
    samples: int = SAMPLES,
) -> tuple[bytes | None, str]:
    """The view file of a run, or None and why there is none.

    `outputs` are those of the run that lie in its directory, `request` says which plugins may be loaded, `store` is
    the cache; with `remake` stages may run that took long; `samples` as for `view_of`.
    """
    for output in reversed(outputs):
        if str(output["path"]).endswith(SUFFIX):
            try:
                data = (path / str(output["path"])).read_bytes()
                head_of(data)
            except (SppmError, OSError) as error:
                return None, f"The live view {output['path']!r} can't be read: {error}"
            return data, ""
    if "runs" in record:
        return None, ""
    try:
        # by default no plugins may be loaded: a report must not run code that came with the run of another user
        plan = open_session(request).plan()
        step = _last_shown(plan, {str(stage["id"]) for stage in record["stages"]})
        if step is None:
            return None, ""
        if not remake and (lacking := _lacking(plan, step, record, store)):
            return None, f"There is no live view: {lacking}; {REMAKE}."
        memory = run_in_memory(plan, threads=threads, until=step.id, store=store)
        return view_of(memory.result(step.id), samples=samples, threads=threads), ""
    except SppmError as error:
        return None, f"There is no live view: {error.message}."


def _last_shown(plan: Plan, ran: set[str]) -> Step | None:
    """The last step that has run and makes a structure; if there is none, another surface, then one of a report."""

    def rank(kind: type) -> int:
        surface = issubclass(kind, Viewable) + (issubclass(kind, Viewable) and not issubclass(kind, Report))
        return surface if viewer_of(kind) is None else 3

    ran_steps = [step for step in plan.steps if step.id in ran]
    ranks = [max(map(rank, step.makes), default=0) for step in ran_steps]
    # of several of the best kind the last one
    best, number = max(zip(ranks, range(len(ranks)), strict=True), default=(0, 0))
    return ran_steps[number] if best else None


def _lacking(plan: Plan, last: Step, record: Mapping[str, Any], store: Store | None) -> str:
    """Stages that would have to run again and took long; empty if all is cached, or was quick."""
    seconds = {str(stage["id"]): float(stage["seconds"]) for stage in record["stages"] if not stage.get("cached")}
    session = (
        None if store is None else CacheSession(store, lambda stage, words: None, seed=plan.seed, recipes=plan.recipes)
    )
    steps = {step.id: step for step in plan.until(last.id)}
    kept: dict[str, bool] = {}
    for id_, step in steps.items():
        entry = session.look_up(step, (id_,)) if session is not None else None
        kept[id_] = entry is not None and (entry.has_value or entry.manifest["same_as"] is not None)
    needed, rest = set(), [last.id]
    while rest:
        id_ = rest.pop()
        if id_ in needed:
            continue
        needed.add(id_)
        entry = session.entry(id_) if session is not None else None
        # its value is that of an input, which has to be made in its place
        passed_on = entry is not None and not entry.has_value and kept[id_]
        if not kept[id_] or passed_on:
            rest += [source for source in steps[id_].inputs.values() if source is not None]
    long = [id_ for id_ in steps if id_ in needed and not kept[id_] and seconds.get(id_, QUICK) >= QUICK]
    return f"what {', '.join(long)} made is not in the cache" if long else ""
