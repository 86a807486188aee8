"""Measures of a stress-strain curve of compression: first rise, plateau, unloading, densification.

Curves are taken as straight between their readings, and looked at in steps of 0.1 % strain; where a measure lies
between two steps it is that of the straight line.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

STEP = 1e-3
"""Strain between the points at which curves are looked at."""

WINDOW, READINGS = 0.01, 10
"""Strain and readings that the steepest window spans at least."""

FALL = 0.02
"""Share by which the stress falls after its first maximum at least."""

PLATEAU_END = 1.3
"""Times the plateau stress at which the plateau ends."""

UNLOADED = (0.7, 0.2)
"""Shares of the plateau stress between which the slope of unloading is taken."""


class Steepest(NamedTuple):
    """The straight line through the steepest window of a curve."""

    slope: float
    root: float  # strain at which the line has no stress
    first: float  # strains that bound the window
    last: float


class Loading(NamedTuple):
    """A curve (n,) in steps of 0.1 % strain from zero, without its loops of unloading."""

    strain: Array
    stress: Array
    work: Array  # area below the curve up to here
    spacing: float  # median strain between readings

    @property
    def end(self) -> float:
        """Largest strain."""
        return float(self.strain[-1])

    def stress_at(self, strain: float) -> float:
        """Stress at a strain."""
        return float(np.interp(strain, self.strain, self.stress))

    def work_to(self, strain: float) -> float:
        """Area below the curve up to a strain."""
        at = min(int(np.searchsorted(self.strain, strain, "right")) - 1, len(self.strain) - 1)
        rest = strain - float(self.strain[at])
        return float(self.work[at]) + rest * (float(self.stress[at]) + self.stress_at(strain)) / 2

    def highest_to(self, strain: float) -> float:
        """Largest stress up to a strain."""
        return max(float(self.stress[self.strain <= strain].max()), self.stress_at(strain))


def loading_branch(strain: ArrayLike, stress: ArrayLike) -> tuple[Array, Array]:
    """The readings at which the strain exceeds all earlier ones."""
    e, s = np.asarray(strain, np.float64), np.asarray(stress, np.float64)
    before = np.concatenate([[-np.inf], np.maximum.accumulate(e)[:-1]])
    return e[e > before], s[e > before]


def loading(strain: ArrayLike, stress: ArrayLike) -> Loading:
    """A curve in steps of 0.1 % strain, three or more; from no strain to its first reading it rises from no stress."""
    e, s = loading_branch(strain, stress)
    spacing = float(np.median(np.diff(e))) if len(e) > 1 else 0.0
    if e[0] > 0:
        e, s = np.concatenate([[0.0], e]), np.concatenate([[0.0], s])
    steps = int(np.floor(e[-1] / STEP + 1e-9))
    if steps < 3:
        raise ValueError(f"the curve ends at a strain of {e[-1]:.3g}; measures need {3 * STEP:g} or more")
    # divided, not multiplied by the step: 0.3 becomes the number that 0.3 is written as
    grid = np.arange(steps + 1) / round(1 / STEP)
    on_grid = np.interp(grid, e, s)
    work = np.concatenate([[0.0], np.cumsum((on_grid[1:] + on_grid[:-1]) / 2) * STEP])
    return Loading(grid, on_grid, work, spacing)


def first_maximum(curve: Loading, within: float) -> float | None:
    """Strain of the first maximum after which the stress falls by 2 %; None if there is none.

    Maxima below half of the largest stress up to the strain `within` are passed over, as noise before contact and
    waves after it are full of them: a heuristic. A quarter would let waves through, and all of it hide a first
    maximum.
    """
    highest = np.maximum.accumulate(curve.stress)
    fallen = (curve.stress <= (1 - FALL) * highest) & (highest >= 0.5 * curve.highest_to(within))
    if not fallen.any():
        return None
    return float(curve.strain[int(np.argmax(curve.stress[: int(np.argmax(fallen)) + 1]))])


def steepest_window(curve: Loading, before: float) -> Steepest | None:
    """The line of least squares through the steepest window of 1 % strain and ten readings, up to a strain.

    Where the curve up to there is shorter, the window is all of it. None if the stress rises nowhere.
    """
    known = int(np.searchsorted(curve.strain, before + 1e-9, "right"))
    width = int(np.ceil(max(WINDOW, (READINGS - 1) * curve.spacing) / STEP - 1e-9))
    width = min(width, known - 1)
    if width < 2:
        return None
    from_middle = np.arange(width + 1) - width / 2
    windows = np.lib.stride_tricks.sliding_window_view(curve.stress[:known], width + 1)
    slopes = windows @ from_middle / (from_middle @ from_middle) / STEP
    at = int(np.argmax(slopes))
    slope = float(slopes[at])
    if slope <= 0:
        return None
    first, last = float(curve.strain[at]), float(curve.strain[at + width])
    return Steepest(slope, (first + last) / 2 - float(windows[at].mean()) / slope, first, last)


def unloading_slope(strain: ArrayLike, stress: ArrayLike, plateau: float) -> float | None:
    """Slope of the first unloading that goes from 70 % to 20 % of the plateau stress, between these stresses."""
    e, s = np.asarray(strain, np.float64), np.asarray(stress, np.float64)
    highest = np.maximum.accumulate(e)
    high, low = (share * plateau for share in UNLOADED)
    back = np.flatnonzero(e < highest - STEP / 2)
    while len(back):
        start = int(np.argmax(e[: back[0]]))
        ahead = np.flatnonzero(e[back[0] :] >= highest[back[0]])
        end = int(back[0] + ahead[0]) if len(ahead) else len(e)
        turn = start + int(np.argmin(e[start:end]))
        way, fall = e[start : turn + 1][::-1], np.maximum.accumulate(s[start : turn + 1][::-1])
        if fall[0] <= low and fall[-1] >= high:
            over = float(np.interp(high, fall, way) - np.interp(low, fall, way))
            if over > 0:
                return (high - low) / over
        back = back[back >= end]
    return None


def offset_stress(curve: Loading, line: Steepest, offset: float) -> float | None:
    """Stress at which the curve first meets the line of the first rise that is shifted by a plastic strain."""
    above = curve.stress - line.slope * (curve.strain - line.root - offset)
    under = np.flatnonzero((above <= 0) & (curve.strain > line.first))
    if not len(under) or under[0] == 0:
        return None
    i = int(under[0])
    share = above[i - 1] / (above[i - 1] - above[i]) if above[i - 1] > above[i] else 0.0
    return float(curve.stress[i - 1] + share * (curve.stress[i] - curve.stress[i - 1]))


def plateau_end(curve: Loading, plateau: float, beyond: float) -> float | None:
    """Strain beyond `beyond` at which the stress first rises through 1.3 times the plateau stress."""
    above = curve.stress - PLATEAU_END * plateau
    through = np.flatnonzero((above[1:] >= 0) & (above[:-1] < 0) & (curve.strain[1:] > beyond))
    if not len(through):
        return None
    i = int(through[0])
    return float(curve.strain[i] + STEP * above[i] / (above[i] - above[i + 1]))


def efficiency(curve: Loading, within: float) -> Array:
    """Work up to each strain over the stress there, (n,); NaN where there is no stress, and before it has risen.

    It has where it first reaches half of its largest value up to the strain `within`: a heuristic, as in the toe before
    that the efficiency has no meaning. Not sensitive: the largest efficiency lies far beyond.
    """
    start = int(np.argmax(curve.stress >= 0.5 * curve.highest_to(within)))
    known = (np.arange(len(curve.stress)) >= start) & (curve.stress > 0)
    return np.where(known, curve.work / np.where(known, curve.stress, 1.0), np.nan)


def densification(curve: Loading, within: float) -> tuple[float, float] | None:
    """Strain at which `efficiency` is largest, and the efficiency there; None if it still grows where the curve ends.

    It must lie 1 % strain before the end, so that noise of the last readings is no maximum: a heuristic. On a straight
    line the efficiency grows, or falls and then grows, so that it is largest at a step.
    """
    eta = efficiency(curve, within)
    if np.isnan(eta).all():
        return None
    at = int(np.nanargmax(eta))
    if at == int(np.argmin(np.isnan(eta))) or curve.end - curve.strain[at] < WINDOW:
        return None
    return float(curve.strain[at]), float(eta[at])


def work_ratio(energy: float, stress: float, area: float, displacement: float) -> float:
    """Energy (J) over stress (MPa) times area (mm2) times way (mm): at most 1 for the largest force on that way."""
    return energy / (stress * area * displacement * 1e-3)


def mean_and_spread(curves: Sequence[tuple[ArrayLike, ArrayLike]]) -> tuple[Array, Array, Array]:
    """Strains in steps of 0.1 % to the shortest of two or more curves, mean stress and sample standard deviation."""
    each = [loading(*one) for one in curves]
    n = min(len(one.strain) for one in each)
    stresses = np.array([one.stress[:n] for one in each])
    return each[0].strain[:n], stresses.mean(axis=0), stresses.std(axis=0, ddof=1)
