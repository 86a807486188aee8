"""``sppm estimate``: what a run will take, estimated along the wiring without running anything."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.cli.arguments import add_configuration, open_from
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
    """Print the estimate; 5 if memory or disk will not do."""
    with limits_of(args):
        from sppm_pipeline.engine.cache.housekeeping import cache_folder, open_store
        from sppm_pipeline.engine.plan.rates import speed_of
        from sppm_pipeline.engine.plan.session import checked, estimates, refuse_unfit

        session = open_from(args)
        plan, rows = checked(session, args.until)
        cache = cache_folder()
        speed = speed_of(open_store(cache) if cache is not None and cache.is_dir() else None)
        found = estimates(session, plan, rows, args.until, speed)
        largest = max(found, key=lambda estimate: estimate.memory)
        runs = max(1, len(rows))
        start = found[0].program.seconds  # once, however many rows there are
        total = {
            "runs": runs,
            "memory_bytes": round(largest.memory),
            "disk_bytes": round(sum(one.disk for one in found) / len(found) * runs),
            "seconds": round(start + sum(one.seconds - start for one in found) / len(found) * runs, 3),
        }
        stages = _stages(largest)
        if args.json:
            print(json.dumps({**total, "unknown": list(largest.unknown), "stages": stages}, indent=1))
        else:
            _print(stages, total, largest.unknown)
        refuse_unfit(session, plan, rows, args.output or Path("runs") / plan.name, until=args.until)
    return 0


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


def _print(stages: list[dict[str, Any]], total: dict[str, Any], unknown: tuple[str, ...]) -> None:
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
    memory, disk = format_bytes(total["memory_bytes"]), format_bytes(total["disk_bytes"])
    least = "at least " if unknown else ""
    print(
        f"in all: {least}{memory} of memory, {least}{disk} on disk, {least}{total['seconds']:.3g} s on one core"
        + (f"; unknown: {', '.join(unknown)}" if unknown else "")
    )
