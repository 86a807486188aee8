"""``sppm``: finds the verb, runs it, and turns whatever happens into a message and an exit code."""

from __future__ import annotations

import atexit
import contextlib
import gc
import io
import os
import signal
import sys
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from sppm_pipeline.errors import SppmError

EXIT_CODES = """\
exit codes: 0 done; 1 unexpected; 2 configuration or command line wrong; 3 input or design can't be satisfied;
4 a plugin failed; 5 disk, memory or a permission is missing; 6 a native library crashed; 129, 130, 143 interrupted"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code; never raises and, without ``--debug``, prints no traceback."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a character that a terminal can't show is no reason to fail
            stream.reconfigure(errors="backslashreplace")
    try:
        code = _dispatch(words)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except BrokenPipeError:
        _close_stdout()
        return 0  # the reader of our results has seen enough; nothing failed here
    except KeyboardInterrupt as error:
        _say_exit_message(words)
        # as shells report the signal; SIGINT is 2
        return 128 + getattr(error, "number", 2)
    except Exception as error:
        return _reported(error, "--debug" in words)


def leave() -> None:
    """Run the command line and end the process; what the console script calls.

    Taking down compiled kernels and their compiler in order takes a fifth of a second, for nothing: all files are
    closed and all threads have ended. So the exit handlers run, the streams are flushed, and the process is left.
    """
    # Nothing has begun that would have to be put in order: an interrupt ends the program without a traceback.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Imports make a hundred thousand objects that live to the end; looking through them again and again costs 50 ms.
    gc.set_threshold(200_000, 50, 100)
    # NumPy's BLAS has its threads look for work for a twentieth of a second from the import on, and after each product,
    # before they sleep; here they sleep at once. Results stay the same.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    if sys.argv[1:] and (sys.argv[1] not in _ALONE or "--all" in sys.argv):
        try:
            from sppm_pipeline.engine.process.supervision import supervised

            code = supervised(_whole, _say, _exit_message(sys.argv[1:]), _mark_ended)
        except Exception as error:  # no second process, or not the descriptors to talk to it
            code = _reported(error, "--debug" in sys.argv)
        # without taking interpreter and compiler down, see above
        os._exit(code)
    os._exit(_whole())


_ALONE = ("-h", "--help", "help", "-V", "--version", "cache", "verify")
"""First words of command lines that run no code of plugins, which may hang or crash, and need no supervisor."""


def _whole() -> int:
    """`main`, exit handlers and all."""
    from sppm_pipeline.engine.process.activity import Activity, doing
    from sppm_pipeline.engine.process.containment import import_seconds

    code = main()
    with doing(Activity("an exit handler of a plugin or a library", False, kind="exit"), import_seconds()):
        # `os._exit` skips them, and plugins may flush files there
        atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
    return code


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help", "help"):
        print(_usage(plugins="--all" in words[1:]), end="")
        return 0
    if words[0] in ("-V", "--version"):
        import sppm_pipeline

        print(f"sppm {sppm_pipeline.__version__}")
        return 0
    verb = words[0]
    import argparse

    # a plugin can't replace a built-in verb, and none is imported for one
    command = _built_in(verb) or _of_plugin(verb, words)
    parser = argparse.ArgumentParser(
        # one parser for the verb that is used: those of all would import all features
        prog=f"sppm {verb}",
        description=command.help[0].upper() + command.help[1:] + ".",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        # an abbreviation that works today would become ambiguous with the next option
        allow_abbrev=False,
    )
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    command.configure(parser)
    try:
        parsed = parser.parse_args(words[1:])
    except SystemExit as exit:
        # argparse has printed help or error itself
        return exit.code if isinstance(exit.code, int) else 2
    if verb == "run":
        from sppm_pipeline.engine.process.resident import share_one_heap

        share_one_heap()
    from sppm_pipeline.engine.process.interruption import interruptibly

    return interruptibly(lambda: int(command.execute(parsed)), lambda: _say_exit_message(words))


class _Verb(NamedTuple):
    """A verb that is ready to be used."""

    help: str
    configure: Callable[[argparse.ArgumentParser], None]
    execute: Callable[[argparse.Namespace], int]


def _built_in(verb: str) -> _Verb | None:
    """A verb of the engine, or else of a feature, whose modules are looked through then only."""
    import importlib

    from sppm_pipeline.engine.cli.commands import VERBS, built_in_commands, place_of

    if verb in VERBS:
        words, places = VERBS[verb], place_of(verb)
    elif (found := built_in_commands().get(verb)) is None:
        return None
    else:
        words, places = found.help, (str(found.configure), str(found.execute))
    configure, execute = (
        getattr(importlib.import_module(module), function)
        for module, _, function in (place.partition(":") for place in places)
    )
    return _Verb(words, configure, execute)


_MEANT = {
    "init": "`sppm new pipeline NAME` writes a first configuration",
    "list": "`sppm stages` lists the stages, `sppm printers` the printers",
    "slice": "slicing is a stage of a configuration: `sppm stages slice`; `sppm run FILE` runs it",
    "mesh": "meshes are made by stages of a configuration: `sppm stages extract`; `sppm run FILE` runs them",
}
"""Verbs of other programs -> what to write here."""


def _of_plugin(verb: str, words: list[str]) -> _Verb:
    """A verb from a plugin; plugins are loaded only for a verb that is not built in."""
    from sppm_pipeline.engine.cli.arguments import commands_of_plugins
    from sppm_pipeline.engine.cli.commands import built_in_commands
    from sppm_pipeline.engine.plan.plugins import ready_command
    from sppm_pipeline.errors import ConfigError, meant, near_names

    commands, failed = commands_of_plugins(load="--no-plugins" not in words)
    if verb not in commands:
        near = near_names(verb, [*built_in_commands(), *commands])
        hints = [meant(near) if near else "`sppm --help` lists them"]
        hints = [_MEANT[verb]] if verb in _MEANT else hints
        hints += [f"{plugin} could not be loaded and may supply it" for plugin in failed]
        raise ConfigError(f"there is no verb {verb!r}", hint="; ".join(hints))
    return _Verb(commands[verb][1].help, *ready_command(verb, *commands[verb]))


def _usage(*, plugins: bool = False) -> str:
    from sppm_pipeline.engine.cli.commands import built_in_commands

    lines = [
        "usage: sppm VERB [options]",
        "",
        "Design, verify, simulate and print stochastic porous microstructures.",
        "",
    ]
    lines += [f"  {verb:10s} {command.help}" for verb, command in built_in_commands().items()]
    if plugins:
        from sppm_pipeline.engine.cli.arguments import commands_of_plugins

        commands, _ = commands_of_plugins()
        lines += ["", "verbs of plugins:" if commands else "no plugin supplies a verb"]
        lines += [f"  {verb:10s} {command.help}  [{plugin}]" for verb, (plugin, command) in sorted(commands.items())]
    lines += ["", "`sppm VERB --help` shows the options of a verb, `sppm help --all` the verbs of plugins as well."]
    return "\n".join([*lines, EXIT_CODES]) + "\n"


def _reported(error: Exception, debug: bool) -> int:
    """Report an error, even if the modules that report can't be loaded any more; its exit code."""
    try:
        return _report(error, debug)
    except (OSError, ImportError, MemoryError):
        from sppm_pipeline.errors import described

        reason = error.strerror if isinstance(error, OSError) else None
        _say(reason or described(error))
        return 5


def _report(error: Exception, debug: bool) -> int:
    from sppm_pipeline.errors import ConfigErrors, SppmError, described

    if debug:
        _print_chain(error)
    if isinstance(error, ConfigErrors):
        _say(f"{len(error.errors)} errors\n{error}")
        return error.exit_code
    if isinstance(error, SppmError):
        _say(str(error))
        return error.exit_code
    if isinstance(error, OSError):
        name = f": {error.filename!r}" if error.filename is not None else ""
        _say(f"{error.strerror or error}{name}")
        return 5
    from sppm_pipeline.engine.process.budget import exhausted_resource

    if (missing := exhausted_resource(error)) is not None:
        _say(missing)
        return 5
    _say(f"internal error: {described(error)}\n  hint: run again with --debug to see where")
    return 1


def _print_chain(error: BaseException) -> None:
    import traceback

    trace: TracebackType | None = error.__traceback__
    traceback.print_exception(type(error), error, trace)


def _exit_message(words: list[str]) -> str:
    """That the work has ended early, and of a run how to go on with it."""
    if words[:1] == ["studio"]:
        return "the studio has ended"
    kept = words[:1] == ["run"] and "--no-cache" not in words and os.environ.get("SPPM_CACHE", "").lower() != "off"
    return "interrupted" + ("; the same command again goes on with the stages that had ended" if kept else "")


def _say_exit_message(words: list[str]) -> None:
    supervision = sys.modules.get("sppm_pipeline.engine.process.supervision")
    if supervision is None or not supervision.is_supervised():  # the parent says it, whatever becomes of this process
        _say(_exit_message(words))


def _mark_ended(folder: Path, status: str, error: SppmError | None) -> None:
    """Put a run directory in order whose process was ended."""
    from sppm_pipeline.engine.run.record import mark_ended

    mark_ended(folder, status, error)


def _say(message: str) -> None:
    """Write to stderr; if it was closed, have the supervisor do so."""
    from sppm_pipeline.errors import harmless

    try:
        print(f"sppm: {harmless(message)}", file=sys.stderr)
    except (OSError, ValueError):
        from sppm_pipeline.engine.process.activity import leave_message

        leave_message(message)


def _close_stdout() -> None:
    """Point stdout at nothing, so that Python does not complain when it ends."""
    import os

    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    leave()
