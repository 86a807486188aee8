"""The graph of a tiling, pore by pore, and blocks that hold a graph which was mapped, resized or joined.

The graph is mapped instead of the field, so that tunnels stay straight, kernels stay round, and no seam can form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.grading.curved_cells import CurvedCells
from sppm_pipeline.method.families.tiler import HALO, without_faces
from sppm_pipeline.method.fields.microstructure import Microstructure, finest_pitch, pieces_from_graph
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.nouns.palette import Blocks
from sppm_pipeline.services.arrays import F64, I64, Bools


@dataclass(frozen=True, eq=False)
class WarpedTiling(Tiling):
    """A tiling whose blocks are no cells of the structure: those are bent.

    `steepest` are the largest omega and mu of pores and tunnels in the cells of the structure, `curved`. Kernels
    mapped beyond the cells may be arbitrarily small, as towards the axis of a tube, and do not count.
    """

    curved: CurvedCells = field(kw_only=True)
    steepest: tuple[float, float] = field(kw_only=True)

    @property
    def finest_radius(self) -> float | None:
        micro, mu = self.tileset.micro, self.steepest[1]
        return TUNNEL_PROFILES[micro.pieces.kernels.profile].radius(mu, micro.level) if mu and micro.level < 1 else None

    @property
    def coarse_pitch(self) -> float | None:
        micro = self.tileset.micro
        if self.exact or micro.coarse_pitch is None:
            return None
        return finest_pitch(*self.steepest, micro.pieces.kernels.profile, micro.level)

    def summary(self) -> dict[str, Any]:
        """That of a tiling, and the number of cells of the structure."""
        return {**super().summary(), "curved_cells": self.curved.count}


MAX_BLOCKS = 4_000_000
"""Blocks of a mapped part, empty ones included: at about 100 bytes each they take 400 MB."""


class LaidGraph(NamedTuple):
    """The pores and tunnels of all cells of a tiling."""

    points: F64  # (n, 3), cell sizes, from the low corner of cell (0, 0, 0)
    omega: F64  # (n,), of the pores, 1 / cell size^2
    edges: I64  # (m, 2)
    mu: F64  # (m,), of the tunnels, in the unit of their profile

    def resized(self, profile: str, pores: F64 | float, tunnels: F64 | float) -> LaidGraph:
        """The graph with the radii of its pores and tunnels multiplied by factors."""
        omega = self.omega * PORE_PROFILE.scaled_radius(np.asarray(pores))
        return self._replace(omega=omega, mu=self.mu * TUNNEL_PROFILES[profile].scaled_radius(np.asarray(tunnels)))


def joined_graphs(parts: Sequence[LaidGraph]) -> LaidGraph:
    """Several graphs side by side; edges of each count its own points."""
    first = np.cumsum([0, *(len(part.points) for part in parts)])
    edges = [part.edges + begin for part, begin in zip(parts, first, strict=False)]
    return LaidGraph(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.omega for part in parts]),
        np.concatenate(edges),
        np.concatenate([part.mu for part in parts]),
    )


def kernel_sizes(micro: Microstructure) -> tuple[F64, F64]:
    """Parameters omega of the pores and mu of the tunnels, in the order of the graph."""
    graph, kernels = micro.graph, micro.pieces.kernels
    # numbers sorted as kernels are tell which kernel is whose
    order = pieces_from_graph(
        graph, np.arange(len(graph.pores.centers), dtype=float), np.arange(len(graph.edges), dtype=float), ""
    ).kernels
    # pieces sort kernels by their place: the numbers come back in that order
    omega, mu = np.empty_like(kernels.omega), np.empty_like(kernels.mu)
    omega[order.omega.astype(np.int64)] = kernels.omega
    mu[order.mu.astype(np.int64)] = kernels.mu
    return omega, mu


@dataclass(frozen=True)
class _Sites:
    """Which piece lies where: interiors and the faces in low planes, over a box of sites."""

    first: I64  # the first site, (3,)
    pieces: list[I64]  # for interiors and each axis, (sx, sy, sz); -1 for none
    wrap: Bools  # (3,)

    def at(self, kind: I64, site: I64) -> tuple[I64, I64]:
        """The flat place of sites (k, 3), and the piece of a kind (0 interior, 1 + axis) there; -1 beyond the box."""
        shape = np.array(self.pieces[0].shape)
        index = site - self.first
        index = np.where(self.wrap, index % shape, index)
        inside = np.logical_and(index >= 0, index < shape).all(axis=1).reshape(-1)
        flat = np.ravel_multi_index(tuple(np.where(inside.reshape(-1, 1), index, 0).T), self.pieces[0].shape)
        found = np.stack([pieces.ravel() for pieces in self.pieces])[kind, flat]
        return flat.astype(np.int64), np.where(inside, found, -1)


def _sites(tiling: Tiling, wrap: tuple[bool, bool, bool]) -> _Sites:
    arrays, pores = tiling.arrays, tiling.tileset.micro.graph.pores
    box = np.array(arrays.shape)
    around = np.where(wrap, 0, HALO)
    axes = [np.arange(-r, n + r) for r, n in zip(around, box, strict=True)]
    pieces = []
    for kind, content in enumerate((arrays.interior, *arrays.faces)):
        places, there = [], []
        for axis, site in enumerate(axes):
            index = site % box[axis] if arrays.periodic else site + arrays.halo
            there.append((index >= 0) & (index < content.shape[axis]))
            places.append(np.clip(index, 0, content.shape[axis] - 1))
        known = there[0][:, None, None] & there[1][:, None] & there[2]
        found = np.where(known, content[np.ix_(*places)], -1).astype(np.int64)
        # faces are owned by the cell on their high side, so that none is laid twice
        if kind:
            # a tiling may name faces that no pores were put on
            found = np.where(found < pores.colors[kind - 1], found, -1)
            found = np.where(found >= 0, found + pores.face_piece(kind - 1, 0), -1)
        pieces.append(found)
    return _Sites(-around, pieces, np.array(wrap))


def laid_graph(tiling: Tiling, wrap: tuple[bool, bool, bool]) -> LaidGraph:
    """The graph of a tiling and one more cell on all sides, or of one turn along axes that wrap, and no farther."""
    micro = tiling.tileset.micro
    graph, sites = micro.graph, _sites(tiling, wrap)
    omega, mu = kernel_sizes(micro)
    pores, shape = graph.pores, sites.pieces[0].shape
    kind_of_piece = pores.axis_of_piece() + 1
    order, begin = pores.by_piece
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order)) - begin[pores.piece[order]]
    ends = graph.edges.astype(np.int64)
    by_piece = np.argsort(pores.piece[ends[:, 0]], kind="stable")
    begin_edges = np.searchsorted(pores.piece[ends[by_piece, 0]], np.arange(len(kind_of_piece) + 1))
    # pores are numbered kind by kind, site by site
    count = np.diff(begin)
    counts = [np.where(p >= 0, count[np.maximum(p, 0)], 0).ravel() for p in sites.pieces]
    start = np.concatenate([[0], np.cumsum(np.concatenate(counts))])[:-1].reshape(4, -1)
    points, omegas, edges, mus = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros((0, 2), np.int64)], [np.zeros(0)]
    for kind, placed in enumerate(sites.pieces):
        for flat in np.flatnonzero(placed.ravel() >= 0):
            piece = int(placed.ravel()[flat])
            site = np.array(np.unravel_index(flat, shape)) + sites.first
            own = order[begin[piece] : begin[piece + 1]]
            points.append(pores.centers[own] + site)
            omegas.append(omega[own])
            led = by_piece[begin_edges[piece] : begin_edges[piece + 1]]
            if not len(led):
                continue
            second = ends[led, 1]
            wanted = pores.piece[second]
            # a tunnel exists where the neighbor has the piece that it was drawn for
            there, found = sites.at(kind_of_piece[wanted], graph.shift[led] + site)
            good = found == wanted
            low = start[kind, flat] + rank[ends[led, 0]]
            high = start[kind_of_piece[wanted], there] + rank[second]
            edges.append(np.stack([low, high], 1)[good])
            mus.append(mu[led][good])
    return LaidGraph(np.concatenate(points), np.concatenate(omegas), np.concatenate(edges), np.concatenate(mus))


_ALONG = np.array([0.5, 0.0, 1.0, 0.25, 0.75])
"""Points along a tunnel by which it is found to run through a cell, the likeliest first."""

_TRIED = 1024
"""Number of the smallest pores and tunnels that are tested first; most often one of them lies in a cell."""


def _largest_inside(sizes: F64, points_of: Callable[[I64], F64], curved: CurvedCells) -> float:
    """The largest of sizes (n,) of what has one of its points (chosen, k, 3) mm in a cell; of all if nothing has."""
    # from the smallest kernel (largest parameter) on, until one lies inside
    order, first, count = np.argsort(-sizes, kind="stable"), 0, _TRIED
    while first < len(order):
        some = order[first : first + count]
        inside = (curved.places(points_of(some).reshape(-1, 3)).cell.reshape(len(some), -1) >= 0).any(axis=1)
        if inside.any():
            return float(sizes[some[np.argmax(inside)]])
        first, count = first + count, 4 * count
    return float(sizes.max(initial=0.0))


def _along(graph: LaidGraph, chosen: I64) -> F64:
    """Points along tunnels, (chosen, 5, 3)."""
    start, end = (graph.points[graph.edges[chosen, k]][:, None] for k in range(2))
    way: F64 = start + _ALONG[:, None] * (end - start)
    return way


def cloud(
    graph: LaidGraph,
    edge: float,
    box: F64,
    profile: str,
    level: float,
    *,
    exact: bool = False,
    curved: CurvedCells | None = None,
) -> Tiling:
    """Blocks without faces that hold a graph, whose points are in mm and whose kernels are in units of `edge`, that of
    a block in mm; `box` (2, 3) mm is what they have to cover. `curved` are the cells of the structure, if they are
    known, and `profile` is that of the tunnels. `DesignError` if the box has too many blocks.
    """
    count = np.maximum(np.ceil((box[1] - box[0]) / edge - 1e-9), 1).astype(np.int64)
    origin = (box[0] + box[1] - count * edge) / 2
    shape = count + 2 * HALO
    if np.prod(shape.astype(float)) > MAX_BLOCKS:
        raise DesignError(
            f"the mapped cells lie in a box of {' x '.join(f'{v:g}' for v in box[1] - box[0])} mm, which takes "
            f"{np.prod(shape.astype(float)):.3g} blocks of {edge:g} mm; the limit is {MAX_BLOCKS}",
            hint="take a smaller radius or larger cells",
        )
    place = (graph.points - origin) / edge + HALO
    block = np.floor(place).astype(np.int64)
    kept = ((block >= 0) & (block < shape)).all(axis=1)
    flat = np.ravel_multi_index(tuple(np.where(kept[:, None], block, 0).T), tuple(shape))
    order = np.flatnonzero(kept)[np.argsort(flat[kept], kind="stable")]
    number = np.full(len(kept), -1, np.int64)
    number[order] = np.arange(len(order))
    ends = number[graph.edges]
    whole = (ends >= 0).all(axis=1) & (ends[:, 0] != ends[:, 1])
    ends = np.sort(ends[whole], axis=1)
    # cells around the box repeat tunnels of its other side: each pair of pores is joined once
    ends, first = np.unique(ends, axis=0, return_index=True)
    blocks = Blocks(np.ones(tuple(shape), bool), False)
    own = block[order]
    pores = PoreSet(
        Cell(edge, True),
        np.clip(place[order] - own, 0.0, 1.0),
        flat[order].astype(np.int32),
        int(np.prod(shape)),
        (0, 0, 0),
        blocks=blocks,
    )
    joined = TunnelGraph(pores, ends, own[ends[:, 1]] - own[ends[:, 0]])
    pieces = pieces_from_graph(joined, graph.omega[order], graph.mu[whole][first], profile)
    micro = Microstructure(Cell(edge, True), joined, pieces, level, exact)
    low = (float(origin[0]), float(origin[1]), float(origin[2]))
    tiling = without_faces(micro, blocks, HALO, edge, low)
    if curved is None:
        return replace(tiling, exact=exact)
    steepest = (
        _largest_inside(graph.omega, lambda chosen: graph.points[chosen], curved),
        _largest_inside(graph.mu, lambda chosen: _along(graph, chosen), curved),
    )
    return WarpedTiling(tiling.tileset, tiling.arrays, edge, low, exact, curved=curved, steepest=steepest)
