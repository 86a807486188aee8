"""Derivatives of the stiffness of a periodic cell by the stiffness of its voxels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.stiffness.numerics.elasticity import Homogenized
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.elastic.loaded import brick_strains

_CHUNK = 20000
"""Bricks at a time, to bound memory."""

_CORNERS = tuple((x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1))


def brick_stiffness(
    found: Homogenized, shape: tuple[int, int, int], edges: tuple[float, float, float], base: F64,
    where: NDArray[np.int64],
) -> F64:  # fmt: skip
    """Mutual energies of the six load cases in bricks of the stiffness `base` (6, 6), over their volume.

    They are the derivatives of the cell's stiffness by the share of `base` that a brick has, times the number of
    bricks: to first order the displacements may stay as they are, since they make the energy least. With the bricks'
    own shares the mean is the stiffness itself, but for the error of the displacements in its second order.

    Parameters
    ----------
    found : Homogenized
        With `fields`.
    shape : (nz, ny, nx)
    edges : (hx, hy, hz)
        Of a brick, in any unit.
    base : (6, 6) float64
    where : (m,) int64
        Flat indices of the bricks.

    Returns
    -------
    (m, 6, 6) float64
    """
    longest = max(edges)
    matrices, weights = brick_strains((edges[0] / longest, edges[1] / longest, edges[2] / longest))
    weights = weights / weights[0]  # the first is the volume
    moved = [packed.reshape(3, *shape) for packed, _ in found.fields]
    steps = np.array([step for _, step in found.fields])
    out = np.empty((len(where), 6, 6))
    for first in range(0, len(where), _CHUNK):
        part = where[first : first + _CHUNK]
        z, y, x = np.unravel_index(part, shape)
        corners = np.empty((6, len(part), 24))
        for n, (cx, cy, cz) in enumerate(_CORNERS):
            at: Any = (slice(None), (z + cz) % shape[0], (y + cy) % shape[1], (x + cx) % shape[2])
            for case, u in enumerate(moved):
                corners[case, :, 3 * n : 3 * n + 3] = steps[case] * u[at].T
        energy = np.zeros((len(part), 6, 6))
        for number, (matrix, weight) in enumerate(zip(matrices, weights, strict=True)):
            strain = corners @ matrix.T
            if not number:  # that of the load case is the same all over the brick
                strain += np.eye(6)[:, None]
            energy += weight * np.einsum("cma,dma->mcd", strain @ base, strain)
        out[first : first + _CHUNK] = energy
    return out
