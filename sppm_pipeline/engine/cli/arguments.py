"""Arguments that several verbs share, and how they become a request to the engine."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sppm_pipeline.engine.plan.estimate import History
    from sppm_pipeline.engine.plan.plugins import Plugin, Plugins
    from sppm_pipeline.engine.plan.session import RunRequest, Session, UntrustedError
    from sppm_pipeline.hookspecs import Command


def add_plugins(parser: ArgumentParser) -> None:
    """Which plugins are loaded."""
    parser.add_argument("--plugin", action="append", default=[], metavar="FILE", help="a Python file with stages")
    parser.add_argument(
        "--allow-plugins",
        metavar="NAMES",
        default=None,
        help="import only these installed plugins, and Python files that the configuration names: names separated by "
        "commas, of distributions, entry points or files; from the environment variable SPPM_PLUGINS if omitted",
    )
    parser.add_argument(
        "--no-plugins", action="store_true", help="load neither installed plugins nor those the configuration names"
    )


def add_configuration(parser: ArgumentParser) -> None:
    """A configuration, its overrides and its plugins."""
    parser.add_argument("file", metavar="FILE", help="configuration, run.json of an earlier run, or name of an example")
    parser.add_argument("-p", "--param", action="append", default=[], metavar="NAME=VALUE", help="set a parameter")
    parser.add_argument(
        "-s", "--set", action="append", default=[], metavar="STAGE.OPTION=VALUE", help="set an option of a stage"
    )
    parser.add_argument("--seed", type=_seed, metavar="N", help="integer that all random numbers come from")
    add_plugins(parser)
    parser.add_argument(
        "--trust",
        action="store_true",
        help="run the Python files that the configuration names, now and from now on as long as they stay as they are",
    )


def _seed(text: str) -> int:
    """A seed; argparse turns the error into a message."""
    if not (text.isascii() and text.isdecimal() and len(text) <= 19) or int(text) >= 2**63:
        raise ValueError(text[:40])
    return int(text)


_seed.__name__ = "integer from 0 to 2^63 - 1"  # argparse shows it: "invalid integer ... value"


def request_from(args: Namespace) -> RunRequest:
    """The request that the arguments describe."""
    from sppm_pipeline.engine.config.parameters import Overrides
    from sppm_pipeline.engine.plan.plugins import allowed_plugins
    from sppm_pipeline.engine.plan.session import RunRequest, find_configuration

    return RunRequest(
        file=str(find_configuration(args.file)),
        plugins=tuple(args.plugin),
        distributions=not args.no_plugins,
        overrides=Overrides(tuple(args.param), tuple(args.set), args.seed),
        allowed=allowed_plugins(args.allow_plugins),
    )


def open_from(args: Namespace) -> Session:
    """Read the configuration and load the plugins; what has not run for this user before is asked for."""
    from sppm_pipeline.engine.plan.session import UntrustedError, open_session, trust
    from sppm_pipeline.errors import ResourceError

    request = request_from(args)
    try:
        session = open_session(request)
    except UntrustedError as error:
        if not (getattr(args, "trust", False) or _agreed(error)):
            raise
        try:
            trust(error.files)
        except (OSError, ResourceError) as unkept:
            print(f"sppm: warning: trust in plugins can't be remembered: {unkept}", file=sys.stderr)
        session = open_session(replace(request, trusted=True))
    warn_of_failed_plugins(session.plugins)
    return session


def _agreed(error: UntrustedError) -> bool:
    """Ask the user, if there is a terminal."""
    if not (sys.stdin and sys.stdin.isatty() and sys.stderr and sys.stderr.isatty()):
        return False
    print(f"sppm: {error.message}", file=sys.stderr)
    print("It runs with all your rights. Run it? [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def run_folder(args: Namespace, session: Session) -> Path:
    """The run directory that is asked for, else ``runs/<name>``."""
    return getattr(args, "output", None) or Path("runs") / session.configuration.name


def history_of_machine(args: Namespace) -> History:
    """Time and memory of runs with the same cache."""
    from sppm_pipeline.engine.cache.housekeeping import cache_folder, open_store
    from sppm_pipeline.engine.plan.estimate import history_of

    folder = cache_folder(getattr(args, "cache", None))
    return history_of(open_store(folder) if folder is not None and folder.is_dir() else None)


def add_cache(parser: ArgumentParser) -> None:
    """Arguments for the folder in which results are kept between runs."""
    parser.add_argument("--cache", type=Path, metavar="DIR", help="folder in which results are kept between runs")
    parser.add_argument("--no-cache", action="store_true", help="run every stage, and keep nothing")


def cache_of(args: Namespace) -> Path | None:
    """The folder that `add_cache` asks for; None for none."""
    from sppm_pipeline.engine.cache.housekeeping import cache_folder

    return None if args.no_cache else cache_folder(args.cache)


def plugins_from(args: Namespace, *, strict: bool = True) -> Plugins:
    """Plugins without a configuration; if `strict`, a broken contract raises."""
    from sppm_pipeline.engine.plan.plugins import allowed_plugins, load_plugins

    plugins = load_plugins(
        files=[Path(p) for p in args.plugin],
        distributions=not args.no_plugins,
        allowed=allowed_plugins(args.allow_plugins),
    )
    if strict:
        plugins.raise_broken()
        warn_of_failed_plugins(plugins)
    return plugins


def commands_of_plugins(*, load: bool = True) -> tuple[dict[str, tuple[Plugin, Command]], list[Plugin]]:
    """The verbs of installed plugins, each with its plugin, and the plugins that failed; `PluginError` if one breaks
    the contract, for instance by taking the name of a built-in verb.
    """
    from sppm_pipeline.engine.plan.plugins import allowed_plugins, load_plugins

    plugins = load_plugins(distributions=load, allowed=allowed_plugins())
    plugins.raise_broken()
    found = {
        verb: (plugin, command)
        for plugin in plugins.plugins
        if not plugin.builtin
        for verb, command in plugin.commands.items()
    }
    return found, plugins.failed()


def warn_of_failed_plugins(plugins: Plugins) -> None:
    """A line on stderr for each plugin that could not be loaded."""
    for plugin in plugins.failed():
        print(f"sppm: warning: {plugin.error}", file=sys.stderr)


_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0}
_NUMBER = re.compile(r"(\d{1,15}(?:\.\d{1,9})?)\s*([A-Za-z]*)")


def add_limits(parser: ArgumentParser) -> None:
    """Time of a stage, memory, and the contract mode."""
    parser.add_argument(
        "--stage-time",
        type=seconds,
        metavar="TIME",
        help="end the run if a stage takes longer, for instance 90, 10min or 2h; no limit if omitted",
    )
    parser.add_argument(
        "--memory",
        type=size,
        metavar="SIZE",
        help="memory that the run may take, for instance 2G: it is refused if the estimate is more, and ended when it "
        "takes more; what the machine has free if omitted",
    )
    parser.add_argument(
        "--contract",
        action="store_true",
        help="check after every stage that it left its inputs alone and made finite numbers, for authors of plugins",
    )


def size(text: str, thousand: int = 1024, least: int = 1) -> int:
    """Bytes from ``1.5G``, ``800 MB``, ``2GiB``; units are powers of 1024, or those without an i of `thousand`."""
    from sppm_pipeline.engine.cache.housekeeping import parse_size

    try:
        found = parse_size(text, thousand)
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from None
    if found < least:
        raise ArgumentTypeError(f"expected a size of {least} bytes or more, got {text!r}")
    return found


def seconds(text: str) -> float:
    """Seconds from ``90``, ``10min``, ``2h``."""
    found = _NUMBER.fullmatch(text.strip())
    if found is None or found[2] not in _SECONDS or not 0 < (value := float(found[1]) * _SECONDS[found[2]]) <= 1e8:
        raise ArgumentTypeError(f"expected a time such as 90, 10min or 2h, got {text[:40]!r}")
    return value


@contextlib.contextmanager
def limits_of(args: Namespace) -> Iterator[None]:
    """Put the limits into the environment, where stages of this and of worker processes find them."""
    from sppm_pipeline.engine.process.budget import MEMORY
    from sppm_pipeline.engine.process.containment import CONTRACT, STAGE_TIME, set_environment

    requested = {
        STAGE_TIME: repr(args.stage_time) if args.stage_time is not None else None,
        MEMORY: str(args.memory) if args.memory is not None else None,
        CONTRACT: "1" if args.contract else None,
    }
    before = {name: os.environ.get(name) for name in requested}
    os.environ.update({name: value for name, value in requested.items() if value is not None})
    try:
        yield
    finally:
        set_environment(before)
