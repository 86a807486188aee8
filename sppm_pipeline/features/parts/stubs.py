"""Stubs of cut struts at a loaded face: found by their sections, and relieved of their load.

A surface cuts struts of a porous part anywhere. Where the cut leaves a stub on a thin neck, a force spread evenly over
the face bends it far away, while whatever presses on the real part, a plate or the head of a screw, would lose touch
with it and rest on all others.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.services.jit.compiled import jit

DEPTH = 1.5
"""Sections below a loaded face that are looked at, in mean widths of its islands."""

SLENDER = 3.0
"""Elongation of what carries an island, over that of a prism below it, from which on the island is a stub. On a cube of
8^3 cells at porosity 0.7 it is 0.8 in the median of some 150 struts, at 16 and 32 voxels a cell; the next ones to the
stubs, which have 4.2 to 14, have 2.8 and 2.5."""

MAX_STUBS = 0.05
"""Share of the loaded voxels that may be stubs: more of them are what the part was designed to be loaded at."""


@jit
def elongations(share: NDArray[Any], voxels: I64, starts: I64, depth: int) -> F64:
    """Elongation of what carries each island of a loaded face, over that of a prism with the section of the island.

    Voxels at equal distance from an island, counted along faces of voxels, cut it off from all that lies deeper. If
    each of these sections were rigid in itself, the elongations between them would add up; that is a lower bound of
    the true one (for currents, that of Nash-Williams).

    Parameters
    ----------
    share : (nz, ny, nx) float
        What voxels count in a section, in any unit; 0 in the void.
    voxels, starts : int64
        Flat indices of the loaded voxels, island by island, and where those of each begin, and the last one ends.
    depth : int
        Sections that are looked at.
    """
    nz, ny, nx = share.shape
    flat = share.reshape(-1)
    free = flat > 0
    steps = np.array([1, -1, nx, -nx, nx * ny, -nx * ny])
    queue = np.empty(1024, np.int64)
    found = np.zeros(len(starts) - 1)
    for island in range(len(found)):
        low, high = 0, starts[island + 1] - starts[island]
        if high > len(queue):
            queue = np.empty(2 * high, np.int64)
        queue[:high] = voxels[starts[island] : starts[island + 1]]
        free[queue[:high]] = False
        area = 0.0
        for _ in range(depth):
            section = 0.0
            for i in range(low, high):
                section += flat[queue[i]]
            if low == high:
                break
            area = area or section
            found[island] += area / section / depth
            end = high
            for i in range(low, high):
                at = queue[i]
                x, y, z = at % nx, at // nx % ny, at // (nx * ny)
                inside = (x < nx - 1, x > 0, y < ny - 1, y > 0, z < nz - 1, z > 0)
                for s in range(6):
                    if inside[s] and free[at + steps[s]]:
                        if end == len(queue):
                            queue = np.append(queue, np.empty(end, np.int64))
                        queue[end] = at + steps[s]
                        free[queue[end]] = False
                        end += 1
            low, high = high, end
        free[queue[:high]] = True
    return found


def firm_faces(voxel: I64, solid: Bools, mass: NDArray[Any]) -> Bools:
    """Which loaded faces (n,) stand on no stub; the most slender ones count first, up to `MAX_STUBS` of the face.

    Parameters
    ----------
    voxel : (n,) int64
        Flat indices of the voxels that the faces belong to.
    solid, mass : (nz, ny, nx)
        Of the body; sections of voxels count by their mass.
    """
    from scipy.ndimage import label

    at = np.unique(voxel)
    places = np.stack(np.unravel_index(at, solid.shape))
    low, high = places.min(1), places.max(1) + 1
    loaded = np.zeros(high - low, bool)
    loaded[tuple(places - low[:, None])] = True
    labels, count = label(loaded)
    if count < 2:
        return np.ones(len(voxel), bool)
    island = labels[tuple(places - low[:, None])] - 1
    depth = max(2, round(DEPTH * float(np.sqrt(len(at) / count))))
    low, high = np.maximum(low - depth, 0), np.minimum(high + depth, solid.shape)
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    near = np.where(solid[box], mass[box], 0)
    order = np.argsort(island, kind="stable")
    flat = np.ravel_multi_index(tuple(places - low[:, None]), near.shape)[order]
    starts = np.concatenate([[0], np.cumsum(np.bincount(island))])
    slender = elongations(near, flat, starts, depth)
    worst = np.argsort(-slender, kind="stable")
    few = np.cumsum(np.diff(starts)[worst]) <= MAX_STUBS * len(at)
    firm = np.ones(count, bool)
    firm[worst[few & (slender[worst] > SLENDER)]] = False
    return np.asarray(firm[island][np.searchsorted(at, voxel)])


def same_resultant(points: F64, weights: F64, kept: Bools, force: F64) -> F64:
    """A force (3,) spread over the kept ones of some points, (n, 3), with the moment it has when spread over all.

    The kept points share it as if a rigid body were tied to them by springs as stiff as their weights.

    Parameters
    ----------
    points : (n, 3)
    weights : (n,)
        Areas.
    kept : (n,) bool
    force : (3,)

    Returns
    -------
    (n, 3)
        None at the points that are left out; at all points by their weights if the kept ones, on a line, can't bear
        that moment.
    """
    whole, w = weights / weights.sum(), np.where(kept, weights, 0) / weights[kept].sum()
    middle = w @ points
    arms = np.where(kept[:, None], points - middle, 0)
    moment = np.cross(whole @ points - middle, force)
    inertia = float(w @ (arms**2).sum(1)) * np.eye(3) - (w[:, None] * arms).T @ arms
    turn = np.linalg.pinv(inertia, rcond=1e-9, hermitian=True) @ moment
    if not np.allclose(inertia @ turn, moment, rtol=0, atol=1e-9 * float(np.linalg.norm(moment))):
        return np.outer(whole, force)
    return np.asarray(w[:, None] * (force + np.cross(turn, arms)))
