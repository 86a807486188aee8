"""The stages that Python knows: those of the program, of plugins, and classes that this process has registered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar, cast

from sppm_pipeline.engine.plan.plugins import REGISTERED, allowed_plugins, load_plugins, register_stage
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.errors import PluginError
from sppm_pipeline.stage import Stage

_LOADED: list[tuple[object, Registry]] = []


def registry() -> Registry:
    """All stages of the program, of installed plugins, and those that this process has registered."""
    known = tuple(REGISTERED.stages.items())
    if not _LOADED or _LOADED[0][0] != known:
        plugins = load_plugins(distributions=True, allowed=allowed_plugins())
        plugins.raise_broken()
        _LOADED[:] = [(known, Registry(plugins))]
    return _LOADED[0][1]


C = TypeVar("C", bound=type[Stage])


def register(cls: C) -> C:
    """Make a class of stages known to this process: its function is there at once, and recipes may name it.

    It is made a frozen, keyword-only dataclass if it is none. Objects of a class that is one can stand in recipes and
    pipelines without this. What a notebook defines is not kept between runs, as no file says what it does; a class
    registered again replaces the earlier one.

    Parameters
    ----------
    cls : subclass of Stage

    Returns
    -------
    type
        `cls`, so that this can decorate it.

    Raises
    ------
    PluginError
        If the class breaks the contract of stages, or another plugin supplies one of this name.

    Examples
    --------
    >>> import sppm_pipeline as sppm
    >>> @sppm.register
    ... class Grid(sppm.Sampler):
    ...     "Pores on a grid."
    ...     name = "sample.grid_of_eight"
    ...     def throw(self, rng, box):
    ...         import numpy as np
    ...         return (np.indices((2, 2, 2)).reshape(3, -1).T + 0.5) / 2
    >>> len(sppm.sample.grid_of_eight(seed=1).centers)
    8
    """
    if isinstance(cls, type) and issubclass(cls, Stage) and not is_dataclass_itself(cls):
        cls = cast("C", dataclass(frozen=True, kw_only=True)(cls))
    before = REGISTERED.stages.get(getattr(cls, "name", ""))
    name = register_stage(cls)
    try:
        registry().get(name)
    except PluginError:
        del REGISTERED.stages[name]
        if before is not None:
            REGISTERED.stages[name] = before
        raise
    return cls


def is_dataclass_itself(cls: type) -> bool:
    """Whether the class is one itself, and not only its base."""
    return "__dataclass_fields__" in vars(cls)


def is_known(cls: type[Stage]) -> bool:
    known = registry()
    return cls.name in known and known.get(cls.name) is cls
