"""Stages that figures of the paper need: pores at given places, pores as bodies, the scores of its worked example."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, Sampler, ScalarField, Stage, option
from sppm_pipeline.method.fields.scalar_field import WrappedField
from sppm_pipeline.method.tiling.statistics import rule2_scores
from sppm_pipeline.method.tiling.wang import tile_colors


@dataclass(frozen=True, kw_only=True)
class Given(Sampler):
    """Place pores at given points of the cell."""

    name: ClassVar[str] = "sample.given"

    x: tuple[float, ...] = option(help="of the pores", unit="cell sizes", minimum=0, maximum=1)
    y: tuple[float, ...] = option(help="of the pores", unit="cell sizes", minimum=0, maximum=1)
    z: float = option(0.5, help="of all pores", unit="cell sizes", minimum=0, maximum=1)

    def check_options(self) -> None:
        """As many x as y."""
        if len(self.x) != len(self.y):
            raise ConfigError(f"`x` has {len(self.x)} values and `y` {len(self.y)}")

    def throw(self, rng, box):
        return np.stack([self.x, self.y, np.full(len(self.x), self.z)], axis=1)


@dataclass(frozen=True, eq=False)
class Bodies(WrappedField):
    """The void of a field as a solid."""

    def sample_layers(self, grid, start, stop, threads=1):
        return -self.base.sample_layers(grid, start, stop, threads)


@dataclass(frozen=True, kw_only=True)
class PoresAsBodies(Stage):
    """Make a solid of the pores and tunnels of a field."""

    name: ClassVar[str] = "field.bodies"

    def run(self, context: Context, field: ScalarField) -> ScalarField:
        return Bodies(field)


PLACED = {
    # place in the 2 x 2 x 2 structure: colors of the tile across x, y and z
    "F1": ((0, 0, 1), (0, 2, 1)),
    "F2": ((1, 0, 0), (1, 2, 1)),
    "L1": ((0, 0, 0), (0, 0, 0)),
    "L2": ((1, 1, 0), (1, 1, 0)),
    "P1": ((0, 1, 0), (0, 1, 1)),
}
"""The five tiles that are there; red, blue and green are 0, 1 and 2."""

FREE, CANDIDATES = (1, 0, 1), {"T1": (0, 1, 1), "T2": (0, 2, 1), "T3": (0, 0, 1)}
"""The place to be filled, and the three tiles that Rule 1 allows there: T1 equals P1, T2 equals F1."""


@dataclass(frozen=True, kw_only=True)
class WorkedExample(Stage):
    """Score the three candidates of the paper's example of Rule 2 by the rule that `tile.wang_3color` uses."""

    name: ClassVar[str] = "check.worked_example"
    reported: ClassVar[tuple[str, ...]] = ("T1", "T2", "T3")

    def run(self, context: Context) -> None:
        number = {tuple(int(c) for c in row): n for n, row in enumerate(tile_colors(3))}
        tiles = np.full((2, 2, 2), -1)
        for place, colors in PLACED.values():
            tiles[place] = number[colors]
        for name, colors in CANDIDATES.items():
            tiles[FREE] = number[colors]
            context.report(**{name: int(rule2_scores(tiles)[0][FREE])})
