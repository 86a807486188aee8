"""Verbs that run nothing: ``sppm check``, ``estimate``, ``explain``, ``graph``, ``stages`` and ``schema``."""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.cli.arguments import (
    add_cache,
    add_configuration,
    add_limits,
    add_plugins,
    cache_of,
    history_of_machine,
    limits_of,
    open_from,
    plugins_from,
    run_folder,
)

if TYPE_CHECKING:
    from sppm_pipeline.engine.plan.estimate import PlanEstimate
    from sppm_pipeline.engine.plan.registry import Registry


def configure_stages(parser: ArgumentParser) -> None:
    parser.add_argument(
        "name", nargs="?", metavar="NAME", help="a stage or preset, or a family to list only its stages"
    )
    add_plugins(parser)
    parser.add_argument("--json", action="store_true", help="print as JSON")


def execute_stages(args: Namespace) -> int:
    """List, or describe."""
    from sppm_pipeline.engine.plan.describe import (
        grouped_list,
        preset_list,
        preset_text,
        stage_data,
        stage_list,
        stage_text,
    )
    from sppm_pipeline.engine.plan.registry import Registry

    registry = Registry(plugins_from(args))
    if args.name is None or any(name.split(".")[0] == args.name for name in registry):
        names = [name for name in registry if args.name in (None, name.split(".")[0])]
        if args.json:
            print(json.dumps([_stage_or_error(name, registry) for name in names], indent=1))
        else:
            listed = stage_list(registry, names) if args.name else grouped_list(registry) + preset_list(registry)
            print(listed, end="")
        return 0
    if args.name in registry.presets and not args.json:
        print(preset_text(args.name, registry), end="")
        return 0
    cls = registry.get(args.name)
    print(json.dumps(stage_data(cls, registry), indent=1) if args.json else stage_text(cls, registry).rstrip("\n"))
    return 0


def _stage_or_error(name: str, registry: Registry) -> dict[str, Any]:
    """The stage, or why it can't be described; one broken plugin does not hide the others."""
    from sppm_pipeline.engine.plan.describe import stage_data
    from sppm_pipeline.errors import PluginError

    try:
        return stage_data(registry.get(name), registry)
    except PluginError as error:
        return {"name": name, "from": str(registry.owner(name)), "error": error.message}


def configure_schema(parser: ArgumentParser) -> None:
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="file to write; printed if omitted")
    parser.add_argument("--record", action="store_true", help="the schema of run.json, the record of a run")
    add_plugins(parser)


def execute_schema(args: Namespace) -> int:
    """Print or write the schema."""
    from sppm_pipeline.engine.files import write_whole
    from sppm_pipeline.engine.plan.registry import Registry
    from sppm_pipeline.engine.plan.schema import configuration_schema

    if args.record:
        text = (Path(__file__).parents[1] / "run" / "record.schema.json").read_text(encoding="utf-8").rstrip()
    else:
        text = json.dumps(configuration_schema(Registry(plugins_from(args))), indent=1, ensure_ascii=False)
    if args.output is None:
        print(text)
    elif args.record:
        write_whole(args.output, f"{text}\n")
    else:
        write_whole(args.output, f"{text}\n")
        line = f"# yaml-language-server: $schema={args.output.name}"
        print(f"{args.output}\nnext: begin configurations beside it with\n{line}")
    return 0


def configure_explain(parser: ArgumentParser) -> None:
    add_configuration(parser)
    add_cache(parser)


def execute_explain(args: Namespace) -> int:
    """Explain a file if there is one of that name, else a stage."""
    from sppm_pipeline.engine.plan.describe import explain_plan, stage_text
    from sppm_pipeline.engine.plan.registry import Registry

    if not Path(args.file).exists():
        registry = Registry(plugins_from(args))
        if args.file in registry:
            print(stage_text(registry.get(args.file), registry), end="")
            return 0
    session = open_from(args)
    plan = session.plan()
    cache = cache_of(args)
    reasons = None
    if cache is not None and session.configuration.sweep is None:
        from sppm_pipeline.engine.cache.housekeeping import open_store
        from sppm_pipeline.engine.cache.session import reasons_of

        reasons = reasons_of(plan, open_store(cache), str(session.configuration.file.absolute()))
    print(explain_plan(plan, reasons), end="")
    return 0


def configure_graph(parser: ArgumentParser) -> None:
    add_configuration(parser)
    parser.add_argument("-f", "--format", choices=("text", "dot", "mermaid"), default="text", help="text if omitted")


def execute_graph(args: Namespace) -> int:
    """Print the graph."""
    from sppm_pipeline.engine.plan.describe import dot_graph, mermaid_graph, wiring_text

    draw = {"text": wiring_text, "dot": dot_graph, "mermaid": mermaid_graph}[args.format]
    print(draw(open_from(args).plan()), end="")
    return 0


def configure_check(parser: ArgumentParser) -> None:
    add_configuration(parser)
    parser.add_argument("--json", action="store_true", help="print the resolved configuration as JSON")


def execute_check(args: Namespace) -> int:
    """Check, and print the wiring and what a run will take; 5 if memory or disk will not suffice."""
    from sppm_pipeline.engine.plan.checking import checked
    from sppm_pipeline.engine.plan.describe import wiring_text

    session = open_from(args)
    plan, rows, estimates = checked(
        session, getattr(args, "until", None), folder=run_folder(args, session), history=history_of_machine(args)
    )
    for message in plan.warnings:
        print(f"sppm: warning: {message}", file=sys.stderr)
    if args.json:
        print(json.dumps(plan.document, indent=1, ensure_ascii=False))
    elif not getattr(args, "quiet", False):  # of `sppm run -n`
        print(wiring_text(plan), end="")
        print(summary_line(estimates, len(rows)))
        print(f"{session.configuration.file}: ok" + (f", a sweep of {len(rows)} runs" if rows else ""))
    return 0


def configure_estimate(parser: ArgumentParser) -> None:
    add_configuration(parser)
    add_limits(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="run directory; runs/<name> if omitted")
    parser.add_argument("--until", metavar="ID", help="stop after this stage")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def execute_estimate(args: Namespace) -> int:
    """Print the estimate; 5 if memory or disk will not suffice."""
    with limits_of(args):
        from sppm_pipeline.engine.config.problems import raise_problems
        from sppm_pipeline.engine.plan.checking import checked, estimate

        session = open_from(args)
        folder = run_folder(args, session)
        plan, rows, _ = checked(session, args.until, folder=None)
        estimates, problems = estimate(session, plan, rows, args.until, folder, history=history_of_machine(args))
        total = total_of(estimates, len(rows))
        largest = max(estimates, key=lambda one: one.memory)
        stages = _stage_rows(largest)
        if args.json:
            print(json.dumps({**total, "unknown": list(largest.unknown), "stages": stages}, indent=1))
        else:
            _print_estimate(stages, total)
            print(summary_line(estimates, len(rows)))
        raise_problems(problems)
    return 0


def total_of(estimates: list[PlanEstimate], rows: int) -> dict[str, Any]:
    """Memory of the largest run, disk and seconds of all; of a sweep, the estimates are of evenly spread rows."""
    runs = max(1, rows)
    start = estimates[0].start  # once, however many rows there are
    return {
        "runs": runs,
        "memory_bytes": round(max(one.memory for one in estimates)),
        "disk_bytes": round(sum(one.disk for one in estimates) / len(estimates) * runs),
        "compiling_seconds": round(estimates[0].compiling.seconds, 3),
        "seconds": round(start + sum(one.seconds - start for one in estimates) / len(estimates) * runs, 3),
    }


def summary_line(estimates: list[PlanEstimate], rows: int) -> str:
    """Totals of an estimate in a line."""
    from sppm_pipeline.engine.process.budget import format_bytes

    total = total_of(estimates, rows)
    unknown = dict.fromkeys(address for one in estimates for address in one.unknown)
    least = "at least " if unknown else ""
    memory, disk = format_bytes(total["memory_bytes"]), format_bytes(total["disk_bytes"])
    compiling = total["compiling_seconds"]
    return (
        f"in all: {least}{memory} of memory, {least}{disk} on disk, {least}{total['seconds']:.3g} s on one core"
        + (f" ({compiling:.3g} of them once, to compile kernels)" if compiling else "")
        + (f"; unknown: {', '.join(unknown)}" if unknown else "")
    )


def _stage_rows(estimate: PlanEstimate) -> list[dict[str, Any]]:
    stages = []
    for found in estimate.stages:
        entry: dict[str, Any] = {"id": found.step.id, "known": found.cost is not None}
        if found.cost is not None and found.size is not None:
            entry |= {
                "memory_bytes": round(found.resident),
                "disk_bytes": round(found.cost.disk),
                "seconds": round(found.cost.seconds, 4),
                "voxels": round(found.size.samples or found.size.voxels),
                "layers": round(found.size.layers),
            }
        stages.append(entry)
    return stages


def _print_estimate(stages: list[dict[str, Any]], total: dict[str, Any]) -> None:
    from sppm_pipeline.engine.process.budget import format_bytes

    width = max(len(stage["id"]) for stage in stages)
    print(f"{'':{width}s}     memory       disk    seconds     voxels")
    for stage in stages:
        if not stage["known"]:
            print(f"{stage['id']:{width}s}    unknown")
            continue
        layers = f"  {stage['layers']} layers" if stage["layers"] else ""
        memory, disk = format_bytes(stage["memory_bytes"]), format_bytes(stage["disk_bytes"])
        numbers = f"{stage['seconds']:10.2f} {stage['voxels']:10.3g}{layers}"
        print(f"{stage['id']:{width}s} {memory:>10s} {disk:>10s} {numbers}")
    if total["runs"] > 1:
        print(f"that is the largest of {total['runs']} runs")
