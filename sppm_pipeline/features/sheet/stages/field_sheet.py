"""``field.sheet``: a sheet of solid between two random networks."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Cell, Length, Palette, PoreSet, ScalarField, Size, TunnelGraph, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.sheet.numerics.waves import Waves, relaxed, sum_of_waves, two_networks
from sppm_pipeline.method.assembly.contents import Pieces, TilingArrays
from sppm_pipeline.method.assembly.gather import Catalog, make_catalog, sample_exact
from sppm_pipeline.method.fields.microstructure import CUTOFF, Microstructure, pieces_from_graph, sampling_tables
from sppm_pipeline.nouns import FormulaField
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.nouns.size import Geometry
from sppm_pipeline.numerics import Grid, cell_centers, phase_report
from sppm_pipeline.services.arrays import F32, F64, I32
from sppm_pipeline.services.mesh.rotation import rotation
from sppm_pipeline.stage import Context, Headline, Stage, option


@dataclass(frozen=True, eq=False, kw_only=True)
class SheetField(FormulaField):
    """Solid where a sum f of waves lies within a half width of the value in the middle of the sheet."""

    reported: ClassVar[tuple[str, ...]] = ("waves", "middle", "half_width", "thinnest_wall")

    waves: Waves  # of f, whose variance is 1
    middle: float  # value of f
    half_width: float  # of f
    slope: float  # length of the gradient of f that nine tenths of the sheet do not exceed, 1 / cell size

    def evaluate(self, x: F64, y: F64, z: F64) -> NDArray[np.floating]:
        values = sum_of_waves(self.waves, x.reshape(-1), y.reshape(-1), z.reshape(-1))
        values -= self.middle
        np.abs(values, out=values)
        values -= self.half_width
        return values

    def cut_at(self, value: float) -> SheetField:
        return replace(self, half_width=self.half_width + value)

    @property
    def thinnest_wall(self) -> float | None:
        # where f is steepest the sheet is thin
        return 2 * self.half_width / self.slope if self.half_width > 0 else None

    def summary(self) -> dict[str, Any]:
        """Number of waves, the values between which there is solid, and the thickness of the thinnest tenth."""
        there = (self.waves.real != 0) | (self.waves.imaginary != 0)
        return {
            "waves": int(np.count_nonzero(there)),
            "middle": self.middle,
            "half_width": self.half_width,
            "thinnest_wall": self.thinnest_wall,
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class SheetMicrostructure(Microstructure):
    """Solid where the kernel sums of pores of two colors nearly balance, for blocks of scattered pores.

    ``|G_1 - G_2 - middle|`` takes the place of the kernel sum G of other microstructures, and the level is the half
    width of the sheet in its values.
    """

    reported: ClassVar[tuple[str, ...]] = (*Microstructure.reported, "middle", "thinnest_wall")
    counted: ClassVar[bool] = False
    is_sum: ClassVar[bool] = False  # it has a crease in its middle

    colors_of_pores: NDArray[np.int8]  # 1 or -1 of each kernel, in the order of `pieces`
    middle: float
    slope: float  # of G_1 - G_2, as in `SheetField`

    def __post_init__(self) -> None:
        object.__setattr__(self, "colors_of_pores", frozen(np.asarray(self.colors_of_pores, np.int8)))

    def check(self) -> None:
        """A color for every pore."""
        super().check()
        if self.colors_of_pores.shape != self.pieces.kernels.omega.shape or (abs(self.colors_of_pores) != 1).any():
            raise ValueError("every pore of a sheet has the color 1 or -1")

    @property
    def finest_radius(self) -> None:
        return None

    @property
    def thinnest_wall(self) -> float | None:
        return 2 * self.level / self.slope if self.slope > 0 else None

    def laid_differences(
        self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None
    ) -> F32:
        """The difference of the kernel sums of both colors in some layers of a layout, (stop - start, ny, nx)."""
        sums = [
            sample_exact(pieces, arrays, grid, CUTOFF, threads, start, stop, wanted=wanted, catalog=catalog).T
            for pieces, catalog in self._networks()
        ]
        return np.asarray(sums[0] - sums[1])

    def laid_sums(
        self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None
    ) -> F32:
        """Half width of the sheet from which on each sample of a layout is solid."""
        values = self.laid_differences(arrays, grid, start, stop, threads, wanted)
        values -= np.float32(self.middle)
        return np.abs(values, out=values)

    def _networks(self) -> list[tuple[Pieces, Catalog]]:
        """The pieces of both colors with their catalogs, made once for all levels."""
        tables = sampling_tables(self.pieces)
        if "networks" not in tables:
            tables["networks"] = [
                (pieces, make_catalog(pieces, CUTOFF)) for pieces in (self._of_color(1), self._of_color(-1))
            ]
        found: list[tuple[Pieces, Catalog]] = tables["networks"]
        return found

    def _of_color(self, color: int) -> Pieces:
        own = self.colors_of_pores == color
        before = np.concatenate([[0], np.cumsum(own)])
        return replace(
            self.pieces,
            kernels=self.pieces.kernels.taken(own, slice(None)),
            first_pore=frozen(before[self.pieces.first_pore]),
        )

    def summary(self) -> dict[str, Any]:
        """Numbers of pores, the values between which there is solid, and the thickness of the thinnest tenth."""
        return {**super().summary(), "middle": self.middle, "thinnest_wall": self.thinnest_wall}


PERIOD = 1.52
"""Period of the sheets, in mean distances of pores: the two networks are as far apart as the pores of both colors."""

KERNEL = 1.6
"""Parameter omega of the kernels of scattered pores, times the square of their mean distance."""

MEASURED_BLOCKS = 8
"""Blocks of scattered pores in which the half width for the density is measured: some 500 pores."""

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
    steps of `relaxation`, by a limiter and a band of waves of one length, after Swift and Hohenberg (1977), with
    weights that make the waves isotropic. Solid is where the field is near the middle value. An extension of the paper,
    which needs no tunnels: both networks percolate as they are, which is checked. A target porosity (`tune.porosity`, a
    tiling's `porosity`, `tune.local_porosity`) is reached by the thickness of the sheet.

    Cells are relaxed one by one, and can be repeated. Scattered pores (`tile.scattered`) are not relaxed: the field is
    the difference of the kernels of both colors, which is local; such a sheet is an eighth softer.
    """

    name: ClassVar[str] = "field.sheet"
    sources: ClassVar[tuple[str, ...]] = (
        "J. Swift, P. C. Hohenberg: Hydrodynamic fluctuations at the convective instability. Physical "
        "Review A 15, 1977. https://doi.org/10.1103/PhysRevA.15.319",
    )
    headline: ClassVar[tuple[Headline, ...]] = (Headline("period"), Headline("thinnest_wall", "thinnest wall"))
    reported: ClassVar[tuple[str, ...]] = ("period", "own_neighbors", "pockets", "void_shares.#2")

    density: float = option(
        0.3, help="expected share of solid, which sets the level; before any tuning", minimum=0.02, maximum=0.9
    )
    balance: float = option(
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
    stretch: tuple[float, float] = option(
        (1.0, 1.0), help="how many times longer; the networks along y and along z than along x, of one cell, as "
        "scattered pores follow maps", minimum=0.25, maximum=4,
    )  # fmt: skip
    turn: tuple[float, float, float] = options.turn((0.0, 0.0, 0.0), note="by which its axes are turned")
    relaxation: int = option(
        40, help="steps of relaxation; many make the sheets regular, a crystal in the end", minimum=0, maximum=1000
    )

    def estimate(self, palette: Palette, pores: Size) -> Size:
        cell = pores.cell
        periods = 1 / self._period(cell.pores, cell.cell, palette.blocks is not None)
        made = Geometry(edge_mm=cell.edge_mm, porosity=1 - self.density, surface=4.2 * periods, kernels=2.0)
        return Size(pores=cell.interiors * cell.pores, samples=(self.relaxation + 5) * 1000 * periods**3,
                    design=replace(cell, radii=(1 / periods, 0.0)), geometry=made)  # fmt: skip

    def run(self, context: Context, pores: PoreSet) -> ScalarField:
        """Color the pores, relax the field between them, and cut it."""
        from sppm_pipeline.method.connecting.candidates import candidate_graph
        from sppm_pipeline.method.sampling.graded_blocks import at_nodes

        blocks = pores.blocks
        if blocks is None and (pores.interiors > 1 or max(pores.colors) > 1):
            raise ConfigError(
                "a sheet is relaxed in one periodic cell, and this recipe is asked for a set of tiles",
                hint="lay cells by `tile.periodic`, or pores by `tile.scattered`",
            )
        if len(pores.centers) < MIN_PORES:
            raise DesignError(
                f"{len(pores.centers)} pores are too few for two networks; {MIN_PORES} or more are needed",
                hint="sample more, for example `total: 95`",
            )
        period = self._period(pores.per_cell, pores.cell, blocks is not None)
        points, repeats, metric = pores.centers % 1.0, [1.0, 1.0, 1.0], None
        if blocks is not None:
            points = pores.centers + blocks.sites[pores.piece]
            repeats = (np.array(blocks.shape, float) * blocks.periodic).tolist()
            metric = None if blocks.metric is None else at_nodes(blocks.metric, points)
        pairs, _ = candidate_graph(points, NEIGHBORS, periodic=repeats, metric=metric)
        colors = two_networks(pairs, len(points), context.rng())
        context.report(period=period, own_neighbors=float((colors[pairs[:, 0]] == colors[pairs[:, 1]]).mean()))
        if blocks is not None:
            if self.stretch != (1.0, 1.0):
                raise ConfigError(
                    "option 'stretch' is for the waves of one cell", hint="scattered pores follow a map of `stretch`"
                )
            return self._of_kernels(context, pores, colors, period)
        made = relaxed(points, colors.astype(np.float64), 1 / period, self.band, self.relaxation, self._metric())
        middle, half_width, slope = self._cut(made.samples, made.slopes)
        field = SheetField(
            waves=made.waves, middle=middle, half_width=half_width, slope=slope,
            edge=pores.cell.edge if pores.cell.physical else None,
        )  # fmt: skip
        context.report(**self._networks(field, math.ceil(SAMPLES / period)))
        return field

    def _cut(self, samples: NDArray[np.floating], slopes: NDArray[np.floating]) -> tuple[float, float, float]:
        """The value in the middle of the sheet, its half width and its steepness, from samples of the field."""
        middle = float(np.quantile(samples, 1 - self.balance))
        away = np.abs(samples - middle)
        half_width = float(np.quantile(away, self.density))
        return middle, half_width, float(np.quantile(slopes[away <= half_width], 0.9))

    def _of_kernels(
        self, context: Context, pores: PoreSet, colors: NDArray[np.int8], period: float
    ) -> SheetMicrostructure:
        """The sheet between kernels of two colors of scattered pores, cut as the blocks in their middle say."""
        from sppm_pipeline.method.families.tiler import without_faces
        from sppm_pipeline.method.sampling.graded_blocks import density_means

        blocks = pores.blocks
        assert blocks is not None
        graph = TunnelGraph(pores, np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64))
        plain = KERNEL * (PERIOD / period) ** 2

        def made(omega: F64) -> SheetMicrostructure:
            pieces = pieces_from_graph(graph, omega, np.zeros(0), "linear")
            return SheetMicrostructure(pores.cell, graph, pieces, 1.0, colors_of_pores=colors, middle=0.0, slope=0.0)

        # where maps change the density, kernels are given other sizes later
        density = (
            np.ones(len(colors)) if blocks.density is None else density_means(blocks.density)[blocks.mask][pores.piece]
        )
        micro = made(plain * density ** (2 / 3))
        arrays = without_faces(micro, blocks, 0, None, (0, 0, 0)).arrays
        n = math.ceil(SAMPLES / period / float(density.min()) ** (1 / 3))
        samples, slopes = [], []
        inmost = np.argsort(np.abs(blocks.sites - blocks.sites.mean(0)).sum(1), kind="stable")[:MEASURED_BLOCKS]
        for x, y, z in blocks.sites[inmost].tolist():
            values = micro.laid_differences(arrays, Grid((x, y, z), (1 / n,) * 3, (n,) * 3), 0, n, context.threads)
            samples.append(values)
            slopes.append(np.linalg.norm(np.gradient(values, 1 / n), axis=0))
        middle, level, slope = self._cut(np.stack(samples), np.stack(slopes))
        return replace(made(np.full(len(colors), plain)), level=level, middle=middle, slope=slope)

    def _metric(self) -> F64:
        """The matrix (3, 3) by which the structure is stretched, of determinant 1."""
        lengths = np.array([1.0, *self.stretch])
        return np.asarray(rotation(self.turn) * (lengths / lengths.prod() ** (1 / 3)))

    def _period(self, pores: float, cell: Cell, scattered: bool) -> float:
        """The period in cell sizes; `ConfigError` if it can't be relaxed in a cell."""
        period = PERIOD * max(pores, 1e-9) ** (-1 / 3) if self.period is None else cell.fraction(self.period)
        # where sheets are compressed, waves are shorter
        least = float(np.linalg.svd(self._metric(), compute_uv=False).min())
        if not scattered and not 1 / MAX_PERIODS <= least * period <= period <= 1:
            raise ConfigError(
                f"the period of the sheets is {period:.3g} cell sizes; allowed are {1 / MAX_PERIODS:g} to 1",
                hint=f"give a `period`, or {math.ceil(PERIOD**3)} to {math.floor((PERIOD * MAX_PERIODS) ** 3)} pores",
            )
        return period

    def _networks(self, field: SheetField, resolution: int) -> dict[str, object]:
        """Shares of the volume in both networks, and how many pockets there are; `DesignError` if one of them is closed
        along an axis.
        """
        grid = cell_centers(resolution, (1, 1, 1))
        x, y, z = (grid.axis(axis) for axis in range(3))
        sides = sum_of_waves(field.waves, x, y, z).T - field.middle
        shares, pockets = [], 0
        for number, side in enumerate((sides, -sides)):
            void = phase_report((side > field.half_width).view(np.uint8))
            closed = [axis for axis, way in zip("xyz", void.wraps, strict=True) if not way]
            if closed:
                which = ("first", "second")[number]
                raise DesignError(
                    f"the {which} network does not lead through the cell along {', '.join(closed)}",
                    hint="take another `seed`, more pores, a lower `density`, or a `balance` nearer to 0.5",
                )
            shares.append(float((side > field.half_width).mean()))
            pockets += void.components - 1
        return {"void_shares": shares, "pockets": pockets}
