"""Warping: points of the lattice too close to the surface are moved onto it (Labelle and Shewchuk, 2007)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.tetrahedra.lattice import Crossings

TOO_CLOSE = np.array([np.nan, 0.45, 0.45, 0.41189, 0.24999])
"""Share of an edge below which the surface counts as too close to its end, by the squared length of the edge in the
doubled grid: 4 and 3 for the long and short edges of the lattice, with the paper's values; 2 and 1 for the half
diagonals of squares in the faces of the box and for the edges from their centers into the box."""

REACH_IN_FACE = 0.45
"""Share of an edge up to which a point in a face of the box is moved, if an edge leaving the face asks for it."""


def warp(
    crossings: Crossings, shares: NDArray[np.float64], top: tuple[int, int, int], periodic: bool
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which points are put onto the surface, and by how much each moves.

    A point in a face of the box moves in that face only, in an edge of the box along it. Where only edges that leave
    the face are cut too close to it, it is moved along one in the face that is cut within reach; failing that it stays
    where it is and counts as on the surface all the same.

    Parameters
    ----------
    crossings : Crossings
    shares : (e,) float64
        Where the surface cuts each edge, as a share of it from its first end.
    top : 3 ints
        Largest coordinates of the doubled grid, x, y, z.
    periodic : bool

    Returns
    -------
    on_surface : (s,) bool
    moved : (s, 3) float64
        In units of the doubled grid; 0 for those that stay.
    """
    steps = np.diff(crossings.ends, axis=1)[:, 0].astype(np.float64)
    squares = (steps**2).sum(1).astype(np.int64)
    nx, ny = top[0] + 1, top[1] + 1
    at = np.stack([crossings.points % nx, crossings.points // nx % ny, crossings.points // (nx * ny)], 1)
    fixed = (at == 0) | (at == np.array(top))
    # those that may move freely go first: what they take over, those in the faces need not approximate
    order = np.argsort(fixed.sum(1), kind="stable")
    on_surface = np.zeros(len(at), np.bool_)
    moved = np.zeros((len(at), 3))
    _warp(
        order, crossings.starts, crossings.incident, crossings.slots, shares, steps, TOO_CLOSE[squares],
        np.sqrt(squares), fixed, on_surface, moved,
    )  # fmt: skip
    return on_surface, moved


@jit
def _warp(
    order: NDArray[np.int64],
    starts: NDArray[np.int64],
    incident: NDArray[np.int64],
    slots: NDArray[np.int32],
    shares: NDArray[np.float64],
    steps: NDArray[np.float64],
    too_close: NDArray[np.float64],
    lengths: NDArray[np.float64],
    fixed: NDArray[np.bool_],
    on_surface: NDArray[np.bool_],
    moved: NDArray[np.float64],
) -> None:
    for s in order:
        close = False
        best, way, nearest = -1, 0.0, np.inf
        in_face = fixed[s, 0] or fixed[s, 1] or fixed[s, 2]
        for p in range(starts[s], starts[s + 1]):
            e = incident[p]
            first = slots[e, 0] == s
            if on_surface[slots[e, 1] if first else slots[e, 0]]:
                continue
            share = shares[e] if first else 1.0 - shares[e]
            close |= share < too_close[e]
            allowed = share < (REACH_IN_FACE if in_face else too_close[e])
            for axis in range(3):
                if fixed[s, axis] and steps[e, axis] != 0:
                    allowed = False
            if allowed and share * lengths[e] < nearest:
                best, way, nearest = e, (share if first else -share), share * lengths[e]
        if close:
            on_surface[s] = True
            if best >= 0:
                for axis in range(3):
                    moved[s, axis] = way * steps[best, axis]
