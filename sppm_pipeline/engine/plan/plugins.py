"""Finding plugins: built-in stages, installed distributions and single Python files, each apart from the others."""

from __future__ import annotations

import hashlib
import importlib
import importlib.machinery
import importlib.util
import inspect
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Any, TypeGuard

import pluggy

import sppm_pipeline
from sppm_pipeline import hookspecs
from sppm_pipeline.built_in import BUILTINS
from sppm_pipeline.engine.config.problems import shown
from sppm_pipeline.engine.plan import installed
from sppm_pipeline.engine.plan.installed import normal
from sppm_pipeline.engine.process.containment import guarded
from sppm_pipeline.errors import ConfigError, PluginError, SppmError, described, did_you_mean, harmless, listed, text_of
from sppm_pipeline.nouns.viewers import Viewer, add_viewers

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace
    from concurrent.futures import Executor

    from sppm_pipeline.stage import Stage, StageAlias

ALLOWED = "SPPM_PLUGINS"
"""Environment variable with the plugins that may be imported, separated by commas."""

API_CONSTANT = "SPPM_API_VERSION"
"""Name under which the module of a plugin may say which version of the interface it was written for."""


def allowed_plugins(names: str | None = None) -> tuple[str, ...] | None:
    """Installed plugins that may be imported: those of `names`, else of the environment; None for all."""
    names = os.environ.get(ALLOWED) if names is None else names
    return None if names is None else tuple(name for part in names.split(",") if (name := part.strip()))


@dataclass
class Plugin:
    """A source of stages, executors and verbs."""

    name: str  # module, entry point or file
    distribution: str | None = None  # of an installed distribution
    version: str | None = None
    target: str | None = None  # what its entry point names: "module" or "module:attribute"
    builtin: bool = False
    error: PluginError | None = None  # why it could not be loaded
    module: object | None = None  # what was loaded
    stages: dict[str, type[Stage] | str] = field(default_factory=dict)  # class or "module:Class" by stage name
    # current name or StageAlias by former stage name
    aliases: dict[str, str | StageAlias] = field(default_factory=dict)
    # functions of the number of workers, and of the place where they are
    executors: dict[str, Callable[..., Executor]] = field(default_factory=dict)
    commands: dict[str, hookspecs.Command] = field(default_factory=dict)  # by verb
    presets: dict[str, hookspecs.Preset] = field(default_factory=dict)
    finders: dict[str, Any] = field(default_factory=dict)
    viewers: dict[str, Viewer] = field(default_factory=dict)  # by "module:Class" of what is shown

    def __str__(self) -> str:
        if self.builtin:
            return "sppm itself"
        if self.distribution:
            return f"{self.distribution} {self.version} (plugin {self.name!r})"
        return f"the plugin {self.name}"


@dataclass
class Plugins:
    """All plugins, those that failed included, in the order of loading."""

    plugins: list[Plugin]
    disabled: bool = False

    def failed(self) -> list[Plugin]:
        """Plugins that could not be loaded."""
        return [plugin for plugin in self.plugins if plugin.error is not None]

    def single_files(self) -> list[ModuleType]:
        """The modules of plugins that are single files, as they were loaded; the files may have been edited since."""
        modules = [plugin.module for plugin in self.plugins if not plugin.builtin and plugin.distribution is None]
        return [module for module in modules if is_single_file(module)]

    def raise_broken(self) -> None:
        """Raise the first error that must not be passed over: a broken contract, or a file the user named.

        A distribution that merely fails to import does not count: it is listed, and the rest goes on.
        """
        for plugin in self.plugins:
            if plugin.error is not None and (plugin.distribution is None or isinstance(plugin.error, BrokenContract)):
                raise plugin.error


REGISTERED = Plugin("registered in this process")
"""The stages of classes that Python has registered, as a notebook does; see `register_stage`."""


def register_stage(cls: type[Stage]) -> str:
    """Have a class of stages loaded beside all plugins from now on, in this process; its name."""
    name = getattr(cls, "name", None)
    if not isinstance(name, str):
        raise PluginError(
            f"{cls!r:.80} can't be registered: it has no name", hint='write name: ClassVar[str] = "family.name"'
        )
    REGISTERED.stages[name] = cls
    return name


class BrokenContract(PluginError):
    """A plugin was loaded but does not keep to the hooks."""


def installed_plugins(allowed: Iterable[str] | None = None) -> Iterator[tuple[Plugin, Callable[[], Any]]]:
    """Plugins of installed distributions as their metadata describe them, each with what imports it; `allowed` are
    names of distributions or of entry points.
    """
    wanted = None if allowed is None else {normal(name) for name in allowed}
    # the order of the file system would decide otherwise who comes first
    for entry in sorted(installed.entry_points(hookspecs.PROJECT), key=lambda e: e.name):
        found = entry.dist
        plugin = Plugin(
            entry.name,
            found.name if found else "unknown",
            (found.version if found else None) or "of no version",
            getattr(entry, "value", None),
        )
        if wanted is None or {normal(entry.name), normal(plugin.distribution or "")} & wanted:
            yield plugin, entry.load


def load_plugins(
    builtins: Sequence[str] = BUILTINS,
    *,
    files: Iterable[Path] = (),
    distributions: bool = True,
    allowed: Sequence[str] | None = None,
) -> Plugins:
    """Load every plugin in its own try: modules with the built-in hook implementations, installed distributions (entry
    points of the group ``sppm``), and single Python files.

    Of distributions only those `allowed` are imported, by their name or that of an entry point; `ConfigError` if one is
    not installed.
    """
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    result: list[Plugin] = []
    for module in builtins:
        plugin = Plugin(module, builtin=True)
        result.append(plugin)
        _attempt(manager, plugin, lambda module=module: importlib.import_module(module))  # type: ignore[misc]
    if distributions:
        if allowed is not None:
            _refuse_unknown(allowed)
        for plugin, load in installed_plugins(allowed):
            result.append(plugin)
            _attempt(manager, plugin, load)
    seen = set()
    for path in files:
        if path.resolve() not in seen:
            seen.add(path.resolve())
            plugin = Plugin(str(path))
            result.append(plugin)
            _attempt(manager, plugin, lambda path=path: import_file(path))  # type: ignore[misc]
    if REGISTERED.stages:
        # a copy, as a name that is taken is removed from it
        result.append(Plugin(REGISTERED.name, stages=dict(REGISTERED.stages)))
    _refuse_duplicates(result)
    for plugin in result:
        if plugin.viewers:
            add_viewers(plugin.viewers)
    return Plugins(result, disabled=not distributions)


def _refuse_unknown(allowed: Sequence[str]) -> None:
    known = {name for plugin, _ in installed_plugins() for name in (plugin.name, plugin.distribution or "")}
    for name in allowed:
        if normal(name) not in {normal(other) for other in known}:
            raise ConfigError(
                f"--allow-plugins: no installed plugin is called {shown(name)}", hint=did_you_mean(name, known)
            )


def _attempt(manager: pluggy.PluginManager, plugin: Plugin, load: Callable[[], Any]) -> None:
    """Load one plugin and ask it for its stages; a failure is kept in `plugin.error`."""

    def fault(message: str) -> PluginError:
        return PluginError(f"{plugin} can't be loaded: its import {message}")

    try:
        with guarded(f"the import of {plugin}", fault, builtin=plugin.builtin):
            module = load()
    except PluginError as error:
        plugin.error = error
        return
    except Exception as error:
        plugin.error = PluginError(f"{plugin} can't be loaded: {first_line(error)}", hint=missing_module(error))
        plugin.error.__cause__ = error
        return
    written_for = getattr(module, API_CONSTANT, sppm_pipeline.API)
    if written_for != sppm_pipeline.API:
        plugin.error = BrokenContract(
            f"{plugin} was written for version {shown(written_for)} of the interface, this program has version "
            f"{sppm_pipeline.API}",
            hint="install the version of the plugin for this program, or leave it out with --allow-plugins",
        )
        return
    try:
        manager.register(module, plugin.name)
        # a misspelled hook would be ignored without a word
        manager.check_pending()
        plugin.module = module
    except (pluggy.PluginValidationError, ValueError) as error:
        if manager.has_plugin(plugin.name):
            manager.unregister(name=plugin.name)
        plugin.error = BrokenContract(f"{plugin}: {' '.join(str(error).split())}", hint=_hook_hint(module))
        return
    try:
        for hook, found, is_valid, expected in _SUPPLIED:
            for implementation in getattr(manager.hook, hook).get_hookimpls():
                if implementation.plugin_name == plugin.name:
                    fault_of_hook = lambda message, hook=hook: BrokenContract(f"{plugin}: {hook} {message}")  # noqa: E731
                    with guarded(f"{hook} of {plugin}", fault_of_hook, builtin=plugin.builtin):
                        supplied = implementation.function()
                    if not isinstance(supplied, Mapping) or not all(isinstance(name, str) for name in supplied):
                        raise BrokenContract(f"{plugin}: {hook} must return a map of names, got {supplied!r:.80}")
                    if wrong := [name for name, value in supplied.items() if not is_valid(value)]:
                        raise BrokenContract(f"{plugin}: {hook} must name {expected}, which {listed(wrong)} is not")
                    getattr(plugin, found).update(supplied)
    except PluginError as error:
        plugin.error = error
    except Exception as error:
        plugin.error = BrokenContract(f"{plugin}: {hook} raised {described(error)}")
        plugin.error.__cause__ = error
    if isinstance(module, ModuleType) and not plugin.builtin and plugin.distribution is None:
        for cls in stage_classes(module):
            # those that a hook names keep the name that it gives
            if cls not in plugin.stages.values():
                plugin.stages[cls.name] = cls


def _is_alias(value: Any) -> bool:
    from sppm_pipeline.stage import StageAlias

    return isinstance(value, (str, StageAlias))


_SUPPLIED: tuple[tuple[str, str, Callable[[Any], bool], str], ...] = (
    ("sppm_stages", "stages", lambda value: callable(value) or isinstance(value, str), "classes or 'module:Class'"),
    ("sppm_stage_aliases", "aliases", _is_alias, "stages or a StageAlias"),
    ("sppm_executors", "executors", callable, "functions"),
    ("sppm_commands", "commands", lambda value: isinstance(value, hookspecs.Command), "a Command"),
    ("sppm_presets", "presets", lambda value: isinstance(value, hookspecs.Preset), "a Preset"),
    ("sppm_design_finders", "finders", lambda value: callable(value) or isinstance(value, str), "functions"),
    ("sppm_live_views", "viewers", lambda value: isinstance(value, Viewer), "a Viewer"),
)
"""Hooks that return a map of names: where the map goes in `Plugin`, what its values may be, and that in words."""


def imported(plugin: Plugin, what: str, target: Any, *, whole: bool = False) -> Any:
    """An object that a plugin supplies as ``"module:attribute"``, or if `whole` a module, imported; others as is."""
    if not isinstance(target, str):
        return target
    module, colon, attribute = target.partition(":")
    if not (colon or whole):
        raise PluginError(f"{plugin}: {what} must be given as 'module:name', got {target!r}")

    def fault(message: str) -> PluginError:
        return PluginError(f"{plugin}: {what} can't be imported: the import {message}")

    try:
        with guarded(f"the import of {what} of {plugin}", fault, builtin=plugin.builtin):
            found = importlib.import_module(module)
            return getattr(found, attribute) if colon else found
    except PluginError:
        raise
    except Exception as error:
        raise PluginError(
            f"{plugin}: {what} can't be imported: {described(error)}", hint=missing_module(error)
        ) from error


def ready_command(
    verb: str, plugin: Plugin, command: hookspecs.Command
) -> tuple[Callable[[ArgumentParser], None], Callable[[Namespace], int]]:
    """The two functions of a plugin's verb; what they raise that is not for the user names the plugin."""

    def call(what: str, target: Any, argument: Any) -> Any:
        function = imported(plugin, f"{what} of the verb {verb!r}", target)
        try:
            return function(argument)
        except SppmError:
            raise
        except Exception as error:
            raise PluginError(f"{plugin}: the verb {verb!r} raised {described(error)}") from error

    def execute(args: Namespace) -> int:
        code = call("execute", command.execute, args)
        if not isinstance(code, int):
            raise PluginError(f"{plugin}: the verb {verb!r} must return an exit code, got {shown(code)}")
        return code

    return lambda parser: call("configure", command.configure, parser), execute


def _refuse_duplicates(plugins: list[Plugin]) -> None:
    """Two plugins that supply the same name: the later one is at fault, both are named."""
    # former names of stages are of one kind with names, as they must not hide stages
    for words, *kinds in (
        ("stage", "stages", "aliases"),
        ("executor", "executors"),
        ("verb", "commands"),
        ("preset", "presets"),
    ):
        owners: dict[str, Plugin] = {}
        for kind, plugin in ((kind, plugin) for kind in kinds for plugin in plugins):
            for name in list(getattr(plugin, kind)):
                if name in owners:
                    del getattr(plugin, kind)[name]
                    plugin.error = plugin.error or BrokenContract(
                        f"the {words} {name!r} comes from {owners[name]} and from {plugin}",
                        hint="rename one, or remove one of the plugins",
                    )
                owners.setdefault(name, plugin)


def _hook_hint(module: Any) -> str | None:
    """Hint for a misspelt hook."""
    known = [name for name in vars(hookspecs) if name.startswith("sppm_")]
    for name in vars(module) if hasattr(module, "__dict__") else ():
        if name.startswith("sppm_") and name not in known:
            return did_you_mean(name, known)
    return None


_IMPORTING = threading.Lock()

_SINGLE = "sppm_plugin_"
"""Prefix of the names of modules that are single files."""


class _AsItIs(importlib.machinery.SourceFileLoader):
    """Runs what a file says now: bytecode that was kept counts as that of a file changed within the same second."""

    def get_code(self, fullname: str) -> CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


def import_file(path: Path) -> ModuleType:
    """Import a single file under a name of its own, once for each content; runs of a sweep may ask at the same time."""
    if not path.is_file():
        raise PluginError(f"there is no plugin file {str(path)!r}")
    digest = hashlib.sha256(str(path.resolve()).encode() + b"\0" + path.read_bytes()).hexdigest()[:16]
    name = f"{_SINGLE}{path.stem}_{digest}"
    if path.suffix != ".py":
        raise PluginError(f"a plugin file must end in .py, got {str(path)!r}")
    loader = _AsItIs(name, str(path))
    spec = importlib.machinery.ModuleSpec(name, loader, origin=str(path))
    spec.has_location = True
    with _IMPORTING:
        if name in sys.modules:
            return sys.modules[name]
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # dataclasses look their module up there
        try:
            loader.exec_module(module)
        except BaseException as error:
            del sys.modules[name]
            if not isinstance(error, Exception):
                raise
            line = _line_in(error, path)
            raise PluginError(
                f"the plugin {path}{line} can't be loaded: {first_line(error)}",
                hint=missing_module(error),
            ) from error
    return module


def _line_in(error: Exception, path: Path) -> str:
    """``:12`` for the last line of `path` that the error passed through."""
    if isinstance(error, SyntaxError):
        return f":{error.lineno}"
    trace, line = error.__traceback__, ""
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = f":{trace.tb_lineno}"
        trace = trace.tb_next
    return line


def is_single_file(module: object) -> TypeGuard[ModuleType]:
    """True if this is a module that `import_file` has imported."""
    return isinstance(module, ModuleType) and module.__name__.startswith(_SINGLE)


def stage_classes(module: ModuleType) -> list[type[Stage]]:
    """Complete stages that a file defines itself."""
    from sppm_pipeline.stage import Stage

    return [
        cls
        for cls in vars(module).values()
        if inspect.isclass(cls)
        and issubclass(cls, Stage)
        and cls.__module__ == module.__name__
        and not inspect.isabstract(cls)
        and isinstance(getattr(cls, "name", None), str)
    ]


def incomplete_stages(module: ModuleType) -> list[str]:
    """Messages on classes of a file that lack something to be stages; bases of complete stages are left out."""
    from sppm_pipeline.stage import Stage

    found = []
    for cls in vars(module).values():
        if not (inspect.isclass(cls) and issubclass(cls, Stage) and cls.__module__ == module.__name__):
            continue
        if any(issubclass(complete, cls) for complete in stage_classes(module)):
            continue
        lacking = [f"the method `{name}`" for name in sorted(getattr(cls, "__abstractmethods__", ()))]
        if not isinstance(getattr(cls, "name", None), str):
            lacking.insert(0, '`name: ClassVar[str] = "family.word"`')
        if lacking:
            found.append(f"{cls.__name__} in {module.__file__} is no stage yet: it lacks {' and '.join(lacking)}")
    return found


def missing_module(error: Exception) -> str | None:
    """The hint that names a module that is not installed, if that is why an import failed."""
    if isinstance(error, ModuleNotFoundError) and error.name:
        return f"the module {error.name!r} is not installed"
    return None


def first_line(error: Exception) -> str:
    """The type of an error and the first line of what it says."""
    line = next((line.strip() for line in text_of(error).splitlines() if line.strip()), "")
    kind = harmless(type(error).__name__)
    return f"{kind}: {line}" if line else kind
