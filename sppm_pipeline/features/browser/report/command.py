"""``sppm report``: one HTML file that shows a run directory."""

from __future__ import annotations

import contextlib
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from sppm_pipeline.engine.config.names import REPORT

if TYPE_CHECKING:
    from sppm_pipeline.engine.plan.plugins import Plugins
    from sppm_pipeline.engine.plan.session import RunRequest


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    from sppm_pipeline.engine.cli.arguments import add_cache, add_plugins

    parser.add_argument("directory", type=Path, metavar="DIR", help="run directory")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="file to write; DIR/report.html if omitted")
    parser.add_argument(
        "--max-size", default="5MB", metavar="SIZE", help="what the file should not exceed; 5MB if omitted"
    )
    parser.add_argument(
        "--remake", action="store_true", help="run what the live view needs again if it is not in the cache"
    )
    parser.add_argument("--no-view", action="store_true", help="leave out the live view")
    parser.add_argument("--open", action="store_true", help="open the file in the browser")
    add_cache(parser)
    add_plugins(parser)


def execute(args: Namespace) -> int:
    """Make the report, and say where it is."""
    target = args.output or args.directory / REPORT
    make_report(args, target)
    print(f"{target}: {target.stat().st_size / 1e6:.2f} MB")
    if args.open:
        open_in_browser(target)
    return 0


def make_report(args: Namespace, target: Path) -> None:
    """Write the report of `args.directory`; `args` are those of `configure`."""
    from sppm_pipeline.engine.cache.housekeeping import parse_size
    from sppm_pipeline.errors import ConfigError

    try:
        most = parse_size(args.max_size)
    except ValueError as error:
        raise ConfigError(f"--max-size: {error}") from error
    if most < MIN_SIZE:
        raise ConfigError(
            f"--max-size is {args.max_size}; the page itself takes {MIN_SIZE // 1000} kB", hint="allow more"
        )
    # what the configuration names is loaded only to run something again: a report runs nothing that came with a run
    of_run(args.directory, target, args, most=most, view=not args.no_view, remake=args.remake, plugins=args.remake)


def after_run(path: Path, args: Namespace) -> None:
    """Write the report of a run that has just ended, with the plugins and the cache that it had."""
    of_run(path, path / REPORT, args)


def of_run(
    path: Path,
    target: Path,
    args: Namespace,
    *,
    most: int = 5_000_000,
    view: bool = True,
    remake: bool = False,
    plugins: bool = True,
) -> None:
    """Write the report of a run directory to `target`, of at most `most` bytes.

    `view` and `remake` say whether there is a live view, and whether stages are run again for it. What shows results
    is loaded from plugins that are installed or named in `args` (`add_cache`, `add_plugins`); from those that the
    configuration names only with `plugins`, which loads them to run stages again.
    """
    from dataclasses import replace

    from sppm_pipeline.engine.cache.housekeeping import open_store
    from sppm_pipeline.engine.cli.arguments import cache_of
    from sppm_pipeline.engine.files import write_whole
    from sppm_pipeline.engine.plan.plugins import allowed_plugins
    from sppm_pipeline.engine.plan.session import RunRequest
    from sppm_pipeline.engine.run.outputs import RECORD
    from sppm_pipeline.engine.run.runner import available_threads
    from sppm_pipeline.features.browser.report.build import report_html
    from sppm_pipeline.features.browser.report.layers import outputs_of
    from sppm_pipeline.features.browser.report.records import read_record
    from sppm_pipeline.features.browser.report.views import live_view

    threads, record = available_threads(), read_record(path)
    request = RunRequest(
        str(path / RECORD),
        plugins=tuple(args.plugin),
        distributions=not args.no_plugins,
        allowed=allowed_plugins(args.allow_plugins),
    )
    found: tuple[bytes | None, str] = (None, "")
    if view:
        cache = cache_of(args)
        store = open_store(cache) if cache is not None else None
        outputs = outputs_of(path, record.get("stages", ()))
        again = request if plugins else replace(request, plugins=(), distributions=False)
        found = live_view(path, record, outputs, again, store=store, threads=threads, remake=remake)
    known = _plugins_of(request, plugins)
    text = report_html(path, record, view=found[0], note=found[1], max_bytes=most, threads=threads, plugins=known)
    write_whole(target, text, durable=False)


def _plugins_of(request: RunRequest, own: bool) -> Plugins:
    """The plugins whose results and sections a report shows; with those that the configuration names if `own`."""
    from sppm_pipeline.engine.plan.plugins import load_plugins
    from sppm_pipeline.engine.plan.session import open_session
    from sppm_pipeline.errors import SppmError

    if own:
        with contextlib.suppress(SppmError):  # of a configuration that can't be read any more the rest is shown
            return open_session(request).plugins
    names = None if request.allowed is None else [name for name in request.allowed if not name.endswith(".py")]
    known = load_plugins(files=map(Path, request.plugins), distributions=request.distributions, allowed=names)
    known.raise_broken()
    return known


def open_in_browser(target: Path) -> None:
    """Open a page in the browser, if there is one."""
    import sys
    import webbrowser

    if not webbrowser.open(target.absolute().as_uri()):
        print(f"no browser could be started; open {target} yourself", file=sys.stderr)


MIN_SIZE = 200_000
"""Bytes that a report without view, layers and pictures may take: style, script, numbers and texts of a long run."""
