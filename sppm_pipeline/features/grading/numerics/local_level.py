"""The level spline that gives every cell of a lattice the porosity it should have."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.kernels.level_spline import (
    control_of_means,
    control_with_some_held,
    extended,
    void_at_level,
    weights_in_cell,
)
from sppm_pipeline.services.arrays import F64, I16, Bools
from sppm_pipeline.services.threads import ordered_map

# Heuristics that bound a step where the slope is measured on few samples or vanishes; with half or double the
# result agrees within the tolerance, as only the path to it differs.
_MAX_STEP = 0.25  # of the range between the bounds
_MIN_CHANGE = 0.05  # of the porosity over all of that range


class LevelFit(NamedTuple):
    """A level, and the errors it leaves; arrays of the shape of the cells."""

    values: F64
    errors: F64  # porosity minus its target; 0 for cells without an equation
    at_bound: Bools  # cells whose value lies at a bound while their error is above the tolerance
    steps: int  # number of times that all cells were compared


def newton_steps(
    measure: Callable[[F64], tuple[F64, F64]],
    move: Callable[[F64, Bools], F64],
    known: Bools,
    targets: F64,
    start: F64,
    bounds: tuple[float, float],
    tolerance: float,
    steps: int,
) -> LevelFit:
    """Adjust the values of all cells at once until each has its porosity within the tolerance, in at most so many
    steps.

    `measure` gives for values the porosity of each cell, and its decrease with the mean of the level over the cell;
    `move` gives for the target changes of these means, and the cells that are held, changes of the values. `known` are
    the cells that have an equation.
    """
    values = np.clip(start, *bounds)
    span = bounds[1] - bounds[0]
    best, least = None, np.inf
    for step in range(1, steps + 1):
        void, slope = measure(values)
        errors = np.where(known, void - targets, 0.0)
        stuck = (errors > tolerance) & (values >= bounds[1] - 1e-9)
        stuck |= (errors < -tolerance) & (values <= bounds[0] + 1e-9)
        worst = float(np.abs(errors[~stuck]).max(initial=0.0))
        # steps may overshoot: the best values so far are the result
        if best is None or worst < least:
            best, least = LevelFit(values, errors, stuck, step), worst
        if worst <= tolerance:
            break
        wanted = np.clip(errors / np.maximum(slope, _MIN_CHANGE / span), -_MAX_STEP * span, _MAX_STEP * span)
        # the residual of a cell at its bound must not move its neighbors
        wanted[stuck] = 0.0
        values = np.clip(values + move(wanted, stuck), *bounds)
    assert best is not None
    return best._replace(steps=step)


_STEPS_OF_CODE = 32766

RUN = 4
"""Cells along x that are sampled together: long rows cost less than short ones, and kernels are listed for all at once.
"""

Cell = tuple[int, int, int]
Sampled = tuple[NDArray[np.floating], Bools | None]
Sample = Callable[[Sequence[Cell]], Iterable[Sampled]]
"""Gives of each cell of a run the values that the level is compared with, (n, n, n) by z, y, x, and which count."""


class CellCodes:
    """Values of cells in 16 bits, kept up to so many bytes of `memory`, and sampled again beyond; those from ``middle
    - half`` to ``middle + half`` are resolved in 65 532 steps.
    """

    def __init__(self, sample: Sample, middle: float, half: float, memory: float) -> None:
        self._sample, self._middle, self._scale = sample, middle, _STEPS_OF_CODE / half
        self._left, self._lock = memory, threading.Lock()
        self._kept: dict[Cell, I16] = {}

    def code(self, values: NDArray[np.floating]) -> I16:
        """Values as codes."""
        scaled = (values - self._middle) * self._scale
        np.rint(np.clip(scaled, -_STEPS_OF_CODE, _STEPS_OF_CODE, out=scaled), out=scaled)
        return np.asarray(scaled.astype(np.int16))

    def width(self, length: float) -> int:
        """A length of values in codes, a multiple of 4."""
        # a ramp of half the width has whole halves, too
        return max(4, 4 * round(length * self._scale / 4))

    @property
    def scaling(self) -> tuple[float, float, float]:
        """Offset of values, factor, and the largest code."""
        return float(self._middle), float(self._scale), float(_STEPS_OF_CODE)

    def of(self, run: Sequence[Cell]) -> list[I16]:
        """Codes of the samples of some cells, those outside of the part left out by the least number there is."""
        if all(cell in self._kept for cell in run):
            return [self._kept[cell] for cell in run]
        made = []
        for cell, (values, inside) in zip(run, self._sample(run), strict=True):
            codes = self.code(np.asarray(values, np.float32))
            if inside is not None:
                codes[~inside] = np.iinfo(np.int16).min
            made.append(codes)
            with self._lock:
                # first come, first kept: what does not fit is sampled again in each step
                keep = codes.nbytes <= self._left
                self._left -= codes.nbytes if keep else 0
            if keep:
                self._kept[cell] = codes
        return made


def void_and_slope(codes: CellCodes, control: F64, run: Sequence[Cell], width: float) -> list[tuple[float, float]]:
    """Share of each cell that is at or above the level, and the change of this share with the level.

    A sample near the level counts in part, by a ramp from half a width below it to half a width above. The mean over
    levels that far apart is off by the square of the width, and ramps of one and of half the width eliminate that
    (Richardson). The remaining error is a third of the noise of counting whole samples: with 48 samples along an edge
    the share is good to 1 or 2 in 10 000.
    """
    ramp, shares = codes.width(width), []
    for cell, found in zip(run, codes.of(run), strict=True):
        # the cells around, with the outermost ones repeated
        x, y, z = ([max(c - 1, 0), c, min(c + 1, n - 1)] for c, n in zip(cell, control.shape, strict=True))
        near = np.ascontiguousarray(control[np.ix_(x, y, z)])
        inside, wide, narrow, beside = void_at_level(found, near, weights_in_cell(len(found)), *codes.scaling, ramp)
        # Richardson: ramps of full and of half width differ by the error of second order, which cancels
        shares.append(((8 * narrow - wide) / (3 * ramp) / inside, beside / inside / width) if inside else (0.0, 0.0))
    return shares


def fit_level(
    codes: CellCodes,
    cells: list[Cell],
    targets: F64,
    start: F64,
    bounds: tuple[float, float],
    width: float,
    tolerance: float,
    steps: int,
    threads: int = 1,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> LevelFit:
    """Newton steps on the porosity of all cells at once.

    The porosity of a cell falls with the mean of the level over it by the share of samples near the level; the spline
    with the wanted changes of its means is a banded solve along each axis. Cells without an equation, outside of the
    part, follow those around them. `targets` are those of the cells, (m,), `start` are control points of the whole
    lattice, and `width` is that of the ramp of `void_and_slope`. The result does not depend on `threads`.
    """
    place, runs = tuple(np.array(cells).T), runs_along_x(cells, RUN)
    known, wanted = np.zeros(start.shape, bool), np.zeros(start.shape)
    known[place], wanted[place] = True, targets
    step = 0

    def measure(control: F64) -> tuple[F64, F64]:
        nonlocal step
        void, slope, done = np.zeros(start.shape), np.zeros(start.shape), 0
        compared = ordered_map(partial(void_and_slope, codes, control, width=width), runs, threads)
        for run, pairs in zip(runs, compared, strict=True):
            void[tuple(np.array(run).T)], slope[tuple(np.array(run).T)] = np.array(pairs).T
            done += len(run)
            progress(step * len(cells) + done, steps * len(cells))
        step += 1
        return void, slope

    def move(change: F64, held: Bools) -> F64:
        # cells outside of the part have no equation; a smooth extension keeps them from bending the level inside
        change = extended(change, known)
        return control_with_some_held(change, held) if held.any() else control_of_means(change)

    fit = newton_steps(measure, move, known, wanted, start, bounds, tolerance, steps)
    return fit._replace(errors=fit.errors[place], at_bound=fit.at_bound[place])


def runs_along_x(cells: Sequence[Cell], most: int) -> list[list[Cell]]:
    """Cells that follow each other along x, at most so many at a time, sorted by z, y, x."""
    runs: list[list[Cell]] = []
    for i, j, k in sorted(cells, key=lambda cell: cell[::-1]):
        if runs and runs[-1][-1] == (i - 1, j, k) and len(runs[-1]) < most:
            runs[-1].append((i, j, k))
        else:
            runs.append([(i, j, k)])
    return runs
