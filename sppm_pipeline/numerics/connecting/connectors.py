"""Connectors: the tunnels that join each pore on a face to a pore of the interior."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.connecting.clearance import segment_distance
from sppm_pipeline.numerics.connecting.images import as_points


def nearest_connectors(face_points: ArrayLike, interior_points: ArrayLike, *, clearance: float) -> NDArray[np.int64]:
    """The interior pore that each face pore is joined to: the nearest, or the second nearest if that is free.

    Face pores are served in their order. The second nearest interior pore is taken if the tunnel to the nearest would
    come closer than `clearance` to a connector chosen before, and the tunnel to the second would not; if both are too
    close, it stays the nearest. Connectors that end in the same interior pore meet there and never count as close.
    Of equally near pores the one with the lower index is nearer.

    Parameters
    ----------
    face_points : (f, 3) float64
        Pores on the face.
    interior_points : (n, 3) float64
        Pores of the interior, in the same frame.
    clearance : float
        Least distance of the tunnels' axes, usually twice the tunnel radius; 0 always takes the nearest.

    Returns
    -------
    (f,) int64
        Index into `interior_points` for each face pore.

    Raises
    ------
    DesignError
        If there are face pores but no interior pore.
    """
    face, interior = as_points(face_points), as_points(interior_points)
    if len(face) and not len(interior):
        raise DesignError(
            f"{len(face)} face pores have no interior pore to connect to",
            hint="place at least one pore in the interior (a smaller spacing or gap leaves more room)",
        )
    return np.asarray(_connect(face, interior, float(clearance)), dtype=np.int64)


@jit
def _connect(face: NDArray[np.float64], interior: NDArray[np.float64], clearance: float) -> NDArray[np.int64]:
    f, n = face.shape[0], interior.shape[0]
    joined = np.empty(f, np.int64)
    unmoved = np.zeros(3)
    rank = np.empty(2, np.int64)
    for i in range(f):
        near = np.inf
        next_near = np.inf
        rank[:] = -1
        for j in range(n):
            d = 0.0
            for a in range(3):
                d += (interior[j, a] - face[i, a]) ** 2
            if d < near:
                near, next_near = d, near
                rank[1] = rank[0]
                rank[0] = j
            elif d < next_near:
                next_near = d
                rank[1] = j
        joined[i] = rank[0]
        for choice in rank:
            if choice < 0:
                continue
            free = True
            for e in range(i):
                if joined[e] != choice:
                    gap = segment_distance(face[i], interior[choice], face[e], interior[joined[e]], unmoved)
                    if gap < clearance:
                        free = False
                        break
            if free:
                joined[i] = choice
                break
    return joined
