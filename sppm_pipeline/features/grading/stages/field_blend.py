"""``field.blend``: blend one structure into another.

Fields made comparable by normal scores, and mixed so that the share of solid is what it should be.

The score of a value is the standard normal quantile of the share of samples below it. Where two fields are
independent, ``cos(s pi / 2) Z_1 + sin(s pi / 2) Z_2`` of their scores is standard normal again, whatever s is, so that
a cut at the quantile of the share of solid keeps that share (Heitz and Neyret 2018, "High-performance by-example noise
using a histogram-preserving blending operator"). A plain linear blend is off by up to ten points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, Palette, ScalarField, Size, Stage, option
from sppm_pipeline.features.grading.local_porosity import filled_cells
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.services.arrays import F32, F64
from sppm_pipeline.services.grid import Grid

SCORES = np.linspace(-4.5, 4.5, 1153)
"""Scores at which a table holds values: steps of 1/128. Beyond lie 7 samples in a million."""


class ScoreTable(NamedTuple):
    """Values (k,) of a field and their scores, both ascending."""

    values: F64
    scores: F64


def score_table(samples: NDArray[np.floating]) -> ScoreTable:
    """The table of a field from samples of equal weight; the score of 0 is exact. `ValueError` if all have one sign."""
    from scipy.special import ndtr, ndtri

    zero = ndtri((samples < 0).mean())
    if not np.isfinite(zero):
        raise ValueError("the samples of the field are all on one side of its surface")

    values = np.quantile(samples.astype(np.float64), ndtr(SCORES))
    # where many samples have one value, as where no kernel reaches, it has the mean of their scores
    distinct, which = np.unique(values, return_inverse=True)
    scores = np.bincount(which.ravel(), SCORES) / np.bincount(which.ravel())
    below, above = (distinct < 0) & (scores < zero), (distinct > 0) & (scores > zero)
    return ScoreTable(
        np.concatenate([distinct[below], [0.0], distinct[above]]),
        np.concatenate([scores[below], [zero], scores[above]]),
    )


def scores_of(table: ScoreTable, values: F32) -> F32:
    """Scores of values, linear in the table and beyond its ends."""
    v, z = table
    found = np.interp(values, v, z)
    for end, inner, beyond in ((0, 1, values < v[0]), (-1, -2, values > v[-1])):
        if beyond.any() and len(v) > 1:
            # rarer values than any sample go on as the last two entries of the table
            slope = (z[end] - z[inner]) / (v[end] - v[inner])
            found[beyond] = z[end] + slope * (values[beyond] - v[end])
    return found.astype(np.float32)


def blended(first: F32, second: F32, weight: F32) -> F32:
    """Scores of two independent fields mixed; a weight of 0 gives the first and of 1 the second, to the bit."""
    angle = np.float32(np.pi / 2) * weight
    mixed = np.cos(angle) * first + np.sin(angle) * second
    return np.where(weight <= 0, first, np.where(weight >= 1, second, mixed)).astype(np.float32)


NODES = 8
"""Points along a cell edge at which maps are evaluated, linear in between. A heuristic: maps vary over
cells, not within them; twice as many points take eight times the evaluations for a quarter of the error."""


@dataclass(frozen=True, eq=False)
class BlendedField(ScalarField):
    """Two fields mixed by a weight that varies from place to place: by normal scores, cut where the porosity is right.

    Lattice, size and place are those of the first one; the second one repeats or covers it.
    """

    reported: ClassVar[tuple[str, ...]] = ("porosity_first", "porosity_second")

    first: ScalarField
    second: ScalarField
    grading: Grading  # holds the map `weight`, and perhaps `porosity`
    tables: tuple[ScoreTable, ScoreTable]  # scores of values of each field
    porosities: tuple[float, float]  # what each field has by itself

    def check(self) -> None:
        """Both fields are in order, and there is a weight."""
        self.first.check()
        self.second.check()
        self.grading.law("weight")

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.first.cells

    @property
    def periodic(self) -> bool:
        return False

    @property
    def edge_mm(self) -> float | None:
        return self.first.edge_mm

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.first.origin_mm

    @property
    def finest_radius(self) -> float | None:
        return self._smaller(self.first.finest_radius, self.second.finest_radius)

    @property
    def thinnest_wall(self) -> float | None:
        return self._smaller(self.first.thinnest_wall, self.second.thinnest_wall)

    def _smaller(self, own: float | None, other: float | None) -> float | None:
        """The smaller of two lengths, each in cells of its field."""
        in_own = None if other is None else other * self.second.physical_edge() / self.first.physical_edge()
        return min((length for length in (own, in_own) if length is not None), default=None)

    def exactly(self) -> BlendedField:
        return replace(self, first=self.first.exactly(), second=self.second.exactly())

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        weight, cut = self._maps(grid, start, stop)
        parts = []
        for field, own, table, needed in (
            (self.first, grid, self.tables[0], weight.min() < 1),
            (self.second, in_cells_of(self.second, self.first, grid), self.tables[1], weight.max() > 0),
        ):
            values = field.sample_zyx(own, start, stop, threads) if needed else np.zeros_like(weight)
            parts.append(scores_of(table, values))
        return (blended(parts[0], parts[1], weight) - cut).T

    def _maps(self, grid: Grid, start: int, stop: int) -> tuple[F32, F32]:
        """The weight, and the score at the surface of the solid, (layers, ny, nx)."""
        from scipy.special import ndtri

        positions = [grid.axis(axis) for axis in range(3)]
        positions[2] = positions[2][start:stop]
        # nodes lie on a lattice fixed in space, so that values do not depend on the slab they are computed in
        low = [np.floor(t * NODES).astype(np.int64) for t in positions]
        nodes = [np.arange(k.min(), k.max() + 2) for k in low]
        edge, origin = self.first.physical_edge(), self.first.origin_mm
        z, y, x = np.meshgrid(*(nodes[a] / NODES * edge + origin[a] for a in (2, 1, 0)), indexing="ij")
        points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
        grading = self.grading.in_cells(edge, origin)
        weight = grading["weight"].at(points)
        if "porosity" in grading:
            porosity = grading["porosity"].at(points)
        else:
            # without a map of the porosity it goes from that of one field to that of the other
            porosity = (1 - weight) * self.porosities[0] + weight * self.porosities[1]
        found = []
        # scores are standard normal: the share 1 - porosity of solid lies below its quantile
        for values in (weight, ndtri(1 - porosity)):
            made = values.reshape(x.shape)
            for axis, a in ((0, 2), (1, 1), (2, 0)):
                share = (positions[a] * NODES - low[a]).reshape([-1 if i == axis else 1 for i in range(3)])
                at = low[a] - nodes[a][0]
                before, after = made.take(at, axis), made.take(at + 1, axis)
                made = before + share * (after - before)
            found.append(made.astype(np.float32))
        return found[0], found[1]

    def summary(self) -> dict[str, Any]:
        """Porosities of the two fields by themselves."""
        return {"porosity_first": self.porosities[0], "porosity_second": self.porosities[1]}


@dataclass(frozen=True, kw_only=True)
class BlendFields(Stage):
    """Blend one structure into another, for instance stochastic cells into a gyroid, without a seam.

    The map `weight` says where: 0 is the first field, 1 the second one. Values are made comparable by their normal
    scores and mixed so that the share of solid is kept; the porosity goes from that of the first field to that of the
    second, or follows the map `porosity`. Write ``from: {first: id, second: id}``. Lattice and place of the result are
    those of the first field. That the mixture is connected is no promise: check it by `check.connectivity`.
    """

    name: ClassVar[str] = "field.blend"

    probes: int = option(
        1_000_000,
        help="number of places at which each field is sampled for its scores",
        minimum=10_000,
        maximum=100_000_000,
    )

    def estimate(self, palette: Palette, first: Size, second: Size, grading: Size) -> Size:
        samples = 2.0 * self.probes
        return Size(samples=samples, sums=samples * first.body.kernels, design=first.design, geometry=first.geometry)

    def run(self, context: Context, first: ScalarField, second: ScalarField, grading: Grading) -> BlendedField:
        """Take the scores of both fields."""
        if "weight" not in grading:
            raise ConfigError(
                "there is no map `weight`", hint="make one, for example by `grade.formula` with `of: weight`"
            )
        tables, porosities = scored(context, {"first": first, "second": second}, self.probes)
        return BlendedField(first, second, grading, (tables[0], tables[1]), (porosities[0], porosities[1]))


def in_cells_of(field: ScalarField, first: ScalarField, grid: Grid) -> Grid:
    """The points of a grid in cells of a first field, in cells of another one."""
    edge, other = first.physical_edge(), field.physical_edge()
    shift = np.subtract(first.origin_mm, field.origin_mm)
    x, y, z = ((np.array(grid.origin) * edge + shift) / other).tolist()
    hx, hy, hz = (spacing * edge / other for spacing in grid.spacing)
    return Grid((x, y, z), (hx, hy, hz), grid.shape)


def scored(context: Context, fields: dict[str, ScalarField], probes: int) -> tuple[list[ScoreTable], list[float]]:
    """Scores and porosities of fields, by their names in messages; all of them cover the first one."""
    tables, porosities, (base, first) = [], [], next(iter(fields.items()))
    for which, field in fields.items():
        if field.edge_mm is None:
            raise ConfigError(
                f"the cells of the {which} field have no size in millimeters",
                hint="lay it by a `tile` stage with `cell: 5 mm`, or give `edge: 5 mm` where it is made",
            )
    own, slack = _box(first), 1e-6 * first.physical_edge()
    for which, field in fields.items():
        other = _box(field)
        if not (field is first or field.periodic) and ((own[0] < other[0] - slack) | (own[1] > other[1] + slack)).any():
            raise ConfigError(
                f"the {which} field lies in the box {other.round(6).tolist()} mm and does not cover that of the "
                f"{base}, {own.round(6).tolist()}",
                hint=f"lay both over the same part or box, or take a field that repeats as the {which} one",
            )
        values = _sampled(context, field, probes)
        try:
            tables.append(score_table(values))
        except ValueError:
            raise ConfigError(f"the {which} field is all {'void' if values[0] >= 0 else 'solid'}") from None
        porosities.append(float((values >= 0).mean()))
    return tables, porosities


def _sampled(context: Context, field: ScalarField, probes: int) -> F32:
    """Values in cells spread over the field, as many in each."""
    cells = np.argwhere(filled_cells(field)).astype(float)
    if not len(cells):
        raise ConfigError("a field has no cells")
    # 64 to 127 cells, spread over the field, if there are as many
    cells = cells[:: max(1, len(cells) // 64)]
    n = max(8, round((probes / len(cells)) ** (1 / 3)))
    h = 1.0 / n
    found = [
        field.sample_zyx(Grid((x + h / 2, y + h / 2, z + h / 2), (h,) * 3, (n,) * 3), 0, n, context.threads).ravel()
        for x, y, z in cells
    ]
    return np.concatenate(found)


def _box(field: ScalarField) -> F64:
    """Low and high corner, mm."""
    low = np.array(field.origin_mm)
    return np.array([low, low + field.physical_edge() * np.array(field.cells)])
