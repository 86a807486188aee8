"""``sppm cache`` and ``verify``: what is kept between runs, and in run directories, and whether it is sound."""

from __future__ import annotations

import dataclasses
import json
from argparse import ArgumentParser, Namespace
from pathlib import Path

from sppm_pipeline.engine.cli.arguments import size


def configure_cache(parser: ArgumentParser) -> None:
    parser.add_argument(
        "what",
        choices=("info", "verify", "prune"),
        help="info: place, entries, size; verify: read every byte, remove what is damaged; prune: remove what was not "
        "used for longest",
    )
    parser.add_argument("--cache", type=Path, metavar="DIR", help="folder of the cache")
    parser.add_argument(
        "--cap",
        type=lambda text: size(text, 1000, 0),
        metavar="SIZE",
        help="prune to this size, for example 5GB; 0 removes all",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def execute_cache(args: Namespace) -> int:
    """Look, check or clear up."""
    from sppm_pipeline.engine.cache.housekeeping import cache_cap, cache_folder, contents, damaged_entries, prune
    from sppm_pipeline.engine.cache.store import Store
    from sppm_pipeline.engine.process.budget import format_bytes
    from sppm_pipeline.errors import ConfigError

    folder = cache_folder(args.cache)
    if folder is None:
        raise ConfigError("the cache is turned off by SPPM_CACHE=off", hint="name its folder with --cache DIR")
    store = Store(folder)
    cap = cache_cap() if args.cap is None else args.cap
    found: dict[str, object] = {"folder": str(folder)}
    code = 0
    try:
        match args.what:
            case "info":
                entries = contents(store)
                total = sum(entry.bytes for entry in entries)
                found |= {"entries": len(entries), "bytes": total, "cap": cap}
                text = f"{folder}: {len(entries)} results, {format_bytes(total)}; kept below {format_bytes(cap)}"
            case "verify":
                damaged = damaged_entries(store)
                code = 3 if damaged else 0
                found |= {"damaged": [{"key": key, "why": why} for key, why in damaged]}
                lines = [f"{key}: {why}; removed" for key, why in damaged]
                text = "\n".join([*lines, f"{folder}: {len(damaged) or 'no'} damaged results"])
            case _:
                removed, left = prune(store, cap)
                found |= {"removed": removed, "bytes": left}
                text = f"{folder}: {removed} results removed, {format_bytes(left)} left"
    finally:
        store.close()
    print(json.dumps(found, indent=1) if args.json else text)
    return code


def configure_verify(parser: ArgumentParser) -> None:
    parser.add_argument("directory", type=Path, metavar="DIR", help="run directory")
    parser.add_argument("--extra-ok", action="store_true", help="do not mind files that no stage has written")
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")


def execute_verify(args: Namespace) -> int:
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
