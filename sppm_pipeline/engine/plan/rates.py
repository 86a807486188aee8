"""The table of rates: what each stage costs for each unit of its size, measured by ``benchmarks/rates.py``.

``rates.json`` holds, for each stage by name (for writers by format), seconds on one core, bytes of memory while it
runs, bytes that its result keeps, and bytes on disk; each for a run (unit ``1``) and for units of `data.size.Size`.
"""

from __future__ import annotations

import contextlib
import functools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.store import Store

TABLE = Path(__file__).with_name("rates.json")
MEASURED = "speed.json"
"""Where a cache remembers how fast stages are on its machine."""

WORTH = 0.2
"""Seconds; of stages that take less, the noise would be learned."""

MEMORY = 0.7
"""Weight of earlier runs in the mean, so that a first run, which compiles kernels, is forgotten after some more."""

BOUND = 30.0
"""Largest factor that is believed."""

Speed = Mapping[str, float]
"""For each entry of the table: how much longer it took on this machine than the table says."""


class Cost(NamedTuple):
    """Seconds on one core; bytes while a stage runs, of its result, and on disk."""

    seconds: float
    memory: float
    kept: float
    disk: float


@functools.cache
def table() -> Mapping[str, Mapping[str, Mapping[str, float]]]:
    """Stage -> column -> unit -> rate."""
    found: dict[str, dict[str, dict[str, float]]] = json.loads(TABLE.read_text(encoding="utf-8"))
    return found


def cost(name: str, units: Mapping[str, float], factor: float = 1.0) -> Cost | None:
    """The cost of a stage of this size, `factor` times as long as in the table; None if it has no entry."""
    if name not in table():
        return None
    totals = (
        sum(rate * (1.0 if unit == "1" else units.get(unit, 0.0)) for unit, rate in table()[name][column].items())
        for column in Cost._fields
    )
    found = Cost(*totals)
    return found._replace(seconds=factor * found.seconds)


def speed_of(store: Store | None) -> dict[str, float]:
    """What a cache remembers of its machine."""
    found: dict[str, float] = ((store.read_text(MEASURED) if store is not None else None) or {}).get("stages", {})
    return found


def learn_speed(store: Store, took: Mapping[str, tuple[float, float]]) -> None:
    """Remember with a cache how long stages took.

    Parameters
    ----------
    store : Store
    took : mapping of entry of the table to (seconds, seconds by the table)
    """
    speed = speed_of(store)
    for name, (seconds, expected) in took.items():
        factor = min(max(seconds / max(expected, 1e-9), 1 / BOUND), BOUND)
        speed[name] = speed.get(name, factor) ** MEMORY * factor ** (1 - MEMORY)
    with contextlib.suppress(OSError):  # a full disk: the next estimate is as good as this one
        store.write_text(MEASURED, {"stages": speed})
