"""Plugins that are a single Python file: imported once for each content, and the stages that it defines."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
import threading
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, TypeGuard

from sppm_pipeline.errors import PluginError, harmless, text_of

if TYPE_CHECKING:
    from sppm_pipeline.stage import Stage

_IMPORTING = threading.Lock()

_SINGLE = "sppm_plugin_"
"""Prefix of the names of modules that are single files."""


def import_file(path: Path) -> ModuleType:
    """Import a single file under a name of its own, once for each content; runs of a sweep may ask at the same time."""
    if not path.is_file():
        raise PluginError(f"there is no plugin file {str(path)!r}")
    digest = hashlib.sha256(str(path.resolve()).encode() + b"\0" + path.read_bytes()).hexdigest()[:16]
    name = f"{_SINGLE}{path.stem}_{digest}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise PluginError(f"a plugin file must end in .py, got {str(path)!r}")
    with _IMPORTING:
        if name in sys.modules:
            return sys.modules[name]
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # dataclasses look their module up there
        try:
            spec.loader.exec_module(module)
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
