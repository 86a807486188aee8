"""``sppm verify``: whether a run directory still holds what its run has written, to the byte."""

from __future__ import annotations

import dataclasses
import json
from argparse import ArgumentParser, Namespace
from pathlib import Path


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("directory", type=Path, metavar="DIR", help="run directory")
    parser.add_argument("--extra-ok", action="store_true", help="do not mind files that no stage has written")
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")


def execute(args: Namespace) -> int:
    """Check, and list what is wrong."""
    from sppm_pipeline.engine.run.runner import available_threads
    from sppm_pipeline.engine.run.verification import differences, verify_run

    found, files = verify_run(args.directory, available_threads())
    if args.extra_ok:
        found = [finding for finding in found if finding.kind != "extra"]
    differs = differences(args.directory)
    if args.json:
        findings = [dataclasses.asdict(f) for f in found]
        print(json.dumps({"files": files, "findings": findings, "differences": differs}, indent=1))
    else:
        for finding in found:
            print(f"{finding.kind:10s} {finding.path}" + (f": {finding.detail}" if finding.detail else ""))
        print(f"{args.directory}: {files} files, {len(found) or 'no'} findings" if found else
              f"{args.directory}: {files} files, all as they were written")  # fmt: skip
        if differs:
            print("a repeat of this run on this machine may differ in last digits, and so in bytes:")
            print("".join(f"  {line}\n" for line in differs), end="")
    return 3 if found else 0
