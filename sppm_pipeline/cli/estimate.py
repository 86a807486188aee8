"""``sppm estimate``: what a run will take, foretold along the wiring without running anything."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.cli.arguments import add_configuration, open_from
from sppm_pipeline.cli.limits import add_limits, limits_of

if TYPE_CHECKING:
    from sppm_pipeline.engine.plan.estimate import Forecast


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_configuration(parser)
    add_limits(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="run directory; runs/<name> if omitted")
    parser.add_argument("--until", metavar="ID", help="stop after this stage")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def execute(args: Namespace) -> int:
    """Print the forecast; 5 if memory or disk will not do."""
    with limits_of(args):
        from sppm_pipeline.engine.plan.session import checked, forecasts, refuse_unfit

        session = open_from(args)
        plan, rows = checked(session, args.until)
        found = forecasts(session, plan, rows, args.until)
        largest = max(found, key=lambda forecast: forecast.memory)
        runs = max(1, len(rows))
        total = {
            "runs": runs,
            "memory_bytes": round(largest.memory),
            "disk_bytes": round(sum(f.disk for f in found) / len(found) * runs),
            "seconds": round(sum(f.seconds for f in found) / len(found) * runs, 3),
        }
        if args.json:
            print(json.dumps({**total, "unknown": list(largest.unknown), "stages": _stages(largest)}, indent=1))
        else:
            _print(largest, total)
        refuse_unfit(session, plan, rows, args.output or Path("runs") / plan.name, until=args.until)
    return 0


def _stages(forecast: Forecast) -> list[dict[str, Any]]:
    stages = []
    for foretold in forecast.stages:
        found = foretold.estimate
        entry: dict[str, Any] = {"id": foretold.step.id, "known": found is not None}
        if found is not None:
            entry |= {
                "memory_bytes": round(foretold.memory),
                "disk_bytes": round(found.disk),
                "seconds": round(found.seconds, 4),
                "voxels": round(found.voxels),
                "layers": found.layers,
            }
        stages.append(entry)
    return stages


def _print(forecast: Forecast, total: dict[str, Any]) -> None:
    from sppm_pipeline.process.resources import words_for_bytes

    width = max(len(stage.step.id) for stage in forecast.stages)
    print(f"{'':{width}s}     memory       disk    seconds     voxels")
    for foretold in forecast.stages:
        found = foretold.estimate
        if found is None:
            print(f"{foretold.step.id:{width}s}  not foretold")
            continue
        layers = f"  {found.layers} layers" if found.layers else ""
        print(
            f"{foretold.step.id:{width}s} {words_for_bytes(foretold.memory):>10s} {words_for_bytes(found.disk):>10s} "
            f"{found.seconds:10.2f} {found.voxels:10.3g}{layers}"
        )
    if total["runs"] > 1:
        print(f"that is the largest of {total['runs']} runs")
    print(
        f"in all: {words_for_bytes(total['memory_bytes'])} of memory, {words_for_bytes(total['disk_bytes'])} on disk, "
        f"{total['seconds']:.3g} s on one core"
    )
    if forecast.unknown:
        print("not foretold, and left out of the sums: " + ", ".join(forecast.unknown))
