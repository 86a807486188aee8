"""Newton steps by which a level gives each cell its porosity, on a lattice or on cells of any shape."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Heuristics that bound a step where the slope is measured on few samples or vanishes; with half or double the
# result agrees within the tolerance, as only the path to it differs.
_MAX_STEP = 0.25  # of the range between the bounds
_MIN_CHANGE = 0.05  # of the porosity over all of that range


class LevelFit(NamedTuple):
    """A level, and the errors it leaves; arrays of the shape of the cells."""

    values: NDArray[np.float64]
    errors: NDArray[np.float64]  # porosity minus its target; 0 for cells without an equation
    at_bound: NDArray[np.bool_]  # cells whose value lies at a bound while their error is above the tolerance
    steps: int  # number of times that all cells were compared


def newton_steps(
    measure: Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]],
    move: Callable[[NDArray[np.float64], NDArray[np.bool_]], NDArray[np.float64]],
    known: NDArray[np.bool_],
    targets: NDArray[np.float64],
    start: NDArray[np.float64],
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
