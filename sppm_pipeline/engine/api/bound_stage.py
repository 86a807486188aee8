"""A stage with its options set, which is called with artifacts: a plan of this stage alone, run in a folder apart."""

from __future__ import annotations

import shutil
import tempfile
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cache
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.config.configuration import FORMAT, parse_configuration
from sppm_pipeline.engine.config.document import compose
from sppm_pipeline.engine.config.options import options_of
from sppm_pipeline.engine.config.problems import did_you_mean
from sppm_pipeline.engine.plan.planning import Plan, make_plan
from sppm_pipeline.engine.plan.plugins import allowed_plugins, load_plugins
from sppm_pipeline.engine.plan.ports import Port, fits, port_words, signature_of
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.run.events import Monitor, Observers
from sppm_pipeline.engine.run.outputs import RunFolder, Scratch
from sppm_pipeline.engine.run.runner import StepRunner, available_threads
from sppm_pipeline.errors import ConfigError, WiringError

RECIPE = "recipe"
"""Name of the recipe that a call is given."""


class SppmWarning(UserWarning):
    """Something that does not stop a run, for instance tunnels that the resolution can't show."""


class WarningMonitor(Monitor):
    """Turns what a run warns of into Python's warnings."""

    def warning(self, stage: str | None, message: str) -> None:
        """See `Monitor.warning`."""
        warnings.warn(f"{stage}: {message}" if stage else message, SppmWarning, stacklevel=2)


class MissingSeed(int):
    """The seed of a call that was given none: drawing random numbers from it raises an error."""

    def __str__(self) -> str:
        raise ConfigError("this stage draws random numbers, but has no seed", hint="give a seed, for example seed=1")


@cache
def registry() -> Registry:
    """All stages of the program and of installed plugins."""
    plugins = load_plugins(distributions=True, allowed=allowed_plugins())
    plugins.raise_broken()
    return Registry(plugins)


def entry_of(stage: str | Mapping[str, Any] | BoundStage) -> str | dict[str, Any]:
    """A stage of a pipeline or recipe as a configuration holds it."""
    if isinstance(stage, BoundStage):
        if stage.recipe is not None:
            raise ConfigError(
                f"{stage.name} holds a recipe of its own", hint="name it: recipe='NAME' and recipes={'NAME': [...]}"
            )
        return {"stage": stage.name, **stage.options}
    return stage if isinstance(stage, str) else dict(stage)


@dataclass(frozen=True)
class BoundStage:
    """A stage with its options set; call it with artifacts.

    Attributes
    ----------
    name : str
    options : mapping of option name to value
    recipe : sequence of stages, name of a preset, or None
        What the stage repeats.
    """

    name: str
    options: Mapping[str, Any] = dataclass_field(default_factory=dict)
    recipe: Sequence[Any] | str | None = None

    def __post_init__(self) -> None:
        """Check the options, as they are known."""
        cls = registry().get(self.name)
        needed = [port for port in signature_of(cls).ports if not (port.is_recipe or port.optional)]
        # planned with stand-ins for the artifacts, so that wrong options are refused at once and not at the call
        self._plan({port.place(0) if port.many else port.name: port.types for port in needed})

    def __call__(
        self,
        *artifacts: Any,
        seed: int | None = None,
        threads: int | None = None,
        output: str | Path = ".",
        **ports: Any,
    ) -> Any:
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
        if made is not None:
            return made
        return [Path(output, out["path"]) for out in entry["outputs"]] if "outputs" in entry else entry["summary"]

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
        if isinstance(self.recipe, str):
            entry["recipe"] = self.recipe
        elif self.recipe is not None:
            if isinstance(self.recipe, (Mapping, BoundStage)) or not isinstance(self.recipe, Iterable):
                raise ConfigError(
                    f"the recipe of {self.name} must be a list of stages, got one {type(self.recipe).__name__}",
                    hint="recipe=[sppm.step.FAMILY.NAME(...), ...], or the name of a preset",
                )
            entry["recipe"] = RECIPE
            document["recipes"] = {RECIPE: [entry_of(stage) for stage in self.recipe]}
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
                    plan.steps,
                    plan.recipes,
                    # no default seed: two calls would silently draw the same numbers
                    seed=MissingSeed() if seed is None else seed,
                    threads=threads or available_threads(),
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


def _unfit(stage: str, artifact: Any, ports: Sequence[Port]) -> WiringError:
    wanted = "; ".join(f"{port.name} takes {port_words(port)}" for port in ports) or "nothing is left to give"
    return WiringError(f"{stage} can't take {type(artifact).__name__}: {wanted}")


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
