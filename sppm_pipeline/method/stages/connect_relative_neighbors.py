"""``connect.relative_neighbors``: the relative neighborhood graph, decided by the pores around each tunnel alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Connector, Context, PoreSet, TunnelGraph, options
from sppm_pipeline.method.families.cloud import Cloud, Piece
from sppm_pipeline.services.arrays import I64


@dataclass(frozen=True, kw_only=True)
class RelativeNeighbors(Connector):
    """Join two pores unless a third is nearer to both than they are to each other (relative neighborhood graph).

    The graph contains the minimum spanning tree, so all pores are connected, and each tunnel depends on the pores
    around it alone: millions are joined in seconds. Pores with fewer than A tunnels then get the shortest that lead to
    pores with room. From pores with more than B the longest are taken away where a loop allows it; how many stay above
    B is reported as `pores_over_degree`.
    """

    name: ClassVar[str] = "connect.relative_neighbors"

    degree: tuple[int, int] = options.degree((3, 5))

    def check_options(self) -> None:
        options.check_degree(self.degree)

    def edges_of_a_pore(self) -> float:
        return max(1.8, 1.1 * self.degree[0] / 2)

    def join(self, rng: np.random.Generator, piece: Piece) -> tuple[I64, I64]:
        from sppm_pipeline.method.connecting.greedy import clamped_degrees, feasible_degrees
        from sppm_pipeline.method.connecting.relative_degrees import relative_neighbor_graph
        from sppm_pipeline.method.connecting.trees import periods

        n, degree = len(piece.points), self.degree
        if piece.region == "face" or piece.graded:
            degree = clamped_degrees(n, *degree)[:2]
        feasible_degrees(n, *degree, images=8 if piece.periodic else 1)
        edges, shifts, _ = relative_neighbor_graph(piece.points, periods(piece.periodic), degree)
        return edges.astype(np.int64), shifts.astype(np.int64)

    def join_cloud(self, context: Context, cloud: Cloud) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
        from sppm_pipeline.method.connecting.relative_degrees import REACH, relative_neighbor_graph

        edges, shifts, over = relative_neighbor_graph(
            cloud.points, cloud.period, self.degree, reach=REACH * cloud.spacing, threads=context.threads
        )
        context.report(pores_over_degree=over)
        return edges, shifts

    def run(self, context: Context, pores: PoreSet) -> TunnelGraph:
        """Join all pieces, then connect faces and interiors."""
        graph = super().run(context, pores)
        if pores.blocks is not None:
            return graph
        own = pores.piece[graph.edges]
        inner = graph.edges[own[:, 0] == own[:, 1]]
        degree = np.bincount(inner.ravel(), minlength=len(pores.centers))
        context.report(pores_over_degree=int((degree > self.degree[1]).sum()))
        return graph
