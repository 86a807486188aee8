"""Tunnels: the edges between pores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.nouns.artifact import Artifact, frozen, in_rows, twin_rows_of, whole_numbers
from sppm_pipeline.services.arrays import F64, I64

NARROW = 1 << 18
"""Number of tunnels from which they are kept in few bytes: eleven each instead of forty, 3 MB instead of 10. Not
sensitive: only memory. Like the content it belongs to the graph, so that digests are the same on every machine."""

_BLOCK = 1 << 16
"""Tunnels that are processed at a time, so that intermediate arrays are small. Not sensitive: only memory."""


@dataclass(frozen=True, eq=False)
class TunnelGraph(Artifact):
    """Edges between the pores of a `PoreSet`.

    Edge (i, j) with shift s is the tunnel from pore i to the image of pore j at ``centers[j] + s``. An edge inside one
    interior or one face pattern belongs to that piece; an edge from an interior pore i to a face pore j is a
    connector, with shift 1 along the axis of the face if it ends on the high side of the cell. Between blocks without
    faces (`PoreSet.blocks`) edges lead from any pore to any other, and belong to the block of the first.

    Attributes
    ----------
    pores : PoreSet
    edges : (m, 2) int64
        int32 from a quarter of a million tunnels on (`NARROW`).
    shift : (m, 3) int64
        Whole cells; int8 from as many tunnels on, if that holds them.
    """

    reported: ClassVar[tuple[str, ...]] = ("tunnels", "connectors", "mean_tunnel_length")

    pores: PoreSet
    edges: NDArray[np.integer]
    shift: NDArray[np.integer]

    def __post_init__(self) -> None:
        many = len(self.edges) >= NARROW
        edges = whole_numbers(self.edges, np.int32 if many else np.int64, "the ends of tunnels")
        small = many and -128 <= np.min(self.shift) <= np.max(self.shift) <= 127
        shift = whole_numbers(self.shift, np.int8 if small else np.int64, "the shifts of tunnels")
        for name, array, width in (("edges", edges, 2), ("shift", shift, 3)):
            rows = in_rows(array, width, f"the {'ends' if name == 'edges' else 'shifts'} of tunnels")
            # a view is copied if it is the caller's own array; a converted one is not shared
            object.__setattr__(self, name, frozen(rows.view() if rows is getattr(self, name) else rows))

    @classmethod
    def from_arrays(cls, pores: PoreSet, edges: ArrayLike, shift: ArrayLike | None = None) -> TunnelGraph:
        """Tunnels between pores.

        Parameters
        ----------
        pores : PoreSet
        edges : (m, 2) array_like of int
            Indices of the pores at both ends.
        shift : (m, 3) array_like of int, optional
            Whole cells to the image of the second pore. Without it the image nearest to the first pore is taken, as the
            cell is periodic.

        Raises
        ------
        ValueError
            If an index is no whole number or out of range, a tunnel leads from a pore to itself, or two are equal.
        """
        ends = in_rows(whole_numbers(np.array(edges), np.int64, "the ends of tunnels"), 2, "the ends of tunnels")
        if len(ends) and not 0 <= ends.min() <= ends.max() < len(pores.centers):
            raise ValueError("a tunnel names a pore that does not exist")
        # minimum image: the offset of a periodic neighbor is at most half a cell along each axis
        nearest = -np.round(pores.centers[ends[:, 1]] - pores.centers[ends[:, 0]])
        graph = cls(pores, ends, np.array(nearest if shift is None else shift, np.int64))
        graph.check()
        return graph

    def to_networkx(self) -> Any:
        """The pores and tunnels as a `networkx.MultiGraph`: two pores may share tunnels to several images.

        Returns
        -------
        networkx.MultiGraph
            Nodes have ``x``, ``y``, ``z`` in the unit of `PoreSet.to_numpy` and ``piece``; tunnels ``length`` in that
            unit and ``shift``, whole cells to the image of their second pore, as a string ``"0 0 -1"``.
        """
        from sppm_pipeline.method.connecting.statistics import networkx_graph

        graph = networkx_graph(self.pores.centers, self.edges, self.shift)
        scale = self.pores.cell.edge if self.pores.cell.physical else 1.0
        for (_, about), piece in zip(graph.nodes(data=True), self.pores.piece.tolist(), strict=True):
            about |= {"piece": piece, **{axis: about[axis] * scale for axis in "xyz"}}
        for *_, about in graph.edges(data=True):
            about["length"] *= scale
        return graph

    def check(self) -> None:
        """Indices in range, one shift an edge, no tunnel twice, connectors pointing from interior to face."""
        if self.shift.shape != (len(self.edges), 3):
            raise ValueError(f"{len(self.edges)} tunnels but shifts of shape {self.shift.shape}")
        if len(self.edges) and not 0 <= self.edges.min() <= self.edges.max() < len(self.pores.centers):
            raise ValueError("a tunnel names a pore that does not exist")
        self._check_distinct()
        if self.pores.blocks is not None:
            return
        a, b = self.pores.piece[self.edges].T
        wrong = (a != b) & ~((a < self.pores.interiors) & (b >= self.pores.interiors))
        if wrong.any():
            raise ValueError("a tunnel between two pieces must lead from an interior pore to a face pore")

    def _check_distinct(self) -> None:
        """No tunnel without length, and none given twice, be it from the other end."""
        # the order in which connectors make them; then no sort is needed
        if self._ascending():
            return
        twins = twin_rows_of(len(self.edges), self._directed, _BLOCK)
        if twins is not None:
            first, second = twins
            a, b = self.edges[first]
            raise ValueError(f"tunnels {first} and {second} are one: both join the pores {a} and {b}")

    def _directed(self, some: slice) -> list[I64]:
        """Columns of some tunnels: their ends and shifts, seen from the end that makes both senses the same."""
        (a, b), s = self.edges[some].astype(np.int64).T, self.shift[some].astype(np.int64)
        loops = np.flatnonzero((a == b) & ~s.any(1))
        if len(loops):
            raise ValueError(f"tunnel {some.start + loops[0]} leads from pore {a[loops[0]]} to itself")
        # a loop to an own image is the same tunnel in both directions: the first shift that is not 0 decides
        leading = np.where(s[:, 0] != 0, s[:, 0], np.where(s[:, 1] != 0, s[:, 1], s[:, 2]))
        backward = (a > b) | ((a == b) & (leading < 0))
        sign = np.where(backward, -1, 1)
        return [np.where(backward, b, a), np.where(backward, a, b), *(s * sign[:, None]).T]

    def _ascending(self) -> bool:
        """True if all tunnels lead from lower to higher pores and are sorted by pores and shift, none twice."""
        if (self.edges[:, 0] >= self.edges[:, 1]).any():
            return False
        equal, less = np.ones(max(len(self.edges) - 1, 0), bool), np.zeros(max(len(self.edges) - 1, 0), bool)
        for column in (*self.edges.T, *self.shift.T):
            # lexicographic comparison of neighbors, column by column
            less |= equal & (column[:-1] < column[1:])
            equal &= column[:-1] == column[1:]
        return bool(less.all())

    def segments(self, some: slice | NDArray[np.integer] = slice(None)) -> tuple[F64, F64]:
        """Start and end points of all tunnels, or of some, each (m, 3), cell sizes."""
        start, end = (self.pores.centers[self.edges[some, k]] for k in range(2))
        end += self.shift[some]
        return start, end

    def sorted_segments(self, order: I64 | None) -> tuple[F64, F64]:
        """`segments` in another order, None for their own, with little memory beside them."""
        start, end = np.empty((len(self.edges), 3)), np.empty((len(self.edges), 3))
        for first in range(0, len(self.edges), _BLOCK):
            some = slice(first, first + _BLOCK)
            start[some], end[some] = self.segments(some if order is None else order[some])
        return start, end

    def lengths(self) -> F64:
        """Lengths of all tunnels, (m,), cell sizes."""
        length = np.empty(len(self.edges))
        for first in range(0, len(length), _BLOCK):
            some = slice(first, first + _BLOCK)
            start, end = self.segments(some)
            end -= start
            length[some] = np.sqrt(np.einsum("ij,ij->i", end, end))
        return length

    def summary(self) -> dict[str, Any]:
        """Counts and lengths; the samplers' connectivity statistics are reported by the connecting stage."""
        length = self.lengths()
        connectors = 0
        if self.pores.blocks is None:
            a, b = self.pores.piece[self.edges].T
            connectors = int((a != b).sum())
        return {
            "tunnels": len(self.edges),
            "connectors": connectors,
            "mean_tunnel_length": float(length.mean()) if len(length) else None,
        }
