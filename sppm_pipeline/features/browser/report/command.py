"""``sppm report``: one HTML file that shows a run directory."""

from __future__ import annotations

import contextlib
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.cache.session import CacheSession
from sppm_pipeline.engine.config.names import REPORT
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.engine.run.memory import run_in_memory
from sppm_pipeline.engine.run.outputs import RECORD, SWEEP_RUNS
from sppm_pipeline.errors import ConfigError, SppmError
from sppm_pipeline.features.browser.live.page import SUFFIX, head_of, room_of_view, wanted
from sppm_pipeline.features.browser.live.views import SAMPLES, view_of
from sppm_pipeline.features.browser.report.layers import outputs_of, stored_layers, view_of_layers
from sppm_pipeline.features.browser.report.records import read_record
from sppm_pipeline.nouns.artifact import Artifact, Viewable
from sppm_pipeline.nouns.report import Report
from sppm_pipeline.nouns.viewers import viewer_of

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.store import Store
    from sppm_pipeline.engine.plan.plugins import Plugins

QUICK = 20.0
"""Seconds; stages that took less in the run are repeated for a report, slower ones only with `--remake`."""

MAX_VIEWS, ROW_BYTES = 60, 40_000
"""Runs of a sweep that are shown live, as each takes about 0.1 s, and bytes that each may take."""

MIN_SAMPLES = 30_000
"""Samples, or a number of triangles in proportion, below which a view shows nothing."""

REMAKE = "`sppm report --remake` runs again what it needs, or add `- {stage: write.view}` to the pipeline"


def live_view(
    path: Path, record: Mapping[str, Any], outputs: Sequence[Mapping[str, Any]], request: RunRequest, *,
    store: Store | None, threads: int, remake: bool = False, samples: int = SAMPLES, most: int = 2**40,
    quick: float = QUICK, kept: Mapping[str, Any] = MappingProxyType({}),
) -> tuple[bytes | None, str]:  # fmt: skip
    """The view file of a run, of at most `most` bytes, or None and why there is none; with what it leaves out.

    `outputs` are those of the run that lie in its directory, `request` says which plugins may be loaded, `store` is
    the cache; stages that took `quick` seconds run again only with `remake`; `samples` as for `view_of`; `kept` are
    results of the run.
    """
    note = ""
    for output in reversed(outputs):
        if str(output["path"]).endswith(SUFFIX):
            try:
                data = (path / str(output["path"])).read_bytes()
                head_of(data)
            except (SppmError, OSError) as error:
                return None, f"The live view {output['path']!r} can't be read: {error}"
            if len(data) <= most:
                return data, ""
            note = f"The live view {output['path']!r} takes {wanted(len(data))}."
    if "runs" in record:
        return None, ""
    try:
        if (made := next((result for result in reversed([*kept.values()]) if result is not None), None)) is not None:
            return fitted(made, samples, most, threads)
        # by default no plugins may be loaded: a report must not run code that came with the run of another user
        plan = open_session(request).plan()
        step = _last_shown(plan, {str(stage["id"]) for stage in record["stages"]})
        if step is None:
            return None, note
        if not remake and (lacking := _lacking(plan, step, record, store, quick)):
            return None, note or f"There is no live view: {lacking}; {REMAKE}."
        memory = run_in_memory(plan, threads=threads, until=step.id, store=store)
        return fitted(memory.result(step.id), samples, most, threads)
    except SppmError as error:
        return None, note or f"There is no live view: {error.message}."


def fitted(what: Artifact, samples: int, most: int, threads: int) -> tuple[bytes | None, str]:
    """The view file of an artifact with as many samples or triangles as `most` bytes hold, and what is left out."""
    data, note = view_of(what, samples=samples, threads=threads), ""
    if len(data) > most:
        note = f"The live view is coarser than it could be: in full it takes {wanted(len(data))}."
    while len(data) > most and samples > MIN_SAMPLES:
        samples = int(0.9 * samples * most / len(data))
        data = view_of(what, samples=samples, threads=threads)
    return (data, note) if len(data) <= most else (None, f"The live view takes {wanted(len(data))}.")


def views_of_rows(
    path: Path, record: Mapping[str, Any], request: RunRequest, store: Store | None, threads: int, most: int
) -> dict[str, bytes]:
    """Small view files of runs of a sweep, evenly spread if there are many, of at most `most` bytes together."""
    runs = [str(run["run"]) for run in record["runs"] if run["status"] == "done"]
    found: dict[str, bytes] = {}
    for run in runs[:: -(-len(runs) // MAX_VIEWS) or 1]:
        folder = path / SWEEP_RUNS / run
        try:
            own = read_record(folder)
        except SppmError:
            continue
        again = replace(request, file=str(folder / RECORD))
        outputs = outputs_of(folder, own["stages"])
        view, _ = live_view(
            folder, own, outputs, again, store=store, threads=threads, quick=1.0, samples=60_000,
            most=min(ROW_BYTES, most),
        )  # fmt: skip
        if view is not None and (not found or head_of(view)["kind"] == head_of(next(iter(found.values())))["kind"]):
            found[run] = view
            most -= len(view)
    return found


def shown_stages(plan: Plan) -> list[str]:
    """The stage whose result the report of a run will show live, if there is one."""
    step = _last_shown(plan, {step.id for step in plan.steps})
    return [] if step is None else [step.id]


def _last_shown(plan: Plan, ran: set[str]) -> Step | None:
    """The last step that has run and makes a structure; if there is none, another surface, then one of a report."""

    def rank(kind: type) -> int:
        surface = issubclass(kind, Viewable) + (issubclass(kind, Viewable) and not issubclass(kind, Report))
        return surface if viewer_of(kind) is None else 3

    ran_steps = [step for step in plan.steps if step.id in ran]
    ranks = [max(map(rank, step.makes), default=0) for step in ran_steps]
    # of several of the best kind the last one
    best, number = max(zip(ranks, range(len(ranks)), strict=True), default=(0, 0))
    return ran_steps[number] if best else None


def _lacking(plan: Plan, last: Step, record: Mapping[str, Any], store: Store | None, quick: float) -> str:
    """Stages that would have to run again and took long; empty if all is cached, or was quick."""
    seconds = {str(stage["id"]): float(stage["seconds"]) for stage in record["stages"] if not stage.get("cached")}
    session = (
        None if store is None else CacheSession(store, lambda stage, words: None, seed=plan.seed, recipes=plan.recipes)
    )
    steps = {step.id: step for step in plan.until(last.id)}
    kept: dict[str, bool] = {}
    for id_, step in steps.items():
        entry = session.look_up(step, (id_,)) if session is not None else None
        kept[id_] = entry is not None and (entry.has_value or entry.manifest["same_as"] is not None)
    needed, rest = set(), [last.id]
    while rest:
        id_ = rest.pop()
        if id_ in needed:
            continue
        needed.add(id_)
        entry = session.entry(id_) if session is not None else None
        # its value is that of an input, which has to be made in its place
        passed_on = entry is not None and not entry.has_value and kept[id_]
        if not kept[id_] or passed_on:
            rest += [source for source in steps[id_].inputs.values() if source is not None]
    long = [id_ for id_ in steps if id_ in needed and not kept[id_] and seconds.get(id_, quick) >= quick]
    return f"what {', '.join(long)} made is not in the cache" if long else ""


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


def after_run(path: Path, args: Namespace, kept: Mapping[str, Any]) -> None:
    """Write the report of a run that has just ended, with its plugins, its cache, and results that were kept."""
    of_run(path, path / REPORT, args, kept=kept)


def of_run(
    path: Path, target: Path, args: Namespace, *, most: int = 5_000_000, view: bool = True, remake: bool = False,
    plugins: bool = True, kept: Mapping[str, Any] = MappingProxyType({}),
) -> None:  # fmt: skip
    """Write the report of a run directory to `target`, of at most `most` bytes.

    `view` and `remake` say whether there is a live view, and whether stages are run again for it. What shows results
    is loaded from plugins that are installed or named in `args` (`add_cache`, `add_plugins`); from those that the
    configuration names only with `plugins`, which loads them to run stages again.
    """
    from sppm_pipeline.engine.cache.housekeeping import open_store
    from sppm_pipeline.engine.cli.arguments import cache_of
    from sppm_pipeline.engine.files import write_whole
    from sppm_pipeline.engine.plan.plugins import allowed_plugins
    from sppm_pipeline.engine.run.runner import available_threads
    from sppm_pipeline.features.browser.report.build import report_html

    threads, record = available_threads(), read_record(path)
    request = RunRequest(
        str(path / RECORD), plugins=tuple(args.plugin), distributions=not args.no_plugins,
        allowed=allowed_plugins(args.allow_plugins),
    )  # fmt: skip
    found: tuple[bytes | None, str] = (None, "")
    rows: dict[str, bytes] = {}
    if view:
        cache = cache_of(args)
        store = open_store(cache) if cache is not None else None
        outputs = outputs_of(path, record.get("stages", ()))
        again = request if plugins else replace(request, plugins=(), allowed=_distributions(request.allowed))
        found = live_view(
            path, record, outputs, again, store=store, threads=threads, remake=remake, most=room_of_view(most),
            kept=kept,
        )  # fmt: skip
        if "runs" in record:
            rows = views_of_rows(path, record, again, store, threads, most // 4)
    known = _plugins_of(request, plugins)
    stored = None
    if view and found[0] is None and "runs" not in record:
        stored = stored_layers(path, record["stages"], Registry(known))
    if stored is not None:
        found = view_of_layers(stored[1]), f"{found[1]} What is shown is made of the layers, at reduced detail."
    text = report_html(
        path, record, view=found[0], note=found[1], max_bytes=most, threads=threads, plugins=known, views=rows
    )
    write_whole(target, text, durable=False)


def _distributions(allowed: Sequence[str] | None) -> tuple[str, ...]:
    """The names of installed plugins that may be imported, without files that a configuration names."""
    from sppm_pipeline.engine.plan.plugins import installed_plugins

    return tuple(plugin.name for plugin, _ in installed_plugins(allowed))


def _plugins_of(request: RunRequest, own: bool) -> Plugins:
    """The plugins whose results and sections a report shows; with those that the configuration names if `own`."""
    from sppm_pipeline.engine.plan.plugins import load_plugins

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
