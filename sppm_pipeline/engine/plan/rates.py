"""The table of rates: what each stage costs for each unit of its size, measured by ``benchmarks/rates.py``.

``rates.json`` holds, for each stage by name (for writers by format), seconds on one core, bytes of memory while it
runs, bytes that its result keeps, and bytes on disk; each for a run (unit ``1``) and for units of `data.size.Size`.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.store import Store
    from sppm_pipeline.engine.plan.wiring import Step

Speed = Mapping[str, tuple[float, int]]
"""For each entry of the table: how much longer it took on this machine than the table says, and in how many runs."""

TABLE = Path(__file__).with_name("rates.json")
MEASURED = "speed.json"
"""Where a cache remembers how fast stages are on its machine."""

WORTH = 0.2
"""Seconds; of stages that take less, the noise would be learned."""

MEMORY = 0.7
"""Weight of earlier runs in the mean, so that a first run, which compiles kernels, is forgotten after some more."""

BOUND = 30.0
"""Largest factor that is believed."""


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Seconds on one core; bytes while a stage runs, of its result, and on disk."""

    seconds: float
    memory: float
    kept: float
    disk: float


@dataclass(frozen=True)
class Rates:
    """Stage -> column -> unit -> rate."""

    table: Mapping[str, Mapping[str, Mapping[str, float]]]

    def cost(self, name: str, units: Mapping[str, float], factor: float = 1.0) -> Cost | None:
        """The cost of a stage of this size; None without a record. `factor` is that of this machine."""
        columns = self.table.get(name)
        if columns is None:
            return None

        def total(column: str) -> float:
            found = columns.get(column, {})
            return found.get("1", 0.0) + sum(rate * units.get(unit, 0.0) for unit, rate in found.items())

        return Cost(seconds=factor * total("seconds"), memory=total("memory"), kept=total("kept"), disk=total("disk"))


@functools.cache
def rates() -> Rates:
    """The table that comes with the program."""
    return Rates(json.loads(TABLE.read_text(encoding="utf-8")))


def speed_of(store: Store | None) -> dict[str, tuple[float, int]]:
    """What a cache remembers of its machine."""
    found = (store.read_text(MEASURED) or {}).get("stages", {}) if store is not None else {}
    return {name: (float(factor), int(runs)) for name, (factor, runs) in found.items()}


def learn_speed(store: Store, steps: Sequence[Step], recipes: Any, record: Sequence[Mapping[str, Any]]) -> None:
    """Compare the seconds of a run with the table, and remember the factor of each stage with the cache.

    Parameters
    ----------
    store : Store
    steps, recipes
        Of the plan.
    record : sequence of mapping
        The entries of the run record.
    """
    took = {entry["id"]: entry["seconds"] for entry in record if not entry.get("cached") and entry["seconds"] > WORTH}
    if not took:
        return
    from sppm_pipeline.data.size import ONE
    from sppm_pipeline.engine.plan.estimate import estimate_steps

    speed = speed_of(store)
    for stage in estimate_steps(steps, recipes, ONE, 0.0, {}):
        if stage.step.id in took and stage.cost and not stage.unknown:
            factor = min(max(took[stage.step.id] / max(stage.cost.seconds, WORTH / BOUND), 1 / BOUND), BOUND)
            name = stage.step.stage.rated_as
            before, runs = speed.get(name, (factor, 0))
            speed[name] = (math.exp(MEMORY * math.log(before) + (1 - MEMORY) * math.log(factor)), runs + 1)
    store.write_text(MEASURED, {"stages": {name: list(pair) for name, pair in sorted(speed.items())}})
