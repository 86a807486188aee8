"""``tile.joined``: two tile sets in one part, and cells between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Length, Palette, Size, SurfaceMesh, TileSet, Tiling, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.grading.joined import JoinedSets, Layout, SameSize, Transition, TwoSizes, usual_kernels
from sppm_pipeline.features.grading.local_porosity import LatticeCells, cell_means
from sppm_pipeline.features.grading.map_sizes import check_round
from sppm_pipeline.features.grading.rounds import in_rounds
from sppm_pipeline.method.connecting.bounded import spanning_subgraph
from sppm_pipeline.method.connecting.greedy import clamped_degrees
from sppm_pipeline.method.families.interiors import MIN_PORES
from sppm_pipeline.method.families.tiler import HALO, lattice_for, tiling_size
from sppm_pipeline.method.fields.level_field import LevelField
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.sampling.darts import throw
from sppm_pipeline.method.tiling.lattice import with_halo
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.stage import Context, Stage, option

TIGHTER = 0.93
"""Factor of the spacing after the pores of a transition cell did not fit. Not sensitive: it is applied until they fit,
at most 60 times; a smaller step costs more attempts and keeps the spacing larger."""


class Usual(NamedTuple):
    """Averages of a set: pores of an interior, their spacing, parameters of kernels, porosity."""

    pores: float
    spacing: float
    omega: float
    mu: float
    porosity: float


@dataclass(frozen=True, kw_only=True)
class JoinedTiling(Stage):
    """Lay two tile sets in one part: the map `weight` says where, 0 the first set, 1 the second one.

    Every face of the lattice belongs to the set that the weight in its middle is nearer to, and cells with six faces of
    one set are cells of that set. All others are transition cells: their interiors are drawn between the faces
    that they touch, with numbers and sizes of pores between those of both sets by weight, and drawn again in rounds
    until they have the porosity between (or that of the map `porosity`, if there is one). No pore or tunnel of either
    set is changed. Where the sets are cut at different levels, so is the result, with a smooth way from one to the
    other; what is left of errors is for `tune.local_porosity`.

    Where cells of one set are m times as large as those of the other one, `cell` and `cells` count the larger ones. The
    weight in its middle then says which set a cell of that size belongs to: it is one large cell, or m x m x m small
    ones. Large cells beside small ones are transition cells; the m x m patterns of small cells are their face.
    """

    name: ClassVar[str] = "tile.joined"
    advice: ClassVar[str] = "give larger cells"
    reported: ClassVar[tuple[str, ...]] = (
        "cells_first", "cells_second", "transition_cells", "error_mean", "error_rms", "error_p95", "error_max",
    )  # fmt: skip

    cell: Length | None = options.cell(None, note="in the part; the recipe's `edge` if omitted")
    cells: tuple[int, int, int] | None = options.cells(None)
    degree: tuple[int, int] = options.degree((3, 5))
    rounds: int = options.rounds(
        2, note="in which pores of transition cells are added and taken away", minimum=0, maximum=10
    )
    resolution: int = options.resolution(40, note="for measuring the porosity", minimum=8, maximum=256)
    limit: int = option(20_000, help="maximum number of cells that are drawn", minimum=1, maximum=1_000_000)

    def check_options(self) -> None:
        options.check_degree(self.degree)

    def estimate(self, palette: Palette, sets: Size, grading: Size, cover: Size | None) -> Size:
        return tiling_size(self.cell, self.cells, cover, sets)

    def run(
        self, context: Context, sets: JoinedSets, grading: Grading, cover: SurfaceMesh | None
    ) -> Tiling | LevelField:
        """Give each face to a set, find the cells between, and draw these."""
        check_round(grading, self.name)
        lattice = lattice_for(self.cell, self.cells, cover, sets.first.micro.edge_mm)
        if lattice.edge is None:
            raise ConfigError("the size of a cell is missing", hint="give `cell: 7.5 mm`")
        edge = lattice.edge
        mask = with_halo(lattice.mask, HALO)
        frame = grading.in_cells(edge, lattice.origin)

        def weights(place: NDArray[Any]) -> F64:
            world = (place - HALO) * edge + np.array(lattice.origin)
            return np.clip(frame["weight"].at(world.reshape(-1, 3)), 0, 1).reshape(place.shape[:-1])

        kind = SameSize if max(sets.per_edge) == 1 else TwoSizes
        layout: Layout = kind(context, sets, mask, weights, edge, lattice.origin)
        own, between = layout.own, layout.between
        if len(between) > self.limit:
            raise DesignError(
                f"{len(between)} cells lie between the sets, and each is drawn by itself; the limit is {self.limit}",
                hint="let the weight go from 0 to 1 on a shorter way, or give larger cells",
            )
        share = weights(between + 0.5)
        usual = [self._usual(context, *both) for both in zip(sets.sets, sets.per_edge, strict=True)]
        if "porosity" in grading:
            targets = cell_means(grading, "porosity", edge, lattice.origin, between - HALO)
        else:
            targets = (1 - share) * usual[0].porosity + share * usual[1].porosity
        # sets that are cut at different levels need a level that goes from one to the other
        control = self._levels(sets, own, between, share)
        counts = (1 - share) * usual[0].pores + share * usual[1].pores
        inside = np.pad(lattice.mask, HALO)[tuple(between.T)]

        def laid(wanted: tuple[int, F64]) -> Tiling | LevelField:
            turn, counts = wanted
            cells = [
                self._drawn(context, layout, number, (turn, number), counts[number], share[number], usual)
                for number in range(len(between))
            ]
            tiling = layout.tiling(cells)
            return tiling if control is None else LevelField(tiling, control)

        def errors(turn: int, made: Tiling | LevelField) -> F64:
            found = np.full(len(between), np.nan)
            if not inside.any():
                return found
            cells = [(i, j, k) for i, j, k in (between[inside] - HALO).tolist()]
            found[inside] = LatticeCells(made, self.resolution, context.threads, only=cells).counted()
            return found - targets

        def again(turn: int, made: Tiling | LevelField, errors: F64) -> tuple[int, F64] | None:
            nonlocal counts
            # a pore takes the same share of what is solid anywhere, as in the Boolean model
            slope = -(1 - targets) * np.log1p(-targets) / np.maximum(counts, 1)
            step = np.rint(np.nan_to_num(errors) / slope)
            context.progress(turn + 1, self.rounds + 1, "rounds")
            if turn == self.rounds or not step.any():
                return None
            counts = np.maximum(counts - step, MIN_PORES)
            return turn + 1, counts

        made, report = in_rounds((0, counts), laid, errors, again)
        report.pop("error_rms_of_rounds", None)
        box = own[HALO:-HALO, HALO:-HALO, HALO:-HALO][lattice.mask]
        context.report(
            cells_first=int((box == 0).sum()) * sets.per_edge[0] ** 3,
            cells_second=int((box == 1).sum()) * sets.per_edge[1] ** 3,
            transition_cells=int((box == 2).sum()),
            **report,
        )
        return made

    def _usual(self, context: Context, tileset: TileSet, m: int) -> Usual:
        """Averages over a large cell full of cells of a set, m along its edge."""
        micro = tileset.micro
        pores = micro.graph.pores
        if tileset.porosity:
            porosity = float(np.mean(tileset.porosity))
        else:
            porosity = float((micro.alone(0, (0, 0, 0)).sample(self.resolution, context.threads) >= 0).mean())
        # darts at the densest packing they reach lie about 0.7 mean distances apart
        spacing = pores.spacing or 0.7 * pores.per_cell ** (-1 / 3)
        count = float((pores.piece < pores.interiors).sum()) / pores.interiors
        return Usual(count * m**3, spacing / m, *usual_kernels(micro, m), porosity)

    def _levels(self, sets: JoinedSets, own: NDArray[np.int8], between: I64, share: F64) -> F64 | None:
        """ln C in the middle of each cell of the box, or None if both sets have one level."""
        first, second = (float(np.log(tileset.micro.level)) for tileset in sets.sets)
        if first == second:
            return None
        weight = (own == 1).astype(np.float64)
        weight[tuple(between.T)] = share
        empty = own < 0
        if empty.any():
            from scipy.ndimage import distance_transform_edt

            nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)
            weight = weight[tuple(nearest)]
        control: F64 = ((1 - weight) * first + weight * second)[HALO:-HALO, HALO:-HALO, HALO:-HALO]
        return control

    def _drawn(
        self, context: Context, layout: Layout, number: int, key: tuple[int, int], count: float, share: float,
        usual: list[Usual],
    ) -> Transition:  # fmt: skip
        """The interior of a transition cell: pores that keep away from those of its faces, joined with each other."""
        a, b = usual
        obstacles = layout.around(number)
        n = max(MIN_PORES, round(float(count)))
        expected = (1 - share) * a.pores + share * b.pores
        # sizes are mixed geometrically, as ratios matter, and shrink where more pores than expected have to fit
        spacing = a.spacing ** (1 - share) * b.spacing**share * min(1.0, (expected / n) ** (1 / 3))
        rng = context.rng(2, *key)
        for _ in range(60):
            # half a spacing from the faces, beyond which other cells begin; at most 0.4, so that some room is left
            margin = min(spacing / 2, 0.4)
            try:
                centers = throw(
                    rng,
                    n,
                    spacing,
                    np.full(3, margin),
                    np.full(3, 1 - margin),
                    obstacles=obstacles,
                    obstacle_images=False,
                )
                break
            except DesignError:
                spacing *= TIGHTER
        else:
            raise DesignError(
                f"{n} pores find no room in the transition cell {(layout.between[number] - HALO).tolist()}"
            )
        low, high, _ = clamped_degrees(n, *self.degree)
        # greedy: cells are small, and their graph is joined to fixed faces anyway
        edges, _ = spanning_subgraph(centers, (low, high), mode="greedy", periodic=False, k=10)
        omega, mu = (float(x ** (1 - share) * y**share) for x, y in ((a.omega, b.omega), (a.mu, b.mu)))
        return Transition(centers, edges, omega, mu)
