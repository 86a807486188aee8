"""``field.blend``: blend one structure into another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, Palette, ScalarField, Size, Stage, option
from sppm_pipeline.features.grading.blended import BlendedField
from sppm_pipeline.features.grading.local_porosity import filled_cells
from sppm_pipeline.features.grading.numerics.normal_scores import score_table
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.services.grid import Grid


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
        for which, field in (("first", first), ("second", second)):
            if field.edge_mm is None:
                raise ConfigError(
                    f"the cells of the {which} field have no size in millimeters",
                    hint="lay it by a `tile` stage with `cell: 5 mm`, or give `edge: 5 mm` where it is made",
                )
        own, other = _box(first), _box(second)
        slack = 1e-6 * first.physical_edge()
        if not second.periodic and ((own[0] < other[0] - slack) | (own[1] > other[1] + slack)).any():
            raise ConfigError(
                f"the second field lies in the box {other.round(6).tolist()} mm and does not cover that of the first, "
                f"{own.round(6).tolist()}",
                hint="lay both over the same part or box, or take a field that repeats as the second one",
            )
        tables, porosities = [], []
        for which, field in (("first", first), ("second", second)):
            values = self._sampled(context, field)
            try:
                tables.append(score_table(values))
            except ValueError:
                raise ConfigError(f"the {which} field is all {'void' if values[0] >= 0 else 'solid'}") from None
            porosities.append(float((values >= 0).mean()))
        return BlendedField(first, second, grading, (tables[0], tables[1]), (porosities[0], porosities[1]))

    def _sampled(self, context: Context, field: ScalarField) -> NDArray[np.float32]:
        """Values in cells spread over the field, as many in each."""
        cells = np.argwhere(filled_cells(field)).astype(float)
        if not len(cells):
            raise ConfigError("a field has no cells")
        # 64 to 127 cells, spread over the field, if there are as many
        cells = cells[:: max(1, len(cells) // 64)]
        n = max(8, round((self.probes / len(cells)) ** (1 / 3)))
        h = 1.0 / n
        found = [
            field.sample_zyx(Grid((x + h / 2, y + h / 2, z + h / 2), (h,) * 3, (n,) * 3), 0, n, context.threads).ravel()
            for x, y, z in cells
        ]
        return np.concatenate(found)


def _box(field: ScalarField) -> NDArray[np.float64]:
    """Low and high corner, mm."""
    low = np.array(field.origin_mm)
    return np.array([low, low + field.physical_edge() * np.array(field.cells)])
