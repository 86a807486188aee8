"""``field.sheet``: a sheet of solid between two random networks."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sppm_pipeline import (
    Cell,
    ConfigError,
    Context,
    DesignError,
    Headline,
    Length,
    Palette,
    PoreSet,
    ScalarField,
    Size,
    Stage,
    option,
    options,
)
from sppm_pipeline.features.sheet.sheet_field import SheetField
from sppm_pipeline.nouns.size import Geometry
from sppm_pipeline.numerics import cell_centers, phase_report

PERIOD = 1.52
"""Period of the sheets, in mean distances of pores: the two networks are as far apart as the pores of both colors."""

NEIGHBORS = 12
"""Nearest pores that are taken for neighbors of a pore; those that find it come on top."""

MIN_PORES = 8
"""Fewer pores have no room for two networks."""

MAX_PERIODS = 16.0
"""Periods along an edge of the cell: the grid on which they are relaxed takes 0.5 GB."""

SAMPLES = 16
"""Samples a period on which both networks are followed, more than three across the thinnest sheets that are printed."""


@dataclass(frozen=True, kw_only=True)
class SheetStage(Stage):
    """Put a sheet of solid between two random networks of void: a gyroid without order, open, stiff and isotropic.

    Pores are given two colors so that each color is one connected network. The field is positive around the pores of
    one color and negative around those of the other, and is relaxed until its zero is nearly a minimal surface: in
    `steps` of a limiter and a band of waves of one length, after Swift and Hohenberg (1977), with weights that make the
    waves alike in all directions. Solid is where the field is near the middle value. An extension of the paper, which
    needs no tunnels: both networks percolate as they are, which is checked. One periodic cell is made, which can be
    repeated. A target porosity (`tune.porosity`) is reached by the thickness of the sheet.
    """

    name: ClassVar[str] = "field.sheet"
    headline: ClassVar[tuple[Headline, ...]] = (Headline("period"), Headline("thinnest_wall", "thinnest wall"))
    reported: ClassVar[tuple[str, ...]] = ("period", "own_neighbors", "pockets", "void_shares.#2")

    density: float = option(0.3, help="share of solid, before any tuning", minimum=0.02, maximum=0.9)
    share: float = option(
        0.5, help="share of the volume on the first network's side of the middle of the sheet: with unequal ones more "
        "flows, through the wider network", minimum=0.25, maximum=0.75,
    )  # fmt: skip
    period: Length | None = option(
        None, help="distance after which sheets repeat, of which each has two; 1.52 mean distances of pores if omitted",
        unit="cell size", above=0, maximum=1,
    )  # fmt: skip
    band: float = option(
        0.2, help="relative width of the band of wave lengths: a narrow one has more regular sheets",
        minimum=0.05, maximum=0.5,
    )  # fmt: skip
    steps: int = option(20, help="steps of relaxation", minimum=0, maximum=1000)

    def estimate(self, palette: Palette, pores: Size) -> Size:
        cell = pores.cell
        periods = 1 / self._period(cell.pores, cell.cell)
        made = Geometry(edge_mm=cell.edge_mm, porosity=1 - self.density, surface=4.2 * periods, kernels=2.0)
        return Size(pores=cell.interiors * cell.pores, samples=(self.steps + 5) * 1000 * periods**3,
                    design=replace(cell, radii=(1 / periods, 0.0)), geometry=made)  # fmt: skip

    def run(self, context: Context, pores: PoreSet) -> ScalarField:
        """Color the pores, relax the field between them, and cut it."""
        from sppm_pipeline.features.sheet.numerics.coloring import two_networks
        from sppm_pipeline.features.sheet.numerics.waves import relaxed
        from sppm_pipeline.method.connecting.candidates import candidate_graph

        if pores.interiors > 1 or max(pores.colors) > 1 or pores.blocks is not None:
            raise ConfigError(
                "a sheet is relaxed in one periodic cell, and this recipe is asked for several",
                hint="lay it by `tile.periodic`, or make a larger cell with more pores",
            )
        points = pores.centers % 1.0
        if len(points) < MIN_PORES:
            raise DesignError(
                f"{len(points)} pores are too few for two networks; {MIN_PORES} or more are needed",
                hint="sample more, for example `total: 95`",
            )
        pairs, _ = candidate_graph(points, NEIGHBORS, periodic=True)
        colors = two_networks(pairs, len(points), context.rng())
        period = self._period(len(points), pores.cell)
        made = relaxed(points, colors.astype(np.float64), 1 / period, self.band, self.steps)
        # void of both sides in the shares asked for, on either side of a sheet of the same half width
        middle = float(np.quantile(made.samples, 1 - self.share))
        half_width = float(np.quantile(np.abs(made.samples - middle), self.density))
        near = np.abs(made.samples - middle) <= half_width
        field = SheetField(
            waves=made.waves, middle=middle, half_width=half_width, slope=float(np.quantile(made.slopes[near], 0.9)),
            edge=pores.cell.edge if pores.cell.physical else None,
        )  # fmt: skip
        context.report(
            period=period, own_neighbors=float((colors[pairs[:, 0]] == colors[pairs[:, 1]]).mean()),
            **self._networks(field, math.ceil(SAMPLES / period)),
        )  # fmt: skip
        return field

    def _period(self, pores: float, cell: Cell) -> float:
        """The period in cell sizes."""
        period = PERIOD * max(pores, 1e-9) ** (-1 / 3) if self.period is None else cell.fraction(self.period)
        if not 1 / MAX_PERIODS <= period <= 1:
            raise ConfigError(
                f"sheets with a period of {period:.3g} cell sizes can't be relaxed; allowed are {1 / MAX_PERIODS:g} to 1",
                hint=f"give a `period`, or {math.ceil(PERIOD**3)} to {math.floor((PERIOD * MAX_PERIODS) ** 3)} pores",
            )
        return period

    def _networks(self, field: SheetField, resolution: int) -> dict[str, object]:
        """Shares of the volume in both networks, and how many pockets there are.

        Raises
        ------
        DesignError
            If one of them is closed along an axis.
        """
        from sppm_pipeline.features.sheet.numerics.waves import sum_of_waves

        grid = cell_centers(resolution, (1, 1, 1))
        x, y, z = (grid.axis(axis) for axis in range(3))
        sides = sum_of_waves(field.waves, x, y, z).T - field.middle
        shares, pockets = [], 0
        for number, side in enumerate((sides, -sides)):
            void = phase_report((side > field.half_width).view(np.uint8))
            closed = [axis for axis, way in zip("xyz", void.wraps, strict=True) if not way]
            if closed:
                raise DesignError(
                    f"the {('first', 'second')[number]} network does not lead through the cell along {', '.join(closed)}",
                    hint="take another `seed`, more pores, a lower `density`, or a `share` nearer to 0.5",
                )
            shares.append(float((side > field.half_width).mean()))
            pockets += void.components - 1
        return {"void_shares": shares, "pockets": pockets}
