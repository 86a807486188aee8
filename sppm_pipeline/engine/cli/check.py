"""``sppm check``: options, wiring and sweep of a configuration, without running it."""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace

from sppm_pipeline.engine.cli.arguments import add_configuration, open_from


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_configuration(parser)
    parser.add_argument("--json", action="store_true", help="print the resolved configuration as JSON")


def execute(args: Namespace) -> int:
    """Check, and print the wiring."""
    from sppm_pipeline.engine.plan.describe import wiring_text
    from sppm_pipeline.engine.plan.session import checked

    session = open_from(args)
    plan, found = checked(session, getattr(args, "until", None))
    rows = len(found)
    for message in plan.warnings:
        print(f"sppm: warning: {message}", file=sys.stderr)
    if args.json:
        print(json.dumps(plan.document, indent=1, ensure_ascii=False))
        return 0
    print(wiring_text(plan), end="")
    print(f"{session.configuration.file}: ok" + (f", a sweep of {rows} runs" if rows else ""))
    return 0
