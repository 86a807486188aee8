"""``tile.graded``: cells whose number of pores follows a map of the porosity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sppm_pipeline import Length, Palette, RecipeSize, Size, SurfaceMesh, TileSet, Tiling, options
from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.grading.local_porosity import LatticeCells, cell_means
from sppm_pipeline.features.grading.map_sizes import check_round, graded_radii, sites_of
from sppm_pipeline.features.grading.numerics.curve import PorosityCurve
from sppm_pipeline.features.grading.rounds import curve_of, in_rounds, of_periodic_cells, recipe_total, trial
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.families.interiors import MIN_PORES
from sppm_pipeline.method.families.tiler import HALO, Lattice, laid_cells, lattice_for, tiling_size
from sppm_pipeline.method.families.tileset_maker import check_faces
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.tiling.lattice import face_presence, meetings, tile_fresh, with_halo
from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.stage import Context, Recipe, Stage, option

FACE_OFFSET = 0.25
"""Distance from a face, in cell sizes, at which the map gives its number of pores on either side. A heuristic: the
middle of each half cell. At 0 a step of the map at a face would count on one side only, at 0.5 a face takes the mean of
cells."""

MIN_GAIN = 0.25
"""Pores by which a cell of an earlier round must be closer to its target than in the last one for another round: less
than the half pore that rounding leaves anyway."""

REDRAW_ERROR = 0.025
"""Relative change of the level, needed to correct the error of a cell, above which it is drawn once more with the same
number of pores; smaller values redraw more cells."""

EXTRA_CELLS = 12
"""Cells that further rounds may draw for those that are still far from their targets: no more than the trials draw."""


@dataclass(frozen=True, kw_only=True)
class GradedTiling(Stage):
    """Lay cells whose numbers of pores follow a map of the porosity (paper, "graded").

    Every cell has an interior of its own. Its number of pores comes from a curve that trial cells of the recipe give,
    and is then corrected in rounds by what the laid cell is found to have; of all rounds each cell gets the one nearest
    to its target. Where no whole number of pores comes near, other draws of the same number are tried, for parts of few
    cells in further rounds. What is left then is left to `tune.local_porosity`. The recipe's samplers need `total` or
    `count`.
    """

    name: ClassVar[str] = "tile.graded"
    version: ClassVar[int] = 3
    advice: ClassVar[str] = "give larger cells"
    reported: ClassVar[tuple[str, ...]] = (
        "cell_deviation", "pores_min", "pores_max", "error_mean", "error_rms", "error_p95", "error_max",
        "error_rms_of_rounds.*",
    )  # fmt: skip

    cell: Length | None = options.cell(None, note="in the part; the recipe's `edge` if omitted")
    cells: tuple[int, int, int] | None = options.cells(None)
    faces: str = option(
        "same",
        help="same: one pattern for each axis, with the recipe's number of pores, as in the paper; fresh: every face "
        "has its own; graded: its own, with as many pores as the map says there",
        choices=("same", "fresh", "graded"),
    )
    rounds: int = options.rounds(2, note="in which pores are added and taken away", minimum=0, maximum=10)
    trials: int = options.trials(3, note="of the curve")
    resolution: int = options.resolution(48, note="for measuring the porosity", minimum=8, maximum=256)
    limit: int = option(100_000, help="maximum number of cells that are drawn", minimum=1, maximum=1_000_000)

    def estimate(self, palette: Palette, recipe: RecipeSize, grading: Size, cover: Size | None) -> Size:
        made = tiling_size(self.cell, self.cells, cover, recipe(palette, 0))
        cells = made.cells if self.faces == "same" else laid_cells(made, False)
        recipe(palette, cells * (1 + self.rounds) + 8 * self.trials)
        samples = made.cells * float(self.resolution) ** 3 * (1 + self.rounds)
        return made.at_porosity(None, cells=cells, samples=samples, sums=samples * made.body.kernels)

    def run(self, context: Context, recipe: Recipe, grading: Grading, cover: SurfaceMesh | None) -> Tiling:
        """Number the cells, draw them, measure them and draw them again."""
        check_round(grading, self.name)
        lattice = lattice_for(self.cell, self.cells, cover, None)
        edge = lattice.edge if lattice.edge is not None else trial(context, recipe, None, 1).physical_edge()
        lattice = Lattice(lattice.mask, edge, lattice.origin)
        # each interior is in one place of the part, so that its number of pores can follow the map there
        arrays = self._arrays(lattice.mask)
        sites = sites_of(arrays)
        wanted = np.clip(sites, 0, np.array(lattice.mask.shape) - 1)  # beyond the part a map goes on as a constant
        targets = cell_means(grading, "porosity", edge, lattice.origin, wanted)
        if len(targets) > self.limit:
            raise DesignError(
                f"the part takes {len(targets)} cells, and each is drawn by itself; the limit is {self.limit}",
                hint=f"give larger cells, or raise `limit: {len(targets)}`",
            )
        total = recipe_total(recipe)
        trials = of_periodic_cells(context, recipe, max(24, self.resolution // 2))
        curve = curve_of(context, trials, total, targets, self.trials)
        count, (x, y, z) = curve.pores(targets), arrays.faces
        palette = Palette(
            len(targets),
            (int(x.max()) + 1, int(y.max()) + 1, int(z.max()) + 1),
            None if self.faces == "same" else meetings(arrays.interior, arrays.faces),
            totals=np.rint(count).astype(np.int64),
            # the share of packing stays: spacing scales with the cube root of the volume per pore
            spacings=(total / count) ** (1 / 3),
            face_totals=self._face_totals(grading, curve, arrays, lattice) if self.faces == "graded" else None,
        )
        assert palette.totals is not None
        redraws = _Redraws(palette, targets, curve, self.rounds)

        def errors(number: int, made: Tiling) -> F64:
            cells, found = LatticeCells(made, self.resolution, context.threads), np.full(len(targets), np.nan)
            own = arrays.box[tuple(np.array(cells.cells).T)]
            found[own] = cells.counted() - targets[own]
            return found

        def laid(palette: Palette) -> Tiling:
            return self._laid(context, recipe, grading, palette, arrays, lattice)

        made, report = in_rounds(palette, laid, errors, redraws.again)
        totals = redraws.totals
        context.report(
            **report, cell_deviation=curve.deviation, pores_min=int(totals.min()), pores_max=int(totals.max())
        )
        return made

    def _arrays(self, mask: Bools) -> TilingArrays:
        """Interiors and faces of the part and of the cells around it."""
        around = with_halo(mask, HALO)
        if self.faces != "same":
            return TilingArrays(*tile_fresh(around), False, HALO)
        # what fits anywhere goes on around the part: the cells there are those nearest to them once more
        from scipy.ndimage import distance_transform_edt

        interior, _ = tile_fresh(mask)
        padded = np.pad(interior, HALO, constant_values=-1)
        nearest = distance_transform_edt(padded < 0, return_distances=False, return_indices=True)
        laid = np.where(around, padded[tuple(nearest)], -1).astype(np.int32)
        x, y, z = (np.where(there, 0, -1).astype(np.int32) for there in face_presence(around))
        return TilingArrays(laid, (x, y, z), False, HALO)

    def _face_totals(
        self, grading: Grading, curve: PorosityCurve, arrays: TilingArrays, lattice: Lattice
    ) -> tuple[I64, I64, I64]:
        """For each face the number of pores that a cell around it would have: the mean of its two sides."""
        assert lattice.edge is not None
        low, high = np.zeros(3), np.array(lattice.mask.shape, np.float64)
        porosity, found = grading.in_cells(lattice.edge, lattice.origin)["porosity"], []
        for axis, faces in enumerate(arrays.faces):
            place = np.argwhere(faces >= 0)
            middle = place - arrays.halo + np.where(np.arange(3) == axis, 0.0, 0.5)
            sides = []
            for step in (-FACE_OFFSET, FACE_OFFSET):
                points = np.clip(middle + step * np.eye(3)[axis], low, high)
                values = porosity.at(points * lattice.edge + np.array(lattice.origin))
                sides.append(curve.pores(np.clip(values, curve.porosities[0], curve.porosities[-1])))
            totals = np.zeros(len(place), np.int64)
            totals[faces[tuple(place.T)]] = np.rint((sides[0] + sides[1]) / 2)
            found.append(np.maximum(totals, MIN_PORES))
        return found[0], found[1], found[2]

    def _laid(
        self,
        context: Context,
        recipe: Recipe,
        grading: Grading,
        palette: Palette,
        arrays: TilingArrays,
        lattice: Lattice,
    ) -> Tiling:
        micro = trial(context, recipe, None, 0, palette)
        check_faces(micro, palette, recipe.name)
        assert lattice.edge is not None
        tiling = Tiling(TileSet(micro, "fresh", 0), arrays, lattice.edge, lattice.origin)
        return graded_radii(tiling, grading, faces_differ=self.faces != "same")


class _Redraws:
    """Palettes of successive rounds: first pores are added and taken away, then the closest draw of each cell is used.

    An interior is drawn from its place, its number of pores and the number of its draw, so that an earlier one can be
    had again. `targets` (m,) are porosities of interiors, `totals` (m,) pores of each cell in the last round.
    """

    def __init__(self, palette: Palette, targets: F64, curve: PorosityCurve, rounds: int) -> None:
        assert palette.totals is not None
        self._palette, self._targets, self._curve, self._rounds, self._last = palette, targets, curve, rounds, False
        # the round in which each cell came nearest to its target, and how far it was from it then
        self.totals = self._best_totals = palette.totals
        self._draws = self._best_draws = self._drawn = np.zeros_like(palette.totals)
        self._nearest = np.full(len(targets), np.inf)

    def again(self, number: int, made: Tiling, errors: F64) -> Palette | None:
        """The palette of the next round by the errors of this one, NaN where there are none; None if it is good."""
        measured = np.isfinite(errors)
        size = np.where(measured, np.abs(errors), np.inf)
        nearer = size < self._nearest
        self._best_totals = np.where(nearer, self.totals, self._best_totals)
        self._best_draws = np.where(nearer, self._draws, self._best_draws)
        self._nearest = np.minimum(size, self._nearest)
        if self._last or not self._rounds:
            return None
        slope = self._curve.slope(self.totals.astype(np.float64))
        reach = REDRAW_ERROR * _level_reach(self._targets, made.solid_below)
        further = number + 1 - self._rounds
        far = measured & (self._nearest > reach)
        if further <= 0:
            # whole pores: what a fraction of one would correct is left to the level
            more = np.rint(np.where(measured, errors, 0.0) / slope).astype(np.int64)
            totals = np.where(measured, np.maximum(self.totals - more, MIN_PORES), self.totals)
            return self._with(totals, self._draws, measured & (more == 0) & (size > reach))
        if further * len(self._targets) <= EXTRA_CELLS and far.any():
            return self._with(self._best_totals, self._best_draws, far)
        if (size <= self._nearest + MIN_GAIN * slope)[measured].all():
            return None
        self._last = True
        return self._with(self._best_totals, self._best_draws, np.zeros(len(size), bool))

    def _with(self, totals: I64, draws: I64, redrawn: Bools) -> Palette:
        """The palette of these numbers of pores and draws; cells `redrawn` get a draw not used before."""
        self._drawn = self._drawn + redrawn
        self.totals, self._draws = totals, np.where(redrawn, self._drawn, draws)
        return replace(self._palette, totals=self.totals, draws=self._draws)


def _level_reach(targets: F64, level: float) -> F64:
    """By how much a porosity changes with ln C of a level C, (m,).

    Of tunnels with kernels exp(-omega r^2) the section is in proportion to -ln C, and where they overlap at random
    -ln(1 - porosity) is in proportion to the section; the derivative of that.
    """
    slope: F64 = (1 - targets) * -np.log1p(-targets) / -np.log(level)
    return slope
