"""The atlas: measured designs of all families, and Gaussian processes between them, on logarithms of properties.

Properties are those of draws of periodic cells of 40 pores; lengths are kept in mean distances of pores, so that cells
of any number of pores follow by similarity. Bands hold 90 % of fresh draws: the residuals of designs left out, of which
the (n + 1) 0.9-th smallest is taken (conformal prediction, Vovk et al. 2005; by leaving out, as in the jackknife).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.built_in import PLUGIN_OF, install_words
from sppm_pipeline.engine.api.registering import registry
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.nouns.length import parse_length
from sppm_pipeline.services.arrays import F64

LENGTHS, ROUGH, NOISE = (0.4, 0.8, 1.6), (0.0, 0.1, 1.0), (0.01, 0.05, 0.2)
"""Lengths of correlation over ranges of parameters, variance of what no parabola has, and variance of draws, both over
that of the property: the triple with the smallest residuals of designs left out is taken."""

PARABOLA = 3.0
"""Variance of the parabola's coefficients, over that of the property."""

COVERED = 0.9
"""Share of fresh draws that bands hold."""


class Surrogate(NamedTuple):
    """A fitted property of a family."""

    weights: F64  # of the draws, (n,)
    settings: F64  # one of `LENGTHS`, `ROUGH` and `NOISE`, (3,)
    mean: float  # of the logarithm
    deviation: float
    band: float  # half width


def covariance(a: F64, b: F64, length: float, rough: float) -> F64:
    """Covariance of parabolas and of rough rests between points (n, d) and (m, d), parameters from 0 to 1."""
    made = PARABOLA * (1 + (2 * a - 1) @ (2 * b - 1).T) ** 2 / (1 + a.shape[1]) ** 2
    if rough:
        squared = (a**2).sum(1)[:, None] + (b**2).sum(1) - 2 * a @ b.T
        made += rough * np.exp(squared / (-2 * length**2))
    return np.asarray(made)


def fitted(points: F64, values: F64, designs: F64) -> Surrogate:
    """Fit the logarithms (n,) of a property at parameters (n, d), from 0 to 1.

    Residuals are those of a design, of which `designs` has the number (n,), that was left out with all its draws.
    """
    mean, deviation = float(values.mean()), float(max(values.std(), 1e-9))
    y = (values - mean) / deviation
    groups = [np.flatnonzero(designs == number) for number in np.unique(designs)]

    def fit(length: float, rough: float, noise: float) -> tuple[float, F64, F64, F64]:
        inverse = np.linalg.inv(covariance(points, points, length, rough) + noise * np.eye(len(y)))
        weights = inverse @ y
        left = np.empty_like(y)
        for group in groups:  # what the others predict, in closed form
            left[group] = np.linalg.solve(inverse[np.ix_(group, group)], weights[group])
        return float(np.sqrt(np.mean(left**2))), weights, np.array([length, rough, noise]), np.abs(left)

    fits = (fit(*settings) for settings in product(LENGTHS, ROUGH, NOISE))
    _, weights, settings, left = min(fits, key=lambda one: one[0])
    rank = min(len(left), int(np.ceil((len(left) + 1) * COVERED)))
    return Surrogate(weights, settings, mean, deviation, deviation * float(np.sort(left)[rank - 1]))


def predicted(surrogates: Sequence[Surrogate], points: F64, at: F64) -> F64:
    """Logarithms of properties at parameters (m, d), (m, properties)."""
    made = np.empty((len(at), len(surrogates)))
    settings = [(float(one.settings[0]), float(one.settings[1])) for one in surrogates]
    for length, rough in dict.fromkeys(settings):
        own = [k for k, each in enumerate(settings) if each == (length, rough)]
        weights = np.stack([surrogates[k].deviation * surrogates[k].weights for k in own], axis=1)
        made[:, own] = covariance(at, points, length, rough) @ weights
    return np.asarray(made + np.array([one.mean for one in surrogates]))


PORES = 40
"""Pores of the cells that the atlas measures; in a cell of n pores, lengths are (n / 40)^(-1/3) times as long."""

RESOLUTION = 40
"""Voxels along an edge of these cells: 12 from pore to pore."""

SIZES = 1.8
"""Times as many for sizes, so that walls are some voxels thick."""

DARTS = "{stage: sample.dart_throwing, total: TOTAL, spacing: 0.05}"
EVEN = "{stage: sample.hyperuniform, total: TOTAL}"
JOINED = "{stage: connect.mbdst, degree: [3, 5], mode: greedy}"
KERNELS = "{stage: field.gaussian, pore_radius: PORE, tunnel_radius: TUNNEL}"
WALLS = "{stage: field.walls, tunnel_radius: HOLE, struts: STRUTS}"


class Family(NamedTuple):
    """A recipe, and the parameters that the atlas varies."""

    stages: tuple[str, ...]  # YAML; words in capitals stand for values
    ranges: Mapping[str, tuple[float, float]]  # lengths are in mean distances of pores, total ** (-1 / 3) cell sizes


POROSITY = "porosity"

_TUNNELS = {POROSITY: (0.45, 0.88), "tunnel": (0.06, 0.3)}

FAMILIES: Mapping[str, Family] = {
    "paper": Family((DARTS, JOINED, KERNELS), _TUNNELS),
    "even": Family((EVEN, JOINED, KERNELS), _TUNNELS),
    "walls": Family((EVEN, JOINED, WALLS), {POROSITY: (0.5, 0.9), "hole": (0.1, 0.4), "struts": (0.0, 0.8)}),
    "thrown_walls": Family((DARTS, JOINED, WALLS), {POROSITY: (0.5, 0.88), "hole": (0.1, 0.4), "struts": (0.0, 0.6)}),
    "sheet": Family((EVEN, "{stage: field.sheet, balance: BALANCE}"), {POROSITY: (0.5, 0.75), "balance": (0.35, 0.5)}),
    "foam": Family(
        (EVEN, "{stage: field.voronoi_foam, form: open, blend: BLEND}"), {POROSITY: (0.6, 0.93), "blend": (0.02, 0.2)}
    ),
    "spinodoid": Family(
        ("{stage: field.spinodoid, wavenumber: WAVES, shell: 0.5, cones: [CONE, CONE, CONE]}",),
        {POROSITY: (0.45, 0.75), "cone": (25, 60)},
    ),
}
"""Families; a spinodoid has a wave for the mean distance of pores, and equal cones in degrees about all axes."""

PORE = 0.44
"""Radius of the paper's pores, in mean distances of pores: that of 95 pores of omega 30 at level 0.25 in a cell of edge
2. Tuning the porosity changes it, and the tunnels with it."""


LENGTHS_OF_RECIPES = ("tunnel", "hole", "blend")
"""Parameters that are kept in mean distances of pores."""


def configuration(name: str, family: str, values: Mapping[str, float], total: int = PORES, cell: str = "") -> str:
    """A configuration that makes one cell of a design and measures what the atlas holds."""
    plugins = {PLUGIN_OF[stage] for stage in stages_of(family) if stage in PLUGIN_OF}
    needs = "".join(f"# needs {install_words(plugin)}\n" for plugin in sorted(plugins))
    length = total ** (-1 / 3)
    edge = f", edge: {cell}" if cell else ""
    words = {"TOTAL": f"{total}{edge}", "PORE": f"{PORE * length:.6g}", "WAVES": f"{1 / length:.6g}{edge}"}
    for word, value in values.items():
        words[word.upper()] = f"{value * length if word in LENGTHS_OF_RECIPES else value:.6g}"
    stages = "\n".join(f"    - {line}" for line in FAMILIES[family].stages)
    for word, text in words.items():
        stages = stages.replace(word, text)
    n, source = round(RESOLUTION * (total / PORES) ** (1 / 3)), "from: tune.porosity"
    return f"""{needs}sppm: 1
name: {name}
recipes:
  cell:
{stages}
pipeline:
  - {{stage: tune.porosity, recipe: cell, target: {values[POROSITY]:.4g}}}
  - {{stage: homogenize.voxel, resolution: {n}, grids: 2, {source}}}
  - {{stage: homogenize.conductivity, resolution: {n}, {source}}}
  - {{stage: homogenize.permeability, resolution: {n}, grids: 1, {source}}}
  - {{stage: check.sizes, resolution: {round(SIZES * n)}, {source}}}
"""


DATA = Path(__file__).with_name("atlas.npz")

LENGTH_POWERS: Mapping[str, int] = {
    "E_relative": 0, "poisson": 0, "E_ratio": 0, "conductivity": 0, "permeability": 2, "surface": -1, "strut": 1,
    "strut_thinnest": 1, "pore": 1,
}  # fmt: skip
"""Properties, and the power of a length in the unit of each."""

PROPERTIES = tuple(LENGTH_POWERS)

TOTALS = (30, 60, 95, 150)
"""Numbers of pores of a cell that are proposed."""

CANDIDATES = 500
"""Parameters that are tried in each family."""

NEAR = 0.15
"""Distance of parameters, over their ranges, below which two designs are the same to a user."""

OF_A_FAMILY = 2
"""Most designs of a family among five, so that others are seen beside them; among more its share of them."""

EQUAL = 0.03
"""Relative tolerance of conditions with ``=``, but that of the porosity, which is a parameter."""

MEASURED = ("tune.porosity", "homogenize.voxel", "homogenize.conductivity", "homogenize.permeability", "check.sizes")


class FoundDesign(NamedTuple):
    """A design that a query has found.

    Attributes
    ----------
    family : str
    parameters : mapping of name to float
        Porosity and parameters of the family; lengths in mean distances of pores.
    total : int
        Pores of a cell.
    values : mapping of property to (low, value, high)
        Expected value of a cell, and the band that 90 % of cells lie in. Lengths in mm if the query had a cell size,
        else in cell sizes.
    cell : str
        Size of the cell; empty without one.
    """

    family: str
    parameters: Mapping[str, float]
    total: int
    values: Mapping[str, tuple[float, float, float]]
    cell: str

    def configuration(self, name: str = "found") -> str:
        """A configuration that makes one cell of the design and measures it."""
        return configuration(name, self.family, self.parameters, self.total, self.cell)


def stages_of(family: str) -> list[str]:
    """Names of the stages of a family's recipe."""
    return re.findall(r"stage: ([\w.]+)", " ".join(FAMILIES[family].stages))


def versions(family: str) -> str:
    """Versions of the stages that make and measure a family, by which rows are known that others made."""
    known = registry()
    return " ".join(f"{name}={known.get(name).version}" for name in (*stages_of(family), *MEASURED))


def spread(count: int, axes: int) -> F64:
    """Evenly spread points (count, axes) from 0 to 1: an additive recurrence (Roberts 2018), of which any number of
    first points is spread evenly."""
    root = 2.0
    for _ in range(60):
        root = (1 + root) ** (1 / (axes + 1))
    powers = root ** -np.arange(1.0, axes + 1)
    return np.asarray((0.5 + np.arange(1, count + 1)[:, None] * powers) % 1)


def scaled(family: str, values: Mapping[str, float]) -> F64:
    """Parameters of a design as shares of their ranges, (1, d)."""
    return np.array([[(values[name] - a) / (b - a) for name, (a, b) in FAMILIES[family].ranges.items()]])


@dataclass(frozen=True)
class Atlas:
    """The data of the package."""

    arrays: Mapping[str, Any]

    @classmethod
    def read(cls) -> Atlas:
        """Read the data file."""
        with np.load(DATA) as file:
            return cls(dict(file))

    def stale(self) -> list[str]:
        """Families whose rows were made by other versions of their stages."""
        return [family for family in FAMILIES if str(self.arrays[f"{family}.versions"][0]) != versions(family)]

    def logs(self, family: str, at: F64) -> tuple[F64, F64]:
        """Logarithms of the properties at parameters (m, d) from 0 to 1, (m, p), and half widths of their bands, (p,);
        lengths in mean distances of pores."""
        points = self.arrays[f"{family}.points"]
        rows = zip(self.arrays[f"{family}.weights"], self.arrays[f"{family}.settings"], strict=True)
        fits = [Surrogate(w, s[:3], *map(float, s[3:])) for w, s in rows]
        logs = predicted(fits, points, at)
        ratio = PROPERTIES.index("E_ratio")
        logs[:, ratio] = np.maximum(logs[:, ratio], 0)  # the largest is at least the smallest
        return logs, np.array([one.band for one in fits])

    def band(self, family: str, values: Mapping[str, float]) -> tuple[F64, F64]:
        """Ends of the bands of all properties of a design, (p,), lengths in cell sizes of a cell of 40 pores."""
        logs, half = self.logs(family, scaled(family, values))
        scale = PORES ** (-np.array(list(LENGTH_POWERS.values())) / 3)
        return np.exp(logs[0] - half) * scale, np.exp(logs[0] + half) * scale


class _Condition(NamedTuple):
    left: Any
    sign: str
    right: Any

    def margin(self, values: Mapping[str, F64], count: int) -> F64:
        """How far it is met, relative; negative where it is not."""
        a, b = self.left.evaluate(values, count), self.right.evaluate(values, count)
        size = np.maximum(np.maximum(np.abs(a), np.abs(b)), 1e-300)
        if self.sign == "=":
            return np.asarray(np.where(np.abs(a - b) <= EQUAL * size, 1.0, -np.abs(a - b) / size))
        return np.asarray((a - b) / size if self.sign == ">" else (b - a) / size)


def _conditions(query: str, names: Sequence[str], cell: bool) -> tuple[list[_Condition], float | None]:
    """The conditions of a query, and the porosity that it asks for exactly."""
    from sppm_pipeline.services.expression import Expression

    found, porosity = [], None
    for part in query.replace("^", "**").split(","):
        match = re.fullmatch(r"(.+?)\s*(>=|<=|==|=|>|<)\s*(.+)", part.strip())
        if match is None:
            raise ConfigError(
                f"{part.strip()!r} is no condition",
                hint='for example "E_relative > 0.1, porosity = 0.7, strut > 0.3 mm"',
            )
        sides = [re.sub(r"(?<=\d)\s*mm\b", "", side) for side in (match[1], match[3])]
        if sides != [match[1], match[3]] and not cell:
            raise ConfigError(f"{part.strip()!r} is in mm, and the size of the cell is missing", hint="`cell`: 4 mm")
        left, right = (Expression(side, names) for side in sides)
        exact = left.text.strip() == POROSITY and match[2] in ("=", "==") and not right.used
        if exact and porosity is None:
            porosity = float(right.evaluate({}, 1)[0])
        else:
            found.append(_Condition(left, match[2].replace("==", "=")[0], right))
    return found, porosity


def find(
    query: str, *, cell: str | None = None, count: int = 5, minimize: str = "", maximize: str = ""
) -> list[FoundDesign]:
    """Designs that meet conditions, by the atlas: nothing is computed but interpolation.

    Parameters
    ----------
    query : str
        Conditions with commas between them, of formulas of `E_relative`, `poisson`, `E_ratio` (largest over smallest
        Young's modulus), `conductivity` (of the solid), `permeability`, `surface` (a volume), `strut`,
        `strut_thinnest`, `pore` and `porosity`. Lengths are in mm with a `cell`, else in cell sizes.
    cell : str, optional
        Size of a cell, such as ``"4 mm"``.
    count : int
        Designs that are returned at most; they differ.
    minimize, maximize : str, optional
        A formula by which designs are ordered; by the least relative margin of all conditions if omitted.

    Raises
    ------
    ConfigError
        If a condition can't be read, or none of the candidates meets all.

    Examples
    --------
    >>> import sppm_pipeline as sppm
    >>> designs = sppm.find("E_relative > 0.05, porosity = 0.7", cell="4 mm", maximize="permeability")
    >>> designs[0].values["E_relative"][1] > 0.05
    True
    """
    return searched(query, cell=cell, count=count, minimize=minimize, maximize=maximize)[0]


def searched(
    query: str, *, cell: str | None, count: int, minimize: str = "", maximize: str = ""
) -> tuple[list[FoundDesign], Mapping[str, F64]]:
    """The designs of `find`, and the properties of all candidates that meet the conditions."""
    from sppm_pipeline.services.expression import Expression

    try:
        edge = parse_length(cell).mm() if cell else 1.0
    except ValueError as error:
        raise ConfigError(f"`cell` is {cell!r}: {error}", hint="for example `4 mm`") from None
    if not edge > 0 or count < 1:
        raise ConfigError(f"`cell` is {cell!r} and `count` {count}; both should be above 0")
    if minimize and maximize:
        raise ConfigError("designs are ordered by one formula", hint="give `minimize` or `maximize`")
    names = (*PROPERTIES, POROSITY)
    conditions, porosity = _conditions(query, names, cell is not None)
    atlas = Atlas.read()
    rows: list[tuple[str, F64, int, F64]] = []
    tables: list[F64] = []
    powers = np.array(list(LENGTH_POWERS.values()))
    for family, (_, ranges) in FAMILIES.items():
        low, high = ranges[POROSITY]
        if porosity is not None and not low <= porosity <= high:
            continue
        at = spread(CANDIDATES, len(ranges))
        at[:, 0] = at[:, 0] if porosity is None else (porosity - low) / (high - low)
        logs, half = atlas.logs(family, at)
        bands = np.exp(half)
        for total in TOTALS:
            values = np.exp(logs) * (edge * total ** (-1 / 3)) ** powers
            tables.append(np.column_stack([values, low + at[:, 0] * (high - low)]))
            rows += [(family, point, total, bands) for point in at]
    if not tables:
        ranges_ = ", ".join(f"{name} {f.ranges[POROSITY]}" for name, f in FAMILIES.items())
        raise ConfigError(f"no family has the porosity {porosity:g}", hint=f"there are {ranges_}")
    table = np.concatenate(tables)
    columns = dict(zip(names, table.T, strict=True))
    margins = [condition.margin(columns, len(table)) for condition in conditions] or [np.ones(len(table))]
    margin = np.min(margins, axis=0)
    aim = Expression(minimize or maximize, names).evaluate(columns, len(table)) if minimize or maximize else -margin
    aim = -aim if maximize else aim
    good = np.flatnonzero(margin > 0)
    if not len(good):
        best = int(np.argmax(margin))
        near = ", ".join(f"{name} {columns[name][best]:.3g}" for name in names)
        raise ConfigError(
            "no design of the atlas meets all conditions", hint=f"the nearest, {rows[best][0]}, has {near}"
        )
    chosen: list[int] = []
    of_a_family = max(OF_A_FAMILY, -(-count // len(FAMILIES)))
    for k in good[np.argsort(aim[good], kind="stable")]:
        family, point, *_ = rows[k]
        own = [j for j in chosen if rows[j][0] == family]
        if len(own) < of_a_family and all(np.abs(rows[j][1] - point).max() > NEAR for j in own):
            chosen.append(int(k))
        if len(chosen) == count:
            break
    found = []
    for k in chosen:
        family, point, total, bands = rows[k]
        values = {
            name: (
                max(float(table[k, p] / bands[p]), name == "E_ratio"),
                float(table[k, p]),
                float(table[k, p] * bands[p]),
            )
            for p, name in enumerate(PROPERTIES)
        }
        parameters = {
            name: float(f"{a + share * (b - a):.4g}")
            for share, (name, (a, b)) in zip(point, FAMILIES[family].ranges.items(), strict=True)
        }
        found.append(FoundDesign(family, parameters, total, values, cell or ""))
    return found, {name: column[good] for name, column in columns.items()}
