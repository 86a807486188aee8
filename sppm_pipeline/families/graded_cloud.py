"""Scattered cells whose density, spacing and sizes follow maps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.grading import Grading
from sppm_pipeline.data.palette import Blocks, Palette, StretchedBlocks
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.families.graded import curve_of, graded_radii, metric_at, recipe_total, trial
from sppm_pipeline.families.local_porosity import LatticeCells, cell_means, error_summary
from sppm_pipeline.families.sampler import FEWEST
from sppm_pipeline.fields.microstructure import Microstructure
from sppm_pipeline.fields.tileset import TileSet
from sppm_pipeline.fields.tiling import Tiling
from sppm_pipeline.numerics.assembly.contents import TilingArrays
from sppm_pipeline.numerics.grading.curve import PorosityCurve
from sppm_pipeline.stage import Context, Recipe

STEEP = 1.0
"""Relative change of the density over one spacing from which a structure can't follow its map."""

ROOM = 2
"""Blocks along an edge of the boxes that repeat, of which the curve is made."""


def without_faces(
    micro: Microstructure, blocks: Blocks, halo: int, edge: float | None, origin: tuple[float, float, float]
) -> Tiling:
    """The tiling of scattered blocks."""
    none = [np.full(tuple(n + (a == axis) for a, n in enumerate(blocks.shape)), -1, np.int32) for axis in range(3)]
    arrays = TilingArrays(blocks.numbers, (none[0], none[1], none[2]), blocks.periodic, halo)
    return Tiling(TileSet(micro, "scattered", 0), arrays, edge, origin)


@dataclass(frozen=True)
class GradedCloud:
    """What is needed to scatter the pores of a lattice by maps.

    Attributes
    ----------
    recipe : Recipe
    grading : Grading
    mask : (nx, ny, nz) bool
        Blocks, the halo included.
    halo : int
    edge : float
        Block edge, mm.
    origin : 3 floats
        Low corner of block (0, 0, 0), mm.
    porosity : float or None
        The target where there is no map of it.
    trials : int
    resolution : int
    """

    recipe: Recipe
    grading: Grading
    mask: NDArray[np.bool_]
    halo: int
    edge: float
    origin: tuple[float, float, float]
    porosity: float | None
    trials: int
    resolution: int

    def laid(self, context: Context, rounds: int) -> Tiling:
        """Scatter, measure, and add and take away pores."""
        from sppm_pipeline.numerics.sampling.graded_blocks import block_means

        total, curve = recipe_total(self.recipe), None
        density, wanted = self._density(context, total)
        if wanted is not None:
            curve, density = self._by_curve(context, total, density, wanted)
        self._warn_of_steepness(context, density, total)
        metric = self._metric()
        blocks = Blocks(self.mask, False, density)
        if metric is not None:
            blocks = StretchedBlocks(self.mask, False, density, metric=metric)
        made = self._drawn(context, blocks)
        if curve is None or wanted is None:
            return made
        rms = []
        scale = block_means(density) / (curve.pores(block_means(wanted)) / total)
        for number in range(rounds + 1):
            cells = LatticeCells(made, self.resolution, context.threads)
            place = np.array(cells.cells)
            targets = self._targets(place)
            errors = np.array([cells.porosity(cell) for cell in cells.cells]) - targets
            summary = error_summary(errors)
            rms.append(summary["error_rms"])
            if number == rounds:
                break
            at = tuple((place + self.halo).T)
            # a block of small pores holds so many times more of them for the same porosity
            change = -np.rint(errors * scale[at] / curve.slope(curve.pores(targets))).astype(np.int64)
            made = self._changed(context, number, made, blocks, place, change)
        context.report(**summary, error_rms_of_rounds=rms, cell_deviation=curve.deviation)
        return made

    def _nodes(self) -> NDArray[np.float64]:
        """Places of the nodes of the density, (n, 3) mm; those beyond the box are moved to its border."""
        from sppm_pipeline.numerics.sampling.graded_blocks import NODES

        low, high = np.zeros(3), np.array(self.mask.shape) - 2.0 * self.halo
        axes = [np.arange(NODES * n + 1) / NODES - self.halo for n in self.mask.shape]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        return np.asarray(np.clip(grid, low, high) * self.edge + np.array(self.origin))

    def _metric(self) -> NDArray[np.float64] | None:
        """Metrics at the nodes, (..., 6); None where nothing is stretched."""
        from sppm_pipeline.numerics.metric import PLAIN
        from sppm_pipeline.numerics.sampling.graded_blocks import NODES

        grading, nodes = self.grading.in_cells(self.edge, self.origin), self._nodes()
        found = metric_at(grading, nodes)
        if found is None:
            return None
        if (found == PLAIN).all() and (grading["stretch"].at(nodes) != 1).any():
            raise DesignError(
                "the direction of the stretch is (0, 0, 0) everywhere", hint="give direction_z a value of 1"
            )
        return found.reshape(*(NODES * n + 1 for n in self.mask.shape), 6)

    def _density(self, context: Context, total: int) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Density by the sizes of pores alone, and the wanted porosity, both at the nodes; None without a target."""
        from sppm_pipeline.numerics.kernels.profiles import PORE_PROFILE
        from sppm_pipeline.numerics.metric import determinants
        from sppm_pipeline.numerics.sampling.graded_blocks import NODES

        grading, points = self.grading.in_cells(self.edge, self.origin), self._nodes()
        shape = tuple(NODES * n + 1 for n in self.mask.shape)
        size = np.ones(len(points))
        if "scale" in grading:
            size *= grading["scale"].at(points)
        if "pore_radius" in grading:
            micro = trial(context, self.recipe, None, 1)
            usual = PORE_PROFILE.radius(float(np.median(micro.pieces.kernels.omega)), micro.level)
            size = grading["pore_radius"].at(points) / (usual * self.edge)
        if "spacing" in grading:
            size = grading["spacing"].at(points) / (self._usual_spacing(context) * self.edge)
        density = size**-3.0
        metric = metric_at(grading, points)
        if metric is not None:
            density *= np.sqrt(determinants(metric))  # as many pores where they are s times longer: 1/s of them
        wanted = None
        if "porosity" in grading:
            wanted = grading["porosity"].at(points).reshape(shape)
        elif self.porosity is not None:
            wanted = np.full(shape, self.porosity)
        return density.reshape(shape), wanted

    def _usual_spacing(self, context: Context) -> float:
        """The spacing of the recipe's pores, cell sizes."""
        if self.porosity is not None or "porosity" in self.grading:
            raise ConfigError(
                "the number of pores can't follow both the map 'spacing' and a porosity",
                hint="leave one out; with a porosity the map `scale` makes pores finer",
            )
        blocks = Blocks(np.ones((ROOM,) * 3, bool), True)
        pores = trial(context, self.recipe, None, 1, Palette(ROOM**3, (0, 0, 0), blocks=blocks)).graph.pores
        if pores.spacing is None:
            raise ConfigError(
                "the recipe's sampler keeps no spacing that a map could change", hint="use `sample.dart_throwing`"
            )
        return float(pores.spacing)

    def _by_curve(
        self, context: Context, total: int, density: NDArray[np.float64], wanted: NDArray[np.float64]
    ) -> tuple[PorosityCurve, NDArray[np.float64]]:
        """The curve of boxes of scattered blocks that repeat, and the density by it."""
        blocks = Blocks(np.ones((ROOM,) * 3, bool), True)

        def porosity(n: int, attempt: int) -> float:
            micro = trial(context, self.recipe, n, attempt, Palette(ROOM**3, (0, 0, 0), blocks=blocks))
            tiling = without_faces(micro, blocks, 0, None, (0.0, 0.0, 0.0))
            return float((tiling.solid(max(24, self.resolution // 2), context.threads) == 0).mean())

        curve = curve_of(context, porosity, total, wanted, self.trials)
        return curve, density * curve.pores(wanted) / total

    def _targets(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        if "porosity" in self.grading:
            return cell_means(self.grading, "porosity", self.edge, self.origin, cells)
        assert self.porosity is not None
        return np.full(len(cells), self.porosity)

    def _drawn(self, context: Context, blocks: Blocks) -> Tiling:
        palette = Palette(int(self.mask.sum()), (0, 0, 0), blocks=blocks)
        micro = trial(context, self.recipe, None, 0, palette)
        return graded_radii(
            without_faces(micro, blocks, self.halo, self.edge, self.origin), self.grading, faces_differ=True
        )

    def _changed(
        self,
        context: Context,
        number: int,
        made: Tiling,
        blocks: Blocks,
        cells: NDArray[np.int64],
        change: NDArray[np.int64],
    ) -> Tiling:
        """Take away pores where there are too many, at random, and add some where there are too few."""
        pores = made.tileset.micro.graph.pores
        interiors = made.arrays.interior[tuple((cells + self.halo).T)]
        keep, added = np.ones(len(pores.centers), bool), np.zeros(pores.interiors, np.int64)
        first = np.searchsorted(pores.piece, np.arange(pores.interiors + 1))
        for interior, more in zip(interiors.tolist(), change.tolist(), strict=True):
            begin, end = int(first[interior]), int(first[interior + 1])
            if more < 0:
                fewer = min(-more, max(0, end - begin - FEWEST))
                keep[begin + context.rng(number, interior).permutation(end - begin)[:fewer]] = False
            added[interior] = max(more, 0)
        kept = pores.centers[keep], pores.piece[keep]
        return self._drawn(context, replace(blocks, kept=kept, added=added))

    def _warn_of_steepness(self, context: Context, density: NDArray[np.float64], total: int) -> None:
        from sppm_pipeline.numerics.sampling.graded_blocks import NODES

        steepest = max(float(np.abs(np.diff(np.log(density), axis=axis)).max(initial=0.0)) for axis in range(3)) * NODES
        spacing = (0.5 / (total * float(density.min()))) ** (1 / 3)
        if steepest * spacing > STEEP:
            context.warn(
                f"the density of pores changes by a factor of {np.exp(steepest * spacing):.3g} over one spacing of "
                f"{spacing * self.edge:.3g} mm, which the structure follows only in the mean"
            )
