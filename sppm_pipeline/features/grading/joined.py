"""Two tile sets as one: their interiors and faces side by side, and cells between them that touch faces of both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.fields.microstructure import Microstructure, pieces_from_graph
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.nouns.artifact import Artifact


@dataclass(frozen=True, eq=False)
class JoinedSets(Artifact):
    """Two tile sets that are to be laid in one part.

    Attributes
    ----------
    first, second : TileSet
    per_edge : tuple of 2 ints
        Cells of either set along the edge of the larger one's; one of them is 1.
    """

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
    """The interior of a cell between two sets.

    Attributes
    ----------
    centers : (n, 3) float64
        Pores, cell sizes.
    edges : (m, 2) int64
        Tunnels between them.
    faces : (6, 3) int64
        Axis, side and color (of both sets in a row) of its faces.
    omega, mu : float
        Of its pores and tunnels.
    """

    centers: NDArray[np.float64]
    edges: NDArray[np.int64]
    faces: NDArray[np.int64]
    omega: float
    mu: float


def kernel_sizes(micro: Microstructure) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Parameters omega of the pores and mu of the tunnels, in the order of the graph."""
    graph, kernels = micro.graph, micro.pieces.kernels
    order = pieces_from_graph(
        graph, np.arange(len(graph.pores.centers), dtype=float), np.arange(len(graph.edges), dtype=float), ""
    ).kernels
    omega, mu = np.empty_like(kernels.omega), np.empty_like(kernels.mu)
    omega[order.omega.astype(np.int64)] = kernels.omega
    mu[order.mu.astype(np.int64)] = kernels.mu
    return omega, mu


class Union:
    """The pores, tunnels and kernels of two sets, to which transition cells are added.

    Interiors of the second set are numbered behind those of the first, and likewise face colors; transition cells come
    last. Pores and tunnels of the sets keep their places, sizes and order.
    """

    def __init__(self, sets: JoinedSets) -> None:
        one, two = (tileset.micro for tileset in sets.sets)
        a, b = one.graph.pores, two.graph.pores
        self.interiors = (a.interiors, b.interiors)
        self.colors = (a.colors, b.colors)
        x, y, z = (m + n for m, n in zip(a.colors, b.colors, strict=True))
        self._all_colors = (x, y, z)
        self._sets = (one, two)
        self._sizes = [kernel_sizes(micro) for micro in self._sets]
        self.profile = one.pieces.kernels.profile
        self.level = max(one.level, two.level)  # that of the narrower tunnels

    def face(self, which: int, axis: int, color: NDArray[np.int32]) -> NDArray[np.int32]:
        """Colors of a set's faces among those of both."""
        return np.where(color >= 0, color + which * self.colors[0][axis], np.int32(-1)).astype(np.int32)

    def face_points(self, face: tuple[int, int, int]) -> NDArray[np.float64]:
        """Pores of a face, given by axis, side and color, where they touch the cell."""
        axis, side, color = face
        which = int(color >= self.colors[0][axis])
        pores = self._sets[which].graph.pores
        found: NDArray[np.float64] = pores.of_piece(pores.face_piece(axis, color - which * self.colors[0][axis]))
        return np.asarray(found + side * np.eye(3)[axis])

    def microstructure(self, transitions: list[Transition]) -> Microstructure:
        """Both sets and these cells between them."""
        one = self._sets[0]
        count = sum(self.interiors) + len(transitions)
        first_face = count + np.concatenate([[0], np.cumsum(self._all_colors)])
        centers, pieces, edges, shifts, omegas, mus = [], [], [], [], [], []
        offset, own_faces = 0, []
        for which, micro in enumerate(self._sets):
            graph = micro.graph
            number = np.empty(graph.pores.interiors + sum(graph.pores.colors), np.int64)
            number[: graph.pores.interiors] = np.arange(graph.pores.interiors) + which * self.interiors[0]
            for axis in range(3):
                start = graph.pores.face_piece(axis, 0)
                own = np.arange(graph.pores.colors[axis])
                number[start : start + len(own)] = first_face[axis] + which * self.colors[0][axis] + own
            own_faces.append(offset)
            centers.append(graph.pores.centers)
            pieces.append(number[graph.pores.piece])
            edges.append(graph.edges.astype(np.int64) + offset)
            shifts.append(graph.shift.astype(np.int64))
            omegas.append(self._sizes[which][0])
            mus.append(self._sizes[which][1])
            offset += len(graph.pores.centers)
        for t, cell in enumerate(transitions):
            n = len(cell.centers)
            centers.append(cell.centers)
            pieces.append(np.full(n, sum(self.interiors) + t))
            omegas.append(np.full(n, cell.omega))
            edges.append(cell.edges + offset)
            shifts.append(np.zeros((len(cell.edges), 3), np.int64))
            mus.append(np.full(len(cell.edges), cell.mu))
            for axis, side, color in cell.faces.tolist():
                which = int(color >= self.colors[0][axis])
                pores, own_color = self._sets[which].graph.pores, color - which * self.colors[0][axis]
                index = pores.indices(pores.face_piece(axis, own_color))
                if not len(index):
                    continue
                points = pores.centers[index] + side * np.eye(3)[axis]
                nearest = ((points[:, None] - cell.centers[None]) ** 2).sum(-1).argmin(1)
                edges.append(np.stack([nearest + offset, index + own_faces[which]], 1))
                shifts.append(np.tile(side * np.eye(3, dtype=np.int64)[axis], (len(index), 1)))
                # a connector is as wide as the mean of the tunnels that it joins
                mus.append(np.full(len(index), np.sqrt(cell.mu * np.median(self._sizes[which][1]))))
            offset += n
        pores = PoreSet(
            one.cell, np.concatenate(centers), np.concatenate(pieces).astype(np.int32), count, self._all_colors
        )
        graph = TunnelGraph(pores, np.concatenate(edges), np.concatenate(shifts))
        made = pieces_from_graph(graph, np.concatenate(omegas), np.concatenate(mus), self.profile)
        return replace(one, graph=graph, pieces=made, level=self.level)
