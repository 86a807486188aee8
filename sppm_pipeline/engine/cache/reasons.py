"""Why a stage would run: what has changed since the last run of a configuration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from sppm_pipeline.engine.cache.keeper import CacheSession, recent_name
from sppm_pipeline.engine.cache.store import Store
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.run.monitor import Monitor


def reasons_of(plan: Plan, store: Store, about: str) -> dict[str, tuple[bool, str]]:
    """For each stage of the pipeline, whether its result is kept, and in words since when or why not.

    Parameters
    ----------
    plan : Plan
    store : Store
    about : str
        Name under which the last run was remembered; see `CacheSession`.
    """
    keeper = CacheSession(store, Monitor(), seed=plan.seed, recipes=plan.recipes)
    recent = store.read_text(recent_name(about)) or {}
    before: Mapping[str, Any] = recent.get("stages", {})
    found: dict[str, tuple[bool, str]] = {}
    for step in plan.steps:
        entry = keeper.look_up(step, (step.id,))
        if entry is not None:
            found[step.id] = True, f"kept; it took {entry.manifest['seconds']:.3g} s"
            continue
        now = keeper.ingredients(step.id)
        again = [source for source in step.inputs.values() if source and not found[source][0]]
        if not step.stage.cacheable:
            why = "it runs every time, as its result depends on more than can be known"
        elif step.id not in before:
            why = "no run of this configuration is known that had it"
        elif again:
            # the keys of what runs again are not known yet, so that only its own changes can be told
            own = [text for text in differences(before[step.id], now or {}) if not text.startswith("its input")]
            why = "; ".join([*own, *(f"{source!r} runs again" for source in dict.fromkeys(again))])
        elif now is None:
            why = "an input file can't be read"
        else:
            own = list(differences(before[step.id], now))
            if recent.get("seed") != plan.seed:
                own.append(f"the seed has changed from {recent.get('seed')} to {plan.seed}")
            why = "; ".join(own) or "its result is not in the cache, or not any more"
        found[step.id] = False, why
    store.close()
    return found


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """What has changed between two lists of ingredients, in words."""
    if not now:
        return
    if before.get("stage") != now.get("stage"):
        yield f"the stage was {before.get('stage')}, and is {now.get('stage')}"
        return
    if before.get("version") != now.get("version"):
        yield f"the version of the stage has changed from {before.get('version')} to {now.get('version')}"
    yield from _changed_options(before.get("options", {}), now.get("options", {}))
    old_files, new_files = before.get("files", {}), now.get("files", {})
    for name in new_files:
        if name in old_files and [d for _, d in old_files[name]] != [d for _, d in new_files[name]]:
            yield f"the content of the file of option {name!r} has changed"
    old_code, new_code = before.get("code", {}), now.get("code", {})
    if old_code.get("version") != new_code.get("version"):
        yield (
            f"{new_code.get('supplier')} has changed from version {old_code.get('version')} "
            f"to {new_code.get('version')}"
        )
    elif old_code != new_code:
        yield f"the code of {new_code.get('supplier')} has changed"
    yield from _changed_recipes(before.get("recipes", {}), now.get("recipes", {}))
    old_world, new_world = before.get("environment", {}), now.get("environment", {})
    for name in sorted({*old_world, *new_world}):
        if old_world.get(name) != new_world.get(name):
            yield f"{name} has changed from {old_world.get(name)} to {new_world.get(name)}"
    old_inputs, new_inputs = before.get("inputs", {}), now.get("inputs", {})
    for port in new_inputs:
        if old_inputs.get(port) != new_inputs[port]:
            yield f"its input {port!r} is another"


def _changed_options(before: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    for name in now:
        if name not in before:
            yield f"option {name!r} is new"
        elif before[name] != now[name]:
            yield f"option {name!r} has changed from {before[name]!r} to {now[name]!r}"


def _changed_recipes(before: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    for port, recipe in now.items():
        old = before.get(port, {"stages": []})
        if [s["id"] for s in old["stages"]] != [s["id"] for s in recipe["stages"]]:
            yield f"the recipe {recipe['name']!r} has other stages"
            continue
        for was, is_ in zip(old["stages"], recipe["stages"], strict=True):
            for text in differences(was, {**is_, "environment": was.get("environment", {})}):
                yield f"in the recipe {recipe['name']!r}, stage {is_['id']!r}: {text}"
