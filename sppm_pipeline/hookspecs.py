"""The hooks through which stages and executors reach the program; built-in ones come through the same hooks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import pluggy

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from sppm_pipeline.stage import Stage, StageAlias

PROJECT = "sppm"
"""Name of the pluggy project; entry points of distributions stand in the group ``sppm``."""

API_VERSION = 1
"""Version of these hooks and of `sppm_pipeline.stage`; raised when a change breaks plugins.

The module of a plugin may hold ``SPPM_API_VERSION = 1``; it is then refused by a program with another version.
"""

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def sppm_stages() -> Mapping[str, type[Stage] | str]:  # type: ignore[empty-body]
    """Supply stages.

    Called once, when the program needs to know the stages there are. Returns a mapping from the stage's name
    (``family.name``) to its class, or to ``"module:Class"``, which is imported only when somebody uses the stage.
    An empty mapping means: no stages. Example::

        @hookimpl
        def sppm_stages():
            return {"sample.fcc": "sppm_fcc.sampler:FaceCenteredCubic"}
    """


@hookspec
def sppm_stage_aliases() -> Mapping[str, str | StageAlias]:  # type: ignore[empty-body]
    """Supply former names of stages, so that configurations written before a stage was renamed still run.

    Called once, together with `sppm_stages`. Returns a mapping from the former name to the current one, or to a
    `StageAlias` with the options that the former name implied. Whoever uses a former name is told the current one in a
    warning; lists and references show current names only. An empty mapping means: nothing was renamed. Example::

        @hookimpl
        def sppm_stage_aliases():
            return {"sample.fcc_lattice": "sample.fcc"}
    """


@hookspec
def sppm_executors() -> Mapping[str, Callable[[int], Executor]]:  # type: ignore[empty-body]
    """Supply executors for sweeps.

    Called once, when ``--executor NAME`` is resolved. Returns a mapping from the name to a function that takes the
    number of workers and returns a `concurrent.futures.Executor`; tasks and results are picklable. Example::

        @hookimpl
        def sppm_executors():
            return {"cluster": lambda workers: ClusterExecutor(max_workers=workers)}
    """
