"""The key of a stage's result: a digest of all that the result depends on."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.cache.identity import code_of, environment, has_files
from sppm_pipeline.engine.files import digest_of
from sppm_pipeline.engine.plan.planning import Plan, step_options
from sppm_pipeline.engine.plan.wiring import Step

KEY_FORMAT = 1
"""Raised when the same ingredients come to mean something else."""


class InputFiles:
    """Digests of input files, each read once in a run.

    Raises from its methods what reading a file raises.
    """

    def __init__(self) -> None:
        self._digests: dict[str, tuple[tuple[Any, ...], str]] = {}

    def digest(self, path: Path) -> str | None:
        """SHA-256 of a file, or of all files in a folder; None if there is nothing of that name."""
        name = os.path.abspath(path)
        if name not in self._digests:
            state = _state(path)
            if state is None:
                return None
            self._digests[name] = (state, digest_of(path))
        return self._digests[name][1]

    def unchanged(self) -> bool:
        """True if all files are still what they were when they were read."""
        return all(_state(Path(name)) == state for name, (state, _) in self._digests.items())


def _state(path: Path) -> tuple[Any, ...] | None:
    """State of a file or folder that changes with each write."""
    try:
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        # times to the nanosecond and the inode: a file replaced by one of equal size is noticed
        stats = [(str(file), file.stat()) for file in files]
    except OSError:
        return None
    return tuple((name, s.st_size, s.st_mtime_ns, s.st_ctime_ns, s.st_ino) for name, s in stats)


def ingredients_of(
    step: Step,
    recipes: Mapping[str, Sequence[Step]],
    path: tuple[str, ...],
    inputs: Mapping[str, str | None],
    files: InputFiles,
) -> dict[str, Any] | None:
    """All dependencies of the result of a step but the seed; None if they are unknown. `path` is that of its random
    numbers, `inputs` keys of the results that it is handed, None for open ports.
    """
    used: list[Step] = []
    described = _described(step, recipes, files, used)
    if described is None:
        return None
    return {
        "format": KEY_FORMAT,
        **described,
        "inputs": dict(inputs),
        # random numbers follow from the path, so that a stage moved elsewhere draws others
        "path": list(path),
        "environment": _environment(used),
    }


def _environment(used: Sequence[Step]) -> dict[str, str]:
    """Dependencies of the results of steps besides this program."""
    libraries = {name for step in used for name in step.stage.libraries}
    plugins = {step.owner.distribution for step in used if step.owner.distribution}
    return environment(tuple(sorted(libraries)), tuple(sorted(plugins)))


def _described(
    step: Step, recipes: Mapping[str, Sequence[Step]], files: InputFiles, used: list[Step]
) -> dict[str, Any] | None:
    """Stage, version, code, options, input files and recipes; the step and those of its recipes are added to `used`."""
    stage = step.stage
    if not (stage.cacheable and has_files(type(stage))):
        return None
    used.append(step)
    options = step_options(step)
    contents: dict[str, Any] = {}
    for name in options:
        value = getattr(stage, name)
        if isinstance(value, Path):
            options[name] = os.path.abspath(value)
        for file in _paths(value):
            digest = files.digest(file)
            if digest is None:
                return None
            # the name counts as well: stages put it into messages and artifacts
            contents.setdefault(name, []).append([os.path.abspath(file), digest])
    handed: dict[str, Any] = {}
    for port, recipe in step.recipes.items():
        if (inner := _described_recipe(recipe, recipes, files, used)) is None:
            return None
        handed[port] = {"name": recipe, "stages": inner}
    described: dict[str, Any] = {
        "stage": stage.name,
        "version": stage.version,
        "code": code_of(type(stage), step.owner),
        "options": options,
    }
    if contents:
        described["files"] = contents
    if handed:
        described["recipes"] = handed
    return described


def _described_recipe(
    name: str, recipes: Mapping[str, Sequence[Step]], files: InputFiles, used: list[Step]
) -> list[dict[str, Any]] | None:
    """The stages of a recipe as `_described`; None if one of them depends on more."""
    inner = [(step, _described(step, recipes, files, used)) for step in recipes[name]]
    found = [{"id": step.id, **about, "inputs": dict(step.inputs)} for step, about in inner if about is not None]
    return found if len(found) == len(inner) else None


def recipe_key(name: str, recipes: Mapping[str, Sequence[Step]], path: tuple[str, ...], seed: int) -> str | None:
    """The key of what a recipe gives, of which `path` is that of its random numbers; None if it is unknown."""
    used: list[Step] = []
    inner = _described_recipe(name, recipes, InputFiles(), used)
    if inner is None:
        return None
    return key_of({
        "format": KEY_FORMAT, "recipe": inner, "path": list(path), "seed": seed,
        "environment": _environment(used),
    })  # fmt: skip


def _paths(value: Any) -> list[Path]:
    if isinstance(value, Path):
        return [value]
    return [path for item in value for path in _paths(item)] if isinstance(value, tuple) else []


def run_key(plan: Plan, until: str | None) -> str | None:
    """The key of a whole run, made of all its stages; None if what it gives depends on more."""
    files = InputFiles()
    stages = []
    for step in plan.steps:
        try:
            ingredients = ingredients_of(step, plan.recipes, (step.id,), dict(step.inputs), files)
        except OSError:
            return None
        if ingredients is None:
            return None
        stages.append(ingredients)
    return key_of({"stages": stages, "seed": plan.seed, "until": until, "config": plan.document})


def key_of(ingredients: Mapping[str, Any]) -> str:
    """The key, 64 hexadecimal digits."""
    # one text for equal ingredients, whatever the order of keys or the locale
    text = json.dumps(ingredients, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=True)
    return hashlib.sha256(text.encode()).hexdigest()


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """Changes between two lists of ingredients, in words."""
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
        # of one version: sources that were edited
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
