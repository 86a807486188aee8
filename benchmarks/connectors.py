"""Connectors on clouds of 10^4, 10^5 and 10^6 pores: time a pore, and length against the Euclidean spanning tree.

Usage: python -m benchmarks.connectors [largest number of pores]
"""

from __future__ import annotations

import sys
import time

import numpy as np

from benchmarks.measure import table
from sppm_pipeline.method.connecting.trees import edge_lengths
from sppm_pipeline.method.families.cloud import Cloud
from sppm_pipeline.method.families.connector import Connector
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.connect_mst import MinimumSpanningTree
from sppm_pipeline.method.stages.connect_relative_neighbors import RelativeNeighbors
from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.testing.plain_context import PlainContext

PORES_OF_A_BLOCK = 68
CONNECTORS: dict[str, Connector] = {
    "connect.mst": MinimumSpanningTree(),
    "connect.relative_neighbors": RelativeNeighbors(),
    "connect.mbdst, greedy": BoundedDegreeSubgraph(mode="greedy"),
}


def jittered_cloud(pores: int) -> Cloud:
    """About as many pores on the torus, one at random in each cube of a grid: uneven, but never all in one place."""
    edge = max(1, round((pores / PORES_OF_A_BLOCK) ** (1 / 3)))
    side = round((PORES_OF_A_BLOCK * edge**3) ** (1 / 3))
    grid = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    points = (grid + np.random.default_rng(0).random(grid.shape)) * (edge / side)
    block = np.ravel_multi_index(tuple(np.floor(points).astype(int).T), (edge,) * 3)
    first = np.concatenate([[0], np.cumsum(np.bincount(block, minlength=edge**3))])
    return Cloud(points[np.argsort(block, kind="stable")], first, (edge,) * 3, (True,) * 3, Cell())


def main() -> None:
    largest = int(float(sys.argv[1])) if len(sys.argv) > 1 else 1_000_000
    rows = []
    small = jittered_cloud(3000)
    for connector in CONNECTORS.values():
        # compiled before it is timed
        connector.join_cloud(PlainContext(0, threads=2), small)
    for pores in (n for n in (10_000, 100_000, 1_000_000) if n <= largest):
        cloud = jittered_cloud(pores)
        tree = 0.0
        for name, connector in CONNECTORS.items():
            wall, cpu = time.perf_counter(), time.process_time()
            edges, shifts = connector.join_cloud(PlainContext(0, threads=2), cloud)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            length = float(edge_lengths(cloud.points, edges, shifts).sum())
            tree = tree or length
            n = len(cloud.points)
            rows.append([f"{name}, {n} pores", wall, cpu / n * 1e6, length / tree])
    table("connectors on clouds, two threads", ["what", "wall s", "CPU us/pore", "length / tree"], rows)


if __name__ == "__main__":
    main()
