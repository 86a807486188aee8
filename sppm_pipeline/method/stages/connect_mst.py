"""``connect.mst``: the minimum spanning tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Connector, Context
from sppm_pipeline.method.families.cloud import Cloud, Piece
from sppm_pipeline.services.arrays import I64


@dataclass(frozen=True, kw_only=True)
class MinimumSpanningTree(Connector):
    """Join pores by the shortest tree (the traditional way that the paper compares with)."""

    name: ClassVar[str] = "connect.mst"

    def join(self, rng: np.random.Generator, piece: Piece) -> tuple[I64, I64]:
        from sppm_pipeline.method.connecting.trees import minimum_spanning_tree

        return minimum_spanning_tree(piece.points, periodic=piece.periodic)

    def join_cloud(self, context: Context, cloud: Cloud) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
        from sppm_pipeline.method.connecting.relative_degrees import REACH, shortest_tree

        return shortest_tree(cloud.points, cloud.period, reach=REACH * cloud.spacing, threads=context.threads)
