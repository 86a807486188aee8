"""``sppm check``: options, wiring and sweep of a configuration, without running it."""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace

from sppm_pipeline.cli.arguments import add_configuration, open_from

__all__ = ["configure", "execute"]


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_configuration(parser)
    parser.add_argument("--json", action="store_true", help="print the resolved configuration as JSON")


def execute(args: Namespace) -> int:
    """Check, and print the wiring."""
    from sppm_pipeline.engine.graph import wiring_text
    from sppm_pipeline.engine.runner import check_until
    from sppm_pipeline.engine.sweep import check_sweep, sweep_rows

    session = open_from(args)
    plan = session.plan()
    check_until(plan, getattr(args, "until", None))
    rows = 0
    if session.configuration.sweep is not None:
        found = sweep_rows(session.configuration.sweep, session.configuration.params)
        check_sweep(session, found)
        rows = len(found)
    for message in plan.warnings:
        print(f"sppm: warning: {message}", file=sys.stderr)
    if args.json:
        print(json.dumps(plan.document, indent=1, ensure_ascii=False))
        return 0
    print(wiring_text(plan), end="")
    print(f"{session.configuration.file}: ok" + (f", a sweep of {rows} runs" if rows else ""))
    return 0
