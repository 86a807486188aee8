"""A field that blends one field into another, of any kind."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.grading.numerics.normal_scores import ScoreTable, blended, scores_of
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.services.grid import Grid

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

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        weight, cut = self._maps(grid, start, stop)
        parts = []
        for field, own, table, needed in (
            (self.first, grid, self.tables[0], weight.min() < 1),
            (self.second, self._in_second(grid), self.tables[1], weight.max() > 0),
        ):
            values = field.sample_zyx(own, start, stop, threads) if needed else np.zeros_like(weight)
            parts.append(scores_of(table, values))
        return (blended(parts[0], parts[1], weight) - cut).T

    def _in_second(self, grid: Grid) -> Grid:
        """The same points in cells of the second field."""
        edge, other = self.first.physical_edge(), self.second.physical_edge()
        shift = np.subtract(self.first.origin_mm, self.second.origin_mm)
        x, y, z = ((np.array(grid.origin) * edge + shift) / other).tolist()
        hx, hy, hz = (spacing * edge / other for spacing in grid.spacing)
        return Grid((x, y, z), (hx, hy, hz), grid.shape)

    def _maps(self, grid: Grid, start: int, stop: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
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
