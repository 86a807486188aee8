"""Two tile sets in one part whose cells differ in size by a whole factor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.grading.joined import JoinedSets, Transition
from sppm_pipeline.features.grading.warped import HALO, LaidGraph, cloud, laid_graph
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.fields.tiling import Tiling

Faces = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]


@dataclass(frozen=True)
class Laid:
    """Where the pieces of one set lie in a box of its cells: interiors and faces, -1 for none."""

    interior: NDArray[np.int32]
    faces: Faces


class TwoSizes:
    """Pores and tunnels of two sets of unlike cells, to which transition cells of the larger size are added.

    Lengths are cell sizes of the larger set, counted from the low corner of the box with the cells around the part.
    A face between a large cell and small ones is the union of the small patterns; the large cell is a transition cell.

    Parameters
    ----------
    sets : JoinedSets
    laid : (Laid, Laid)
        Of both sets, each in cells of its own.
    edge : float
        Size of a large cell, mm.
    origin : 3 floats
        Low corner of the part's cell (0, 0, 0), mm.
    """

    def __init__(
        self, sets: JoinedSets, laid: tuple[Laid, Laid], edge: float, origin: tuple[float, float, float]
    ) -> None:
        from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES

        self._edge, self._origin = edge, np.array(origin)
        self._shape = np.array(laid[int(sets.per_edge[0] > 1)].interior.shape)
        micros = [tileset.micro for tileset in sets.sets]
        self._profile, self._level = micros[0].pieces.kernels.profile, max(micro.level for micro in micros)
        graphs, widths = [], []
        for tileset, own, m in zip(sets.sets, laid, sets.per_edge, strict=True):
            arrays = TilingArrays(own.interior, own.faces, False, 0)
            graph = laid_graph(Tiling(tileset, arrays, edge / m), (False, False, False))
            factor = np.array([1 / m])
            mu = TUNNEL_PROFILES[self._profile].scaled_radius(factor)
            graphs.append(
                LaidGraph(
                    graph.points / m, graph.omega * PORE_PROFILE.scaled_radius(factor), graph.edges, graph.mu * mu
                )
            )
            usual = float(np.median(tileset.micro.pieces.kernels.mu)) * float(mu[0])
            widths.append(np.full(len(graph.points), usual))
        first = len(graphs[0].points)
        self._graph = LaidGraph(
            np.concatenate([g.points for g in graphs]),
            np.concatenate([g.omega for g in graphs]),
            np.concatenate([graphs[0].edges, graphs[1].edges + first]),
            np.concatenate([g.mu for g in graphs]),
        )
        self._widths = np.concatenate(widths)
        self._on_planes = [self._sorted_on_planes(axis) for axis in range(3)]

    def _sorted_on_planes(self, axis: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pores on planes of the large lattice: numbers of the faces in which they lie, ascending, and the pores."""
        place = self._graph.points
        index = np.flatnonzero(np.abs(place[:, axis] - np.rint(place[:, axis])) < 1e-9)
        site = np.floor(place[index]).astype(np.int64)
        site[:, axis] = np.rint(place[index, axis])
        kept = ((site >= 0) & (site <= self._shape)).all(1)
        number = np.ravel_multi_index(tuple(site[kept].T), tuple(self._shape + 1))
        order = np.argsort(number, kind="stable")
        return number[order], index[kept][order]

    def pores_around(self, place: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers of the pores on the six faces of a large cell."""
        found = []
        for axis, (faces, pores) in enumerate(self._on_planes):
            for side in range(2):
                number = np.ravel_multi_index(
                    tuple((place + side * np.eye(3, dtype=np.int64)[axis]).tolist()), tuple(self._shape + 1)
                )
                found.append(pores[np.searchsorted(faces, number) : np.searchsorted(faces, number, side="right")])
        return np.unique(np.concatenate(found))  # those on an edge lie in two planes

    def points(self, pores: NDArray[np.int64], place: NDArray[np.int64]) -> NDArray[np.float64]:
        """Centers of pores, from the low corner of a large cell."""
        return np.asarray(self._graph.points[pores] - place)

    def tiling(self, transitions: list[Transition], places: NDArray[np.int64]) -> Tiling:
        """All of it as blocks without faces, one for each large cell."""
        points, omegas, edges, mus = ([part] for part in self._graph)
        offset = len(self._graph.points)
        for cell, place in zip(transitions, places, strict=True):
            around = self.pores_around(place)
            away = self.points(around, place)[:, None] - cell.centers[None]
            points.append(cell.centers + place)
            omegas.append(np.full(len(cell.centers), cell.omega))
            edges.append(cell.edges + offset)
            mus.append(np.full(len(cell.edges), cell.mu))
            edges.append(np.stack([(away**2).sum(-1).argmin(1) + offset, around], 1))
            # a connector is as wide as the mean of the tunnels that it joins
            mus.append(np.sqrt(cell.mu * self._widths[around]))
            offset += len(cell.centers)
        graph = LaidGraph(np.concatenate(points), np.concatenate(omegas), np.concatenate(edges), np.concatenate(mus))
        in_mm = graph._replace(points=(graph.points - HALO) * self._edge + self._origin)
        box = np.array([self._origin, self._origin + (self._shape - 2 * HALO) * self._edge])
        return cloud(in_mm, self._edge, box, self._profile, self._level)


def refined(mask: NDArray[np.bool_], m: int) -> NDArray[np.bool_]:
    """Each cell as m x m x m smaller ones."""
    for axis in range(3):
        mask = np.repeat(mask, m, axis)
    return mask


def faces_without(faces: Faces, other: NDArray[np.bool_]) -> Faces:
    """Faces of a lattice but for those that touch `other` cells, where they become -1."""
    kept = []
    for axis, color in enumerate(faces):
        touched = np.zeros(color.shape, bool)
        for side in (slice(None, -1), slice(1, None)):
            touched[tuple(side if a == axis else slice(None) for a in range(3))] |= other
        kept.append(np.where(touched, np.int32(-1), color).astype(np.int32))
    return kept[0], kept[1], kept[2]


def beside(other: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells that share a face with one of `other`."""
    padded, found = np.pad(other, 1), np.zeros(other.shape, bool)
    for axis in range(3):
        for step in (-1, 1):
            found |= np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1]
    return found
