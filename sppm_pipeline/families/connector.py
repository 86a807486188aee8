"""Base class of connectors: one method joins the pores of one piece."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.length import Cell
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.pores import PoreSet
from sppm_pipeline.data.size import Size
from sppm_pipeline.data.tunnels import TunnelGraph
from sppm_pipeline.stage import Context, Stage


class Piece(NamedTuple):
    """The pores of one interior or one face pattern, to be joined.

    Attributes
    ----------
    points : (n, 3) float64, cell sizes
    periodic : bool
        Whether tunnels may lead to images in neighboring cells (a cell without face pores).
    region : str
        "face" or "interior".
    cell : Cell
        Turns the user's lengths into cell sizes.
    """

    points: NDArray[np.float64]
    periodic: bool
    region: str
    cell: Cell


@dataclass(frozen=True, kw_only=True)
class Connector(Stage):
    """Base of connectors: implement `join`; `run` applies it to faces and interiors separately and then connects them.

    "The MBDST method is separately and concurrently applied on the surface and the interior, ultimately generating a
    tunnel between each pore on the surface and its closest counterpart on the interior" (paper, section 2.1).
    """

    @abstractmethod
    def join(self, rng: np.random.Generator, piece: Piece) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Join the pores of one piece.

        Returns
        -------
        edges : (m, 2) int64
            Indices into ``piece.points``.
        shift : (m, 3) int64
            Whole cells by which the second end is moved; zero unless ``piece.periodic``.
        """

    def connect(
        self, face_points: NDArray[np.float64], interior_points: NDArray[np.float64], cell: Cell
    ) -> NDArray[np.int64]:
        """For each face pore the interior pore that its connector leads to, (f,) int64: the nearest."""
        d = ((face_points[:, None, :] - interior_points[None, :, :]) ** 2).sum(-1)
        nearest: NDArray[np.int64] = np.argmin(d, axis=1).astype(np.int64)
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
        """Join all pieces, then connect faces and interiors."""
        edges, shifts = [np.zeros((0, 2), np.int64)], [np.zeros((0, 3), np.int64)]
        axis_of_piece = pores.axis_of_piece()
        members = [pores.indices(piece) for piece in range(len(axis_of_piece))]
        for piece, index in enumerate(members):
            if len(index) > 1:
                region = "face" if axis_of_piece[piece] >= 0 else "interior"
                e, s = self.join(
                    context.rng(piece), Piece(pores.centers[index], not pores.has_faces, region, pores.cell)
                )
                edges.append(index[e])
                shifts.append(s)
            if len(members) > 4:
                context.progress(piece + 1, len(members), "pieces joined")
        for t, axis, side, color in context.palette.all_meetings() if pores.has_faces else ():
            inside = members[t]
            outside = members[pores.face_piece(axis, color)]
            if len(inside) and len(outside):
                shift = np.zeros(3, np.int64)
                shift[axis] = side
                nearest = self.connect(pores.centers[outside] + shift, pores.centers[inside], pores.cell)
                edges.append(np.stack([inside[nearest], outside], 1))
                shifts.append(np.tile(shift, (len(outside), 1)))
        return TunnelGraph(pores, np.concatenate(edges), np.concatenate(shifts))
