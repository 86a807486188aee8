"""Arguments that limit what a run may take; they travel to worker processes in environment variables."""

from __future__ import annotations

import contextlib
import os
import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Iterator

_UNITS = {"": 1, "B": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0}
_NUMBER = re.compile(r"(\d{1,15}(?:\.\d{1,9})?)\s*([A-Za-z]*)")


def add_limits(parser: ArgumentParser) -> None:
    """Time of a stage, memory, and the contract mode."""
    parser.add_argument(
        "--stage-time",
        type=seconds,
        metavar="TIME",
        help="end the run if a stage takes longer, for instance 90, 10min or 2h; no limit if omitted",
    )
    parser.add_argument(
        "--memory",
        type=size,
        metavar="SIZE",
        help="memory that the run may take, for instance 2G: it is refused if the estimate is more, and ended when it "
        "takes more; what the machine has free if omitted",
    )
    parser.add_argument(
        "--contract",
        action="store_true",
        help="check after every stage that it left its inputs alone and made finite numbers, for authors of plugins",
    )


def size(text: str) -> int:
    """Bytes from ``1.5G``, ``800 MB``, ``2GiB``; units are powers of 1024."""
    found = _NUMBER.fullmatch(text.strip())
    unit = found[2].upper().removesuffix("B").removesuffix("I") if found else None
    if found is None or unit not in _UNITS or not 1 <= float(found[1]) * _UNITS[unit] < 2**63:
        raise ArgumentTypeError(f"expected a size such as 800M or 2G, got {text[:40]!r}")
    return int(float(found[1]) * _UNITS[unit])


def seconds(text: str) -> float:
    """Seconds from ``90``, ``10min``, ``2h``."""
    found = _NUMBER.fullmatch(text.strip())
    if found is None or found[2] not in _SECONDS or not 0 < (value := float(found[1]) * _SECONDS[found[2]]) <= 1e8:
        raise ArgumentTypeError(f"expected a time such as 90, 10min or 2h, got {text[:40]!r}")
    return value


@contextlib.contextmanager
def limits_of(args: Namespace) -> Iterator[None]:
    """Put the limits into the environment, where stages of this and of worker processes find them."""
    from sppm_pipeline.engine.process.budget import MEMORY
    from sppm_pipeline.engine.process.containment import STAGE_TIME
    from sppm_pipeline.engine.run.contract import CONTRACT

    requested = {
        STAGE_TIME: repr(args.stage_time) if args.stage_time is not None else None,
        MEMORY: str(args.memory) if args.memory is not None else None,
        CONTRACT: "1" if args.contract else None,
    }
    before = {name: os.environ.get(name) for name in requested}
    os.environ.update({name: value for name, value in requested.items() if value is not None})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
