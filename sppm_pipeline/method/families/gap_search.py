"""Search for a porosity by the gap between faces and interior (paper, "Porosity Control").

Porosity as a function of the gap d has jumps, as a dart that is discarded changes all that follow it, so one cell may
step over the target. Cells with some pores more or less, and other draws, step elsewhere: they are tried until one
meets it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.porosity.level import search_monotone

OFFSETS = (0, 1, -1, 2, -2, 3, -3)
"""Pores more or less than the fitted line says. One pore moves the porosity by about 0.007 in a cell of 66, and draws
of one number spread by 0.02, so these cover the spread; a wider range only tries cells that meet the target less often.
"""

EVALUATIONS_PER_CELL = 12
"""Gaps tried of one cell. Eleven halvings of a bracket leave a jump; more only narrow down where it is."""


class Candidate(NamedTuple):
    """A cell whose gap is searched."""

    draw: int  # number of the draw
    extra: int  # pores more than the line says


class GapFit(NamedTuple):
    """The cell that is nearest to the target."""

    candidate: Candidate
    gap: float  # cell sizes
    porosity: float
    made: Microstructure


def candidates(offsets: tuple[int, ...]) -> Iterator[Candidate]:
    """Cells in the order in which they are tried: all numbers of pores of one draw, then the next draw."""
    draw = 0
    while True:
        yield from (Candidate(draw, extra) for extra in offsets)
        draw += 1


def search_gap(
    interval: Callable[[Candidate], tuple[float, float] | None], evaluate: Callable[[Candidate, float],
    tuple[float, Microstructure]], offsets: tuple[int, ...], target: float, tolerance: float, max_evaluations: int,
) -> tuple[GapFit | None, int]:  # fmt: skip
    """Try cells until the gap of one gives the porosity; returns the nearest one and the number of evaluations.

    It meets the target unless the evaluations are used up, and is None if no cell could be searched. `interval` gives
    the gaps between which a cell is searched, from its spacing on, or None if its interior is too full for any;
    `evaluate` makes a porosity and a microstructure from a cell and a gap. Of `offsets`, see `OFFSETS`, the first is
    tried first. `max_evaluations` bounds the microstructures that are drawn and measured. Raises DesignError if no cell
    could be drawn.
    """
    best: GapFit | None = None
    failure: DesignError | None = None
    done = 0
    for number, candidate in enumerate(candidates(offsets)):
        # a search takes two evaluations or more; and where no number of pores could be searched in the first draw, more
        # draws are in vain
        if done + 2 > max_evaluations or (best is None and number >= len(offsets)):
            break
        ends = interval(candidate)
        if ends is None:
            continue
        nearest: GapFit | None = None

        def porosity(gap: float, candidate: Candidate = candidate) -> float:
            nonlocal nearest
            value, made = evaluate(candidate, gap)
            if nearest is None or abs(value - target) < abs(nearest.porosity - target):
                nearest = GapFit(candidate, gap, value, made)
            return value

        tried = min(EVALUATIONS_PER_CELL, max_evaluations - done)
        try:
            done += search_monotone(porosity, *ends, target, tolerance, tried).evaluations
        except DesignError as error:  # an interior that is nearly full can't be drawn each time
            done, failure = done + 1, failure or error
        if nearest is not None and (best is None or abs(nearest.porosity - target) < abs(best.porosity - target)):
            best = nearest
        if best is not None and abs(best.porosity - target) <= tolerance:
            break
    if best is None and failure is not None:
        raise failure
    return best, done
