"""Base class of connectors: one method joins the pores of one piece."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.families.cloud import CellCube, Cloud, Piece
from sppm_pipeline.method.families.interiors import MANY
from sppm_pipeline.method.families.scattered import joined
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.size import Size
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.stage import Context, Stage

WINDOW_PORES = 3000
"""Approximate maximum number of pores that `Connector.join_cloud` passes to `join` at a time, margin included
(heuristic): the time of a `join` may grow with the square of their number, the share of pores in margins with its power
-1/3."""

WINDOW_MARGIN = 3.0
"""Width of the margin in mean distances of pores (heuristic): all pores that decide about a short edge should lie in
the window of either end. Edges of relative neighbors are at most 2.3 long in random packings."""


@dataclass(frozen=True, kw_only=True)
class Connector(Stage):
    """Base of connectors: implement `join`; `run` applies it to faces and interiors separately and then connects them.

    "The MBDST method is separately and concurrently applied on the surface and the interior, ultimately generating a
    tunnel between each pore on the surface and its closest counterpart on the interior" (paper, section 2.1).

    Attributes
    ----------
    follows_metric : bool
        Whether `join_cloud` joins pores that are stretched; otherwise it is given none.
    """

    follows_metric: ClassVar[bool] = False

    @abstractmethod
    def join(self, rng: np.random.Generator, piece: Piece) -> tuple[I64, I64]:
        """Join the pores of one piece.

        Returns
        -------
        edges : (m, 2) int64
            Indices into ``piece.points``.
        shift : (m, 3) int64
            Whole cells by which the second end is moved; zero unless ``piece.periodic``.
        """

    def join_cloud(self, context: Context, cloud: Cloud) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
        """Join the pores of a lattice of blocks into one connected graph.

        A cloud that `join` can take as one piece is one. A larger one is cut into windows of blocks, and `join` is
        called for each with a margin of pores around it; an edge counts if the window of its lower pore has found it.
        Where the windows do not agree the graph may fall apart: whether it is connected is found by union-find, and
        its parts are joined by the shortest edges between them, whose number is reported.

        Returns
        -------
        edges : (m, 2) int64 or int32
            Pairs i < j of indices into ``cloud.points``, sorted.
        shifts : (m, 3) int64 or int32
            Whole cells by which the second end is moved: multiples of the lattice along periodic axes, else zero. Both
            arrays are handed over: the caller may write to them.

        Raises
        ------
        ValueError
            If `join` returns no edges between pores of its piece.
        """
        from sppm_pipeline.method.connecting.candidates import bridging_edges
        from sppm_pipeline.method.connecting.trees import canonical_edges

        found = self._edges_of_windows(context, cloud)
        edges, shifts = canonical_edges(np.concatenate([e for e, _ in found]), np.concatenate([s for _, s in found]))
        # windows see the same pores near their borders, but a graph without long edges may still fall apart
        bridges, turns = bridging_edges(cloud.points, edges, cloud.period)
        context.report(bridging_tunnels=len(bridges))
        return canonical_edges(np.concatenate([edges, bridges]), np.concatenate([shifts, turns]))

    def _edges_of_windows(self, context: Context, cloud: Cloud) -> list[tuple[I64, I64]]:
        """Edges and shifts of each window of the cloud, by calls of `join`."""
        from sppm_pipeline.method.connecting.windows import (
            Lattice,
            edges_of_window,
            window,
            window_corners,
            window_edge,
        )

        n, (size, *others) = len(cloud.points), cloud.lattice
        # `Piece.periodic` means the unit cube: other lattices that repeat go by windows
        cubic = all(cloud.periodic) and others == [size, size]
        if n <= WINDOW_PORES and (cubic or not any(cloud.periodic)):
            # a periodic piece is a unit cube
            scale = size if cubic else 1
            cell = CellCube(cloud.cell.edge, cloud.cell.physical, scale) if cubic else cloud.cell
            edges, shifts = self._joined(context.rng(0), Piece(cloud.points / scale, cubic, "interior", cell))
            return [(edges, shifts * scale)]
        lattice = Lattice(cloud.points, cloud.first, cloud.lattice, cloud.period)
        margin = WINDOW_MARGIN * cloud.spacing
        boxes = list(window_corners(cloud.lattice, window_edge(cloud.spacing, WINDOW_PORES, margin)))
        found = []
        for number, corners in enumerate(boxes):
            view = window(lattice, corners, margin)
            if view.own.any():
                piece = Piece(cloud.points[view.pores] + view.turns, False, "interior", cloud.cell)
                # a stream for each window: none depends on what the others have drawn
                found.append(edges_of_window(view, *self._joined(context.rng(number), piece)))
            context.progress(number + 1, len(boxes), "windows joined")
        return found

    def _joined(self, rng: np.random.Generator, piece: Piece) -> tuple[I64, I64]:
        """Checked result of `join` for a piece of a cloud."""
        if len(piece.points) < 2:
            return np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64)
        edges, shifts = (np.asarray(array, np.int64) for array in self.join(rng, piece))
        if edges.ndim != 2 or edges.shape[1] != 2 or shifts.shape != (len(edges), 3):
            raise ValueError(f"{self.name}.join must return edges (m, 2) and shifts (m, 3)")
        if len(edges) and not 0 <= edges.min() <= edges.max() < len(piece.points):
            raise ValueError(f"{self.name}.join names a pore that is not in its piece")
        return edges, shifts

    def connect(self, face_points: F64, interior_points: F64, cell: Cell) -> I64:
        """For each face pore the interior pore that its connector leads to, (f,) int64: the nearest."""
        d = ((face_points[:, None, :] - interior_points[None, :, :]) ** 2).sum(-1)
        # of equally near ones the first: the same on every machine
        nearest: I64 = np.argmin(d, axis=1).astype(np.int64)
        return nearest

    def edges_of_a_pore(self) -> float:
        """Tunnels that `join` makes for each pore of a piece, on average."""
        return 1.0

    def estimate(self, palette: Palette, pores: Size) -> Size:
        cell = pores.cell
        patterns = sum(cell.colors)
        meetings = max(1, cell.colors[0]) if palette.meetings is None else 1
        along, across = self.edges_of_a_pore() * cell.pores, 2 * cell.face_pores
        return Size(
            pores=cell.interior_pores * cell.interiors + cell.face_pores / 3 * patterns,
            tunnels=(along + across * meetings) * cell.interiors,
            cells=cell.interiors + patterns,
            design=replace(cell, tunnels=along + across),
        )

    def run(self, context: Context, pores: PoreSet) -> TunnelGraph:
        """Join all pieces, then connect faces and interiors; or all blocks of a lattice without faces."""
        if context.palette.blocks is not None:
            return joined(context, self, pores)
        inner, turns = self.join_pieces(context, pores)
        across, sides = self.connect_pieces(context, pores)
        return TunnelGraph(pores, np.concatenate([inner, across]), np.concatenate([turns, sides]))

    def join_pieces(self, context: Context, pores: PoreSet) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
        """Join the pores of every piece by `join`; for connectors with a faster way for many pieces.

        Returns
        -------
        edges : (m, 2) int64 or int32
            Indices into ``pores.centers``, piece after piece.
        shifts : (m, 3) int64 or int8
        """
        edges, shifts = [np.zeros((0, 2), np.int64)], [np.zeros((0, 3), np.int64)]
        pieces = pores.interiors + sum(pores.colors)
        for piece in range(pieces):
            if len(pores.indices(piece)) > 1:
                found, turns = self.join_piece(context, pores, piece)
                edges.append(found)
                shifts.append(turns)
            if pieces > 4:
                context.progress(piece + 1, pieces, "pieces joined")
        return np.concatenate(edges), np.concatenate(shifts)

    def join_piece(self, context: Context, pores: PoreSet, piece: int) -> tuple[I64, I64]:
        """Result of `join` for one piece, as indices into ``pores.centers``."""
        index, region = pores.indices(piece), "interior" if piece < pores.interiors else "face"
        graded = context.palette.totals is not None and pores.has_faces and region == "interior"
        edges, shifts = self.join(
            context.rng(piece), Piece(pores.centers[index], not pores.has_faces, region, pores.cell, graded)
        )
        return index[edges], shifts

    @property
    def connects_to_the_nearest(self) -> bool:
        """True if `connect` leads to the nearest pores, which a compiled search finds for many faces at once."""
        return type(self).connect is Connector.connect

    def connect_pieces(self, context: Context, pores: PoreSet) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
        """The connectors of all interiors with the faces that they may meet, in the form of `join_pieces`."""
        edges, shifts = [np.zeros((0, 2), np.int64)], [np.zeros((0, 3), np.int64)]
        # which faces an interior may meet: all with an open palette, its own ones in the paper's set
        meetings = context.palette.all_meetings() if pores.has_faces else np.zeros((0, 4), np.int64)
        faces = pores.face_pieces(meetings[:, 1], meetings[:, 3])
        if self.connects_to_the_nearest and pores.has_faces and pores.interiors + sum(pores.colors) >= MANY:
            from sppm_pipeline.method.connecting.pieces import nearest_in_interiors

            return nearest_in_interiors(pores.centers, *pores.by_piece, meetings, faces)
        for (t, axis, side, _), face in zip(meetings.tolist(), faces.tolist(), strict=True):
            inside, outside = pores.indices(t), pores.indices(face)
            if len(inside) and len(outside):
                shift = np.zeros(3, np.int64)
                # patterns lie in the plane 0 of their axis; the face at 1 is the same one, a cell further
                shift[axis] = side
                nearest = self.connect(pores.centers[outside] + shift, pores.centers[inside], pores.cell)
                edges.append(np.stack([inside[nearest], outside], 1))
                shifts.append(np.tile(shift, (len(outside), 1)))
        return np.concatenate(edges), np.concatenate(shifts)
