"""Walls between pores, pierced by tunnels: how the two distances make one field."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import inline_jit

#: Half a thickness, in cell sizes, that no wall has: what `opening` is inside of tunnels.
OPEN = np.float32(16.0)


@inline_jit
def _wall_field(
    distance: NDArray[np.float32], depth: NDArray[np.float32], half: np.float32, radius: np.float32
) -> None:
    for i in range(np.uint64(len(distance))):
        a, b = distance[i] - half, depth[i]
        top, gap = max(a, b), abs(a - b)
        # the larger of both, and above it where they are within `radius` of each other (`soft_minimum` of two)
        rest = max(radius - gap, np.float32(0.0))
        other = radius + rest
        lift = np.float32(0.5) * (other - np.sqrt(max(np.float32(2.0) * radius * radius - (radius - rest) ** 2, 0.0)))
        distance[i] = top + (lift if rest > np.float32(0.0) else np.float32(0.0))


@inline_jit
def _opening(distance: NDArray[np.float32], depth: NDArray[np.float32], radius: np.float32, top: np.float32) -> None:
    for i in range(np.uint64(len(distance))):
        b = max(radius + depth[i], np.float32(0.0))
        rise = radius - np.sqrt(max(radius * radius - b * b, np.float32(0.0)))
        distance[i] = distance[i] + rise if depth[i] < np.float32(0.0) else top


def wall_field(
    distance: NDArray[np.float32], depth: NDArray[np.float32], half_thickness: float, rounding: float
) -> NDArray[np.float32]:
    """Negative inside of walls: the larger of ``distance - half_thickness`` and `depth`, smooth where they meet.

    Parameters
    ----------
    distance : float32, C-contiguous
        From the middle of the nearest wall; is overwritten by the result.
    depth : float32, of the same shape
        In tunnels, negative outside.
    half_thickness : float
    rounding : float
        Radius of the rims of the openings; 0 for sharp ones.
    """
    _wall_field(distance.reshape(-1), depth.reshape(-1), np.float32(half_thickness), np.float32(rounding))
    return distance


def opening(distance: NDArray[np.float32], depth: NDArray[np.float32], rounding: float) -> NDArray[np.float32]:
    """The half thickness above which a point is solid, so that a porosity is a quantile of it; see `wall_field`.

    In tunnels it is `OPEN`: no wall closes them. Overwrites `distance`.
    """
    _opening(distance.reshape(-1), depth.reshape(-1), np.float32(rounding), OPEN)
    return distance
