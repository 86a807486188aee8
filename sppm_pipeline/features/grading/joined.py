"""Two tile sets in one part: their cells, and transition cells between them that connect to the faces of both.

Both layouts below answer the same questions (`Layout`). Cells of one size share the lattice, so that the result stays
a tile set whose pieces repeat; cells of two sizes have no common lattice, and their graphs are laid pore by pore.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.grading.laid_graph import LaidGraph, cloud, joined_graphs, kernel_sizes, laid_graph
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.families.tiler import HALO, Tiler
from sppm_pipeline.method.fields.microstructure import Microstructure, pieces_from_graph
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.method.tiling.lattice import Faces
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.stage import Context

Weights = Callable[[NDArray[Any]], F64]
"""The map `weight` at places in cells of the box, (..., 3)."""

Origin = tuple[float, float, float]

_AXES = np.eye(3, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class JoinedSets(Artifact):
    """Two tile sets to be laid in one part, and cells of each along the edge of the larger one's, of which one is 1."""

    reported: ClassVar[tuple[str, ...]] = ("first.*", "second.*")

    first: TileSet
    second: TileSet
    per_edge: tuple[int, int] = (1, 1)

    def check(self) -> None:
        """Each set is in order, their tunnels have one profile, and one of them has the larger cells."""
        self.first.check()
        self.second.check()
        if min(self.per_edge) != 1:
            raise ValueError(f"along an edge there is one of the larger cells, not {self.per_edge}")
        profiles = [tileset.micro.pieces.kernels.profile for tileset in self.sets]
        if profiles[0] != profiles[1]:
            raise ValueError(f"joined sets have one profile of tunnels, not {profiles[0]} and {profiles[1]}")

    @property
    def sets(self) -> tuple[TileSet, TileSet]:
        """Both sets."""
        return self.first, self.second

    def summary(self) -> dict[str, Any]:
        """The summaries of both sets."""
        return {"first": self.first.summary(), "second": self.second.summary()}


class Transition(NamedTuple):
    """The interior of a cell between two sets."""

    centers: F64  # pores, (n, 3) cell sizes
    edges: I64  # tunnels between them, (m, 2)
    omega: float
    mu: float

    def connectors(self, around: F64, mu: F64) -> tuple[I64, F64]:
        """The pore that each pore `around` (k, 3) on the faces, from the low corner of the cell, is connected to, and
        mu of that tunnel: the geometric mean with `mu` (k,), the usual one among the tunnels of the set to which each
        belongs.
        """
        # the nearest pore, by the shortest tunnel
        nearest = ((around[:, None] - self.centers[None]) ** 2).sum(-1).argmin(1)
        return nearest, np.sqrt(self.mu * mu)


class Layout(Protocol):
    """Cells of both sets in a box."""

    own: NDArray[np.int8]  # (nx, ny, nz), owner of each cell: 0 or 1 for a set, 2 for a transition cell, -1 for none
    between: I64  # transition cells, (m, 3)

    def around(self, number: int) -> F64:
        """Pores on the faces of a transition cell, from its low corner."""

    def tiling(self, cells: list[Transition]) -> Tiling:
        """Both sets with the transition cells."""


class SameSize:
    """The `Layout` of sets with cells of one size; each face of the lattice belongs to one of them.

    Interiors of the second set are numbered after those of the first, and so are face colors; transition cells come
    last. Pores and tunnels of the sets keep their places, sizes and order.
    """

    def __init__(
        self, context: Context, sets: JoinedSets, mask: Bools, weights: Weights, edge: float, origin: Origin
    ) -> None:
        self._edge, self._origin = edge, origin
        self._micros = [tileset.micro for tileset in sets.sets]
        self._sizes = [kernel_sizes(micro) for micro in self._micros]
        self._pores = [micro.graph.pores for micro in self._micros]
        self._interiors = sum(pores.interiors for pores in self._pores)
        laid = [_rule(tileset).lay(context.rng(which), mask, tileset) for which, tileset in enumerate(sets.sets)]
        faces, count = [], np.zeros(mask.shape, np.int64)
        for axis in range(3):
            low, high = laid[0][1][axis], laid[1][1][axis]
            place = np.argwhere(low >= 0)
            second = np.zeros(low.shape, bool)
            # the weight in the middle of a face decides whose it is
            second[tuple(place.T)] = weights(place + np.where(np.arange(3) == axis, 0.0, 0.5)) >= 0.5
            high = np.where(high >= 0, high + self._pores[0].colors[axis], -1)
            faces.append(np.where(second, high, low).astype(np.int32))
            for side in _sides(axis):
                count += second[side]
        # all six faces of one set make a cell of that set; anything between is a transition cell
        self.own = np.where(~mask, -1, np.where(count == 0, 0, np.where(count == 6, 1, 2))).astype(np.int8)
        self.between = np.argwhere(self.own == 2)
        first, after = laid[0][0], laid[1][0] + self._pores[0].interiors
        interior = np.where(self.own == 0, first, np.where(self.own == 1, after, -1)).astype(np.int32)
        interior[tuple(self.between.T)] = self._interiors + np.arange(len(self.between))
        self._arrays = TilingArrays(interior, (faces[0], faces[1], faces[2]), False, HALO)

    def _faces(self, number: int) -> Iterator[tuple[int, I64, I64]]:
        """For each face of a transition cell: its set, the pores on it in that set, and its shift from the low side."""
        for axis in range(3):
            for side in range(2):
                shift = side * _AXES[axis]
                color = int(self._arrays.faces[axis][tuple(self.between[number] + shift)])
                which = int(color >= self._pores[0].colors[axis])
                pores = self._pores[which]
                own = color - which * self._pores[0].colors[axis]
                yield which, pores.indices(pores.face_piece(axis, own)), shift

    def around(self, number: int) -> F64:
        """See `Layout`."""
        return np.concatenate(
            [self._pores[which].centers[index] + shift for which, index, shift in self._faces(number)]
        )

    def tiling(self, cells: list[Transition]) -> Tiling:
        """See `Layout`."""
        return Tiling(TileSet(self._microstructure(cells), "fresh", 0), self._arrays, self._edge, self._origin)

    def _microstructure(self, transitions: list[Transition]) -> Microstructure:
        """One microstructure of both sets and the transition cells."""
        one, two = self._pores
        x, y, z = (a + b for a, b in zip(one.colors, two.colors, strict=True))
        count = self._interiors + len(transitions)
        first_face = count + np.cumsum([0, x, y])
        centers, pieces, edges, shifts, omegas, mus = [], [], [], [], [], []
        for which, (micro, pores) in enumerate(zip(self._micros, self._pores, strict=True)):
            number = [np.arange(pores.interiors) + which * one.interiors]
            for axis, colors in enumerate(pores.colors):
                number.append(first_face[axis] + which * one.colors[axis] + np.arange(colors))
            centers.append(pores.centers)
            pieces.append(np.concatenate(number)[pores.piece])
            edges.append(micro.graph.edges.astype(np.int64) + which * len(one.centers))
            shifts.append(micro.graph.shift.astype(np.int64))
            omegas.append(self._sizes[which][0])
            mus.append(self._sizes[which][1])
        offset = len(one.centers) + len(two.centers)
        for number_of_cell, cell in enumerate(transitions):
            n = len(cell.centers)
            centers.append(cell.centers)
            pieces.append(np.full(n, self._interiors + number_of_cell))
            omegas.append(np.full(n, cell.omega))
            edges.append(cell.edges + offset)
            shifts.append(np.zeros((len(cell.edges), 3), np.int64))
            mus.append(np.full(len(cell.edges), cell.mu))
            for which, index, shift in self._faces(number_of_cell):
                usual = np.full(len(index), np.median(self._sizes[which][1]))
                nearest, mu = cell.connectors(self._pores[which].centers[index] + shift, usual)
                edges.append(np.stack([nearest + offset, index + which * len(one.centers)], 1))
                shifts.append(np.tile(shift, (len(index), 1)))
                mus.append(mu)
            offset += n
        made = PoreSet(one.cell, np.concatenate(centers), np.concatenate(pieces).astype(np.int32), count, (x, y, z))
        graph = TunnelGraph(made, np.concatenate(edges), np.concatenate(shifts))
        profile, level = self._micros[0].pieces.kernels.profile, max(micro.level for micro in self._micros)
        pieces_made = pieces_from_graph(graph, np.concatenate(omegas), np.concatenate(mus), profile)
        return replace(self._micros[0], graph=graph, pieces=pieces_made, level=level)  # the level of narrower tunnels


class TwoSizes:
    """The `Layout` of sets whose cells differ in size; each large cell belongs to one of them.

    Lengths are cell sizes of the larger set, counted from the low corner of the box with the cells around the part.
    The face between a large cell and small ones is the union of the small patterns; the large cell is a transition
    cell.
    """

    def __init__(
        self, context: Context, sets: JoinedSets, mask: Bools, weights: Weights, edge: float, origin: Origin
    ) -> None:
        self._edge, self._origin, self._shape = edge, np.array(origin), np.array(mask.shape)
        large = int(sets.per_edge[0] > 1)
        second = np.zeros(mask.shape, bool)
        place = np.argwhere(mask)
        second[tuple(place.T)] = weights(place + 0.5) >= 0.5
        small = mask & (second if large == 0 else ~second)
        between = mask & ~small & _beside(small)
        self.own = np.where(~mask, -1, np.where(between, 2, second)).astype(np.int8)
        self.between = np.argwhere(between)
        micros = [tileset.micro for tileset in sets.sets]
        self._profile, self._level = micros[0].pieces.kernels.profile, max(micro.level for micro in micros)
        graphs, usual = [], []
        for which, (tileset, m) in enumerate(zip(sets.sets, sets.per_edge, strict=True)):
            region = mask if which == large else small.repeat(m, 0).repeat(m, 1).repeat(m, 2)
            interior, faces = _rule(tileset).lay(context.rng(which), region, tileset)
            if which == large:
                interior, faces = np.where(small | between, -1, interior), _without(faces, small)
            arrays = TilingArrays(interior.astype(np.int32), faces, False, 0)
            graph = laid_graph(Tiling(tileset, arrays, edge / m), (False, False, False))
            graphs.append(graph._replace(points=graph.points / m).resized(self._profile, 1 / m, 1 / m))
            usual.append(np.full(len(graph.points), usual_kernels(tileset.micro, m)[1]))
        self._graph, self._usual = joined_graphs(graphs), np.concatenate(usual)
        self._on_planes = [self._sorted_on_planes(axis) for axis in range(3)]

    def _sorted_on_planes(self, axis: int) -> tuple[I64, I64]:
        """Pores on planes of the large lattice: numbers of the faces in which they lie, ascending, and the pores."""
        place = self._graph.points
        index = np.flatnonzero(np.abs(place[:, axis] - np.rint(place[:, axis])) < 1e-9)
        site = np.floor(place[index]).astype(np.int64)
        site[:, axis] = np.rint(place[index, axis])
        kept = ((site >= 0) & (site <= self._shape)).all(1)
        number = np.ravel_multi_index(tuple(site[kept].T), tuple(self._shape + 1))
        order = np.argsort(number, kind="stable")
        return number[order], index[kept][order]

    def _pores_around(self, place: I64) -> I64:
        """Pores on the six faces of a large cell."""
        found = []
        for axis, (faces, pores) in enumerate(self._on_planes):
            for side in range(2):
                number = np.ravel_multi_index(tuple((place + side * _AXES[axis]).tolist()), tuple(self._shape + 1))
                found.append(pores[np.searchsorted(faces, number) : np.searchsorted(faces, number, side="right")])
        return np.unique(np.concatenate(found))  # those on an edge lie in two planes

    def around(self, number: int) -> F64:
        """See `Layout`."""
        place = self.between[number]
        return np.asarray(self._graph.points[self._pores_around(place)] - place)

    def tiling(self, cells: list[Transition]) -> Tiling:
        """Blocks without faces, one for each large cell."""
        points, omegas, edges, mus = ([part] for part in self._graph)
        offset = len(self._graph.points)
        for cell, place in zip(cells, self.between, strict=True):
            around = self._pores_around(place)
            nearest, mu = cell.connectors(self._graph.points[around] - place, self._usual[around])
            points.append(cell.centers + place)
            omegas.append(np.full(len(cell.centers), cell.omega))
            edges += [cell.edges + offset, np.stack([nearest + offset, around], 1)]
            mus += [np.full(len(cell.edges), cell.mu), mu]
            offset += len(cell.centers)
        in_mm = (np.concatenate(points) - HALO) * self._edge + self._origin
        graph = LaidGraph(in_mm, np.concatenate(omegas), np.concatenate(edges), np.concatenate(mus))
        box = np.array([self._origin, self._origin + (self._shape - 2 * HALO) * self._edge])
        return cloud(graph, self._edge, box, self._profile, self._level)


def usual_kernels(micro: Microstructure, m: int) -> tuple[float, float]:
    """Medians of omega and mu of a set in the unit of a cell m times as large."""
    kernels, factor = micro.pieces.kernels, np.array([1 / m])
    omega = kernels.omega * PORE_PROFILE.scaled_radius(factor)
    return float(np.median(omega)), float(
        np.median(kernels.mu * TUNNEL_PROFILES[kernels.profile].scaled_radius(factor))
    )


def _sides(axis: int) -> Iterator[tuple[slice, ...]]:
    """Indices of the low faces of all cells, and of the high ones, in an array of the faces across an axis."""
    for side in (slice(None, -1), slice(1, None)):
        yield tuple(side if a == axis else slice(None) for a in range(3))


def _without(faces: Faces, other: Bools) -> Faces:
    """Faces of a lattice with -1 for those of `other` cells."""
    kept = [color.copy() for color in faces]
    for axis, color in enumerate(kept):
        for side in _sides(axis):
            color[side][other] = -1
    return kept[0], kept[1], kept[2]


def _beside(other: Bools) -> Bools:
    """Cells that share a face with one of `other`."""
    padded, found = np.pad(other, 1), np.zeros(other.shape, bool)
    for axis in range(3):
        for step in (-1, 1):
            found |= np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1]
    return found


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
