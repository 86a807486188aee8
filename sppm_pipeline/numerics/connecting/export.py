"""Tunnel graphs as networkx graphs, for GraphML, JSON and inspection by other tools."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.connecting.images import as_points, edge_lengths


def networkx_graph(
    points: ArrayLike,
    edges: NDArray[np.int64],
    shifts: NDArray[np.int64],
    regions: Sequence[str] | None = None,
) -> Any:
    """The tunnel graph as a `networkx.MultiGraph`: two pores may share tunnels to several images.

    Every attribute is a plain number or string, so that GraphML and JSON can hold it.

    Parameters
    ----------
    points : (n, 3) float64
        Pore centers: node attributes ``x``, ``y``, ``z``.
    edges, shifts : (m, 2), (m, 3) int64
        Tunnels from ``points[i]`` to ``points[j] + shift`` with i < j: edge attributes ``length`` and ``shift``, the
        latter as three integers in a string ("0 0 -1").
    regions : n strings, optional
        Node attribute ``region``, for example "face" or "interior".

    Raises
    ------
    ValueError
        If `regions` has another length than `points`.
    """
    import networkx

    points = as_points(points)
    if regions is not None and len(regions) != len(points):
        raise ValueError(f"{len(regions)} regions for {len(points)} points")
    graph = networkx.MultiGraph()
    for v, (x, y, z) in enumerate(points.tolist()):
        graph.add_node(v, x=x, y=y, z=z)
        if regions is not None:
            graph.nodes[v]["region"] = str(regions[v])
    lengths = edge_lengths(points, edges, shifts).tolist()
    for (i, j), shift, length in zip(edges.tolist(), shifts.tolist(), lengths, strict=True):
        graph.add_edge(i, j, length=length, shift=" ".join(str(step) for step in shift))
    return graph
