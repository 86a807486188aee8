"""Pipelines as values: built in Python or read from YAML, varied, run in memory, and saved."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.api.bound_stage import counted, entries_of
from sppm_pipeline.engine.api.monitor import WarningMonitor
from sppm_pipeline.engine.api.run import Run
from sppm_pipeline.engine.cache.housekeeping import cache_folder
from sppm_pipeline.engine.config.configuration import FORMAT, checked_seed
from sppm_pipeline.engine.config.document import parse_yaml, plain, read_yaml
from sppm_pipeline.engine.config.options import options_of, plain_option
from sppm_pipeline.engine.config.parameters import Overrides
from sppm_pipeline.engine.config.problems import shown
from sppm_pipeline.engine.plan.checking import checked
from sppm_pipeline.engine.plan.plugins import REGISTERED, allowed_plugins
from sppm_pipeline.engine.plan.session import RunRequest, Session, find_configuration, open_session
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.engine.run.outputs import RECORD
from sppm_pipeline.engine.run.runner import available_threads
from sppm_pipeline.errors import ConfigError, InputError, listed
from sppm_pipeline.nouns.artifact import escaped
from sppm_pipeline.nouns.table import Table


class Pipeline:
    """A design: stages with options, in order. A value; what changes it makes another one.

    Parameters
    ----------
    stages : sequence of stages, or str or Path
        A file, the name of a packaged example or YAML, as `from_yaml` takes it; or a list of steps, objects of
        subclasses of `Stage`, names, or mappings as in YAML. Steps may hold their recipes.
    recipes : mapping of name to sequence of stages, or to ``{"preset": NAME, ...}``, optional
        Lists of stages that others repeat.
    params : mapping of name to value, optional
        Values that stand in for ``"${name}"``.
    name : str
    seed : int
        Where all random numbers come from.
    plugins : sequence of paths, optional
        Python files with further stages.
    """

    _request: RunRequest

    def __init__(
        self,
        stages: Sequence[Any] | str | Path,
        *,
        recipes: Mapping[str, Sequence[Any] | Mapping[str, Any]] | None = None,
        params: Mapping[str, Any] | None = None,
        name: str = "pipeline",
        seed: int = 0,
        plugins: Sequence[str | Path] = (),
    ) -> None:
        if isinstance(stages, (str, Path)):
            if recipes or params or plugins or name != "pipeline" or seed:
                raise ConfigError(
                    f"{str(stages)!r} names its own recipes, parameters, seed and plugins",
                    hint="change them with `Pipeline(...).with_(...)`, or pass a list of stages",
                )
            self._request = Pipeline.from_yaml(stages)._request
            return
        document: dict[str, Any] = {"sppm": FORMAT, "name": name, "seed": seed}
        if params:
            document["params"] = dict(params)
        if plugins:
            document["plugins"] = [str(path) for path in plugins]
        # their names are taken before those of recipes inside of stages are chosen
        lists: dict[str, Any] = dict.fromkeys(recipes or {})
        for key, group in (recipes or {}).items():
            lists[key] = dict(group) if isinstance(group, Mapping) else entries_of(group, lists, key)
        entries = entries_of(stages, lists)
        if lists:
            document["recipes"] = lists
        document["pipeline"] = entries
        allowed = allowed_plugins()
        # a caller who names files in Python runs code anyway
        self._request = RunRequest(name, document=document, folder=os.getcwd(), allowed=allowed, trusted=True)

    @classmethod
    def from_yaml(cls, source: str | Path) -> Pipeline:
        """A pipeline from a file, the name of a packaged example, or YAML itself.

        Parameters
        ----------
        source : str or Path
            A string with a line break is YAML; ``run.json`` of an earlier run is a file, too.

        Raises
        ------
        ConfigError
            If there is no such file.
        """
        if isinstance(source, str) and "\n" in source:
            return cls._of(RunRequest("pipeline", text=source, folder=os.getcwd(), allowed=allowed_plugins()))
        return cls._of(RunRequest(str(find_configuration(str(source))), allowed=allowed_plugins()))

    @classmethod
    def _of(cls, request: RunRequest) -> Pipeline:
        # past `__init__`, which takes stages
        made = cls.__new__(cls)
        made._request = request
        return made

    def with_(
        self,
        params: Mapping[str, Any] | None = None,
        /,
        *,
        set: Mapping[str, Any] | None = None,
        seed: int | None = None,
        **more: Any,
    ) -> Pipeline:
        """The same pipeline with other parameters, options or another seed.

        Parameters
        ----------
        params, **more
            Values of parameters by name.
        set : mapping of "stage.option" to value, optional
            As ``--set`` of the command line.
        seed : int, optional
        """
        given = {**(params or {}), **more}
        before = self._request.overrides
        # as arguments of the command line, so that both are read, checked and reported alike
        overrides = Overrides(
            (*_without(before.params, given), *_arguments(given)),
            (*_without(before.options, set or {}), *_arguments(set or {})),
            before.seed if seed is None else checked_seed(seed),
        )
        return self._of(replace(self._request, overrides=overrides))

    def sweep(self, rows: Sequence[Mapping[str, Any]] | None = None, /, **axes: Iterable[Any]) -> Pipeline:
        """The same pipeline, to be run once for each combination of values.

        Parameters
        ----------
        rows : sequence of mappings, optional
            Instead of axes: parameters (or ``seed``) of each run.
        **axes
            Values of parameters, or of ``seed``; the last one changes fastest.
        """
        if (rows is None) == (not axes):
            raise ConfigError("a sweep takes either rows or axes", hint="sweep(seed=range(8)), or sweep([{'seed': 1}])")
        for name, values in axes.items():
            if isinstance(values, str) or not isinstance(values, Iterable):
                raise ConfigError(
                    f"a sweep varies {name!r} over a list of values, got {shown(values)}",
                    hint=f"sweep({name}=[{shown(values)}]), or run(...) with one value",
                )
        sweep: Any = [dict(row) for row in rows] if rows is not None else {k: list(v) for k, v in axes.items()}
        file = Path(self._request.file)
        document = self._request.document
        if document is None:
            text = self._request.text
            document = plain(parse_yaml(text, self._request.file) if text is not None else read_yaml(file))
            # as a file that names no design is called
            document.setdefault("name", file.stem)
        folder = self._request.folder or str(file.absolute().parent)
        return self._of(replace(self._request, text=None, document={**document, "sweep": sweep}, folder=folder))

    def check(self) -> tuple[str, ...]:
        """Check options and wiring of all stages without running any.

        Returns
        -------
        tuple of str
            Warnings.

        Raises
        ------
        ConfigError
            All that is wrong, with its place.
        ResourceError
            If the run can't fit into memory or onto the disk.
        """
        return checked(self._session).plan.warnings

    def to_yaml(self, *, defaults: bool = False) -> str:
        """The pipeline as YAML, parameters and options put in; read again it gives the same results.

        Parameters
        ----------
        defaults : bool
            Whether options are written that have their default value.
        """
        from ruamel.yaml import YAML

        plan = checked(self._session, inputs=False, folder=None).plan
        document = dict(plan.document)
        steps = [step for group in (plan.steps, plan.after, *plan.recipes.values()) for step in group]
        if own := sorted({step.stage.name for step in steps if step.owner.name == REGISTERED.name}):
            WarningMonitor().warning(
                None,
                f"{listed(own, 'and')} is known to this process alone: put the class into a file and name it under "
                "`plugins`, so that others can run this",
            )
        # what starts here needs no folder, and can be moved
        if document["folder"] == os.getcwd():
            del document["folder"]
        if not defaults:
            document["pipeline"] = _brief(document["pipeline"], plan.steps)
            if "recipes" in document:
                document["recipes"] = {
                    name: _brief(entries, plan.recipes[name]) for name, entries in document["recipes"].items()
                }
            if "after" in document:
                document["after"] = _brief(document["after"], plan.after)
        text, yaml = io.StringIO(), YAML()
        yaml.default_flow_style = None
        yaml.width = 110
        yaml.dump(document, text)
        return text.getvalue()

    def run(
        self,
        output: str | Path | None = None,
        *,
        params: Mapping[str, Any] | None = None,
        set: Mapping[str, Any] | None = None,
        seed: int | None = None,
        threads: int | None = None,
        jobs: int = 1,
        until: str | None = None,
        cache: bool | str | Path = True,
    ) -> Run:
        """Run the pipeline, or each row of its sweep.

        Parameters
        ----------
        output : str or Path, optional
            The run directory; if omitted, nothing is written, and stages that only write are left out.
        params, set, seed
            What `with_` changes before the run.
        threads : int, optional
            As many as there are processors if omitted; no result depends on it.
        jobs : int
            Rows of a sweep that run at the same time.
        until : str, optional
            Id of the last stage to run.
        cache : bool, str or Path
            Where results are kept between runs: True for where the command line keeps them, False for nowhere.

        Raises
        ------
        SppmError
            What stopped the run; in a sweep, what is wrong before the first row runs.
        """
        if params or set or seed is not None:
            changed = self.with_(params, set=set, seed=seed)
            return changed.run(output, threads=threads, jobs=jobs, until=until, cache=cache)
        threads = available_threads() if threads is None else counted("threads", threads)
        plan, rows, _ = checked(self._session, until, folder=Path(output or "."), jobs=counted("jobs", jobs))
        run = Run(self._session, plan, until=until, threads=threads, cache=_cache_folder(cache))
        if rows:
            run._run_rows(rows, jobs)
        else:
            run._run()
        if output is not None:
            run.save(output, jobs=jobs)
        return run

    @cached_property
    def _session(self) -> Session:
        return open_session(self._request)

    def __repr__(self) -> str:
        return f"<Pipeline {self._request.file}>"

    def _repr_html_(self) -> str:
        # cut, as a pipeline may hold long lists
        return f"<pre>{escaped(self.to_yaml(), 60_000)}</pre>"


def pipeline_of(config: Pipeline | str | Path | Mapping[str, Any]) -> Pipeline:
    """A pipeline from whatever may stand for one: a file, YAML, or a configuration as a mapping."""
    if isinstance(config, Pipeline):
        return config
    if isinstance(config, Mapping):
        name = str(config.get("name", "pipeline"))
        request = RunRequest(name, document=config, folder=os.getcwd(), allowed=allowed_plugins())
        return Pipeline._of(request)
    return Pipeline.from_yaml(config)


def run(
    config: Pipeline | str | Path | Mapping[str, Any],
    params: Mapping[str, Any] | None = None,
    set: Mapping[str, Any] | None = None,
    output: str | Path | None = None,
    *,
    seed: int | None = None,
    threads: int | None = None,
    jobs: int = 1,
    until: str | None = None,
    cache: bool | str | Path = True,
) -> Run:
    """Run a configuration, as ``sppm run`` does.

    Parameters
    ----------
    config : str, Path, mapping or Pipeline
        A file, the name of a packaged example, YAML, a configuration as a mapping, or a pipeline.
    params, set, output, seed, threads, jobs, until, cache
        As for `Pipeline.run`.
    """
    return pipeline_of(config).run(
        output, params=params, set=set, seed=seed, threads=threads, jobs=jobs, until=until, cache=cache
    )


def load(path: str | Path, *, cache: bool | str | Path = True) -> Run:
    """The run in a run directory: its record and numbers; artifacts come from the cache, or are made again.

    Raises
    ------
    InputError
        If the folder holds no run.
    """
    # the record holds the configuration with all values, so that it can be run as a file
    file = Path(path) / RECORD
    try:
        record = json.loads(file.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(f"{str(path)!r} holds no run", hint=f"a run directory has a file {RECORD}") from error
    pipeline = Pipeline._of(RunRequest(str(file), allowed=allowed_plugins()))
    plan, rows, _ = checked(pipeline._session, folder=None)
    run = Run(
        pipeline._session, plan, until=record.get("until"), threads=available_threads(), cache=_cache_folder(cache)
    )
    run.record = record
    if rows:
        run.table = Table(json.loads((Path(path) / "sweep.json").read_bytes())["columns"])
    return run


def _cache_folder(cache: bool | str | Path) -> Path | None:
    if isinstance(cache, bool):
        return cache_folder() if cache else None
    return cache_folder(Path(cache))


def _arguments(values: Mapping[str, Any]) -> Iterable[str]:
    """Values as the arguments of ``-p`` and ``-s``; JSON is YAML."""
    return [f"{name}={json.dumps(_plain(value), allow_nan=False)}" for name, value in values.items()]


def _plain(value: Any) -> Any:
    # numpy's scalars and arrays
    value = plain_option(value.tolist() if hasattr(value, "tolist") else value)
    return [_plain(item) for item in value] if isinstance(value, list) else value


def _without(arguments: Iterable[str], names: Mapping[str, Any]) -> Iterable[str]:
    return [text for text in arguments if text.partition("=")[0] not in names]


def _brief(entries: Sequence[Any], steps: Sequence[Step]) -> list[Any]:
    """Entries without what is as it would be if nothing was written."""
    brief = []
    for entry, step in zip(entries, steps, strict=True):
        defaults = {name: plain_option(option.default) for name, option in options_of(type(step.stage)).items()}
        short = {k: v for k, v in entry.items() if not (k in defaults and v == defaults[k])}
        # that is the id that it gets without one
        if short.get("id") == short["stage"]:
            del short["id"]
        brief.append(short)
    return brief
