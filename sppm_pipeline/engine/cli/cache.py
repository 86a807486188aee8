"""``sppm cache``: what is kept between runs, whether it is sound, and how to make it smaller."""

from __future__ import annotations

import json
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument(
        "what",
        choices=("info", "verify", "prune"),
        help="info: place, entries, size; verify: read every byte, remove what is damaged; prune: remove what was not "
        "used for longest",
    )
    parser.add_argument("--cache", type=Path, metavar="DIR", help="folder of the cache")
    parser.add_argument("--cap", type=_size, metavar="SIZE", help="prune to this size, for example 5GB; 0 removes all")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def _size(text: str) -> int:
    from sppm_pipeline.engine.cache.housekeeping import parse_size

    try:
        return parse_size(text)
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from None


def execute(args: Namespace) -> int:
    """Look, check or clear up."""
    from sppm_pipeline.engine.cache.housekeeping import cache_cap, cache_folder, contents, damaged_entries, prune
    from sppm_pipeline.engine.cache.store import Store
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
                size = sum(entry.bytes for entry in entries)
                found |= {"entries": len(entries), "bytes": size, "cap": cap}
                text = f"{folder}: {len(entries)} results, {_words(size)}; kept below {_words(cap)}"
            case "verify":
                damaged = damaged_entries(store)
                code = 3 if damaged else 0
                found |= {"damaged": [{"key": key, "why": why} for key, why in damaged]}
                lines = [f"{key}: {why}; removed" for key, why in damaged]
                text = "\n".join([*lines, f"{folder}: {len(damaged) or 'no'} damaged results"])
            case _:
                removed, left = prune(store, cap)
                found |= {"removed": removed, "bytes": left}
                text = f"{folder}: {removed} results removed, {_words(left)} left"
    finally:
        store.close()
    print(json.dumps(found, indent=1) if args.json else text)
    return code


def _words(size: int) -> str:
    """A size for people."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size} bytes"
