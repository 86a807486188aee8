"""Connected spanning subgraphs with bounded degrees: the paper's "MBDST with A = 3, B = 5" and its kin."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting.greedy import feasible_degrees, greedy_subgraph
from sppm_pipeline.method.connecting.trees import Periodic, as_points, images_per_pair, periods
from sppm_pipeline.services.arrays import F64, I64


def spanning_subgraph(
    points: ArrayLike,
    degree: tuple[int, int],
    *,
    mode: str = "exact",
    periodic: Periodic = False,
    k: int = 10,
    two_edge_connected: bool = False,
    clearance: float | None = None,
    metric: F64 | None = None,
) -> tuple[I64, I64]:
    """Shortest connected graph on all pores in which every degree lies in [A, B].

    A tree can't have every degree >= 3, so the paper's degree-bounded tree (section "Reinforcement of Pore
    Connectivity") is read as the minimum-cost connected spanning subgraph with degrees in [A, B]; with A <= 1 this is
    the degree-bounded spanning tree of M. Singh and L. C. Lau (J. ACM 62, 2015). See `feasible_degrees`, and
    `clamped_degrees` for faces with few pores.

    The mode ``exact``: no shorter graph exists among the candidate edges (an integer program, solved to its end: by
    linear programs and branching, or by HiGHS where that takes too long). Beyond `exact.PROVEN` pores this is not
    proven where branching does not end: edges that the linear relaxation decides then stay, and the graph is up to 0.4
    % longer. ``greedy``: a tree filled up and improved by exchange, a few percent longer, in milliseconds, without
    scipy.

    Axes are `periodic` with period 1, or after so many cells each, 0 for never. Two pores may then share tunnels to
    several images; a pore is never joined to its own image. The number `k` of candidate neighbors grows by itself if
    the bounds can't be met with it. With `two_edge_connected` every tunnel lies on a loop, so that no single lost
    tunnel cuts the graph, and every degree is at least 2. `clearance` is the least distance between the axes of tunnels
    without a common pore. With `metric` (n, 6) a tunnel is measured, and neighbors are found, in the mean of the
    metrics of its ends.

    Returns pairs i < j (m, 2), sorted by (i, j, shift), and shifts (m, 3): the tunnel runs from ``points[i]`` to
    ``points[j] + shift``. Raises DesignError if no graph has these degrees, or none was found that holds the clearance.
    """
    points = as_points(points)
    period = periods(periodic)
    if clearance is not None and not clearance >= 0:
        raise DesignError(f"a clearance of {clearance} is not a distance", hint="give a number >= 0, or none")
    n = len(points)
    lower, upper = (int(bound) for bound in degree)
    # refused here, before any search: an infeasible program takes the solver longest
    feasible_degrees(n, lower, upper, images=images_per_pair(period.tolist()), two_edge_connected=two_edge_connected)
    if n == 1:
        return np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64)
    # connection alone asks for one tunnel at every pore, loops for two
    lower = max(lower, 2 if two_edge_connected else 1)
    # no distance is below 0: the search for close pairs can be skipped
    clearance = clearance or None
    if mode == "exact":  # imported here: it takes scipy, which the greedy mode does without
        from sppm_pipeline.method.connecting.exact import exact_subgraph as solved
    else:
        solved = greedy_subgraph
    return solved(
        points, lower, upper, period=period, k=k, loops=two_edge_connected, clearance=clearance, metric=metric
    )
