"""A stage with its options set, which is called with artifacts: a plan of this stage alone, run in a folder apart."""

from __future__ import annotations

import contextlib
import itertools
import shutil
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from sppm_pipeline.engine.api.monitor import WarningMonitor
from sppm_pipeline.engine.api.registering import is_dataclass_itself, is_known, register, registry
from sppm_pipeline.engine.config.configuration import FORMAT, checked_seed, parse_configuration
from sppm_pipeline.engine.config.document import Entry, compose
from sppm_pipeline.engine.config.options import options_of, parse_options, plain_option, with_current_names
from sppm_pipeline.engine.config.problems import raise_problems, shown
from sppm_pipeline.engine.plan.planning import Plan, make_plan
from sppm_pipeline.engine.plan.ports import Port, fits, port_words, signature_of
from sppm_pipeline.engine.run.events import Observers
from sppm_pipeline.engine.run.outputs import RunFolder, Scratch
from sppm_pipeline.engine.run.runner import StepRunner, available_threads
from sppm_pipeline.errors import ConfigError, WiringError, did_you_mean
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.stage import Stage

RECIPE = "recipe"
"""Name of the recipe that a call is given; recipes inside of it are called ``recipe2``, ``recipe3``, ..."""

Takes = TypeVar("Takes")
Makes = TypeVar("Makes", covariant=True)

_PLACEHOLDER = "${"


class MissingSeed(int):
    """The seed of a call that was given none: drawing random numbers from it raises an error."""

    def __str__(self) -> str:
        raise ConfigError("this stage draws random numbers, but has no seed", hint="give a seed, for example seed=1")


def entries_of(stages: Iterable[Any], recipes: dict[str, Any], base: str = RECIPE) -> list[Any]:
    """Stages of a pipeline or recipe as a configuration holds them.

    The recipes that they hold themselves, at any depth, are added to `recipes` under names that are free.
    """
    return [_entry_of(stage, recipes, base) for stage in stages]


def _entry_of(stage: Any, recipes: dict[str, Any], base: str) -> Any:
    if isinstance(stage, Artifact):
        # a call that needed nothing has run where it was written; in a list it is the step again
        made_by = vars(stage).get(_MADE_BY)
        if made_by is None:
            raise ConfigError(
                f"a recipe or pipeline is a list of stages, got the result {type(stage).__name__}",
                hint="write the call itself into the list, without a seed and without artifacts",
            )
        stage = made_by
    if isinstance(stage, Stage):
        cls = type(stage)
        if not is_dataclass_itself(cls):
            raise ConfigError(
                f"{cls.__name__} is no dataclass, so that it has no options", hint="write @sppm.register above it"
            )
        if not is_known(cls):
            register(cls)
        given = {name: (getattr(stage, name), option.default) for name, option in options_of(cls).items()}
        return {"stage": cls.name, **{name: plain_option(one) for name, (one, usual) in given.items() if one != usual}}
    if not isinstance(stage, BoundStage):
        if isinstance(stage, (str, Mapping)):
            return stage if isinstance(stage, str) else dict(stage)
        raise ConfigError(
            f"a recipe or pipeline is a list of stages, got {type(stage).__name__}",
            hint="sppm.FAMILY.NAME(...), an object of a subclass of Stage, a name, or a mapping as in YAML",
        )
    entry: dict[str, Any] = {"stage": stage.name}
    entry |= {key: value for key, value in (("id", stage.id), ("from", stage.sources)) if value is not None}
    if stage.recipe is not None:
        entry["recipe"] = _recipe_name(stage, recipes, base)
    return {**entry, **stage.options}


def _recipe_name(stage: BoundStage[Any, Any], recipes: dict[str, Any], base: str) -> Any:
    """The name of a recipe that a stage holds, which is put among `recipes`; a name or mapping of names as it is."""
    recipe = stage.recipe
    if isinstance(recipe, (str, Mapping)):
        return recipe
    free = (base if number == 1 else f"{base}{number}" for number in itertools.count(1))
    name = next(name for name in free if name not in recipes)
    recipes[name] = []  # taken before those inside of it
    recipes[name] = entries_of(cast("Sequence[Any]", recipe), recipes, base)
    return name


_MADE_BY = "_made_by"


def _is_open(value: Any) -> bool:
    """Whether a parameter stands for an option, or for a part of it."""
    if isinstance(value, BoundStage):
        return value.is_open
    if isinstance(value, Mapping):
        value = tuple(value.values())
    if isinstance(value, (list, tuple)):
        return any(map(_is_open, value))
    return isinstance(value, str) and _PLACEHOLDER in value


@dataclass(frozen=True)
class BoundStage(Generic[Takes, Makes]):
    """A step: a stage with its options set. It stands in recipes and pipelines, and runs when it is called.

    Type checkers know what it takes and makes: ``BoundStage[TunnelGraph, Microstructure]``.

    Attributes
    ----------
    name : str
    options : mapping of option name to value
    recipe : sequence of stages, name of a preset or of a recipe of the pipeline, or None
        What the stage repeats.
    id : str or None
        Its name in a pipeline.
    sources : str, sequence, mapping or None
        What it takes in a pipeline, as ``from`` in YAML.

    Examples
    --------
    >>> import sppm_pipeline as sppm
    >>> throw = sppm.sample.dart_throwing(count=9, spacing=0.2)
    >>> throw
    <step sample.dart_throwing(count=9, spacing=0.2)>
    >>> len(throw(seed=1).centers)
    9
    """

    name: str
    options: Mapping[str, Any] = dataclass_field(default_factory=dict)
    recipe: Sequence[Any] | Mapping[str, Any] | str | None = None
    id: str | None = None
    sources: str | Sequence[str] | Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        """Check the options, as far as they are known."""
        cls = registry().get(self.name)
        _check_recipe(self)
        if self.is_open:
            self._check_what_is_written(cls)
            return
        needed = [port for port in signature_of(cls).ports if not (port.is_recipe or port.optional)]
        # planned with stand-ins for the artifacts, so that wrong options are refused at once and not at the call
        self._plan({port.place(0) if port.many else port.name: port.types for port in needed})

    @property
    def is_open(self) -> bool:
        """Whether parameters, or recipes that only a pipeline knows, stand in it or in its recipe."""
        named = isinstance(self.recipe, Mapping) or (
            isinstance(self.recipe, str) and self.recipe not in registry().presets
        )
        return named or _is_open(self.options) or _is_open(self.recipe)

    def _check_what_is_written(self, cls: type[Stage]) -> None:
        where = f"sppm.{self.name}"
        root = compose({"options": dict(self.options)}, where)
        given: dict[str, Entry] = root.value["options"].node.value
        (given, _), problems = with_current_names(cls, given, stage=self.name)
        put = {name for name, entry in given.items() if _is_open(self.options.get(name, entry.node.value))}
        known = {name: entry for name, entry in given.items() if name not in put or name not in options_of(cls)}
        _, unfit = parse_options(cls, known, root.where, lambda _: Path.cwd(), stage=self.name)
        # what a parameter stands for is not missing
        missing = tuple(f"the option {name!r} is missing" for name in put)
        raise_problems([*problems, *(one for one in unfit if not one.message.startswith(missing or "\0"))])

    def __repr__(self) -> str:
        words = [f"{key}={value!r}" for key, value in (("id", self.id), *self.options.items()) if value is not None]
        if self.recipe is not None:
            words.append("recipe=" + (repr(self.recipe) if isinstance(self.recipe, str) else "[...]"))
        return f"<step {self.name}({', '.join(words)})>"

    if not TYPE_CHECKING:  # to type checkers it would promise every name

        def __getattr__(self, name: str) -> Any:
            message = f"a step has no attribute {name!r}"
            if not name.startswith("_"):
                message = (
                    f"{self.name}(...) is a step and has not run, so that it has no {name!r}; {self._how_to_run()}"
                )
            raise AttributeError(message)

    def _how_to_run(self) -> str:
        ports = signature_of(registry().get(self.name)).ports
        needed = [port.name for port in ports if not (port.is_recipe or port.optional)]
        return f"call it with {', '.join(needed)}" if needed else f"give it a seed: sppm.{self.name}(..., seed=1)"

    def __call__(
        self,
        *artifacts: Takes,
        seed: int | None = None,
        threads: int | None = None,
        output: str | Path = ".",
        **ports: Takes,
    ) -> Makes:
        """Run the stage.

        Parameters
        ----------
        *artifacts, **ports
            What the stage takes, each in the first port that its type fits, or by the name of the port. A port that
            takes many takes all that fit, or a sequence.
        seed : int, optional
            Needed where random numbers are drawn.
        threads : int, optional
            As many as there are processors if omitted; no result depends on it.
        output : str or Path
            Folder of the files that the stage writes.

        Returns
        -------
        object
            What the stage makes; the paths that it has written, or else the numbers that it reports, if it makes
            nothing.

        Raises
        ------
        SppmError
            As in a pipeline.
        """
        made, entry = self._run(self._by_port(artifacts, ports), seed, threads, Path(output))
        if made is None:
            made = [Path(output, out["path"]) for out in entry["outputs"]] if "outputs" in entry else entry["summary"]
        elif not artifacts and not ports and seed is None and isinstance(made, Artifact):
            with contextlib.suppress(AttributeError):  # of a class with slots
                object.__setattr__(made, _MADE_BY, self)
        return cast("Makes", made)

    def report(
        self, *artifacts: Any, seed: int | None = None, threads: int | None = None, **ports: Any
    ) -> dict[str, Any]:
        """Run the stage and return the numbers that a run record holds of it, instead of what it makes."""
        numbers: dict[str, Any] = self._run(self._by_port(artifacts, ports), seed, threads, None)[1]["summary"]
        return numbers

    def _by_port(self, artifacts: Sequence[Any], named: Mapping[str, Any]) -> dict[str, Any]:
        """The artifacts by the names of their ports, those of a port that takes many by their places."""
        ports = [port for port in signature_of(registry().get(self.name)).ports if not port.is_recipe]
        taken: dict[str, list[Any]] = {}
        for name, given in named.items():
            port = next((port for port in ports if port.name == name), None)
            if port is None:
                hint = did_you_mean(name, [port.name for port in ports]) if ports else "it takes no artifacts"
                raise WiringError(f"{self.name} has no port {name!r}", hint=hint)
            if given is not None:
                taken[name] = list(given) if port.many and isinstance(given, (list, tuple)) else [given]
                for artifact in taken[name]:
                    if not fits((type(artifact),), port):
                        raise _unfit(self.name, artifact, [port])
        for artifact in artifacts:
            if isinstance(artifact, BoundStage):
                raise WiringError(
                    f"{self.name} takes artifacts, and {artifact.name}(...) has not run", hint=artifact._how_to_run()
                )
            # a port given by name takes no artifact by type
            left = [port for port in ports if port.name not in named and (port.many or port.name not in taken)]
            # in the order of the signature, so that two artifacts of a type go to the first and the second port
            fitting = [port for port in left if fits((type(artifact),), port)]
            if not fitting:
                raise _unfit(self.name, artifact, left)
            taken.setdefault(fitting[0].name, []).append(artifact)
        for port in ports:
            if not port.optional and not taken.get(port.name):
                raise WiringError(f"{self.name} needs {port_words(port)} for the port {port.name!r}")
        return {
            port.place(number) if port.many else port.name: artifact
            for port in ports
            for number, artifact in enumerate(taken.get(port.name, ()))
        }

    def _plan(self, available: Mapping[str, tuple[type, ...]]) -> Plan:
        """A plan of this stage alone."""
        entry: dict[str, Any] = {"stage": self.name, **self.options}
        if available:
            sources: dict[str, Any] = {}
            entry["from"] = sources
            for place in available:
                port, bracket, _ = place.partition("[")
                if bracket:
                    sources.setdefault(port, []).append(place)
                else:
                    sources[port] = place
        document: dict[str, Any] = {"sppm": FORMAT, "pipeline": [entry]}
        if self.recipe is not None:
            recipes: dict[str, Any] = {}
            entry["recipe"] = _recipe_name(self, recipes, RECIPE)
            document |= {"recipes": recipes} if recipes else {}
        # stands where messages have the file
        where = f"sppm.{self.name}"
        configuration, _ = parse_configuration(compose(document, where), Path(where), Path.cwd())
        return make_plan(configuration, registry(), available=available)

    def _run(
        self, inputs: Mapping[str, Any], seed: int | None, threads: int | None, output: Path | None
    ) -> tuple[Any, dict[str, Any]]:
        plan = self._plan({port: (type(artifact),) for port, artifact in inputs.items()})
        monitor = WarningMonitor()
        for message in plan.warnings:
            monitor.warning(None, message)
        (step,) = plan.steps
        # a stage that writes nothing needs no run directory
        writes = output is not None and any(option.spec.output for option in options_of(type(step.stage)).values())
        # beside the target, so that moving is renaming and not copying
        with _scratch(output if writes else None) as scratch:
            runs = RunFolder(Path(scratch) / "run") if writes else None
            if runs is not None:
                runs.prepare()
            try:
                runner = StepRunner(
                    steps=plan.steps,
                    recipes=plan.recipes,
                    # no default seed: two calls would silently draw the same numbers
                    seed=MissingSeed() if seed is None else checked_seed(seed),
                    threads=available_threads() if threads is None else counted("threads", threads),
                    folder=runs or Scratch(Path(scratch)),
                    monitor=monitor,
                    observers=Observers([], [], lambda message: monitor.warning(None, message)),
                    available=inputs,
                    keep={step.id},
                )
                runner.run()
                (entry,) = runner.entries
                if runs is not None and output is not None:
                    _move([out["path"] for out in entry.get("outputs", ())], runs.path, output)
                return runner.result(step.id), entry
            finally:
                if runs is not None:
                    runs.discard()


def _check_recipe(step: BoundStage[Any, Any]) -> None:
    recipe = step.recipe
    if (
        recipe is None
        or isinstance(recipe, (str, list, tuple))
        or (isinstance(recipe, Mapping) and "stage" not in recipe)
    ):
        return
    if isinstance(recipe, (Mapping, BoundStage, Artifact)) or not isinstance(recipe, Iterable):
        raise ConfigError(
            f"the recipe of {step.name} must be a list of stages, got one {type(recipe).__name__}",
            hint="recipe=[sppm.FAMILY.NAME(...), ...], or the name of a preset",
        )


def _unfit(stage: str, artifact: Any, ports: Sequence[Port]) -> WiringError:
    wanted = "; ".join(f"{port.name} takes {port_words(port)}" for port in ports) or "nothing is left to give"
    hint = None
    if not isinstance(artifact, Artifact):
        made = next((t.__name__ for port in ports for t in port.types if hasattr(t, "from_array")), None)
        option = next(iter(options_of(registry().get(stage))), None)
        if hasattr(artifact, "__array__") and made:
            hint = f"sppm.{made}.from_array(...) makes one of an array"
        elif option:
            hint = f"options are given by name, for example {option}=..."
    return WiringError(f"{stage} can't take {type(artifact).__name__}: {wanted}", hint=hint)


def counted(name: str, value: Any) -> int:
    """A number of threads or jobs, within the bounds of the command line."""
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 4096:
        raise ConfigError(f"`{name}` is an integer, at least 1, at most 4096, got {shown(value)}")
    return value


def _scratch(beside: Path | None) -> AbstractContextManager[str]:
    """A folder that is gone at the end, on the file system of the results."""
    if beside is None:
        return tempfile.TemporaryDirectory(prefix="sppm-")
    beside.mkdir(parents=True, exist_ok=True)
    return tempfile.TemporaryDirectory(prefix=".sppm-", dir=beside)


def _move(names: Sequence[str], source: Path, target: Path) -> None:
    """Put outputs into place; files replace earlier ones, folders are never written into."""
    for name in names:
        if (target / name).is_dir():
            raise ConfigError(
                f"there is a folder {str(target / name)!r} already", hint="remove it, or give another `path`"
            )
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.move(source / name, target / name)
