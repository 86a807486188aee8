"""The level spline that gives every cell of a lattice the porosity it should have."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.grading.level_spline import (
    control_of_means,
    control_with_some_held,
    extended,
    rows_of_cell,
)

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
        self._left = memory
        self._kept: dict[tuple[int, int, int], NDArray[np.int16]] = {}

    def code(self, values: NDArray[np.floating]) -> NDArray[np.int16]:
        """Values as codes."""
        scaled = (values - self._middle) * self._scale
        np.rint(np.clip(scaled, -_STEPS_OF_CODE, _STEPS_OF_CODE, out=scaled), out=scaled)
        return np.asarray(scaled.astype(np.int16))

    def width(self, length: float) -> int:
        """A length of values in codes."""
        return round(length * self._scale)

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
        if codes.nbytes <= self._left:
            self._left -= codes.nbytes
            self._kept[cell] = codes
        return codes


def void_and_slope(
    codes: CellCodes, control: NDArray[np.float64], cell: tuple[int, int, int], half_width: float
) -> tuple[float, float]:
    """Share of the samples of a cell at or above the level, and the change of this share with the level."""
    from sppm_pipeline.numerics.grading.level_rows import counts_at_level

    found = codes.of(cell)
    n = len(found)
    t = 1 + (np.arange(n) + 0.5) / n
    # the cells around, with the outermost ones repeated, as the spline of one cell in the middle of three
    near = [np.clip(np.arange(c - 1, c + 2), 0, size - 1) for c, size in zip(cell, control.shape, strict=True)]
    rows, weights = rows_of_cell(control[np.ix_(*near)], t)
    inside, above, beside = counts_at_level(found, rows, weights, *codes.scaling, codes.width(half_width))
    return (above / inside, beside / inside / (2 * half_width)) if inside else (0.0, 0.0)


def fit_level(
    codes: CellCodes,
    cells: list[tuple[int, int, int]],
    targets: NDArray[np.float64],
    start: NDArray[np.float64],
    bounds: tuple[float, float],
    half_width: float,
    tolerance: float,
    steps: int,
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
    half_width : float
        Samples so near to the level tell the slope.
    tolerance : float
        Largest error of a cell.
    steps : int
        Comparisons at most.
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
        found = []
        for done, cell in enumerate(cells):
            found.append(void_and_slope(codes, control, cell, half_width))
            progress((step - 1) * len(cells) + done + 1, steps * len(cells))
        void, slope = np.array(found).T
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


def _worst(fit: LevelFit) -> float:
    """The largest error of the cells that can still move."""
    free = np.abs(fit.errors[~fit.at_bound])
    return float(free.max()) if len(free) else 0.0 if fit.at_bound.any() else math.inf
