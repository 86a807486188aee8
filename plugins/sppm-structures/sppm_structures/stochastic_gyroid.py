"""``field.stochastic_gyroid``: a sheet gyroid whose cells, phases and walls vary at random, in places closed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, FieldMaker, Palette, ScalarField, Size, option
from sppm_pipeline.nouns import FormulaField
from sppm_structures.sizes import field_size
from sppm_structures.waves import Waves, half_space, sum_of_waves, waves_of

LID = 2.0
"""Growth of a lid inwards from the border of a closed place: values of f a standard deviation."""

SAMPLED = 150.0
"""Nanoseconds of a sample, of any number of waves."""


@dataclass(frozen=True, eq=False, kw_only=True)
class BentGyroid(FormulaField):
    """``max(f - w - lid, -f - w)`` of a gyroid f at bent positions: solid where ``-w < f < w + lid``.

    There are `repeat` gyroid cells along an edge of the cell. `bends` moves the phases along x, y and z, radians;
    `walls` is the difference of the half width w from `half_width`, values of f; `closing` is a random function of
    variance 1. The lid is ``LID max(0, closing - closed_from)``, or none.
    """

    repeat: int
    bends: tuple[Waves, Waves, Waves]
    walls: Waves
    closing: Waves
    closed_from: float | None
    half_width: float

    def evaluate(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.floating]:
        sines, cosines = [], []
        for bend, axis in zip(self.bends, (x, y, z), strict=True):
            phase = sum_of_waves(bend, x, y, z)
            phase += 2 * np.pi * ((self.repeat * axis) % 1.0)
            sines.append(np.sin(phase))
            cosines.append(np.cos(phase, out=phase))
        f = sines[0] * cosines[1]
        f += sines[1] * cosines[2]
        f += sines[2] * cosines[0]
        width = sum_of_waves(self.walls, x, y, z)
        width += self.half_width
        low = -f
        low -= width
        f -= width
        if self.closed_from is not None:
            lid = sum_of_waves(self.closing, x, y, z)
            lid -= self.closed_from
            f -= LID * np.maximum(lid, 0.0, out=lid)
        values: NDArray[np.float64] = np.maximum(f, low, out=f)
        return values

    def cut_at(self, value: float) -> BentGyroid:
        return replace(self, half_width=self.half_width + value)

    def summary(self) -> dict[str, Any]:
        """Gyroid cells and what tuning changes."""
        return {"repeat": self.repeat, "half_width": self.half_width}


@dataclass(frozen=True, kw_only=True)
class StochasticGyroid(FieldMaker):
    """A sheet gyroid ``|sin X cos Y + sin Y cos Z + sin Z cos X| < w``, bent, uneven and in places closed, at random.

    After the sheet-based stochastic gyroid of Al-Ketan et al. 2021, which varies the cells and closes some pores so
    that no direction is preferred. Here the phases are ``X = 2 pi repeat x + u(x, y, z)``, and likewise Y and Z, with
    smooth random functions u: their value shifts a cell, their slope makes it longer or shorter. Another one is added
    to the half width w. Where a last one is in its highest share `closed`, a lid is put on one of the two labyrinths:
    the solid reaches to ``f < w + lid``. All are sums of some waves of the cell, so that the structure repeats with the
    cell and not with the gyroid. These functions are our own choice, not the publication's.

    ``tune.porosity`` changes the half width.
    """

    name: ClassVar[str] = "field.stochastic_gyroid"
    is_random: ClassVar[bool] = True

    repeat: int = option(3, help="periods along an edge of the cell; of the gyroid", minimum=1, maximum=64)
    half_width: float = option(0.4, help="half the width of a sheet in values of f; its mean", above=0, below=1.5)
    bend: float = option(
        0.08, help="standard deviation of the shift along each axis", unit="gyroid cells", minimum=0, maximum=0.5
    )
    uneven: float = option(0.2, help="standard deviation of the half width over its mean", minimum=0, maximum=1)
    closed: float = option(0.1, help="share of the volume in which a labyrinth is closed", minimum=0, below=1)
    longest: float = option(
        2.0, help="longest wave vector of the random functions", unit="periods per cell size", minimum=1, maximum=8
    )

    def estimate(self, palette: Palette) -> Size:
        # a sheet of half width w takes 0.66 w of the volume, and a period has 3.1 squared periods of gyroid
        return field_size(self.edge_mm, 0.66 * self.half_width, 6.2 * self.repeat, SAMPLED)

    def run(self, context: Context) -> ScalarField:
        """Draw the random functions."""
        from statistics import NormalDist

        turn = 2 * np.pi * self.bend
        bends = (self._drawn(context, 0, turn), self._drawn(context, 1, turn), self._drawn(context, 2, turn))
        steep = max(_slope(bend, axis) for axis, bend in enumerate(bends)) / (2 * np.pi * self.repeat)
        context.report(cell_length_variation=steep)
        if 3 * steep > 1:
            context.warn(
                f"the shift changes so fast (standard deviation {steep:.2g} of the gyroid's own rate) that cells are "
                "folded back in places; a smaller `bend`, a smaller `longest` or a larger `repeat` keep them apart"
            )
        return BentGyroid(
            repeat=self.repeat,
            bends=bends,
            walls=self._drawn(context, 3, self.uneven * self.half_width),
            closing=self._drawn(context, 4, 1.0),
            closed_from=NormalDist().inv_cdf(1 - self.closed) if self.closed else None,
            half_width=self.half_width,
            edge=self.edge_mm,
        )

    def _drawn(self, context: Context, number: int, deviation: float) -> Waves:
        """A random function of mean zero that repeats with the cell."""
        most = int(self.longest)
        axis = np.arange(-most, most + 1)
        every = half_space(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3))
        vectors = every[(every * every).sum(axis=1) <= self.longest**2 + 1e-9]
        rng = context.rng(number)
        # of random size, too: the square of a wave's amplitude has an exponential distribution in a Gaussian field
        sizes = np.sqrt(rng.exponential(size=len(vectors)))
        sizes *= deviation * np.sqrt(2 / (sizes * sizes).sum())
        return waves_of(vectors, 2 * np.pi * rng.random(len(vectors)), sizes)


def _slope(waves: Waves, axis: int) -> float:
    """Standard deviation of the derivative along an axis, for positions in cell sizes."""
    squares = waves.real**2 + waves.imaginary**2
    return float(2 * np.pi * np.sqrt((squares * waves.vectors[:, axis] ** 2).sum() / 2))
