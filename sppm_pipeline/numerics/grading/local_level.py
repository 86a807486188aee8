"""The level spline that gives every cell of a lattice the porosity it should have."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.grading.level_spline import (
    control_of_means,
    control_with_some_held,
    extended,
    weights_in_cell,
)
from sppm_pipeline.numerics.threads import ordered_map

_STEPS_OF_CODE = 32766
# Choices: a Newton step is cut at this share of the range between the bounds, and over all of that range the porosity
# is taken to change at least so much.
_LONGEST_STEP, _LEAST_CHANGE = 0.25, 0.05

Sample = Callable[[tuple[int, int, int]], tuple[NDArray[np.floating], NDArray[np.bool_] | None]]
"""Gives of a cell the values that the level is compared with, (n, n, n) indexed z, y, x, and which of them count."""


class LevelFit(NamedTuple):
    """A level spline and how well it does.

    Attributes
    ----------
    control : (nx, ny, nz) float64
        Control points.
    errors : (m,) float64
        Porosity less its target of each cell.
    slopes : (m,) float64
        Change of the porosity with the level.
    at_bound : (m,) bool
        Cells whose control point lies at a bound while their error is above the tolerance.
    steps : int
        How often all cells were compared.
    """

    control: NDArray[np.float64]
    errors: NDArray[np.float64]
    slopes: NDArray[np.float64]
    at_bound: NDArray[np.bool_]
    steps: int


class CellCodes:
    """Values of cells in 16 bits, kept as far as memory goes and asked for again beyond.

    Parameters
    ----------
    sample : callable
        See `Sample`.
    middle, half : float
        Values from ``middle - half`` to ``middle + half`` are told apart in 65 532 steps.
    memory : float
        Bytes that may be kept.
    """

    def __init__(self, sample: Sample, middle: float, half: float, memory: float) -> None:
        self._sample, self._middle, self._scale = sample, middle, _STEPS_OF_CODE / half
        self._left, self._lock = memory, threading.Lock()
        self._kept: dict[tuple[int, int, int], NDArray[np.int16]] = {}

    def code(self, values: NDArray[np.floating]) -> NDArray[np.int16]:
        """Values as codes."""
        scaled = (values - self._middle) * self._scale
        np.rint(np.clip(scaled, -_STEPS_OF_CODE, _STEPS_OF_CODE, out=scaled), out=scaled)
        return np.asarray(scaled.astype(np.int16))

    def width(self, length: float) -> int:
        """A length of values in codes, a multiple of 4."""
        return max(4, 4 * round(length * self._scale / 4))

    @property
    def scaling(self) -> tuple[float, float, float]:
        """What is taken off, the factor behind it, and the largest code."""
        return float(self._middle), float(self._scale), float(_STEPS_OF_CODE)

    def of(self, cell: tuple[int, int, int]) -> NDArray[np.int16]:
        """Codes of a cell's samples, those outside of the part left out by the least number there is."""
        if cell in self._kept:
            return self._kept[cell]
        values, inside = self._sample(cell)
        codes = self.code(np.asarray(values, np.float32))
        if inside is not None:
            codes[~inside] = np.iinfo(np.int16).min
        with self._lock:
            keep = codes.nbytes <= self._left
            self._left -= codes.nbytes if keep else 0
        if keep:
            self._kept[cell] = codes
        return codes


def void_and_slope(
    codes: CellCodes, control: NDArray[np.float64], cell: tuple[int, int, int], width: float
) -> tuple[float, float]:
    """Share of a cell that is at or above the level, and the change of this share with the level.

    A sample near the level counts in part, by a ramp from half a width below it to half a width above. The mean over
    levels that far apart which this tells is off by the square of the width; ramps of one and of half the width tell by
    how much (Richardson). What is left is a third of the noise of counting whole samples: with 48 samples along an edge
    the share is good to 1 or 2 in 10 000.

    Parameters
    ----------
    codes : CellCodes
    control : (nx, ny, nz) float64
        Control points of the level.
    cell : 3 ints
    width : float
        Of the ramp, in values.
    """
    from sppm_pipeline.numerics.grading.level_rows import void_at_level

    found = codes.of(cell)
    # the cells around, with the outermost ones repeated
    x, y, z = ([max(c - 1, 0), c, min(c + 1, n - 1)] for c, n in zip(cell, control.shape, strict=True))
    near = np.ascontiguousarray(control[np.ix_(x, y, z)])
    ramp = codes.width(width)
    inside, wide, narrow, beside = void_at_level(found, near, weights_in_cell(len(found)), *codes.scaling, ramp)
    if not inside:
        return 0.0, 0.0
    return (8 * narrow - wide) / (3 * ramp) / inside, beside / inside / width


def fit_level(
    codes: CellCodes,
    cells: list[tuple[int, int, int]],
    targets: NDArray[np.float64],
    start: NDArray[np.float64],
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
    part, follow those around them.

    Parameters
    ----------
    codes : CellCodes
    cells : list of m cells
    targets : (m,) float64
        Porosities.
    start : (nx, ny, nz) float64
        Control points to begin with.
    bounds : 2 floats
        Least and largest control point.
    width : float
        Of the ramp by which samples near the level count, in values: see `void_and_slope`.
    tolerance : float
        Largest error of a cell.
    steps : int
        Comparisons at most.
    threads : int
        Number of threads; the result does not depend on it.
    progress : callable
        Told how many cells of all have been compared.
    """
    place = tuple(np.array(cells).T)
    known = np.zeros(start.shape, bool)
    known[place] = True
    control = np.clip(start, *bounds)
    span = bounds[1] - bounds[0]
    longest, least = _LONGEST_STEP * span, _LEAST_CHANGE / span
    best: LevelFit | None = None
    for step in range(1, steps + 1):
        found = np.empty((len(cells), 2))
        compared = ordered_map(partial(_compared, codes, control, width), cells, threads)
        for done, pair in enumerate(compared):
            found[done] = pair
            progress((step - 1) * len(cells) + done + 1, steps * len(cells))
        void, slope = found.T
        errors = void - targets
        stuck = (errors > tolerance) & (control[place] >= bounds[1] - 1e-9)
        stuck |= (errors < -tolerance) & (control[place] <= bounds[0] + 1e-9)
        fit = LevelFit(control, errors, slope, stuck, step)
        if best is None or _worst(fit) < _worst(best):
            best = fit
        if _worst(fit) <= tolerance:
            break
        change = np.zeros(start.shape)
        # what a cell at its bound still lacks is no reason for those around it to move
        change[place] = np.where(stuck, 0.0, np.clip(errors / np.maximum(slope, least), -longest, longest))
        change = extended(change, known)
        held = np.zeros(start.shape, bool)
        held[place] = stuck
        moved = control_with_some_held(change, held) if stuck.any() else control_of_means(change)
        control = np.clip(control + moved, *bounds)
    assert best is not None
    return best._replace(steps=step)


def _compared(
    codes: CellCodes, control: NDArray[np.float64], width: float, cell: tuple[int, int, int]
) -> tuple[float, float]:
    return void_and_slope(codes, control, cell, width)


def _worst(fit: LevelFit) -> float:
    """The largest error of the cells that can still move."""
    free = np.abs(fit.errors[~fit.at_bound])
    return float(free.max()) if len(free) else 0.0 if fit.at_bound.any() else math.inf
