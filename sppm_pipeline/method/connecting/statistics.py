"""Statistics of a tunnel graph: degrees, parts, loops, bridges, lengths, and whether it runs through the periodic cell.

Also the graph as `networkx` has it, for GraphML, JSON and inspection by other tools.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.method.connecting.trees import Indices, as_points, bridge_mask, component_labels, edge_lengths
from sppm_pipeline.services.arrays import I64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.union_find import unite_shifted


class GraphStatistics(NamedTuple):
    """Figures of a tunnel graph; lengths are in the unit of the points, NaN without a tunnel."""

    pores: int  # n
    tunnels: int  # m
    degree_histogram: I64  # (highest degree + 1,) number of pores with 0, 1, 2, ... tunnels
    mean_degree: float  # 2 m / n
    components: int  # connected parts; a pore without a tunnel is one
    loops: int  # independent loops, m - n + components
    bridges: int  # tunnels on no loop
    mean_length: float
    min_length: float
    max_length: float
    wraps: tuple[bool, bool, bool]  # axes along which the graph runs through the periodic cell into its own image


def graph_statistics(points: ArrayLike, edges: Indices, shifts: Indices) -> GraphStatistics:
    """Figures of the graph with the tunnels ``points[i]`` to ``points[j] + shift``; parallel tunnels count each."""
    points = as_points(points)
    edges = np.ascontiguousarray(edges, dtype=np.int64)
    n, m = len(points), len(edges)
    lengths = edge_lengths(points, edges, shifts) if m else np.array([np.nan])
    components = int(component_labels(n, edges).max(initial=-1)) + 1
    return GraphStatistics(
        pores=n, tunnels=m, degree_histogram=np.bincount(np.bincount(edges.ravel(), minlength=n)).astype(np.int64),
        mean_degree=2.0 * m / n if n else 0.0, components=components, loops=m - n + components,
        bridges=int(bridge_mask(n, edges).sum()), mean_length=float(lengths.mean()), min_length=float(lengths.min()),
        max_length=float(lengths.max()), wraps=wraps(n, edges, shifts),
    )  # fmt: skip


def wraps(n: int, edges: Indices, shifts: Indices) -> tuple[bool, bool, bool]:
    """Along which axes some cycle of the graph on n pores ends in another image of its start.

    Each pore carries its offset from the root of its component; a tunnel that closes a cycle whose offsets do not add
    up to zero along an axis runs through the cell along that axis (J. Machta et al., Phys. Rev. E 54, 1996).
    """
    edges = np.ascontiguousarray(edges, dtype=np.int64).reshape(-1, 2)
    shifts = np.ascontiguousarray(shifts, dtype=np.int64).reshape(-1, 3)
    x, y, z = (bool(along.any()) for along in _wraps(n, edges, shifts).T)
    return x, y, z


@jit
def _wraps(n: int, edges: I64, shifts: I64) -> Bools:
    parent, offset, wraps = np.arange(n).astype(np.int32), np.zeros((n, 3), np.int32), np.zeros((n, 3), np.bool_)
    for e in range(len(edges)):
        unite_shifted(parent, offset, wraps, edges[e, 0], edges[e, 1], shifts[e, 0], shifts[e, 1], shifts[e, 2])
    return wraps


def networkx_graph(points: ArrayLike, edges: Indices, shifts: Indices, regions: Sequence[str] | None = None) -> Any:
    """The tunnel graph as a `networkx.MultiGraph`: two pores may share tunnels to several images.

    Every attribute is a plain number or string, so that GraphML and JSON can hold it: of nodes ``x``, ``y``, ``z`` and,
    with `regions` (n strings, say "face" or "interior"), ``region``; of edges ``length`` and ``shift``, three integers
    in a string ("0 0 -1"). Each edge leads from the lower to the higher pore.
    """
    import networkx

    points = as_points(points)
    graph = networkx.MultiGraph()
    for v, (x, y, z) in enumerate(points.tolist()):
        graph.add_node(v, x=x, y=y, z=z)
        if regions is not None:
            graph.nodes[v]["region"] = str(regions[v])
    lengths = edge_lengths(points, edges, shifts).tolist()
    for (i, j), shift, length in zip(edges.tolist(), shifts.tolist(), lengths, strict=True):
        # an undirected graph returns its edges from the lower end, where the same tunnel has the opposite shift
        first, second, sign = (i, j, 1) if i <= j else (j, i, -1)
        graph.add_edge(first, second, length=length, shift=" ".join(str(sign * step) for step in shift))
    return graph
