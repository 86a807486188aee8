"""Exact squared Euclidean distances between voxels, on a torus or in a box."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit

FAR = np.int32(2**30)
"""Stands for no voxel of the other phase at all."""


def squared_distance(
    phase: NDArray[np.uint8], periodic: tuple[bool, bool, bool] = (True, True, True)
) -> NDArray[np.int32]:
    """For each voxel of a phase the squared distance to the nearest voxel outside of it, in voxels, center to center.

    Parameters
    ----------
    phase : (nz, ny, nx) uint8
        1 in the phase.
    periodic : tuple of 3 bools
        Whether opposite sides along x, y, z are neighbors; otherwise nothing is known to lie beyond a side.

    Returns
    -------
    (nz, ny, nx) int32
        0 outside the phase; `FAR` everywhere if there is no outside.
    """
    squared = np.where(phase != 0, FAR, np.int32(0))
    # along one axis after the other, the nearest in a plane follows from the nearest in its rows
    for axis, wraps in ((2, periodic[0]), (1, periodic[1]), (0, periodic[2])):
        lines = np.ascontiguousarray(np.moveaxis(squared, axis, 2))
        _along_rows(lines, wraps)
        squared = np.ascontiguousarray(np.moveaxis(lines, 2, axis))
    return squared


@jit
def _along_rows(lines: NDArray[np.int32], wraps: bool) -> None:
    """Lower envelope of parabolas along the last axis: each sample looks outward until nothing nearer can come."""
    nz, ny, n = lines.shape
    best = np.empty(n, np.int32)
    for k in range(nz):
        for j in range(ny):
            row = lines[k, j]
            for i in range(n):
                nearest = row[i]
                step = 1
                while step < n and step * step < nearest:
                    for side in (-step, step):
                        at = i + side
                        if wraps:
                            if at < 0:
                                at += n
                            elif at >= n:
                                at -= n
                        elif at < 0 or at >= n:
                            continue
                        candidate = row[at] + step * step
                        nearest = min(nearest, candidate)
                    step += 1
                best[i] = nearest
            for i in range(n):
                row[i] = best[i]
