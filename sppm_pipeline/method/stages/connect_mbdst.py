"""``connect.mbdst``: the cheapest connected graph with bounded degrees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Cell, Connector, Context, DesignError, Length, PoreSet, TunnelGraph, option, options
from sppm_pipeline.method.families.cloud import Cloud, Piece
from sppm_pipeline.method.families.interiors import MANY
from sppm_pipeline.services.arrays import F64, I64

MAX_EXACT = 3000
"""Pores of a piece up to which `exact` is used, for time: the relaxation takes a second for 2000 and a quarter of a
minute for 4000. Beyond, `greedy` makes graphs that are some percent longer."""


@dataclass(frozen=True, kw_only=True)
class BoundedDegreeSubgraph(Connector):
    """Join pores by the cheapest connected graph in which every pore has between A and B tunnels.

    The paper calls it the minimum bounded-degree spanning tree (Singh and Lau 2015) and asks for A = 3, B = 5; as no
    tree has degree 3 everywhere, this is read as a spanning subgraph. With A = 1 it is the degree-bounded tree. Where
    a face has too few pores for A, the bound is relaxed to what the pores allow, and this is reported. So it is between
    the faces of a graded cell, whose connectors come on top.
    """

    name: ClassVar[str] = "connect.mbdst"
    sources: ClassVar[tuple[str, ...]] = (
        "M. Singh, L. C. Lau: Approximating minimum bounded degree spanning trees to within one of "
        "optimal. Journal of the ACM 62(1), 2015. https://doi.org/10.1145/2629366",
    )
    version: ClassVar[int] = 2
    follows_metric: ClassVar[bool] = True

    degree: tuple[int, int] = options.degree((3, 5))
    mode: str = option(
        "exact",
        help="exact: proven optimum for up to 100 pores in one piece, within about 0.4 % of it for up to 3000, then "
        "greedy; greedy: within about 5 %, in milliseconds; lp_fix: former name of exact",
        choices=("exact", "greedy", "lp_fix"),
    )
    neighbors: int = option(
        10, help="nearest neighbors a pore may be joined to", minimum=2, maximum=100, formerly="neighbours"
    )
    two_edge_connected: bool = option(False, help="no single tunnel may hold the graph together")
    clearance: Length | None = option(
        None, help="smallest distance between tunnels that share no pore", unit="cell size", above=0, maximum=1e6
    )
    connector_clearance: Length | None = option(
        None, help="a face pore takes the second nearest interior pore if its tunnel would run closer to another one",
        unit="cell size", above=0, maximum=1e6,
    )  # fmt: skip

    def check_options(self) -> None:
        options.check_degree(self.degree)

    def edges_of_a_pore(self) -> float:
        return 1.05 * max(2.0, self.degree[0]) / 2

    @property
    def rated_as(self) -> str:
        return f"{self.name}.{self.mode_for(1)}"

    def mode_for(self, pores: int) -> str:
        """The mode by which so many pores are joined; where a clearance has to be proved impossible, always `mode`."""
        return "greedy" if self.mode == "greedy" or (pores > MAX_EXACT and self.clearance is None) else "exact"

    def join(self, rng: np.random.Generator, piece: Piece) -> tuple[I64, I64]:
        from sppm_pipeline.method.connecting.bounded import spanning_subgraph
        from sppm_pipeline.method.connecting.greedy import clamped_degrees

        minimum, maximum = self.degree
        if piece.region == "face" or piece.graded:
            minimum, maximum, _ = clamped_degrees(len(piece.points), minimum, maximum)
        return spanning_subgraph(
            piece.points, (minimum, maximum), mode=self.mode_for(len(piece.points)), periodic=piece.periodic,
            k=self.neighbors, two_edge_connected=self.two_edge_connected,
            clearance=None if self.clearance is None else piece.cell.fraction(self.clearance),
        )  # fmt: skip

    def join_cloud(self, context: Context, cloud: Cloud) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
        from sppm_pipeline.method.connecting import regional
        from sppm_pipeline.method.connecting.bounded import spanning_subgraph
        from sppm_pipeline.method.connecting.greedy import feasible_degrees

        n = len(cloud.points)
        if n <= regional.WHOLE:
            return spanning_subgraph(
                cloud.points, self.degree, mode=self.mode_for(n), periodic=cloud.period.tolist(), k=self.neighbors,
                two_edge_connected=self.two_edge_connected,
                clearance=None if self.clearance is None else cloud.cell.fraction(self.clearance), metric=cloud.metric,
            )  # fmt: skip
        for option_name, given in (("two_edge_connected", self.two_edge_connected), ("clearance", self.clearance)):
            if given:
                raise DesignError(
                    f"`{option_name}` can't be promised for {n} pores without cells, only for {regional.WHOLE}",
                    hint=f"leave `{option_name}` out, or use tiles, whose cells are joined one by one",
                )
        feasible_degrees(n, *self.degree)
        return regional.regional_subgraph(
            cloud.points, cloud.period, self.degree, spacing=cloud.spacing, mode=self.mode_for(1), k=self.neighbors,
            metric=cloud.metric, threads=context.threads,
            progress=lambda done, total: context.progress(done, total, "passes over the regions"),
        )  # fmt: skip

    def join_pieces(self, context: Context, pores: PoreSet) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
        from sppm_pipeline.method.connecting.pieces import greedy_pieces, piece_degrees

        order, first = pores.by_piece
        sizes = np.diff(first)
        plain = self.mode == "greedy" and not self.two_edge_connected and self.clearance is None
        replaced = type(self).join is not BoundedDegreeSubgraph.join
        if replaced or not (plain and pores.has_faces) or len(sizes) < MANY:
            return super().join_pieces(context, pores)
        pieces = np.flatnonzero(sizes > 1)
        degrees = piece_degrees(sizes, pores.interiors, self.degree)[pieces]
        edges: list[NDArray[np.integer]] = [np.zeros((0, 2), np.int32)]
        done = 0
        runs = greedy_pieces(pores.centers, order, first, pieces, degrees, k=self.neighbors, threads=context.threads)
        for own, found, counts in runs:
            start = 0
            for left in np.flatnonzero(counts < 0).tolist():
                stop = int(np.maximum(counts[:left], 0).sum())
                edges += [found[start:stop], self.join_piece(context, pores, int(own[left]))[0]]
                start = stop
            edges.append(found[start:])
            done += len(own)
            context.progress(done, len(pieces), "pieces joined")
        together = np.concatenate(edges)
        # tunnels of a piece that does not repeat lead to no image
        return together, np.zeros((len(together), 3), np.int8)

    @property
    def connects_to_the_nearest(self) -> bool:
        return self.connector_clearance is None and type(self).connect is BoundedDegreeSubgraph.connect

    def connect(self, face_points: F64, interior_points: F64, cell: Cell) -> I64:
        if self.connector_clearance is None:
            return super().connect(face_points, interior_points, cell)
        from sppm_pipeline.method.connecting.clearance import nearest_connectors

        return nearest_connectors(face_points, interior_points, clearance=cell.fraction(self.connector_clearance))

    def run(self, context: Context, pores: PoreSet) -> TunnelGraph:
        """Join all pieces, then connect faces and interiors."""
        from sppm_pipeline.method.connecting.greedy import clamped_degrees

        sizes = np.diff(pores.by_piece[1])
        self._warn_of_mode(context, len(pores.centers) if pores.blocks is not None else int(sizes.max(initial=0)))

        def relaxed(sizes: NDArray[np.integer]) -> int:
            kinds, counts = np.unique(sizes, return_counts=True)
            few = [size > 1 and clamped_degrees(size, *self.degree)[2] for size in kinds.tolist()]
            return int(counts @ np.array(few, np.int64))

        graph = super().run(context, pores)
        context.report(faces_with_relaxed_degree=relaxed(sizes[pores.interiors :]))
        if context.palette.totals is not None and pores.has_faces:
            context.report(interiors_with_relaxed_degree=relaxed(sizes[: pores.interiors]))
        return graph

    def _warn_of_mode(self, context: Context, largest: int) -> None:
        """Warn of a former name, and if pieces of so many pores are joined by another mode than the one asked for."""
        if self.mode == "lp_fix":
            context.warn("option 'mode': `lp_fix` is now `exact`; the old name works in this version")
        if self.mode_for(largest) == self.mode_for(1):
            return
        from sppm_pipeline.method.connecting.regional import WHOLE

        # the regions of a larger cloud are joined by the mode that was asked for
        if context.palette.blocks is None or largest <= WHOLE:
            context.warn(
                f"option 'mode': a piece of {largest} pores is joined by `mode: greedy`, as `exact` would take too long"
            )
