"""Scattered cells whose density, spacing and sizes follow maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.grading.graded import curve_of, graded_radii, metric_at, recipe_total, trial
from sppm_pipeline.features.grading.grading import Grading
from sppm_pipeline.features.grading.local_porosity import LatticeCells, Places, cell_means, error_summary
from sppm_pipeline.features.grading.numerics.curve import PorosityCurve
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.families.interiors import FEWEST
from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.nouns.palette import Blocks, KeptPores, Palette, StretchedBlocks
from sppm_pipeline.stage import Context, Recipe

STEEP = 1.0
"""Relative change of the density over one spacing from which a structure can't follow its map."""

AT_A_TIME = 1 << 18
"""Nodes at which maps are asked for together."""

TOLD = 64
"""Cells, spread over the part, by which the errors that the last round leaves are told."""

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
    cover : SurfaceMesh or None
        The part; porosities are those of what lies in it.
    filled : (nx, ny, nz) bool
        Cells that the part touches, in the lattice of all blocks.
    mask : (nx, ny, nz) bool
        All blocks, the halo included.
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
    cover: SurfaceMesh | None
    filled: NDArray[np.bool_]
    mask: NDArray[np.bool_]
    halo: int
    edge: float
    origin: tuple[float, float, float]
    porosity: float | None
    trials: int
    resolution: int

    def laid(self, context: Context, rounds: int) -> Tiling:
        """Scatter, measure, and add and take away pores."""
        from sppm_pipeline.method.sampling.graded_blocks import density_means

        total, curve = recipe_total(self.recipe), None
        density, wanted = self._density(context), self._wanted()
        scale = density_means(density)
        if wanted is not None:
            curve = self._curve(context, total, wanted)
            self._follow(density, curve, wanted, total)
        self._warn_of_steepness(context, density, total)
        metric = self._metric()
        blocks = Blocks(self.mask, False, density)
        if metric is not None:
            blocks = StretchedBlocks(self.mask, False, density, metric=metric)
        made = self._drawn(context, blocks)
        if curve is None:
            return made
        del wanted
        rms, places = [], dict[int, Places]()
        for number in range(rounds + 1):
            # what a coarse grid misses in early rounds the last one, which looks closely, puts right
            n = self.resolution if number >= rounds - 1 else max(8, self.resolution // 2)
            cells = self._cells_of(context, made, n, places.get(n))
            places[n] = cells.places
            # nothing is put right in the end: some cells, spread over all, tell the errors that are left
            some = slice(None, None, 1 if number < rounds else -(-len(cells.cells) // TOLD))
            place, targets = np.array(cells.cells), self._targets(np.array(cells.cells))[some]
            share = 1 / (rounds + 1) / len(targets)
            tell = partial(self._progress, context, number / (rounds + 1), share)
            errors = cells.porosities(cells.cells[some], tell) - targets
            summary = error_summary(errors)
            rms.append(summary["error_rms"])
            if number == rounds:
                break
            at = tuple((place + self.halo).T)
            # a block of small pores holds so many times more of them for the same porosity
            change = -np.rint(errors * scale[at] / curve.slope(curve.pores(targets))).astype(np.int64)
            keep, added = self._changed(context, number, made, place, change)
            # millions of pores are not held twice
            pores = made.tileset.micro.graph.pores
            del made, cells
            kept = KeptPores(pores.centers[keep], pores.piece[keep])
            del pores
            made = self._drawn(context, replace(blocks, kept=kept, added=added))
        context.report(**summary, error_rms_of_rounds=rms, cell_deviation=curve.deviation)
        return made

    def _progress(self, context: Context, before: float, share: float, done: int) -> None:
        context.progress(before + share * done, 1.0, "cells measured")

    def _cells_of(self, context: Context, made: Tiling, n: int, places: Places | None) -> LatticeCells:
        """The cells that are measured, as far as they lie in the part; whole ones if the part fills none by a share."""
        if self.cover is not None:
            part = Part(made, self.cover, islands="keep")
            cells = LatticeCells(part, n, context.threads, places=places)
            if cells.cells:
                return cells
        return LatticeCells(made, n, context.threads, places=places)

    def _on_nodes(self, values: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Values (n, ...) at places (n, 3) mm, at the nodes of the density.

        Maps are asked for at nodes of cells that the part touches. Beyond these they go on as in the nearest ones, node
        by node; nodes far from all have the value of any.
        """
        from sppm_pipeline.method.sampling.graded_blocks import NODES

        grid = tuple(NODES * n + 1 for n in self.mask.shape)
        known = np.zeros(grid, bool)
        for x, y, z in (NODES * np.argwhere(self.filled)).tolist():
            known[x : x + NODES + 1, y : y + NODES + 1, z : z + NODES + 1] = True
        some, found = np.flatnonzero(known), np.zeros(0)
        for begin in range(0, len(some), AT_A_TIME):  # there may be millions
            part = some[begin : begin + AT_A_TIME]
            place = np.stack(np.unravel_index(part, grid), -1) / NODES - self.halo
            here = values(place * self.edge + np.array(self.origin))
            if not begin:
                found = np.empty((known.size, *here.shape[1:]))
                found[:] = here[0]
            found[part] = here
        found = found.reshape(*grid, *found.shape[1:])
        for _ in range(NODES * self.halo):
            for axis in range(3):
                before, at = np.moveaxis(known, axis, 0).copy(), np.moveaxis(found, axis, 0)
                reached = np.moveaxis(known, axis, 0)
                for to, of in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
                    new = before[of] & ~reached[to]
                    at[to][new] = at[of][new]
                    reached[to] |= new
        return found

    def _metric(self) -> NDArray[np.float64] | None:
        """Metrics at the nodes, (..., 6); None where nothing is stretched."""
        from sppm_pipeline.services.metric import PLAIN

        grading = self.grading.in_cells(self.edge, self.origin)
        if metric_at(grading, np.zeros((0, 3))) is None:
            return None

        def here(points: NDArray[np.float64]) -> NDArray[np.float64]:
            metric = metric_at(grading, points)
            assert metric is not None
            return np.concatenate([metric, grading["stretch"].at(points)[:, None]], axis=1)

        found = self._on_nodes(here)
        if (found[..., :6] == PLAIN).all() and (found[..., 6] != 1).any():
            raise DesignError(
                "the direction of the stretch is (0, 0, 0) everywhere", hint="give direction_z a value of 1"
            )
        return np.ascontiguousarray(found[..., :6])

    def _density(self, context: Context) -> NDArray[np.float64]:
        """Density by the sizes of pores alone, at the nodes."""
        from sppm_pipeline.method.kernels.profiles import PORE_PROFILE
        from sppm_pipeline.services.metric import determinants

        grading, name, usual = self.grading.in_cells(self.edge, self.origin), "scale", 1.0
        if "pore_radius" in grading:
            micro = trial(context, self.recipe, None, 1)
            name = "pore_radius"
            usual = PORE_PROFILE.radius(float(np.median(micro.pieces.kernels.omega)), micro.level) * self.edge
        if "spacing" in grading:
            name, usual = "spacing", self._usual_spacing(context) * self.edge

        def here(points: NDArray[np.float64]) -> NDArray[np.float64]:
            size = grading[name].at(points) / usual if name in grading else np.ones(len(points))
            density, metric = size**-3.0, metric_at(grading, points)
            if metric is not None:
                density *= np.sqrt(determinants(metric))  # as many pores where they are s times longer: 1/s of them
            return density

        return self._on_nodes(here)

    def _wanted(self) -> NDArray[np.float64] | None:
        """The porosity that is wanted, at the nodes; None without a target."""
        grading = self.grading.in_cells(self.edge, self.origin)
        if "porosity" in grading:
            return self._on_nodes(grading["porosity"].at)
        return None if self.porosity is None else np.full((1, 1, 1), self.porosity)

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

    def _curve(self, context: Context, total: int, wanted: NDArray[np.float64]) -> PorosityCurve:
        """The curve of boxes of scattered blocks that repeat."""
        blocks = Blocks(np.ones((ROOM,) * 3, bool), True)

        def porosity(n: int, attempt: int) -> float:
            micro = trial(context, self.recipe, n, attempt, Palette(ROOM**3, (0, 0, 0), blocks=blocks))
            tiling = without_faces(micro, blocks, 0, None, (0.0, 0.0, 0.0))
            return float((tiling.solid(max(24, self.resolution // 2), context.threads) == 0).mean())

        return curve_of(context, porosity, total, wanted, self.trials)

    def _follow(
        self, density: NDArray[np.float64], curve: PorosityCurve, wanted: NDArray[np.float64], total: int
    ) -> None:
        """Multiply the density by that which gives pores of one size the wanted porosity."""
        wanted = np.broadcast_to(wanted, density.shape)
        for plane, here in zip(density, wanted, strict=True):
            plane *= curve.pores(here) / total

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
        cells: NDArray[np.int64],
        change: NDArray[np.int64],
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """Which pores are kept where there are too many, at random, and how many each interior gets more."""
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
        return keep, added

    def _warn_of_steepness(self, context: Context, density: NDArray[np.float64], total: int) -> None:
        from sppm_pipeline.method.sampling.graded_blocks import NODES

        steepest = 0.0
        for axis in range(3):
            for near, far in zip(np.moveaxis(density, axis, 0)[:-1], np.moveaxis(density, axis, 0)[1:], strict=True):
                steepest = max(steepest, float(np.abs(np.log(far / near)).max()) * NODES)
        least = float(density.min())
        spacing = (0.5 / (total * least)) ** (1 / 3)
        if steepest * spacing > STEEP:
            context.warn(
                f"the density of pores changes by a factor of {np.exp(steepest * spacing):.3g} over one spacing of "
                f"{spacing * self.edge:.3g} mm, which the structure follows only in the mean"
            )
