"""Running one stage, and recipes: results checked, errors given their place and the plugin at fault."""

from __future__ import annotations

import dataclasses
import errno
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sppm_pipeline.engine.config.options import current_name, options_of, parse_typed
from sppm_pipeline.engine.files import DISK
from sppm_pipeline.engine.plan.checking import declared_numbers, is_declared
from sppm_pipeline.engine.plan.ports import artifact_words
from sppm_pipeline.engine.plan.wiring import Step, last_uses
from sppm_pipeline.engine.process.budget import exhausted_resource
from sppm_pipeline.engine.process.containment import CONTRACT, contained, limited
from sppm_pipeline.engine.process.interruption import check
from sppm_pipeline.engine.run.context import RunContext
from sppm_pipeline.engine.run.sweep_table import numbers_of
from sppm_pipeline.engine.strict_json import jsonable
from sppm_pipeline.errors import (
    ConfigError,
    DesignError,
    InputError,
    PluginError,
    ResourceError,
    SppmError,
    described,
    did_you_mean,
    listed,
    meant,
    near_names,
    text_of,
)
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.stage import Context, Observed, Recipe, Rejected, Stage

RecipeSteps = Mapping[str, Sequence[Step]]


def run_step(step: Step, stage: Stage, inputs: Mapping[str, Any], context: RunContext, recipes: RecipeSteps) -> Any:
    """Run one stage and return what it made; errors of the stage get its place and id.

    What a plugin raises unexpectedly becomes a `PluginError`, what a built-in stage does an `SppmError` with exit code
    1; missing memory or disk a `ResourceError`.
    """
    # recipes are handed over as objects that a stage runs as often as it likes
    handed = {port: StepRecipe(name, recipes) for port, name in step.recipes.items()}
    optional = {port.name: None for port in step.signature.ports if port.optional}
    taken = {**optional, **step.signature.gathered(inputs), **handed}
    # digests of all inputs cost as much as some stages, so they are for authors of plugins
    before = digests(inputs) if is_strict() else {}
    writable = set() if step.owner.builtin else writable_ports(inputs)
    try:
        what = f"{step.owner}: the stage {step.stage.name!r}"
        with limited(what, builtin=step.owner.builtin, where=step.where, stage=step.address):
            if step.owner.builtin:
                made = stage.run(context, **taken)
            else:
                with contained(lambda message: _fault_of(step, message)):
                    made = stage.run(context, **taken)
        _check_result(step, made)
        ports = changed(inputs, before)
        if not step.owner.builtin:
            # an array that was unlocked may have been changed even where its digest is not taken
            ports = ports or sorted(writable_ports(inputs) - writable)
        if ports:
            raise _fault_of(step, f"changed its input {listed(ports)}, which other stages share")
        return made
    except SppmError as error:
        error.where = error.where or step.where
        error.stage = error.stage or step.address
        raise
    # the machine is at fault, not the author of the stage
    except MemoryError as error:
        raise ResourceError(
            "not enough memory" if step.owner.builtin else f"{step.owner}: not enough memory",
            hint="use a coarser resolution, or a stage that streams",
            where=step.where,
            stage=step.address,
        ) from error
    except Exception as error:
        raise _system_error(step, error) from error


def _system_error(step: Step, error: Exception) -> SppmError:
    """A file that is not there, something of the machine that is missing, or the author of the stage is at fault."""
    # files that users name in options are missing far more often than a stage is wrong
    if isinstance(error, (FileNotFoundError, IsADirectoryError, NotADirectoryError)):
        place = f": {error.filename!r}" if error.filename is not None else ""
        return InputError(f"{error.strerror or error}{place}", where=step.where, stage=step.address)
    missing = exhausted_resource(error)
    if missing is not None and (step.owner.builtin or not isinstance(error, ModuleNotFoundError)):
        # only for a disk does the hint help
        full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
        return ResourceError(missing, hint=DISK if full else None, where=step.where, stage=step.address)
    return _fault_of(step, f"raised {described(error)}")


def _fault_of(step: Step, message: str) -> SppmError:
    """An error that is the fault of the author of the stage."""
    if step.owner.builtin:
        hint = "this is a mistake in the program; --debug shows where"
        return SppmError(f"internal error: {message}", where=step.where, stage=step.address, hint=hint)
    hint = f"this is a mistake in {step.owner}; --debug shows where"
    return PluginError(f"{step.owner}: {message}", where=step.where, stage=step.address, hint=hint)


def _check_result(step: Step, made: Any) -> None:
    """Type as announced, parts that agree with each other."""
    # the plan was wired by what the stage announces
    if not isinstance(made, step.makes or type(None)):
        raise _fault_of(step, f"made {type(made).__name__}, but announces {artifact_words(step.makes)}")
    # results are checked here, so that the stage that made a wrong one is named and not one that reads it
    check = getattr(made, "check", None)
    if check is not None:
        try:
            check()
        except ValueError as error:
            raise _fault_of(step, f"made a {type(made).__name__} that contradicts itself: {text_of(error)}") from error
        except Exception as error:
            words = f"made a {type(made).__name__} that can't be checked: {described(error)}"
            raise _fault_of(step, words) from error
    if not step.owner.builtin and isinstance(made, Artifact):
        made.attribute(lambda message: _fault_of(step, f"made a {type(made).__name__} {message}"))
    if (not step.owner.builtin or is_strict()) and (place := no_numbers(made)) is not None:
        raise _fault_of(step, f"made a {type(made).__name__} with {place}")


def summary_of(made: Any, reported: Mapping[str, Any], step: Step) -> dict[str, Any]:
    """The numbers of the result and those that the stage reported, which win."""
    try:
        own = jsonable(made.summary()) if hasattr(made, "summary") else {}
    except SppmError:
        raise
    except Exception as error:
        raise _fault_of(step, f"the summary of {type(made).__name__} raised {described(error)}") from error
    return {**reported, **{name: value for name, value in own.items() if name not in reported}}


class StepRecipe(Recipe):
    """A recipe of the plan, as stages see it; `recipes` are all, as recipes may use recipes."""

    def __init__(self, name: str, recipes: RecipeSteps) -> None:
        self.name = name
        self._recipes = recipes
        self._steps = recipes[name]

    def options(self) -> Mapping[str, Mapping[str, Any]]:
        return {
            step.id: {name: getattr(step.stage, name) for name in options_of(type(step.stage))} for step in self._steps
        }

    def inner_options(self) -> Mapping[str, Mapping[str, Any]]:
        names = [name for step in self._steps for name in step.recipes.values()]
        found: dict[str, Mapping[str, Any]] = {}
        for name in dict.fromkeys(names):
            inner = StepRecipe(name, self._recipes)
            found |= {f"{name}.{id_}": values for id_, values in inner.options().items()} | dict(inner.inner_options())
        return found

    def number(self, name: str) -> str:
        declared = {step.id: declared_numbers(type(step.stage), step.owner.builtin, step.makes) for step in self._steps}
        owners = [id_ for id_ in declared if name.startswith(f"{id_}.")]
        if any((there := declared[id_]) is None or is_declared(name[len(id_) + 1 :], there) for id_ in owners):
            return name
        alone = [id_ for id_, there in declared.items() if there is not None and is_declared(name, there)]
        if len(alone) == 1:
            return f"{alone[0]}.{name}"
        if alone:
            hint = f"write {listed([f'{id_}.{name}' for id_ in alone], 'or')}"
            raise ConfigError(f"{len(alone)} stages of the recipe {self.name!r} report {name!r}", hint=hint)
        numbers = [f"{id_}.{number}" for id_, there in declared.items() for number in there or ()]
        near = sorted(number for number in numbers if f".{name}." in f".{number}")[:3]
        hint = f"there are {', '.join(sorted(numbers))}"
        if owners:
            own = sorted(declared[owners[0]] or ())
            near = near or [f"{owners[0]}.{word}" for word in near_names(name[len(owners[0]) + 1 :], own)]
            hint = f"numbers of {owners[0]}: {', '.join(own)}"
        near = near or ([] if owners else near_names(name, numbers))
        message = f"no stage of the recipe {self.name!r} reports a number {name!r}"
        raise ConfigError(message, hint=meant(near) if near else hint)

    def run(
        self,
        context: Context,
        *,
        palette: Palette | None = None,
        attempt: int = 0,
        options: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> Any:
        """See `Recipe.run`; `ConfigError` if `options` has a stage, option or value that is not allowed."""
        made: Any = None
        own = _of_a_run(context)
        for one, _ in self._run(own, palette or context.palette, attempt, self._with(own, options or {})):
            made = one
        return made

    def observe(
        self,
        context: Context,
        kind: type,
        *,
        attempt: int = 0,
        options: Mapping[str, Mapping[str, Any]] | None = None,
        again: bool = False,
    ) -> Observed:
        own = _of_a_run(context)
        recipes = self._with(own, options or {})
        # the numbers of a draw are kept, as a search asks for the same draw again when it is resumed
        key = own.recipe_key(self.name, recipes, attempt)
        known = None if again or key is None else context.recall(key)
        if known is not None:
            if "failed" in known:
                raise self._failure(known["failed"])
            return Observed(None, known["numbers"])
        kept: Any = None
        entries: list[Mapping[str, Any]] = []
        try:
            for made, entry in self._run(own, context.palette, attempt, recipes):
                kept = made if isinstance(made, kind) else kept
                entries.append(entry)
        except DesignError as error:  # of this draw, as its numbers would be
            if key is not None:
                failed = {"message": error.message, "hint": error.hint or "", "stage": error.stage or ""}
                context.remember(key, {"failed": {**failed, "rejected": isinstance(error, Rejected)}})
            raise
        numbers = numbers_of(entries)
        if key is not None:
            context.remember(key, {"numbers": numbers})
        return Observed(kept, numbers)

    def _failure(self, failed: Mapping[str, Any]) -> DesignError:
        """The error that ended a remembered run, at the place where its stage stands now."""
        kind = Rejected if failed["rejected"] else DesignError
        stage = failed["stage"] or None
        steps = (step for steps in self._recipes.values() for step in steps)
        where = next((step.where for step in steps if step.address == stage), None)
        return kind(failed["message"], hint=failed["hint"] or None, where=where, stage=stage)

    def _run(
        self, context: RunContext, palette: Palette, attempt: int, recipes: RecipeSteps
    ) -> Iterator[tuple[Any, Mapping[str, Any]]]:
        """Result of each stage, with its id and summary."""
        steps = recipes[self.name]
        results: dict[str, Any] = {}
        for step, done in zip(steps, last_uses(steps), strict=True):
            check()
            inner = context.inside(self.name, attempt, step.id, step.address, palette)
            inner.log.begin(step.address)
            # each draw takes the place of the files of the one before
            if inner.folder is not None:
                inner.folder.restart(step.address)
            inputs = {port: results[source] if source else None for port, source in step.inputs.items()}
            started = time.perf_counter()
            made = results[step.id] = run_step(step, step.stage, inputs, inner, recipes)
            seconds = time.perf_counter() - started
            summary = summary_of(made, inner.log.values.get(step.address, {}), step)
            kind = None if made is None else type(made).__name__
            inner.log.ran(step.address, step.stage.name, kind, seconds, summary)
            del inputs
            for id_ in done:
                results.pop(id_, None)
            yield made, {"id": step.id, "summary": summary}

    def _with(self, context: RunContext, options: Mapping[str, Mapping[str, Any]]) -> RecipeSteps:
        """All recipes, with some options of this one, and of those that it repeats, replaced."""
        own = {target: values for target, values in options.items() if target not in self.inner_options()}
        changes = {(self.name, id_): values for id_, values in self._changes(own).items()}
        for target in options.keys() - own.keys():
            recipe, _, id_ = target.partition(".")
            changes[recipe, id_] = dict(options[target])
        if not changes:
            return self._recipes
        return {
            name: [
                dataclasses.replace(step, stage=self._changed(step, values, context))
                if (values := changes.get((name, step.id))) else step for step in steps
            ]
            for name, steps in self._recipes.items()
        }  # fmt: skip

    def _changes(self, options: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
        """Options by step id, from options by step id or stage name."""
        changes: dict[str, dict[str, Any]] = {}
        for target, values in options.items():
            ids = [step.id for step in self._steps if step.id == target]
            ids = ids or [step.id for step in self._steps if step.stage.name == target]
            if not ids:
                known = [*(step.id for step in self._steps), *self.inner_options()]
                hint = did_you_mean(target, known) or f"stages of the recipe: {', '.join(known)}"
                raise ConfigError(f"the recipe {self.name!r} has no stage {target!r}", hint=hint)
            if len(ids) > 1:
                raise ConfigError(f"{target!r} may mean {listed(ids, 'or')} of the recipe {self.name!r}")
            changes.setdefault(ids[0], {}).update(values)
        return changes

    def _changed(self, step: Step, values: Mapping[str, Any], context: RunContext) -> Stage:
        """The stage with some options replaced, under the same rules as in the file."""
        declared = options_of(type(step.stage))
        parsed = {}
        for former, value in values.items():
            name = current_name(type(step.stage), former)
            if name != former:
                context.warn(
                    f"the option {former!r} of {step.stage.name} is now {name!r}; the old name works in this version"
                )
            if name not in declared:
                raise ConfigError(f"{step.stage.name} has no option {name!r}", hint=did_you_mean(name, declared))
            try:
                plain = value.item() if hasattr(value, "item") else value
                parsed[name] = parse_typed(declared[name], plain, Path.cwd())
            except ValueError as error:
                raise ConfigError(
                    f"option {name!r} of {step.address!r}: {error}", hint=declared[name].spec.help
                ) from None
        stage = dataclasses.replace(step.stage, **parsed)
        # options that were fine one by one may contradict each other
        stage.check_options()
        return stage


def _of_a_run(context: Context) -> RunContext:
    if not isinstance(context, RunContext):
        raise TypeError("a recipe runs in the context that the calling stage was given")
    return context


def is_strict() -> bool:
    """True if inputs are digested before and after each stage, and results of built-in stages looked at, too."""
    return os.environ.get(CONTRACT, "") not in ("", "0")


def no_numbers(made: Any) -> str | None:
    """A NaN, an infinity or an object in the arrays and numbers of an artifact, with its place; None if there is none.

    Infinities in private fields, and in fields that no comparison looks at, are the artifact's own business.
    """
    for place, value in _parts(made, type(made).__name__):
        if isinstance(value, np.ndarray):
            # objects would need pickle, which the cache does not read
            if value.dtype.hasobject:
                return f"an array of objects, which can't be kept: {place}"
            if value.dtype.kind in "fc" and not np.isfinite(value).all():
                # the first place is found only when there is one: this is slower than the test
                bad = np.argwhere(~np.isfinite(value))
                first = f"{place}{bad[0].tolist()} is {value[tuple(bad[0])]}"
                return f"numbers that are not finite: {first} ({len(bad)} of {value.size} are not finite)"
        elif isinstance(value, float) and not math.isfinite(value):
            return f"numbers that are not finite: {place} is {value}"
    return None


def _parts(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Arrays and numbers of artifacts, tuples and lists, with their places; tables may hold NaN where a run failed."""
    if isinstance(value, Artifact):
        for field in dataclasses.fields(value):  # type: ignore[arg-type]
            if field.compare and not field.name.startswith("_"):
                yield from _parts(getattr(value, field.name), f"{place}.{field.name}")
    elif isinstance(value, (tuple, list)):
        names: Any = getattr(value, "_fields", range(len(value)))
        for name, item in zip(names, value, strict=True):
            yield from _parts(item, f"{place}.{name}" if isinstance(name, str) else f"{place}[{name}]")
    else:
        yield place, value


def digests(inputs: Mapping[str, Any]) -> dict[str, str]:
    """The digest of each input that has one."""
    found = {}
    for port, value in inputs.items():
        if isinstance(value, Artifact):
            try:
                found[port] = value.digest()
            except (TypeError, AttributeError):  # an artifact that computes what it holds while it is read
                continue
    return found


def changed(inputs: Mapping[str, Any], before: Mapping[str, str]) -> list[str]:
    """The ports whose artifacts are not what they were."""
    return [port for port, digest in digests({name: inputs[name] for name in before}).items() if digest != before[port]]


def writable_ports(inputs: Mapping[str, Any]) -> set[str]:
    """The ports whose artifacts have an array that can be written to; to unlock one is the way to change it."""
    return {
        port
        for port, artifact in inputs.items()
        if isinstance(artifact, Artifact)
        and any(isinstance(value, np.ndarray) and value.flags.writeable for _, value in _parts(artifact, port))
    }
