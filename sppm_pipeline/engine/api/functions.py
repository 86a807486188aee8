"""Stages as functions, under the names that they have in YAML.

A call checks the options as a file's are checked. It runs the stage if it is given all that the stage needs: artifacts
for its ports, and a seed if it draws random numbers. Otherwise it is a step: it stands in recipes and pipelines, and
runs when it is called with the rest::

    pores = sppm.sample.dart_throwing(count=40, spacing=0.2, seed=1)
    throw = sppm.sample.dart_throwing(count=40, spacing=0.2)
    cell = sppm.field.gaussian(level=0.25)(graph)

Random numbers are those of a pipeline with the same seed in which the stage has its default id.
"""

from __future__ import annotations

import inspect
import textwrap
import types
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.api.bound_stage import BoundStage
from sppm_pipeline.engine.api.registering import registry
from sppm_pipeline.engine.config.options import options_of
from sppm_pipeline.engine.plan.describe import makes_words, option_words
from sppm_pipeline.engine.plan.ports import port_words, signature_of
from sppm_pipeline.errors import ConfigError, did_you_mean
from sppm_pipeline.stage import FAMILIES, Stage

OF_STEPS = ("id", "sources")
OF_RUNS = ("seed", "threads", "output")


def make_function(stage: str, *, runs: bool = True) -> Callable[..., Any]:
    """The function of a stage; without `runs` every call of it is a step."""
    return _function(registry().get(stage), runs)


@cache
def _function(cls: type[Stage], runs: bool) -> Callable[..., Any]:
    """One for each class, so that a class that is registered again gets its own."""

    def call(*artifacts: Any, **given: Any) -> Any:
        return _called(cls, runs, artifacts, given)

    # what `help`, notebooks and editors read
    call.__module__ = "sppm_pipeline" if runs else "sppm_pipeline.step"
    call.__qualname__ = cls.name
    call.__name__ = cls.name.partition(".")[2]
    call.__doc__ = _documentation(cls)
    call.__signature__ = _signature(cls)  # type: ignore[attr-defined]
    return call


def _called(cls: type[Stage], runs: bool, artifacts: Sequence[Any], given: dict[str, Any]) -> Any:
    ports = [port for port in signature_of(cls).ports if not port.is_recipe]
    if not ports and artifacts:
        # the likeliest mistake is an option given by position
        first = next(iter(options_of(cls)), None)
        raise ConfigError(
            f"{cls.name} takes no artifacts, got {type(artifacts[0]).__name__}",
            hint=f"options are given by name, for example {first}=..." if first else "leave it out",
        )
    named = {port.name: given.pop(port.name) for port in ports if port.name in given}
    if runs and "output" not in given:
        given |= _apart(cls, given)
    for_run = {name: value for name in OF_RUNS if (value := given.pop(name, None)) is not None}
    as_step = {name: given.pop(name, None) for name in OF_STEPS}
    recipe = given.pop("recipe", None)
    bound: BoundStage[Any, Any] = BoundStage(cls.name, given, recipe, **as_step)
    if runs and not any(value is not None for value in as_step.values()):
        if isinstance(recipe, str) and "seed" in for_run and recipe not in registry().presets:
            # a recipe of a pipeline has a name, too, and no call has one
            raise ConfigError(f"there is no preset {recipe!r}", hint=did_you_mean(recipe, registry().presets))
        waits = not all(port.optional for port in ports) or (
            "seed" not in for_run and (cls.is_random or recipe is not None)
        )
        if artifacts or named or not (waits or bound.is_open):
            return bound(*artifacts, **for_run, **named)
    for name, value in {**for_run, **named, "artifacts": artifacts or None}.items():
        if value is not None:
            raise ConfigError(
                f"{cls.name} needs artifacts before it can run"
                if runs
                else f"{cls.name} is a step here, and runs later",
                hint=f"sppm.{cls.name}(...)(artifact, {name}=...): `{name}` belongs to the second call",
            )
    return bound


def _apart(cls: type[Stage], given: Mapping[str, Any]) -> dict[str, Any]:
    """Folder and name of a file that is named with its folder: in a pipeline outputs lie below the run directory."""
    outputs = [name for name, option in options_of(cls).items() if option.spec.output and name in given]
    paths = {name: Path(given[name]) for name in outputs if isinstance(given[name], (str, Path))}
    if len(paths) != 1 or not any(path.is_absolute() or ".." in path.parts for path in paths.values()):
        return {}
    ((name, path),) = paths.items()
    return {name: path.name, "output": path.parent}


def _signature(cls: type[Stage]) -> inspect.Signature:
    """Ports by position, options by keyword, as editors and `help` show them."""
    kind = inspect.Parameter
    # options by keyword only: their order may change
    parameters = [kind("artifacts", kind.VAR_POSITIONAL)]
    parameters += [
        kind(
            name,
            kind.KEYWORD_ONLY,
            default=kind.empty if option.required else option.default,
            annotation=option.kind,
        )
        for name, option in options_of(cls).items()
    ]
    recipe = ["recipe"] if any(port.is_recipe for port in signature_of(cls).ports) else []
    parameters += [kind(name, kind.KEYWORD_ONLY, default=None) for name in (*recipe, *OF_RUNS, *OF_STEPS)]
    return inspect.Signature(parameters)


def _documentation(cls: type[Stage]) -> str:
    """The docstring of a stage with its ports, and with its options: type, unit, bounds, default and what each is."""
    lines = [inspect.getdoc(cls) or "", "", "Parameters", "----------"]
    for port in signature_of(cls).ports:
        words = "sequence of steps, or name of a preset" if port.is_recipe else port_words(port)
        lines.append(f"{'recipe' if port.is_recipe else port.name} : {words}{', optional' if port.optional else ''}")
    for option in options_of(cls).values():
        lines += [f"{option.name} : {option_words(option)}", *textwrap.wrap(
            option.spec.help, 100, initial_indent="    ", subsequent_indent="    "
        )]  # fmt: skip
    makes = makes_words(cls)
    if makes == "nothing":
        writes = any(option.spec.output for option in options_of(cls).values())
        makes = "paths of the files written, a list of Path" if writes else "the numbers that it reports, a dict"
    lines += ["seed, threads, output", "    Of a run, see `sppm_pipeline.nouns.BoundStage`.", "id, sources",
              "    Of a step in a pipeline: its name, and what it takes.", "", "Returns", "-------", makes]  # fmt: skip
    if any(not (port.is_recipe or port.optional) for port in signature_of(cls).ports):
        lines.append("    Without artifacts the step, which is called with them.")
    elif cls.is_random or any(port.is_recipe for port in signature_of(cls).ports):
        lines.append("    Without a seed the step, for a recipe or pipeline.")
    return "\n".join(lines)


class NoStage(ConfigError, AttributeError):
    """A family has no stage of a name; an `AttributeError`, too, as `hasattr` and completion expect."""


class Family(types.ModuleType):
    """The stages of a family as functions; a module, so that help and completion know what to do with it."""

    def __init__(self, name: str, make: Callable[[str], Any]) -> None:
        super().__init__(f"sppm_pipeline.{name}", f"Stages of the family {name}: {FAMILIES.get(name, 'of a plugin')}.")

        def load(word: str) -> Any:
            # inspection asks for such names, and must not load all plugins
            if word == "__all__":
                return names()
            if word.startswith("_"):
                raise AttributeError(word)
            try:
                # now, so that a misspelled stage is an AttributeError here and not an error of a later call
                return make(f"{name}.{word}")
            except ConfigError as error:
                raise NoStage(error.message, hint=error.hint) from None

        def names() -> list[str]:
            stages = registry().sound(name)
            return [word for stage in stages if (word := stage.partition(".")[2]).isidentifier()]

        # of the module and not of the class, which completion trusts
        self.__dict__.update(__getattr__=load, __dir__=names)

    def __repr__(self) -> str:
        return f"<stages {self.__name__.partition('.')[2]}: {', '.join(dir(self))}>"


class CheckFamily(Family):
    """The stages of the family ``check``; called, it checks a configuration."""

    def __call__(
        self, config: Any, *, params: Mapping[str, Any] | None = None, set: Mapping[str, Any] | None = None
    ) -> tuple[str, ...]:
        """Check a configuration or `Pipeline` without running it; see `Pipeline.check`.

        Examples
        --------
        >>> import sppm_pipeline as sppm
        >>> sppm.check("quickstart")
        ()
        """
        from sppm_pipeline.engine.api.pipeline import pipeline_of

        return pipeline_of(config).with_(params, set=set).check()


@cache
def family_of(name: str) -> Family:
    """A family of stages, by its name; `AttributeError` if no stage has such a name."""
    if name not in FAMILIES and not (name.isidentifier() and any(one.startswith(f"{name}.") for one in registry())):
        raise AttributeError(f"no family of stages is called {name!r}")
    return (CheckFamily if name == "check" else Family)(name, make_function)


def families() -> list[str]:
    """All families of which there are stages."""
    return list(dict.fromkeys(name.partition(".")[0] for name in registry()))


def step_families() -> types.ModuleType:
    """The namespace ``sppm.step``: all families, in which every call is a step."""

    def load(name: str) -> Family:
        if name.startswith("_"):
            raise AttributeError(name)
        family_of(name)
        found = Family(name, lambda stage: make_function(stage, runs=False))
        setattr(steps, name, found)
        return found

    about = "Stages whose calls are steps, whatever they are given: ``step.read.primitive(shape='ball', size='2 mm')``."
    steps = types.ModuleType("sppm_pipeline.step", about)
    steps.__dict__.update(__getattr__=load, __dir__=families)
    return steps


def param(name: str) -> Any:
    """A parameter of a pipeline as the value of an option, ``"${name}"`` in YAML; type checkers let it pass anywhere.

    Parameters
    ----------
    name : str

    Examples
    --------
    >>> import sppm_pipeline as sppm
    >>> sppm.tune.porosity(target=sppm.param("porosity"), recipe="paper")
    <step tune.porosity(target='${porosity}', recipe='paper')>
    """
    if not name.isidentifier():
        raise ConfigError(f"a parameter is named by a word, got {name!r}")
    return f"${{{name}}}"
