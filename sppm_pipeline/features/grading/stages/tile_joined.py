"""``tile.joined``: two tile sets in one part, and cells between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import (
    ConfigError,
    Context,
    DesignError,
    Length,
    Palette,
    Size,
    Stage,
    SurfaceMesh,
    Tiler,
    TileSet,
    Tiling,
    option,
    options,
)
from sppm_pipeline.features.grading.graded import check_round, in_rounds
from sppm_pipeline.features.grading.grading import Grading
from sppm_pipeline.features.grading.joined import JoinedSets, Transition, Union
from sppm_pipeline.features.grading.joined_sizes import Laid, TwoSizes, beside, faces_without, refined
from sppm_pipeline.features.grading.local_porosity import LatticeCells, cell_means
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.families.interiors import MIN_PORES
from sppm_pipeline.method.families.tiler import HALO, lattice_for, tiling_size
from sppm_pipeline.method.fields.level_field import LevelField

TIGHTER = 0.93
"""Factor of the spacing where the pores of a transition cell found no room: a choice."""


Weights = Callable[[NDArray[Any]], NDArray[np.float64]]
"""The map `weight` at places in cells of the box, (..., 3)."""


class Usual(NamedTuple):
    """What is usual in a set: pores of an interior, their spacing, parameters of kernels, porosity."""

    pores: float
    spacing: float
    omega: float
    mu: float
    porosity: float


@dataclass(frozen=True, kw_only=True)
class JoinedTiling(Stage):
    """Lay two tile sets in one part: the map `weight` says where, 0 the first set, 1 the second one.

    Every face of the lattice belongs to the set that the weight in its middle is nearer to, and cells with six faces of
    one set are cells of that set. All others are transition cells: their interiors are drawn anew between the faces
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
        from sppm_pipeline.method.tiling.lattice import with_halo

        check_round(grading, self.name)
        lattice = lattice_for(self.cell, self.cells, cover, sets.first.micro.edge_mm)
        if lattice.edge is None:
            raise ConfigError("the size of a cell is missing", hint="give `cell: 7.5 mm`")
        edge = lattice.edge
        mask = with_halo(lattice.mask, HALO)
        frame = grading.in_cells(edge, lattice.origin)

        def weights(place: NDArray[Any]) -> NDArray[np.float64]:
            world = (place - HALO) * edge + np.array(lattice.origin)
            return np.clip(frame["weight"].at(world.reshape(-1, 3)), 0, 1).reshape(place.shape[:-1])

        layout = (OneSize if max(sets.per_edge) == 1 else Sized)(context, sets, mask, weights, edge, lattice.origin)
        own, between = layout.own, layout.between
        if len(between) > self.limit:
            raise DesignError(
                f"{len(between)} cells lie between the sets, and each would be drawn anew; the limit is {self.limit}",
                hint="let the weight go from 0 to 1 on a shorter way, or give larger cells",
            )
        share = weights(between + 0.5)
        usual = [self._usual(context, *both) for both in zip(sets.sets, sets.per_edge, strict=True)]
        if "porosity" in grading:
            targets = cell_means(grading, "porosity", edge, lattice.origin, between - HALO)
        else:
            targets = (1 - share) * usual[0].porosity + share * usual[1].porosity
        control = self._levels(sets, own, between, share)
        counts = (1 - share) * usual[0].pores + share * usual[1].pores
        inside = np.pad(lattice.mask, HALO)[tuple(between.T)]

        def laid(wanted: tuple[int, NDArray[np.float64]]) -> Tiling | LevelField:
            turn, counts = wanted
            cells = [
                self._drawn(context, layout, number, (turn, number), counts[number], share[number], usual)
                for number in range(len(between))
            ]
            tiling = layout.tiling(cells)
            return tiling if control is None else LevelField(tiling, control)

        def errors(turn: int, made: Tiling | LevelField) -> NDArray[np.float64]:
            found = np.full(len(between), np.nan)
            if not inside.any():
                return found
            wanted = [tuple(place) for place in (between[inside] - HALO).tolist()]
            cells = LatticeCells(made, self.resolution, context.threads, only=wanted)
            found[inside] = [cells.porosity(cell) for cell in wanted]
            return found - targets

        def again(
            turn: int, made: Tiling | LevelField, errors: NDArray[np.float64]
        ) -> tuple[int, NDArray[np.float64]] | None:
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
        """What is usual in a large cell full of cells of a set, m along its edge."""
        from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES

        micro = tileset.micro
        pores = micro.graph.pores
        inner = pores.piece < pores.interiors
        kernels = micro.pieces.kernels
        if tileset.porosity:
            porosity = float(np.mean(tileset.porosity))
        else:
            porosity = float((micro.alone(0, (0, 0, 0)).sample(self.resolution, context.threads) >= 0).mean())
        spacing = pores.spacing or 0.7 * pores.per_cell ** (-1 / 3)
        count = float(inner.sum()) / pores.interiors
        factor = np.array([1 / m])
        omega = float(np.median(kernels.omega * PORE_PROFILE.scaled_radius(factor)))
        mu = float(np.median(kernels.mu * TUNNEL_PROFILES[kernels.profile].scaled_radius(factor)))
        return Usual(count * m**3, spacing / m, omega, mu, porosity)

    def _levels(
        self, sets: JoinedSets, own: NDArray[np.int8], between: NDArray[np.int64], share: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
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
        control: NDArray[np.float64] = ((1 - weight) * first + weight * second)[HALO:-HALO, HALO:-HALO, HALO:-HALO]
        return control

    def _drawn(
        self, context: Context, layout: OneSize | Sized, number: int, key: tuple[int, int], count: float, share: float,
        usual: list[Usual],
    ) -> Transition:  # fmt: skip
        """The interior of a transition cell: pores that keep away from those of its faces, joined with each other."""
        from sppm_pipeline.method.connecting.bounded import spanning_subgraph
        from sppm_pipeline.method.connecting.degrees import clamped_degrees
        from sppm_pipeline.method.sampling.darts import throw

        a, b = usual
        obstacles, around = layout.around(number)
        n = max(MIN_PORES, round(float(count)))
        expected = (1 - share) * a.pores + share * b.pores
        spacing = a.spacing ** (1 - share) * b.spacing**share * min(1.0, (expected / n) ** (1 / 3))
        rng = context.rng(2, *key)
        for _ in range(60):
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
        edges, _ = spanning_subgraph(centers, (low, high), mode="greedy", periodic=False, k=10)
        omega, mu = (float(x ** (1 - share) * y**share) for x, y in ((a.omega, b.omega), (a.mu, b.mu)))
        return Transition(centers, edges, around, omega, mu)


class OneSize:
    """Where both sets lie whose cells are equally large; each face belongs to one of them.

    Attributes
    ----------
    own : (nx, ny, nz) int8
        Whose each cell is: 0, 1, 2 between, -1 none.
    between : (m, 3) int64
        Transition cells.
    """

    def __init__(
        self, context: Context, sets: JoinedSets, mask: NDArray[np.bool_], weights: Weights, edge: float,
        origin: tuple[float, float, float],
    ) -> None:  # fmt: skip
        self._union, self._edge, self._origin = Union(sets), edge, origin
        union = self._union
        laid = [_rule(tileset).lay(context.rng(which), mask, tileset) for which, tileset in enumerate(sets.sets)]
        faces, seconds = [], []
        for axis in range(3):
            place = np.argwhere(laid[0][1][axis] >= 0)
            middle = place + np.where(np.arange(3) == axis, 0.0, 0.5)
            second = np.zeros(laid[0][1][axis].shape, bool)
            second[tuple(place.T)] = weights(middle) >= 0.5
            low, high = (union.face(which, axis, laid[which][1][axis]) for which in range(2))
            faces.append(np.where(second, high, low).astype(np.int32))
            seconds.append(second)
        count = np.zeros(mask.shape, np.int64)
        for axis, second in enumerate(seconds):
            for side in (slice(None, -1), slice(1, None)):
                count += second[tuple(side if a == axis else slice(None) for a in range(3))]
        self.own = np.where(~mask, -1, np.where(count == 0, 0, np.where(count == 6, 1, 2))).astype(np.int8)
        self.between = np.argwhere(self.own == 2)
        first, second_set = laid[0][0], laid[1][0] + union.interiors[0]
        interior = np.where(self.own == 0, first, np.where(self.own == 1, second_set, -1)).astype(np.int32)
        interior[tuple(self.between.T)] = sum(union.interiors) + np.arange(len(self.between))
        self._arrays = TilingArrays(interior, (faces[0], faces[1], faces[2]), False, HALO)

    def around(self, number: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Pores on the faces of a transition cell, and axis, side and color of each face."""
        place = self.between[number]
        faces = np.array(
            [
                (axis, side, self._arrays.faces[axis][tuple(place + side * np.eye(3, dtype=np.int64)[axis])])
                for axis in range(3)
                for side in range(2)
            ]
        )
        points = [self._union.face_points((axis, side, color)) for axis, side, color in faces.tolist()]
        return np.concatenate(points), faces

    def tiling(self, cells: list[Transition]) -> Tiling:
        """Both sets, and the transition cells."""
        tileset = TileSet(self._union.microstructure(cells), "fresh", 0)
        return Tiling(tileset, self._arrays, self._edge, self._origin)


class Sized:
    """Where both sets lie whose cells differ in size; each large cell belongs to one of them. See `OneSize`."""

    def __init__(
        self, context: Context, sets: JoinedSets, mask: NDArray[np.bool_], weights: Weights, edge: float,
        origin: tuple[float, float, float],
    ) -> None:  # fmt: skip
        large = int(sets.per_edge[0] > 1)
        second = np.zeros(mask.shape, bool)
        place = np.argwhere(mask)
        second[tuple(place.T)] = weights(place + 0.5) >= 0.5
        small = mask & (second if large == 0 else ~second)
        between = mask & ~small & beside(small)
        self.own = np.where(~mask, -1, np.where(between, 2, second)).astype(np.int8)
        self.between = np.argwhere(between)
        laid: list[Laid] = []
        for which, (tileset, m) in enumerate(zip(sets.sets, sets.per_edge, strict=True)):
            region = mask if which == large else refined(small, m)
            interior, faces = _rule(tileset).lay(context.rng(which), region, tileset)
            if which == large:
                interior, faces = np.where(small | between, -1, interior), faces_without(faces, small)
            laid.append(Laid(interior.astype(np.int32), faces))
        self._sizes = TwoSizes(sets, (laid[0], laid[1]), edge, origin)

    def around(self, number: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Pores on the faces of a transition cell; they say themselves where they are."""
        place = self.between[number]
        return self._sizes.points(self._sizes.pores_around(place), place), np.zeros((0, 3), np.int64)

    def tiling(self, cells: list[Transition]) -> Tiling:
        """Both sets, and the transition cells."""
        return self._sizes.tiling(cells, self.between)


def _rule(tileset: TileSet) -> Tiler:
    """The tile rule of a set."""
    if tileset.kind == "wang":
        from sppm_pipeline.method.stages.tile_wang_3color import WangTiling

        return WangTiling()
    if tileset.kind == "corner":
        from sppm_pipeline.method.stages.tile_corner_colors import CornerColorsTiling

        return CornerColorsTiling()
    from sppm_pipeline.method.stages.tile_free_faces import FreeFacesTiling

    return FreeFacesTiling()
