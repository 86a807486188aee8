"""Measures of a stress-strain curve of compression: first rise, plateau, unloading, densification.

Curves are taken as straight between their readings, and looked at in steps of 0.1 % strain; where a measure lies
between two steps it is that of the straight line.

Measures of compression, each with the definition that it was computed by.

All are of nominal stress and strain. They follow ISO 13314 (porous metals) and ISO 844 (rigid cellular plastics, which
GB/T 8813 follows) as they are known from the literature; the text of neither standard was at hand. The densification
strain is that of Li, Magkiriadis and Harrigan 2006, "Compressive strain at the onset of densification of cellular
solids". The last three are those of the paper, section 3.3, whose "elastic and yielding stage" is taken to end at the
densification strain.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

EQUAL_STRAINS = (0.25, 0.4)
"""Strains up to which structures are compared by their energies."""

FOAM_STRAIN = 0.1
"""Strain at and below which ISO 844 takes stresses."""

_METALS, _FOAMS, _PAPER = "ISO 13314", "ISO 844, GB/T 8813", "paper, section 3.3"
_LI = "Li et al. 2006"


class Measure(NamedTuple):
    """A number of a curve, in the words that sweeps (`name`) and people (`label`) call it by."""

    name: str
    label: str
    value: float | None  # None if the curve has no such number; `remark` says why
    unit: str  # empty for shares, strains among them, and for what is relative to Young's modulus of the solid
    definition: str
    source: str  # where the definition is from; empty for our own
    remark: str


class Specimen(NamedTuple):
    """The compressed specimen, undeformed, and why its curve ends before it was to (`ended`, empty if it does not)."""

    unit: str = "MPa"  # of stresses; or GPa or relative
    area: float | None = None  # mm2
    height: float | None = None  # mm
    density: float | None = None  # pores included, g/cm3
    ended: str = ""

    @property
    def stress_unit(self) -> str:
        """As tables show it."""
        return "" if self.unit == "relative" else self.unit

    @property
    def energy_unit(self) -> str:
        """Of energies per volume, whose numbers are those of stresses."""
        return {"MPa": "MJ/m3", "GPa": "GJ/m3"}.get(self.unit, "")


class Table:
    """Measures of a curve that are added one by one; `ended` says why it ends where it does."""

    def __init__(self, curve: Loading, ended: str = "") -> None:
        self.curve = curve
        self.end = percent(curve.end) + (f", where {ended}" if ended else "")
        self.found: list[Measure] = []

    def add(
        self, name: str, label: str, value: float | None, unit: str, definition: str, source: str, without: str = ""
    ) -> None:
        """A measure; `without` says why there is none."""
        self.found.append(Measure(name, label, value, unit, definition, source, "" if value is not None else without))

    def ends_before(self, strain: float) -> str:
        """Why there is no measure up to a strain; empty if there is one."""
        return f"not reached: the curve ends at {self.end}" if self.curve.end < strain - 1e-9 else ""


def measures(
    strain: ArrayLike,
    stress: ArrayLike,
    specimen: Specimen = Specimen(),  # noqa: B008 - a constant
    *,
    plateau: tuple[float, float] = (0.2, 0.4),
    energy_to: float = 0.5,
) -> list[Measure]:
    """All measures of a curve (n,), nominal, positive in compression, in the order of the test.

    `plateau` are strains between which the plateau stress is taken, `energy_to` the one up to which energy is.
    `ValueError` if the curve is shorter than 0.3 % strain, or its stress is nowhere positive.
    """
    curve = loading(strain, stress)
    if not curve.stress.max() > 0:
        raise ValueError("the stress is nowhere positive; is compression counted as negative?")
    table = Table(curve, specimen.ended)
    mean, end = _plateau(table, specimen, *plateau)
    _energies(table, specimen, energy_to, end)
    elastic = None if mean is None else unloading_slope(strain, stress, mean)
    _first_rise(table, specimen, plateau[0], elastic)
    onset = _densification(table, specimen, plateau[0])
    _foam(table, specimen)
    _paper(table, specimen, onset, min(energy_to, curve.end))
    return table.found


def _plateau(table: Table, specimen: Specimen, low: float, high: float) -> tuple[float | None, float | None]:
    curve, short = table.curve, table.ends_before(high)
    within = (curve.strain >= low - 1e-9) & (curve.strain <= high + 1e-9)
    mean = None if short else float(curve.stress[within].mean())
    words = f"mean of the stress at 0.1 % steps from {percent(low)} to {percent(high)} strain"
    table.add("plateau_stress", "plateau stress", mean, specimen.stress_unit, words, _METALS, short)
    end = None if mean is None else plateau_end(curve, mean, low)
    words = (
        f"first strain beyond {percent(low)} at which the stress rises through {PLATEAU_END:g} times the plateau stress"
    )
    table.add("plateau_end", "plateau end", end, "", words, _METALS, short or f"not reached at {table.end}")
    return mean, end


def _energies(table: Table, specimen: Specimen, energy_to: float, end: float | None) -> None:
    def add(name: str, label: str, to: float | None, words: str, without: str) -> None:
        work = None if to is None or without else table.curve.work_to(to)
        share = None if work is None or to is None else work / (table.curve.highest_to(to) * to)
        area = f"area below the curve up to {words}, per volume of the undeformed specimen"
        table.add(f"energy_{name}", f"W to {label}", work, specimen.energy_unit, area, _METALS, without)
        over = f"W to {label} over the largest stress up to there times the strain"
        table.add(f"energy_efficiency_{name}", f"W_e to {label}", share, "", over, _METALS, without)

    add("to_strain", percent(energy_to), energy_to, f"{percent(energy_to)} strain", table.ends_before(energy_to))
    no_end = "" if end is not None else "the plateau end is not reached"
    add("to_plateau_end", "plateau end", end, "the plateau end", no_end)
    for to in EQUAL_STRAINS:
        short = table.ends_before(to)
        work = None if short else table.curve.work_to(to)
        words = f"area below the curve up to {percent(to)} strain: structures compare at equal strain only"
        number = round(100 * to)
        table.add(f"energy_{number}", f"W{number}", work, specimen.energy_unit, words, "", short)


def _first_rise(table: Table, specimen: Specimen, low: float, elastic: float | None) -> None:
    curve, unit = table.curve, specimen.stress_unit
    peak = first_maximum(curve, low)
    fall = percent(FALL)
    never = f"the stress never falls by {fall} up to {percent(curve.end)}"
    words = (
        f"first maximum of the stress with a fall of {fall} or more behind it, and no less than half of the largest "
        f"stress up to {percent(low)} strain"
    )
    top = None if peak is None else curve.stress_at(peak)
    table.add("first_maximum", "first maximum", top, unit, words, _METALS, never)
    table.add("first_maximum_strain", "first maximum at", peak, "", "strain of the first maximum", _METALS, never)
    line = steepest_window(curve, low if peak is None else min(peak, low))
    flat = "the stress does not rise before the plateau"
    where = "" if line is None else f", here {percent(line.first)} to {percent(line.last)}"
    words = (
        "slope of the line of least squares through the steepest window of 1 % strain and ten readings before the "
        f"first maximum and the plateau{where}"
    )
    table.add("gradient", "quasi-elastic gradient", line and line.slope, unit, words, _METALS, flat)
    for name, label, offset in (("offset_stress", "offset stress", 0.002), ("proof_strength", "proof strength", 0.01)):
        met = None if line is None else offset_stress(curve, line, offset)
        words = f"stress where the curve meets the line of that gradient, shifted by {percent(offset)} plastic strain"
        table.add(name, label, met, unit, words, _METALS, flat if line is None else "the curve does not meet the line")
    high, deep = (percent(share) for share in UNLOADED)
    words = f"slope of the first unloading between {high} and {deep} of the plateau stress"
    table.add("elastic_gradient", "elastic gradient", elastic, unit, words, _METALS, "no such loop of unloading")


def _densification(table: Table, specimen: Specimen, low: float) -> float | None:
    found = densification(table.curve, low)
    onset, best = found or (None, None)
    growing = f"not reached: the efficiency still grows where the curve ends, at {table.end}"
    words = "strain at which the efficiency, area below the curve over the stress, is largest"
    table.add("densification_strain", "densification strain", onset, "", words, _LI, growing)
    table.add("efficiency_max", "largest efficiency", best, "", "efficiency there", _LI, growing)
    work = None if onset is None else table.curve.work_to(onset)
    words = "area below the curve up to the densification strain, per volume of the undeformed specimen"
    table.add("energy_to_densification", "W to densification", work, specimen.energy_unit, words, _LI, growing)
    known = specimen.density is not None and specimen.unit != "relative"
    per_mass = work / specimen.density if work is not None and known and specimen.density else None
    unit = {"MPa": "J/g", "GPa": "kJ/g"}.get(specimen.unit, "")
    words = "that energy over the density of the specimen"
    without = "the mass of the specimen, or the unit of stresses, is not known" if not known else growing
    table.add("energy_per_mass", "W to densification per mass", per_mass, unit, words, "", without)
    return onset


def _foam(table: Table, specimen: Specimen) -> None:
    curve, short, at = table.curve, table.ends_before(FOAM_STRAIN), percent(FOAM_STRAIN)
    tenth = None if short else curve.stress_at(FOAM_STRAIN)
    table.add("stress_10", f"stress at {at}", tenth, specimen.stress_unit, f"stress at {at} strain", _FOAMS, short)
    below = curve.stress[curve.strain <= FOAM_STRAIN + 1e-9]
    top = int(np.argmax(below))
    strength = float(below[top]) if top < len(below) - 1 else None
    without = short or f"the stress still rises at {at}; its value there stands for it"
    words = f"largest stress below {at} strain"
    table.add("compressive_strength", "compressive strength", strength, specimen.stress_unit, words, _FOAMS, without)


def _paper(table: Table, specimen: Specimen, onset: float | None, otherwise: float) -> None:
    curve, stage = table.curve, onset if onset is not None else otherwise
    way = float(curve.strain[int(np.argmax(curve.stress[curve.strain <= stage + 1e-9]))])
    until = "the densification strain" if onset is not None else f"{percent(stage)} strain"
    words = f"highest force up to {until}, over the area"
    strength = curve.stress_at(way)
    table.add("yield_strength", "yield strength", strength, specimen.stress_unit, words, _PAPER)
    height, unit = (1.0, "") if specimen.height is None else (specimen.height, "mm")
    words = f"displacement at that force{'' if unit else ', over the height'}"
    table.add("effective_displacement", "effective displacement", way * height, unit, words, _PAPER)
    work, joules = curve.work_to(way), {"MPa": 1e-3, "GPa": 1.0}.get(specimen.unit)
    words = "work of the force up to there"
    if specimen.area is None or specimen.height is None or joules is None:
        words, unit = f"{words}, per volume", specimen.energy_unit
    else:
        work, unit = work * specimen.area * specimen.height * joules, "J"
    table.add("effective_energy", "effective energy", work, unit, words, _PAPER)


def percent(share: float) -> str:
    """A share or strain as people write it."""
    return f"{100 * share:.4g} %"


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
