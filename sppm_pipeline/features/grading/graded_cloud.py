"""Scattered cells whose density, spacing and sizes follow maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.grading.local_porosity import LatticeCells, Places, cell_means
from sppm_pipeline.features.grading.map_sizes import ACROSS, DIRECTION, graded_radii, metric_at
from sppm_pipeline.features.grading.rounds import (
    corrected,
    curve_of,
    in_rounds,
    of_scattered_boxes,
    recipe_total,
    scattered,
    trial,
)
from sppm_pipeline.method.families.tiler import (
    HALO,
    REPORTED_CELLS,
    TRIAL_BLOCKS,
    Scattering,
    at_porosity,
    without_faces,
)
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.sampling.graded_blocks import NODES, density_means
from sppm_pipeline.nouns.palette import Blocks, StretchedBlocks
from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.services.metric import PLAIN, determinants
from sppm_pipeline.stage import Context

STEEP = 1.0
"""Relative change of the density over one spacing from which a structure can't follow its map."""

AT_A_TIME = 1 << 18
"""Nodes at which maps are evaluated together: 6 MB of points."""

EVEN = 1e-9
"""Difference of metrics up to which a map counts as constant."""

FOLLOWED = ("porosity", "spacing", "scale", "pore_radius", "tunnel_radius", "stretch", *DIRECTION, *ACROSS)
"""Maps that change what is scattered."""


def scattered_by_maps(context: Context, grading: Grading, wanted: Scattering) -> Tiling | None:
    """Pores of a lattice that follow maps; None if no map changes what is scattered."""
    if not any(name in grading for name in FOLLOWED):
        return None
    if wanted.periodic:
        return repeated_by_maps(context, grading, wanted)
    if wanted.porosity is not None and "porosity" in grading:
        raise ConfigError(
            "the porosity is given twice, by a map and by the option or a design", hint="leave out one of them"
        )
    mask, edge, origin = wanted.lattice
    if edge is None:
        edge = trial(context, wanted.recipe, None, 1).physical_edge()
    cloud = GradedCloud(wanted, grading, np.pad(mask, HALO), edge, origin)
    return cloud.laid(context)


def repeated_by_maps(context: Context, grading: Grading, wanted: Scattering) -> Tiling:
    """A box that repeats, of pores that are stretched alike everywhere; `ConfigError` if a map varies."""
    from sppm_pipeline.method.connecting.regional import WHOLE

    if varying := [name for name in FOLLOWED if name in grading and name not in ("stretch", *DIRECTION, *ACROSS)]:
        raise ConfigError(
            f"cells that follow the map {varying[0]!r} do not repeat", hint="leave out `periodic`, or the map"
        )
    mask, edge, origin = wanted.lattice
    if min(mask.shape) < 2:
        raise ConfigError(
            f"a box of {list(mask.shape)} blocks that repeats has blocks that are their own neighbors",
            hint="give at least 2 cells along each axis",
        )
    edge = trial(context, wanted.recipe, None, 1).physical_edge() if edge is None else edge
    shape = tuple(NODES * n + 1 for n in mask.shape)
    places = np.argwhere(np.ones(shape, bool)) / NODES
    metric = metric_at(grading.in_cells(edge, origin), places * edge + np.array(origin))
    assert metric is not None
    if np.abs(metric - metric[0]).max() > EVEN:
        raise ConfigError(
            "pores whose stretch varies do not repeat", hint="leave out `periodic`, or give constant maps"
        )
    density = np.full(shape, float(np.sqrt(determinants(metric[:1])[0])))
    blocks = StretchedBlocks(mask, True, density, metric=np.tile(metric[0], (*shape, 1)))
    micro = scattered(context, wanted.recipe, None, 0, blocks)
    if len(micro.graph.pores.centers) > WHOLE:
        raise DesignError(
            f"{len(micro.graph.pores.centers)} stretched pores that repeat are too many; allowed are {WHOLE}",
            hint="lay fewer `cells`, or leave out `periodic`",
        )
    made = graded_radii(without_faces(micro, blocks, 0, edge, origin), grading, faces_differ=True)
    if wanted.porosity is None:
        return made
    return at_porosity(context, made, None, wanted.porosity, wanted.resolution)


@dataclass(frozen=True)
class GradedCloud:
    """Pores scattered over a lattice of blocks by maps.

    Porosities are those of what lies in the part, if there is one. `filled` are the cells that the part touches in the
    lattice of all blocks; `edge` is that of a block and `origin` the low corner of the first one that is no halo, mm.
    """

    wanted: Scattering
    grading: Grading
    filled: Bools
    edge: float
    origin: tuple[float, float, float]

    def laid(self, context: Context) -> Tiling:
        """Scatter, measure, and add and take away pores."""
        recipe, rounds, mask = self.wanted.recipe, self.wanted.rounds, self.wanted.mask
        total, curve = recipe_total(recipe), None
        density, porosity = self._density(context), self._porosity()
        # a block of small pores holds so many times more of them for the same porosity
        room = density_means(density)[mask]
        if porosity is not None:
            trials = of_scattered_boxes(context, recipe, max(24, self.wanted.resolution // 2))
            curve = curve_of(context, trials, total, porosity, self.wanted.trials)
            # plane by plane, so that temporaries stay small
            for plane, here in zip(density, np.broadcast_to(porosity, density.shape), strict=True):
                plane *= curve.pores(here) / total
        self._warn_of_steepness(context, density, total)
        metric = self._metric()
        blocks = Blocks(mask, False, density)
        if metric is not None:
            blocks = StretchedBlocks(mask, False, density, metric=metric)

        def drawn(blocks: Blocks) -> Tiling:
            micro = scattered(context, recipe, None, 0, blocks)
            return graded_radii(
                without_faces(micro, blocks, HALO, self.edge, self.origin), self.grading, faces_differ=True
            )

        if curve is None:
            return drawn(blocks)
        del porosity
        places = dict[int, Places]()

        def again(number: int, made: Tiling, errors: F64) -> Blocks | None:
            if number == rounds:
                return None
            known, pores = np.isfinite(errors), made.tileset.micro.graph.pores
            # porosity to pores of the recipe by the slope of the curve, and to pores of this block by its density
            errors[known] *= room[known] / curve.slope(curve.pores(self._targets(np.argwhere(mask)[known] - HALO)))
            return corrected(context, number, blocks, pores, pores.piece, errors)

        made, report = in_rounds(blocks, drawn, partial(self._errors, context, places), again)
        context.report(**report, cell_deviation=curve.deviation)
        return made

    def _targets(self, cells: I64) -> F64:
        if "porosity" in self.grading:
            return cell_means(self.grading, "porosity", self.edge, self.origin, cells)
        assert self.wanted.porosity is not None
        return np.full(len(cells), self.wanted.porosity)

    def _errors(self, context: Context, places: dict[int, Places], number: int, made: Tiling) -> F64:
        rounds, resolution = self.wanted.rounds, self.wanted.resolution
        # the last correction uses the full resolution, so that a coarse grid does before it
        n = resolution if number >= rounds - 1 else max(8, resolution // 2)
        cells = self._cells_of(context, made, n, places.get(n))
        places[n] = cells.places
        # nothing is corrected after the last round: some cells, spread over all, show the remaining errors
        some = slice(None, None, 1 if number < rounds else -(-len(cells.cells) // REPORTED_CELLS))
        place = np.array(cells.cells)
        of = len(place[some])

        def tell(done: int) -> None:
            context.progress((number + done / of) / (rounds + 1), 1.0, "cells measured")

        errors = np.full(np.count_nonzero(self.wanted.mask), np.nan)
        errors[made.arrays.box[tuple(place[some].T)]] = (
            cells.porosities(cells.cells[some], tell) - self._targets(place)[some]
        )
        return errors

    def _cells_of(self, context: Context, made: Tiling, n: int, places: Places | None) -> LatticeCells:
        """The cells that are measured, as far as they lie in the part; whole ones if the part fills none by a share."""
        if self.wanted.cover is not None:
            part = Part(made, self.wanted.cover, islands="keep")
            cells = LatticeCells(part, n, context.threads, places=places)
            if cells.cells:
                return cells
        return LatticeCells(made, n, context.threads, places=places)

    def _on_nodes(self, values: Callable[[F64], F64]) -> F64:
        """Values (n, ...) at places (n, 3) mm, at the nodes of the density.

        Maps are asked for at nodes of cells that the part touches. Beyond these they go on as in the nearest ones,
        node by node; nodes far from all have the value of any.
        """
        grid = tuple(NODES * n + 1 for n in self.wanted.mask.shape)
        known = np.zeros(grid, bool)
        for x, y, z in (NODES * np.argwhere(self.filled)).tolist():
            known[x : x + NODES + 1, y : y + NODES + 1, z : z + NODES + 1] = True
        some, found = np.flatnonzero(known), np.zeros(0)
        for begin in range(0, len(some), AT_A_TIME):  # there may be millions
            part = some[begin : begin + AT_A_TIME]
            place = np.stack(np.unravel_index(part, grid), -1) / NODES - HALO
            here = values(place * self.edge + np.array(self.origin))
            if not begin:
                found = np.empty((known.size, *here.shape[1:]))
                found[:] = here[0]
            found[part] = here
        found = found.reshape(*grid, *found.shape[1:])
        # one layer of nodes at a time, until the halo is full
        for _ in range(NODES * HALO):
            for axis in range(3):
                before, at = np.moveaxis(known, axis, 0).copy(), np.moveaxis(found, axis, 0)
                reached = np.moveaxis(known, axis, 0)
                for to, of in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
                    new = before[of] & ~reached[to]
                    at[to][new] = at[of][new]
                    reached[to] |= new
        return found

    def _metric(self) -> F64 | None:
        """Metrics at the nodes, (..., 6); None where nothing is stretched."""
        grading = self.grading.in_cells(self.edge, self.origin)
        if metric_at(grading, np.zeros((0, 3))) is None:
            return None

        def here(points: F64) -> F64:
            metric = metric_at(grading, points)
            assert metric is not None
            return np.concatenate([metric, grading["stretch"].at(points)[:, None]], axis=1)

        found = self._on_nodes(here)
        if (found[..., :6] == PLAIN).all() and (found[..., 6] != 1).any():
            raise DesignError(
                "the direction of the stretch is (0, 0, 0) everywhere", hint="give direction_z a value of 1"
            )
        return np.ascontiguousarray(found[..., :6])

    def _density(self, context: Context) -> F64:
        """Density by the sizes of pores alone, at the nodes."""
        grading, name, usual = self.grading.in_cells(self.edge, self.origin), "scale", 1.0
        if "pore_radius" in grading:
            micro = trial(context, self.wanted.recipe, None, 1)
            name = "pore_radius"
            usual = PORE_PROFILE.radius(float(np.median(micro.pieces.kernels.omega)), micro.level) * self.edge
        if "spacing" in grading:
            name, usual = "spacing", self._usual_spacing(context) * self.edge

        def here(points: F64) -> F64:
            size = grading[name].at(points) / usual if name in grading else np.ones(len(points))
            # as many pores in a cube of the local spacing everywhere: the porosity stays where sizes vary
            density, metric = size**-3.0, metric_at(grading, points)
            if metric is not None:
                density *= np.sqrt(determinants(metric))  # as many pores where they are s times longer: 1/s of them
            return density

        return self._on_nodes(here)

    def _porosity(self) -> F64 | None:
        """The porosity that is wanted, at the nodes; None without a target."""
        if "porosity" in self.grading:
            return self._on_nodes(self.grading.in_cells(self.edge, self.origin)["porosity"].at)
        return None if self.wanted.porosity is None else np.full((1, 1, 1), self.wanted.porosity)

    def _usual_spacing(self, context: Context) -> float:
        """The spacing of the recipe's pores, cell sizes."""
        if self.wanted.porosity is not None or "porosity" in self.grading:
            raise ConfigError(
                "the number of pores can't follow both the map 'spacing' and a porosity",
                hint="leave one out; with a porosity the map `scale` makes pores finer",
            )
        blocks = Blocks(np.ones((TRIAL_BLOCKS,) * 3, bool), True)
        pores = scattered(context, self.wanted.recipe, None, 1, blocks).graph.pores
        if pores.spacing is None:
            raise ConfigError(
                "the recipe's sampler keeps no spacing that a map could change", hint="use `sample.dart_throwing`"
            )
        return float(pores.spacing)

    def _warn_of_steepness(self, context: Context, density: F64, total: int) -> None:
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
