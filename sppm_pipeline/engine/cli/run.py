"""``sppm run``: run a pipeline or a sweep into a run directory."""

from __future__ import annotations

import contextlib
import io
import math
import os
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.cli.arguments import (
    add_cache,
    add_configuration,
    add_limits,
    cache_of,
    history_of_machine,
    limits_of,
    open_from,
    run_folder,
    seconds,
)
from sppm_pipeline.errors import SppmError

if TYPE_CHECKING:
    from sppm_pipeline.engine.cli.progress import ProgressLines
    from sppm_pipeline.engine.plan.session import Session
    from sppm_pipeline.engine.plan.wiring import Step
    from sppm_pipeline.engine.run.crew import WorkerPool
    from sppm_pipeline.engine.run.executors import WorkerOptions
    from sppm_pipeline.stage import Headline


LINE = 100
"""Characters of a line of numbers, beside the stage and its time: with both, lines stay below the 120 columns of a
usual terminal."""


def configure_run(parser: ArgumentParser) -> None:
    add_configuration(parser)
    add_limits(parser)
    parser.add_argument(
        "--time-limit", type=seconds, metavar="TIME", help="end the run, whatever it is doing, after this time"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="run directory; runs/<name> if omitted")
    parser.add_argument("--until", metavar="ID", help="stop after this stage")
    parser.add_argument(
        "-j",
        "--jobs",
        type=_integer(1, 4096),
        default=1,
        metavar="N",
        help="runs of a sweep, or workers of a long single run",
    )
    parser.add_argument(
        "--threads", type=_integer(1, 4096), metavar="N", help="threads in all; the number of processors if omitted"
    )
    parser.add_argument("--executor", metavar="NAME[:WHERE]", help="serial, threads, processes, or one from a plugin")
    parser.add_argument(
        "--retries",
        type=_integer(0, 100),
        metavar="N",
        default=2,
        help="runs again of work whose worker died; 2 if omitted",
    )
    parser.add_argument(
        "--target",
        choices=("native",),
        help="compile kernels for this very processor: faster on some, with other last digits; x86-64-v3 if omitted",
    )
    parser.add_argument("--same-processor", action="store_true", help="refuse workers on another kind of processor")
    failing = parser.add_mutually_exclusive_group()
    failing.add_argument(
        "-k",
        "--keep-going",
        action="store_true",
        help="go on with the other runs of a sweep after one has failed, and exit with its code: what is done anyway",
    )
    failing.add_argument("--ignore-failed", action="store_true", help="exit with 0 though runs of a sweep failed")
    add_cache(parser)
    parser.add_argument(
        "--audit", choices=("fail", "warn"), help="what a contradiction of results does; as in the file"
    )
    parser.add_argument("-n", "--dry-run", action="store_true", help="check everything, run nothing")
    parser.add_argument(
        "-q",
        "--quiet",
        action="store_true",
        help="no progress, and nothing on stdout but what --json prints; warnings stay",
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="a line with date and time for each event")
    parser.add_argument("--log", type=Path, metavar="FILE", help="add these lines to a file")
    parser.add_argument("--json", action="store_true", help="print the run record as JSON")
    parser.add_argument("--report", action="store_true", help="write report.html as well, as `sppm report` does")
    parser.add_argument(
        "--bundle",
        type=Path,
        metavar="ZIP",
        help="write an RO-Crate of configuration, inputs and results, to run again",
    )


def _integer(low: int, high: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise ArgumentTypeError(f"expected an integer from {low} to {high}, got {text!r}")
        return int(text)

    return read


def execute_run(args: Namespace) -> int:
    """Run."""
    if args.target:
        from sppm_pipeline.services.jit.machine_code import use_native

        use_native()
    if args.time_limit is not None:
        from sppm_pipeline.engine.process.activity import limit_run

        limit_run(args.time_limit)
    if args.memory is not None:
        from sppm_pipeline.engine.process.activity import limit_memory

        limit_memory(args.memory)
    with limits_of(args):
        return _execute(args)


def _execute(args: Namespace) -> int:
    if args.dry_run:
        from sppm_pipeline.engine.cli.describe import execute_check

        return execute_check(args)
    from sppm_pipeline.engine.cache.housekeeping import open_store
    from sppm_pipeline.engine.cli.kernels import compile_first
    from sppm_pipeline.engine.config.problems import raise_problems
    from sppm_pipeline.engine.plan.checking import checked
    from sppm_pipeline.engine.plan.estimate import unfit_problems
    from sppm_pipeline.engine.run.crew import min_samples
    from sppm_pipeline.engine.run.events import breach_error
    from sppm_pipeline.engine.run.executors import WorkerOptions
    from sppm_pipeline.engine.run.runner import available_threads, run_plan

    session = open_from(args)
    path = run_folder(args, session)
    plan, rows, estimates = checked(session, args.until, folder=path, jobs=args.jobs, history=history_of_machine(args))
    cache = cache_of(args)
    threads = args.threads or available_threads()
    options = WorkerOptions(
        workers=args.jobs,
        executor=args.executor,
        threads=threads,
        cache=cache,
        retries=args.retries,
        same_processor=args.same_processor,
    )
    minimum = 0.0
    if args.jobs > 1 and not rows:
        minimum = min_samples(args.executor, estimates[0])
        if minimum < math.inf and options.name == "processes":
            raise_problems(unfit_problems(estimates, path, crew=args.jobs))
    stack = contextlib.ExitStack()
    monitor = _monitor(args, stack)
    kept = dict.fromkeys(_of_report("before_run")(plan)) if args.report and not rows else {}
    try:
        compile_first(plan, monitor, threads)
        if session.configuration.sweep is None:
            record = run_plan(
                plan,
                path,
                threads=threads,
                until=args.until,
                monitor=monitor,
                store=open_store(cache) if cache is not None else None,
                about=str(session.configuration.file.absolute()),
                crew=_crew(session, path, options, monitor, minimum),
                kept=kept,
            )
        else:
            from sppm_pipeline.engine.run.sweep import run_sweep

            record = run_sweep(
                session,
                plan,
                path,
                # a row that used up its time in this process would take the table of the others with it
                options if args.stage_time is None else replace(options, executor=options.executor or "processes"),
                until=args.until,
                monitor=monitor,
            )
    except Exception as error:
        if args.json and hasattr(error, "record"):
            _print_json(error.record)
        if args.report and hasattr(error, "record"):
            with contextlib.suppress(SppmError):  # what stopped the run is what has to be said
                _of_report("after_run")(path, args, kept)
        raise
    finally:
        stack.close()
    if args.report:
        _of_report("after_run")(path, args, kept)
    if args.bundle:
        from sppm_pipeline.engine.run.crate import write_crate

        write_crate(args.bundle, plan, path, record)
    if args.json:
        _print_json(record)
    elif args.quiet:
        for line in _failures(record):
            print(f"sppm: {line}", file=sys.stderr)
    else:
        _print_summary(record, path, {step.address: headlines_of(step) for step in (*plan.steps, *plan.after)})
    failed = [run for run in record.get("runs", ()) if run["status"] != "done"]
    if (
        (args.audit or plan.configuration.audit) == "fail"
        and not failed
        and (breach := breach_error(record)) is not None
    ):
        raise breach
    if failed and not args.ignore_failed:
        codes = {run["error"]["exit_code"] for run in failed}
        # runs that failed for different reasons have no code in common; 3 says that designs could not be made
        return codes.pop() if len(codes) == 1 else 3
    return 0


def _monitor(args: Namespace, stack: contextlib.ExitStack) -> ProgressLines:
    """The monitor that shows the run, closed by `stack`."""
    from sppm_pipeline.engine.cli.progress import ProgressLines
    from sppm_pipeline.services.jit.kernel_cache import on_first_compilation
    from sppm_pipeline.services.jit.machine_code import refused

    def told() -> None:
        for place, why in refused.items():
            monitor.note(f"{place} is not used, its kernels are compiled here: {why}")

    log = stack.enter_context(args.log.open("a", encoding="utf-8")) if args.log else None
    stream = sys.stderr or io.StringIO()  # there is none if it was closed
    monitor = ProgressLines(stream, verbose=args.verbose, quiet=args.quiet, log=log)
    stack.callback(monitor.close)
    stack.callback(told)
    on_first_compilation(lambda: monitor.note("compiling kernels (once, then cached)..."))
    return monitor


def _crew(
    session: Session, path: Path, options: WorkerOptions, monitor: ProgressLines, minimum: float
) -> WorkerPool | None:
    """The workers of a single run, if it is to have any; started when a stage asks for them."""
    if options.executor is None and options.workers == 1:
        return None
    from sppm_pipeline.engine.run.crew import WorkerPool
    from sppm_pipeline.engine.run.executors import require_executor

    require_executor(options.executor, options.workers, session.plugins)
    return WorkerPool(session.plugins, path, options, monitor=monitor, minimum=minimum) if options.apart else None


def _of_report(what: str) -> Any:
    """A function that the verb `report` has for ``sppm run --report``."""
    from sppm_pipeline.engine.cli import commands
    from sppm_pipeline.engine.plan.plugins import Plugin, imported

    verb = commands.built_in_commands()["report"]
    return imported(Plugin(commands.__name__, builtin=True), "the report", getattr(verb, what))


def _print_json(record: Mapping[str, Any]) -> None:
    from sppm_pipeline.engine.strict_json import json_text

    print(json_text(dict(record)), end="")


def _print_summary(
    record: Mapping[str, Any], path: Path, headlines: Mapping[str, Sequence[Headline]] | None = None
) -> None:
    """A line a stage with its numbers, a line for each failed run of a sweep, and where the files are.

    Stages that name their headline numbers show these, others the first five.
    """
    # a sweep without stages of `after` has none
    width = max((len(stage["id"]) for stage in record["stages"]), default=0)
    for stage in record["stages"]:
        shown = [
            text for one in (headlines or {}).get(stage["id"], ()) if (text := headline_text(one, stage["summary"]))
        ]
        numbers = (
            shown
            or [
                f"{name} {_number(value)}"
                for name, value in stage["summary"].items()
                if isinstance(value, (int, float)) and not isinstance(value, bool)
            ][:5]
        )
        time = "    kept  " if stage.get("cached") else f"{stage['seconds']:8.3f} s"
        print(f"{stage['id']:{width}s} {time}  {_wrapped(numbers, width + 13)}".rstrip())
    # the stream may never have been open; the variable is the convention of no-color.org
    color = sys.stdout is not None and sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    for line in audit_lines(record.get("audit"), color=color):
        print(line)
    for line in _failures(record):
        print(line)
    runs = record.get("runs", [])
    for run in runs:
        for text in run.get("breaches", ()):
            print(_red(f"run {run['run']}: audit: {text}", color))
    peak = f", peak memory {record['peak_memory_mb']:.0f} MB" if record["peak_memory_mb"] else ""
    done = f", {sum(run['status'] == 'done' for run in runs)} of {len(runs)} runs" if runs else ""
    print(f"{record['status']} in {record['seconds']:.2f} s{done}{peak}: {path}")


def _failures(record: Mapping[str, Any]) -> Iterator[str]:
    """A line for each failed run of a sweep."""
    for run in record.get("runs", ()):
        if run["error"]:
            values = ", ".join(f"{name}={value}" for name, value in run["params"].items())
            yield f"run {run['run']} ({values}) failed: {run['error']['message']}"


def audit_lines(audit: Mapping[str, Any] | None, *, color: bool) -> Iterator[str]:
    """The verdict of the audit in a line, and a red one for each contradiction."""
    if not audit or not audit["comparisons"]:
        return
    bad = [one["text"] for one in audit["comparisons"] if not one["holds"]]
    agree = len(audit["comparisons"]) - len(bad)
    yield f"audit: {audit['verdict']}, {agree} of {len(audit['comparisons'])} comparisons agree"
    for text in bad:
        yield _red(f"  {text}", color)


def _red(text: str, color: bool) -> str:
    return f"\x1b[31m{text}\x1b[0m" if color else text


def _wrapped(texts: Sequence[str], indent: int) -> str:
    """Texts one after the other, on as many lines as they need."""
    lines: list[str] = []
    for text in texts:
        if lines and len(lines[-1]) + len(text) < LINE:
            lines[-1] += f", {text}"
        else:
            lines.append(text)
    return f",\n{' ' * indent}".join(lines)


def headlines_of(step: Step) -> Sequence[Headline]:
    """The numbers that the terminal shows of a stage: those that it states, else those of the report that it makes."""
    from sppm_pipeline.nouns.report import Report

    made = (kind.headlines() for kind in step.makes if issubclass(kind, Report))
    return step.stage.headline or next(made, ())


def headline_text(headline: Headline, summary: Mapping[str, Any]) -> str:
    """A headline number as ``E 371 369 370 +- 4 MPa``; empty if the summary has it not.

    Lists, and numbers with an error bar, are shown to four digits, others to six.
    """
    value, error = _at(summary, headline.number), _at(summary, headline.error) if headline.error else None
    if value is None:
        return ""
    bars = [bar for bar in (error if isinstance(error, list) else [error]) if isinstance(bar, (int, float))]
    # a list has to fit a line, and an error bar makes further digits idle
    digits = 6 if isinstance(value, (int, float)) and not bars else 4
    if isinstance(value, Mapping):
        text = " ".join(f"{name} {_number(one, digits)}" for name, one in value.items())
    else:
        text = " ".join(_number(one, digits) for one in (value if isinstance(value, list) else [value]))
    bar = f" +- {max(bars):.2g}" if bars else ""
    unit = headline.unit.replace("{unit}", str(summary.get("unit") or ""))
    return f"{headline.label or headline.number} {text}{bar} {unit}".rstrip()


def _at(summary: Any, place: str) -> Any:
    """The entry of a summary at a place such as ``C.1.1``; None if there is none."""
    for part in place.split("."):
        if isinstance(summary, Mapping):
            summary = summary.get(part)
        elif isinstance(summary, list) and part.isdigit() and 0 < int(part) <= len(summary):
            summary = summary[int(part) - 1]
        else:
            return None
    return summary


def _number(value: Any, digits: int = 6) -> str:
    """A number to some digits; what is not defined as a dash."""
    return f"{value:.{digits}g}" if isinstance(value, float) else "-" if value is None else str(value)
