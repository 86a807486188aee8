"""Stages as functions, under the names that they have in YAML.

``sppm.sample.dart_throwing(count=40, spacing=0.2, seed=1)`` checks the options as a file's are checked, and runs the
stage if all that it needs is there. Otherwise it returns the stage with its options set, to be called with artifacts:
``sppm.field.gaussian(level=0.25)(graph)``. Random numbers are those of a pipeline with the same seed in which the stage
has its default id.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.api.bound_stage import BoundStage, registry
from sppm_pipeline.engine.config.options import options_of
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.stage import FAMILIES, Stage


class StageFunction:
    """A stage as a function; its keywords are the stage's options."""

    def __init__(self, name: str) -> None:
        cls = registry().get(name)
        self.name = cls.name
        self.__name__ = name.partition(".")[2]
        self.__doc__ = inspect.getdoc(cls)
        self.__signature__ = _signature(cls)

    def __repr__(self) -> str:
        return f"<stage {self.name}>"

    def __call__(
        self,
        *artifacts: Any,
        recipe: Sequence[Any] | str | None = None,
        seed: int | None = None,
        threads: int | None = None,
        output: str | Path | None = None,
        **options: Any,
    ) -> Any:
        """Set options, and run the stage if all that it needs is there; see `BoundStage`.

        Parameters
        ----------
        *artifacts
            What the stage takes.
        recipe : sequence of stages, or name of a preset, optional
            What the stage repeats: calls without artifacts, entries made with `step`, names, or mappings as in YAML.
        seed, threads, output
            As for `BoundStage`.
        **options
            Options of the stage, and ports by name.
        """
        ports = [port for port in signature_of(registry().get(self.name)).ports if not port.is_recipe]
        if not ports and artifacts:
            # the likeliest mistake is an option given by position
            first = next(iter(options_of(registry().get(self.name))), None)
            raise ConfigError(
                f"{self.name} takes no artifacts, got {type(artifacts[0]).__name__}",
                hint=f"options are given by name, for example {first}=..." if first else "leave it out",
            )
        named = {port.name: options.pop(port.name) for port in ports if port.name in options}
        bound = BoundStage(self.name, options, recipe)
        # without required ports there is nothing to wait for
        if artifacts or named or all(port.optional for port in ports):
            folder = "." if output is None else output
            return bound(*artifacts, seed=seed, threads=threads, output=folder, **named)
        for name, value in (("seed", seed), ("threads", threads), ("output", output)):
            if value is not None:
                raise ConfigError(
                    f"{self.name} needs artifacts before it can run",
                    hint=f"sppm.{self.name}(...)(artifact, {name}=...): `{name}` belongs to the second call",
                )
        return bound


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
    return inspect.Signature(parameters)


def _entry(name: str) -> Callable[..., dict[str, Any]]:
    def entry(
        *,
        id: str | None = None,
        sources: str | Sequence[str] | Mapping[str, Any] | None = None,
        recipe: Any = None,
        **options: Any,
    ) -> dict[str, Any]:
        reserved = {"id": id, "from": sources, "recipe": recipe}
        return {"stage": name, **{key: value for key, value in reserved.items() if value is not None}, **options}

    entry.__doc__ = f"An entry of a pipeline or recipe: {name} with options, id, `sources` (from) and recipe."
    return entry


class Family:
    """The stages of a family as attributes; `make` makes one from a stage's full name."""

    def __init__(self, name: str, make: Callable[[str], Any]) -> None:
        self._name = name
        self._make = make
        self.__doc__ = f"Stages of the family {name}: {FAMILIES.get(name, 'of a plugin')}."

    def __getattr__(self, word: str) -> Any:
        # inspection asks for such names, and must not load all plugins
        if word.startswith("_"):
            raise AttributeError(word)
        try:
            # now, so that a misspelled stage is an AttributeError here and not an error of a later call
            registry().get(f"{self._name}.{word}")
        except ConfigError as error:
            # as `hasattr` and completion expect
            raise AttributeError(str(error)) from None
        return self._make(f"{self._name}.{word}")

    def __dir__(self) -> list[str]:
        return [name.partition(".")[2] for name in registry() if name.startswith(f"{self._name}.")]

    def __repr__(self) -> str:
        return f"<stages {self._name}: {', '.join(dir(self))}>"


class CheckFamily(Family):
    """The stages of the family ``check``; called, it checks a configuration."""

    def __call__(
        self, config: Any, *, params: Mapping[str, Any] | None = None, set: Mapping[str, Any] | None = None
    ) -> tuple[str, ...]:
        """Check a configuration or `Pipeline` without running it; see `Pipeline.check`."""
        from sppm_pipeline.engine.api.pipeline import pipeline_of

        return pipeline_of(config).with_(params, set=set).check()


class Steps:
    """Entries of pipelines: ``step.sample.dart_throwing(total=66, id="pores")``, by family and name."""

    def __getattr__(self, family: str) -> Family:
        if family not in FAMILIES and not any(name.startswith(f"{family}.") for name in registry()):
            raise AttributeError(family)
        return Family(family, _entry)

    def __dir__(self) -> list[str]:
        return list(FAMILIES)


step = Steps()
check = CheckFamily("check", StageFunction)
(
    connect, design, extract, field, fill, grade, homogenize, measure, mesh, read, sample, slice, tile, tileset, tune,
    warp, write,
) = (
    Family(name, StageFunction)
    for name in (
        "connect", "design", "extract", "field", "fill", "grade", "homogenize", "measure", "mesh", "read", "sample",
        "slice", "tile", "tileset", "tune", "warp", "write",
    )
)  # fmt: skip
