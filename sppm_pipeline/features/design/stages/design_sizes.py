"""``design.sizes``: the cell size and the porosity that give struts and pores of sizes in millimeters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, Length, Microstructure, Recipe, RecipeSize, ScalarField, Size, Stage, option, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.connectivity.components import find_components
from sppm_pipeline.method.families.tiler import without_faces
from sppm_pipeline.method.nouns.cell_sizes import CellSizes
from sppm_pipeline.nouns.palette import Blocks, Palette
from sppm_pipeline.services.arrays import F32
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.services.local_thickness import LimitSizes, limit_sizes, local_thickness, squared_distance

TORUS = (True, True, True)

POROSITIES = (0.05, 0.95)
"""Porosities that are searched; beyond, one phase of every cell measured was in pieces."""

MIN_CONNECTED = 0.9
"""Least share of a phase in its largest component: later stages refuse to remove 10 % of the solid or more."""

CLOSE = 0.01
"""Relative error of the ratio at which the corrections end; each size gets half of it, a fifth of what a draw scatters.
Half of it takes about one more evaluation."""

TOO_NARROW = 1.9
"""Voxels by which balls are too small whose centers go from voxel to voxel through a round channel: 1.9 +- 0.35 in
channels of 8 to 14 voxels in seven directions. Two grids would not do, as throats go in steps of a part of a voxel."""

THROAT_CLOSE = 0.04
"""That which is taken in the end where throats are asked for: ten voxels go in steps of this size."""

CORRECTIONS = 8
"""Most evaluations on the fine grid; cells took one to three, more only where a phase measures few voxels."""

MAX_STEP = 0.25
"""Largest step of the porosity by the slope of the coarse grid, which is flat where walls vanish."""

FAR = 0.7
"""Logarithm of a ratio over that asked for, beyond which it is taken as this much off."""

SCAN = 0.02
"""Step of the porosity with which the reachable range is looked for; it only decides how near the named ratio is."""


@dataclass
class Draws:
    """Sampled fields of the same draws on two grids, cut at any porosity: every evaluation sees the same pores."""

    fine: Sequence[F32]  # values (n, n, n) of periodic cells, solid below a level
    coarse: Sequence[F32]  # about half as many samples along an edge
    finer: Sequence[F32] = ()  # twice as many as `fine`: the ratio is that of solid to throats, which need them
    known: dict[float, tuple[LimitSizes, ...]] = field(default_factory=dict)

    def coarse_ratio(self, porosity: float) -> float:
        """Ratio of solid to void on the coarse grid, within some percent, but quick: balls are a voxel too small."""
        if self.finer:
            solid = _thickness(_phases(self.coarse, porosity)[0])
            return float(solid[solid > 0].mean(dtype=np.float64) + 1) / (throat(self.fine, porosity) / 2 + 1)
        solid, void = (_thickness(phases) for phases in _phases(self.coarse, porosity))
        return float((solid[solid > 0].mean(dtype=np.float64) + 1) / (void[void > 0].mean(dtype=np.float64) + 1))

    def ratio(self, porosity: float) -> float:
        """Mean size of the solid over that of the void, in the limit of fine grids."""
        solid, void = self.sizes(porosity)
        return solid.mean / (self.passing(porosity) if self.finer else void.mean)

    def passing(self, porosity: float) -> float:
        """Mean over draws of the diameter of the largest ball that passes through the void, in cell sizes."""
        return max(throat(self.finer, porosity) / int(self.finer[0].shape[0]), 1e-6)

    def sizes(self, porosity: float) -> tuple[LimitSizes, ...]:
        """Sizes of solid and void in the limit of fine grids, in cell sizes."""
        if porosity not in self.known:
            spacings = (1 / self.fine[0].shape[0], 1 / self.coarse[0].shape[0])
            fine = [_thickness(phases) for phases in _phases(self.fine, porosity)]
            coarse = [_thickness(phases) for phases in _phases(self.coarse, porosity)]
            self.known[porosity] = tuple(limit_sizes(f, c, spacings) for f, c in zip(fine, coarse, strict=True))
        return self.known[porosity]

    def connected(self, porosity: float) -> bool:
        """Test whether solid and void run through in x, y and z and are in one piece but for small rests."""
        for phases in _phases(self.fine, porosity):
            found = [find_components(phase, TORUS) for phase in phases]
            if not all(len(one.sizes) and one.wraps[0].all() for one in found):
                return False
            if sum(float(one.sizes[0] / one.sizes.sum()) for one in found) < MIN_CONNECTED * len(found):
                return False
        return True

    def porosity_for(self, ratio: float) -> float | None:
        """The porosity at which solid over void has a ratio; None if there is none in `POROSITIES`.

        Bisected on the coarse grid; the fine one is corrected by its slope, and by secants once it is enclosed.
        """
        start = self._bisected(ratio)
        if start is None:
            return None
        # near the start both grids have nearly the same relative slope
        width = 0.06 if self.finer else 0.02  # throats go in steps of voxels
        low, high = max(start - width, POROSITIES[0]), min(start + width, POROSITIES[1])
        slope = math.log(self.coarse_ratio(high) / self.coarse_ratio(low)) / (high - low)
        errors: dict[float, float] = {}
        at = start
        while len(errors) < CORRECTIONS and at not in errors:
            errors[at] = math.log(max(self.ratio(at), 1e-9) / ratio)  # walls of a voxel are extrapolated to nothing
            if abs(errors[at]) < CLOSE:
                return at
            # the ratio falls: too large a one needs more porosity
            denser = max((p for p in errors if errors[p] > 0), default=None)
            lighter = min((p for p in errors if errors[p] <= 0), default=None)
            if denser is None or lighter is None:
                step = min(max(-errors[at] / slope, -MAX_STEP), MAX_STEP)
                at = min(max(at + step, POROSITIES[0]), POROSITIES[1])
            else:
                # ln r is nearly straight over the logit of the porosity
                a, b = (math.log(p / (1 - p)) for p in (denser, lighter))
                # where walls vanish on the grid the logarithm says nothing, and would push all steps to the other end
                above, below = min(errors[denser], FAR), max(errors[lighter], -FAR)
                share = min(max(above / (above - below), 0.1), 0.9)  # one end that stays would slow the search down
                at = 1 / (1 + math.exp(-(a + (b - a) * share)))
        best = min(errors, key=lambda p: abs(errors[p]))
        return best if self.finer and abs(errors[best]) < THROAT_CLOSE else None

    def _bisected(self, ratio: float) -> float | None:
        low, high = POROSITIES
        # the coarse ratio is not exact at the ends: the fine grid decides there
        if not self.coarse_ratio(high) * 0.5 < ratio < self.coarse_ratio(low) * 2:
            return None
        while high - low > 0.01:
            middle = (low + high) / 2
            low, high = (middle, high) if self.coarse_ratio(middle) > ratio else (low, middle)
        return (low + high) / 2

    def reachable(self, progress: Callable[[int, int], None]) -> tuple[float, float] | None:
        """Lowest and highest ratio of cells that are connected; None if no cell is.

        The ratio falls with the porosity, and cells break into pieces at both ends. The range is followed outwards from
        the middle: beyond its ends single porosities may be connected by chance.
        """
        steps = np.arange(POROSITIES[0] + SCAN, POROSITIES[1] - SCAN / 2, SCAN)
        outwards = np.argsort(np.abs(steps - 0.5), kind="stable")
        middle = next((int(i) for i in outwards if self.connected(float(steps[i]))), None)
        if middle is None:
            return None
        progress(1, 2)
        below, above = steps[:middle][::-1], steps[middle + 1 :]
        densest, lightest = (
            [float(steps[middle]), *takewhile(self.connected, map(float, side))][-1] for side in (below, above)
        )
        return self.ratio(lightest), self.ratio(densest)


def _phases(values: Sequence[F32], porosity: float) -> tuple[list[NDArray[np.uint8]], ...]:
    """Solid and void of all draws at a porosity, which each of them has exactly."""
    solid = [(one < np.quantile(one, 1 - porosity)).view(np.uint8) for one in values]
    return solid, [1 - one for one in solid]


def _thickness(phases: Sequence[NDArray[np.uint8]]) -> F32:
    """Local thickness of one phase of all draws, in voxels."""
    return np.concatenate([local_thickness(phase, TORUS) for phase in phases])


def throat(values: Sequence[F32], porosity: float) -> float:
    """Mean over draws of the diameter, in voxels, of the largest ball whose center runs through the void along x, y and
    z; 0 for a void that does not run through."""
    found = []
    for phase in _phases(values, porosity)[1]:
        squared = squared_distance(phase, TORUS)
        steps = np.unique(squared)
        low, high = 0, len(steps)  # at `low` it passes, as 0 is everywhere
        while high - low > 1:
            middle = (low + high) // 2
            open_ = find_components(squared >= steps[middle], TORUS)
            passes = any(all(wraps) for wraps in open_.wraps)
            low, high = (middle, high) if passes else (low, middle)
        found.append(2 * math.sqrt(float(steps[low])) - 1 + TOO_NARROW if low else 0.0)
    return float(np.mean(found))


MIN_VOXELS_ACROSS = 5
"""Voxels that a mean size should measure: below, the extrapolation from two grids was off by 5 % for walls."""

PORE_OVER_THROAT = 1.3
"""Mean size of pores over the throat, by which estimates know the cell."""

SIZES_OF_CELL = 1.8
"""Strut and pore together over the mean distance of pores, by which estimates know the cell: that of the preset `paper`
from porosity 0.4 to 0.8 within 15 %; walls have half of it. Only estimates depend on it."""

INSIDE = 0.01
"""Relative distance from the end of the reachable range of the ratio that errors name."""


@dataclass(frozen=True, kw_only=True)
class DesignSizes(Stage):
    """Find the cell size and the porosity of a recipe at which struts and pores have the sizes asked for.

    Sizes are mean local thicknesses (Hildebrand and Rüegsegger 1997), as `check.sizes` reports them, in the limit of
    fine grids. Their ratio has no scale: it falls as the porosity rises, whatever the cell measures. So the porosity is
    bisected on coarse grids of a few draws of the cell, always the same ones, and corrected on fine grids; then the
    cell size follows by similarity. The level of the recipe's field is changed, not its pores and tunnels.

    The `tile` stages after it take the cell size and the porosity where their options `cell` and `porosity` are
    omitted. The sizes then hold in the mean over a part: single cells scatter by some percent. Scattered pores are
    joined across cells, which makes other struts than in cells with faces, so that `lay` says which; a rule that lays
    otherwise refuses the design.

    With `throat` in place of `pore`, what is asked for is the diameter of the largest ball that passes through the void
    along x, y and z: what a filter lets through, or through which powder leaves. Ratios at which the solid or the void
    breaks into pieces are refused, with the nearest one that can be had.
    """

    name: ClassVar[str] = "design.sizes"
    version: ClassVar[int] = 2
    advice: ClassVar[str] = "lower `resolution` or `draws`"

    pore: Length | None = option(None, help="mean size of the pores", unit="mm", minimum=1e-4, maximum=1e4)
    throat: Length | None = option(
        None, help="diameter of the largest ball that passes through the void, in place of `pore`", unit="mm",
        minimum=1e-4, maximum=1e4,
    )  # fmt: skip
    strut: Length | None = option(None, help="mean size of the struts", unit="mm", minimum=1e-4, maximum=1e4)
    wall: Length | None = option(
        None, help="mean thickness of the walls, for recipes such as `stiff` that make walls instead of struts",
        unit="mm", minimum=1e-4, maximum=1e4,
    )  # fmt: skip
    lay: str = option(
        "scattered", help="how cells will be laid: by tile.scattered, or as cells with faces by another tile rule",
        choices=("scattered", "cells"),
    )  # fmt: skip
    draws: int = options.draws(3, note="over which sizes are averaged", maximum=50)
    resolution: int = options.resolution(56, note="of the finer grid", minimum=32, maximum=256)

    @property
    def rated_as(self) -> str:
        """Its work is that of `check.sizes`: balls painted into both phases."""
        return "check.sizes"

    def check_options(self) -> None:
        """One of `strut` and `wall`, and one of `pore` and `throat`."""
        if (self.pore is None) == (self.throat is None):
            raise ConfigError(
                "the size of the void is either `pore` or `throat`; "
                f"{'neither is' if self.pore is None else 'both are'} given",
                hint="give one of them, for example `pore: 0.6 mm`",
            )  # fmt: skip
        if (self.strut is None) == (self.wall is None):
            raise ConfigError(
                "the size of the solid is either `strut` or `wall`; "
                f"{'neither is' if self.strut is None else 'both are'} given",
                hint="give one of them, for example `strut: 0.4 mm`",
            )

    @property
    def solid(self) -> Length:
        """The size asked for of struts or walls."""
        size = self.strut if self.strut is not None else self.wall
        assert size is not None  # `check_options`
        return size

    @property
    def void(self) -> Length:
        """The size asked for of pores or throats."""
        size = self.pore if self.pore is not None else self.throat
        assert size is not None  # `check_options`
        return size

    def estimate(self, palette: Palette, recipe: RecipeSize) -> Size:
        made = recipe(palette, self.draws)
        grid = made.grid(self.resolution)
        strut, pore = self.solid.mm(), self.void.mm() * (1 if self.throat is None else PORE_OVER_THROAT)
        # r = 0.95 ((1 - porosity) / porosity)^0.55 fits the preset `paper` within 10 %
        porosity = 1 / (1 + (strut / pore / 0.95) ** (1 / 0.55))
        edge = (strut + pore) * made.cell.pores ** (1 / 3) / SIZES_OF_CELL
        cell = made.in_box((1.0, 1.0, 1.0), edge_mm=edge).at_porosity(porosity)
        # two evaluations, each with both phases, whose balls grow with the resolution
        voxels = 2.0 * self.draws * self.resolution**4
        return Size(
            samples=self.draws * grid.samples, sums=self.draws * grid.sums, resident=self.draws * grid.samples,
            voxels=voxels, design=cell.design, geometry=cell.geometry,
        )  # fmt: skip

    def run(self, context: Context, recipe: Recipe) -> CellSizes:
        """Draw the cells, find the porosity, scale."""
        strut, pore = self.solid.mm(), self.void.mm()
        fields = [self._drawn(context, recipe, draw) for draw in range(self.draws)]
        n = self.resolution
        fine, coarse = ([_sampled(context, one, edge) for one in fields] for edge in (n, n // 2))
        cells = Draws(fine, coarse, [_sampled(context, one, 2 * n) for one in fields] if self.throat else ())
        porosity = cells.porosity_for(strut / pore)
        if porosity is None or not cells.connected(porosity):
            raise self._unreachable(context, recipe, cells)
        solid, void = cells.sizes(porosity)
        thinner = min(solid.mean, void.mean)
        if thinner * n < MIN_VOXELS_ACROSS:
            context.warn(
                f"the {'solid' if solid.mean == thinner else 'void'} measures {thinner * n:.2g} voxels in the mean, "
                f"too few for sizes within 5 %: give `resolution: {math.ceil(MIN_VOXELS_ACROSS / thinner) + 1}`"
            )
        # what is left of the ratio's error is shared by both sizes
        passing = cells.passing(porosity) if self.throat else None
        edge = math.sqrt(strut * pore / (solid.mean * (passing or void.mean)))
        return CellSizes(
            edge_mm=edge, porosity=porosity, draws=self.draws, strut_asked=strut,
            pore_asked=None if passing else pore, throat=edge * passing if passing else None,
            strut=edge * solid.mean, strut_deviation=edge * solid.deviation, strut_low=edge * solid.low,
            strut_high=edge * solid.high, strut_thinnest=edge * solid.thinnest,
            pore=edge * void.mean, pore_deviation=edge * void.deviation, pore_low=edge * void.low,
            pore_high=edge * void.high, pore_thinnest=edge * void.thinnest, lay=self.lay,
        )  # fmt: skip

    def _drawn(self, context: Context, recipe: Recipe, draw: int) -> ScalarField:
        palette = context.palette
        if self.lay == "scattered":  # one block that meets itself has the sizes of a large box, measured on 2^3 blocks
            blocks = Blocks(np.ones((1, 1, 1), bool), True)
            palette = Palette(1, (0, 0, 0), blocks=blocks)
        made = recipe.run(context, palette=palette, attempt=draw)
        if self.lay == "scattered":
            if not isinstance(made, Microstructure):
                raise ConfigError(
                    f"the recipe {recipe.name!r} makes a {type(made).__name__}; scattered cells need a Microstructure",
                    hint="give `lay: cells`, or end the recipe with `field.gaussian`",
                )
            made = without_faces(made, blocks, 0, None, (0.0, 0.0, 0.0))
        if not isinstance(made, ScalarField) or not made.periodic:
            raise ConfigError(
                f"the recipe {recipe.name!r} makes a {type(made).__name__}"
                + (" that does not repeat" if isinstance(made, ScalarField) else "")
                + "; sizes are those of a periodic cell",
                hint="end the recipe with a stage such as `field.gaussian`",
            )
        context.progress(draw + 1, self.draws, "cells drawn")
        return made

    def _unreachable(self, context: Context, recipe: Recipe, cells: Draws) -> DesignError:
        """The error that names the nearest ratio."""
        strut, pore, word = self.solid.mm(), self.void.mm(), "strut" if self.strut is not None else "wall"
        other = "pore" if self.throat is None else "throat"
        ratio = strut / pore
        ends = cells.reachable(lambda done, all_: context.progress(done, all_, "ends of the range"))
        if ends is None:
            return DesignError(
                f"no porosity of the recipe {recipe.name!r} gives a cell whose solid and void both run through",
                hint="join the pores by more or wider tunnels",
            )
        low, high = ends[0] * (1 + INSIDE), ends[1] * (1 - INSIDE)
        nearest = min(max(ratio, low), high)
        if nearest == ratio:  # inside of the range, but a draw is in pieces there, or the ratio jumps
            nearest = low if ratio - low < high - ratio else high
        return DesignError(
            f"{word} over {other} {ratio:.3g} is out of reach of the recipe {recipe.name!r}: its solid and void both "
            f"run through from {low:.3g} to {high:.3g}",
            hint=f"nearest are `{word}: {nearest * pore:.3g} mm` with this {other}, and "
            f"`{other}: {strut / nearest:.3g} mm` with this {word}; another recipe has other limits",
        )


def _sampled(context: Context, field: ScalarField, edge: int) -> F32:
    values: F32 = field.sample(cell_centers(edge, field.cells), context.threads)
    return np.ascontiguousarray(values.T)
