"""Everything needed to plan and run a configuration, from values that can be sent to another process."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from sppm_pipeline.built_in import BUILTINS
from sppm_pipeline.engine.config.configuration import Configuration, parse_configuration
from sppm_pipeline.engine.config.document import Entry, compose, parse_yaml, read_yaml, yaml_text
from sppm_pipeline.engine.config.parameters import Overrides, sweep_rows, without_fixed_axes
from sppm_pipeline.engine.config.problems import Problems
from sppm_pipeline.engine.files import packaged_folder, write_whole
from sppm_pipeline.engine.plan.planning import Plan, make_plan
from sppm_pipeline.engine.plan.plugins import Plugins, load_plugins
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.errors import ConfigError, did_you_mean, listed


def find_configuration(name: str) -> Path:
    """A file by its path, or a packaged example by its name; `ConfigError` if there is neither."""
    path = Path(name)
    if path.exists():
        return path
    examples = packaged_configurations()
    if name in examples:
        return examples[name]
    hint = did_you_mean(name, examples) if path.name == name and not path.suffix else None
    if hint is None:
        siblings = [p.name for p in path.parent.glob("*") if p.suffix in (".yaml", ".yml", ".json")]
        hint = did_you_mean(path.name, siblings) if siblings else None
    raise ConfigError(f"there is no configuration {name!r}", hint=hint)


def packaged_configurations() -> dict[str, Path]:
    """Configurations and examples that come with the program, by name."""
    home = packaged_folder()
    return {file.stem: file for folder in ("examples", "configs") for file in (home / folder).glob("*.yaml")}


Row = Mapping[str, Entry]
"""Values of a row of a sweep, by parameter."""


@dataclass(frozen=True)
class RunRequest:
    """A configuration to run and how to run it, in plain picklable values."""

    file: str  # with `text` or `document`, the name by which messages and the run record call it
    builtins: tuple[str, ...] = BUILTINS  # modules with the built-in hook implementations
    plugins: tuple[str, ...] = ()  # Python files with further stages
    distributions: bool = True  # whether installed plugins, and those the configuration names, are loaded
    overrides: Overrides = field(default_factory=Overrides)
    # installed plugins that may be imported, by distribution or entry point; all if None
    allowed: tuple[str, ...] | None = None
    text: str | None = None  # the configuration itself as YAML, instead of a file
    # the configuration as plain Python values; see `compose`
    document: Mapping[str, Any] | None = field(default=None, hash=False)
    folder: str | None = None  # where relative paths in `text` or `document` start; the current folder if None
    trusted: bool = False  # whether the user has agreed to run whatever Python files the configuration names

    def absolute(self) -> RunRequest:
        """The same for another process in another folder: the text of the configuration, which keeps its name."""
        # a worker can't ask the user, and runs what was agreed to here
        plugins = tuple(str(Path(path).absolute()) for path in self.plugins)
        if self.text is None and self.document is None:
            # the text travels, as the file may be changed or out of reach there
            text, folder = yaml_text(Path(self.file)), Path(self.file).parent
            return replace(self, plugins=plugins, text=text, folder=os.path.abspath(folder), trusted=True)
        return replace(self, plugins=plugins, folder=os.path.abspath(self.folder or "."), trusted=True)

    def read(self) -> tuple[Configuration, Problems]:
        """The configuration that is asked for, without the sweep axes that overrides fix, and what is wrong with it."""
        path, folder = Path(self.file), Path(self.folder or ".")
        if self.document is not None:
            root = compose(self.document, self.file)
        elif self.text is not None:
            root = parse_yaml(self.text, self.file)
        else:
            # the folder of a record is relative to it, and a link must not stand in the way from one to the other
            root, folder = read_yaml(path), path.parent.resolve() if path.suffix == ".json" else path.parent
        configuration, problems = parse_configuration(root, path, folder)
        return without_fixed_axes(configuration, self.overrides), problems


@dataclass(frozen=True)
class Session:
    """A configuration that was read, with the plugins it needs."""

    request: RunRequest
    configuration: Configuration
    plugins: Plugins
    registry: Registry
    # errors of the top level that do not keep the rest from being looked at
    unread: Problems = field(default_factory=list)

    def plan(self, row: Row | None = None) -> Plan:
        """Plan the run, or one row of its sweep; raises all that is wrong."""
        return make_plan(self.configuration, self.registry, self.request.overrides, row, unread=self.unread)

    @cached_property
    def rows(self) -> Sequence[Row]:
        """Rows of the sweep, laid out once whatever their number; none of a single run. Raises as `sweep_rows` does."""
        sweep = self.configuration.sweep
        return [] if sweep is None else sweep_rows(sweep, self.configuration.params)


def open_session(request: RunRequest) -> Session:
    """Read the configuration and load the plugins.

    Raises `UntrustedError` if the configuration names Python files that the user has not agreed to run: neither as
    `RunRequest.trusted` and `RunRequest.plugins` say nor by name in `RunRequest.allowed`, nor by `trust.trust`.
    """
    configuration, unread = request.read()
    files = [Path(path) for path in request.plugins]
    if request.distributions:
        named = [path for path in configuration.plugins if request.allowed is None or path.name in request.allowed]
        agreed = request.trusted or request.allowed is not None
        # naming a file on the command line is agreement
        given = {path.resolve() for path in files}
        if not agreed and (unknown := untrusted(path for path in named if path.resolve() not in given)):
            raise UntrustedError(unknown)
        files += named
    # single files are no distributions, and were taken above
    names = None if request.allowed is None else [name for name in request.allowed if not name.endswith(".py")]
    plugins = load_plugins(request.builtins, files=files, distributions=request.distributions, allowed=names)
    plugins.raise_broken()
    return Session(request, configuration, plugins, Registry(plugins), unread)


FOLDERS = "SPPM_TRUST"
"""Environment variable with folders, separated as in PATH, whose Python files may run."""

_PACKAGE = Path(__file__).resolve().parents[2]
_OWN = (_PACKAGE / "examples", _PACKAGE / "configs", _PACKAGE.parent / "examples", _PACKAGE.parent / "configs")
"""Folders of the examples of this program: in a wheel within the package, in a checkout beside it."""


class UntrustedError(ConfigError):
    """A configuration names Python files that the user has not agreed to.

    A configuration may come from anybody, and `sppm check` of it would run the files that it names, with all rights of
    the user. So such a file is imported only if the user has agreed to it: its content is remembered by digest, so that
    a copy elsewhere is trusted and an edit is not. Files of one's own are trusted as they are in the folders that
    `SPPM_TRUST` names.
    """

    def __init__(self, files: Sequence[Path]) -> None:
        names = listed(map(str, files))
        super().__init__(
            f"the configuration names Python code that has not run for you before, or was changed since: {names}",
            hint="read it, then `sppm check FILE --trust` remembers that you trust it; "
            f"files of your own are trusted in the folders that {FOLDERS} names; --no-plugins goes on without it",
        )
        self.files = tuple(files)


def untrusted(files: Iterable[Path]) -> list[Path]:
    """Those that may not run yet; what is not there is left for the import to refuse."""
    files = [path for path in files if path.is_file() and not _in_trusted_folder(path)]
    known = _remembered() if files else set()
    return [path for path in files if _digest(path) not in known]


def trust(files: Iterable[Path]) -> None:
    """Remember the content of files, which may run from now on; `OSError` or `ResourceError` if it can't be kept."""
    known = _remembered() | {_digest(path) for path in files}
    folder = _state_folder()
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    write_whole(folder / "trusted.json", json.dumps({"sha256": sorted(known)}, indent=1), mode=0o600)


def _in_trusted_folder(path: Path) -> bool:
    named = [Path(name).expanduser() for name in os.environ.get(FOLDERS, "").split(os.pathsep) if name]
    place = path.resolve()
    # an installed program trusts its examples; a folder that others can write to is the user's own decision
    return any(place.is_relative_to(folder.resolve()) for folder in (*_OWN, *named))


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _remembered() -> set[str]:
    """Digests that were trusted; none if the file is not the user's own, as another user may have written them."""
    file = _state_folder() / "trusted.json"
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError), file.open(encoding="utf-8") as opened:
        if not hasattr(os, "getuid") or os.fstat(opened.fileno()).st_uid == os.getuid():
            return set(json.load(opened)["sha256"])
    return set()


def _state_folder() -> Path:
    """Folder in which programs keep their state of a user."""
    if sys.platform == "win32":
        root = os.environ.get("LOCALAPPDATA")
    else:
        root = os.environ.get("XDG_STATE_HOME")
    return Path(root) / "sppm" if root else Path.home() / ".local" / "state" / "sppm"
