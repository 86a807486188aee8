"""``sppm check``: options, wiring and sweep of a configuration, without running it."""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace

from sppm_pipeline.engine.cli.arguments import add_configuration, history_of_machine, open_from, run_folder


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_configuration(parser)
    parser.add_argument("--json", action="store_true", help="print the resolved configuration as JSON")


def execute(args: Namespace) -> int:
    """Check, and print the wiring and what a run will take; 5 if memory or disk will not suffice."""
    from sppm_pipeline.engine.cli.estimate import summary_line
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
