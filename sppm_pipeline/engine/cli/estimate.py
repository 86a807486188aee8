"""``sppm estimate``: memory, disk and time of a run, estimated along the wiring without running anything."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.cli.arguments import add_configuration, history_of_machine, open_from, run_folder
from sppm_pipeline.engine.cli.limits import add_limits, limits_of

if TYPE_CHECKING:
    from sppm_pipeline.engine.plan.estimate import PlanEstimate


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_configuration(parser)
    add_limits(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="run directory; runs/<name> if omitted")
    parser.add_argument("--until", metavar="ID", help="stop after this stage")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def execute(args: Namespace) -> int:
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
        stages = _stages(largest)
        if args.json:
            print(json.dumps({**total, "unknown": list(largest.unknown), "stages": stages}, indent=1))
        else:
            _print(stages, total)
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


def _stages(estimate: PlanEstimate) -> list[dict[str, Any]]:
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


def _print(stages: list[dict[str, Any]], total: dict[str, Any]) -> None:
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
