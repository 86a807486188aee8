"""Costs of stages: rates that come with the program, corrected by what this machine has seen.

``rates.json`` holds, for each stage by name (for writers by format), seconds on one core, bytes of memory while it
runs, bytes that its result keeps, and bytes on disk; each for a run (unit ``1``) and for units of `nouns.size.Size`.
``benchmarks/rates.py`` corrects them by runs of the configurations; each run does so for its machine, with the cache.
"""

from __future__ import annotations

import contextlib
import functools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.store import Store

TABLE = Path(__file__).with_name("rates.json")
HISTORY = "history.json"
"""File of a cache with what stages took on its machine."""

MAX_SEEN = 12
"""Runs of a stage that are remembered, the latest. More would distinguish more sizes; twelve of each of a hundred
stages
make a file of 100 kB, which is read in a millisecond."""

SAME = 1.05
"""Factor between sizes up to which runs are of the same size: the latest counts."""

MARGIN = 1.03
"""Factor by which the memory of the same run differs between two times: 0.2 to 1.2 % in those that were repeated."""


class Seen(NamedTuple):
    """A stage that ran on this machine: seconds and bytes of the process, by the table and as they were."""

    rated: float
    seconds: float
    expected: float
    peak: float  # 0 where it is unknown


History = Mapping[str, Sequence[Seen]]
"""For each entry of the table what was seen, the latest last."""


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


def cost(name: str, units: Mapping[str, float]) -> Cost | None:
    """The cost of a stage of this size by the table; None if it has no entry."""
    if name not in table():
        return None
    totals = (
        sum(rate * (1.0 if unit == "1" else units.get(unit, 0.0)) for unit, rate in table()[name][column].items())
        for column in Cost._fields
    )
    return Cost(*totals)


def by_history(seen: Sequence[Seen], rated: float, expected: float) -> tuple[float, float]:
    """Seconds of a stage and bytes of its process, in proportion to the runs that were nearest in size; those by the
    table, `rated` and `expected`, if there are none.
    """
    time = _nearest([(one.rated, one.seconds) for one in seen], rated)
    memory = _nearest([(one.expected, one.peak) for one in seen if one.peak], expected)
    return (
        rated if time is None else rated * time[1] / time[0],
        expected if memory is None else expected * MARGIN * memory[1] / memory[0],
    )


def _nearest(seen: Sequence[tuple[float, float]], size: float) -> tuple[float, float] | None:
    """The pair whose first number is nearest to `size`; of those that are as near, the latest."""

    def distance(pair: tuple[float, float]) -> float:
        return max(math.log(SAME), abs(math.log(max(pair[0], 1e-9) / max(size, 1e-9))))

    return min(reversed([pair for pair in seen if pair[0] > 0]), key=distance, default=None)


def history_of(store: Store | None) -> dict[str, list[Seen]]:
    """Runs of stages that a cache remembers of its machine."""
    found = ((store.read_text(HISTORY) if store is not None else None) or {}).get("stages", {})
    return {name: [Seen(*numbers) for numbers in runs] for name, runs in found.items()}


def remember(store: Store, took: Iterable[tuple[str, Seen]]) -> None:
    """Remember with a cache what stages took; nothing is written if that says nothing new."""
    history = history_of(store)
    news = [(name, seen) for name, seen in took if not _is_known(history.get(name, ()), seen)]
    for name, seen in news:
        # four digits keep the file small and are more than a time is reproducible to
        history[name] = [*history.get(name, ()), Seen(*(float(f"{number:.4g}") for number in seen))][-MAX_SEEN:]
    if news:
        with contextlib.suppress(OSError):  # a full disk: the next estimate is as good as this one
            store.write_text(HISTORY, {"stages": {name: [list(one) for one in runs] for name, runs in history.items()}})


def _is_known(runs: Sequence[Seen], seen: Seen) -> bool:
    """True if the last run of this size took the same, up to noise."""
    near = [one for one in runs if max(one.rated, seen.rated) <= SAME * min(one.rated, seen.rated)]
    # 10 % or 0.05 s of time and 1 % of memory are noise of a machine that does other work as well
    return bool(near) and (
        abs(near[-1].seconds - seen.seconds) < max(0.05, 0.1 * seen.seconds)
        and abs(near[-1].peak - seen.peak) < 0.01 * seen.peak
    )
