"""Kernels of a periodic cell: their images, and the field on the torus (method: every image within reach counts)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.kernels.kernels import Kernels
from sppm_pipeline.numerics.kernels.parameters import DEFAULT_CUTOFF, reach_boxes
from sppm_pipeline.numerics.kernels.splat import add_kernels


def periodic_images(
    kernels: Kernels,
    lower: ArrayLike = (0.0, 0.0, 0.0),
    upper: ArrayLike = (1.0, 1.0, 1.0),
    cutoff: float = DEFAULT_CUTOFF,
) -> Kernels:
    """All images of the kernels of a unit cell, shifted by whole cells, that reach a box.

    Parameters
    ----------
    kernels : Kernels
        The kernels of one cell in cell units; each pore and tunnel once. Tunnels may leave the unit cube.
    lower, upper : (3,) array_like
        Corners of the box, in cell units.
    cutoff : float
        An image is left out where it stays below the cut-off in the whole box.

    Returns
    -------
    Kernels
        Images ordered by kernel, then by shift.
    """
    lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    pore_lower, pore_upper, tunnel_lower, tunnel_upper = reach_boxes(kernels, cutoff)
    pore, pore_shift = _shifts(pore_lower, pore_upper, lower, upper)
    tunnel, tunnel_shift = _shifts(tunnel_lower, tunnel_upper, lower, upper)
    return Kernels(
        kernels.centers[pore] + pore_shift,
        kernels.omega[pore],
        kernels.starts[tunnel] + tunnel_shift,
        kernels.ends[tunnel] + tunnel_shift,
        kernels.mu[tunnel],
        kernels.squared,
    )


def _shifts(
    box_lower: NDArray[np.float64],
    box_upper: NDArray[np.float64],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Index of the kernel and shift of every image whose box meets the box."""
    if len(box_lower) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    first = np.ceil(lower - box_upper).min(axis=0).astype(int)
    last = np.floor(upper - box_lower).max(axis=0).astype(int)
    ranges = [np.arange(a, b + 1, dtype=np.float64) for a, b in zip(first, last, strict=True)]
    x, y, z = (
        (box_lower[:, axis, None] + ranges[axis] <= upper[axis])
        & (box_upper[:, axis, None] + ranges[axis] >= lower[axis])
        for axis in range(3)
    )
    index, i, j, k = np.nonzero(x[:, :, None, None] & y[:, None, :, None] & z[:, None, None, :])
    return index, np.stack([ranges[0][i], ranges[1][j], ranges[2][k]], axis=-1)


def sample_periodic(
    kernels: Kernels,
    n: int,
    at: Literal["centers", "nodes"] = "centers",
    cutoff: float = DEFAULT_CUTOFF,
    threads: int = 1,
) -> NDArray[np.float32]:
    """The field of a periodic unit cell on a regular grid; opposite faces agree to the last bit.

    Parameters
    ----------
    kernels : Kernels
        The kernels of one cell in cell units; each pore and tunnel once.
    n : int
        Voxels along a cell edge.
    at : {"centers", "nodes"}
        Sample the voxel centers, or the voxel corners including both ends: the last plane of corners is a copy of
        the first one.
    cutoff : float
        See `add_kernels`.
    threads : int
        Number of threads; the result does not depend on it.

    Returns
    -------
    (m, m, m) float32
        Index order z, y, x; m = n for centers, n + 1 for nodes.
    """
    if n < 1:
        raise ValueError(f"a cell needs at least one voxel along its edge, not {n}")
    if at not in ("centers", "nodes"):
        raise ValueError(f"samples lie at 'centers' or 'nodes', not {at!r}")
    start = 0.5 / n if at == "centers" else 0.0
    grid = Grid((start,) * 3, (1.0 / n,) * 3, (n, n, n))
    lower, upper = np.full(3, start), np.full(3, start + (n - 1) / n)
    m = n if at == "centers" else n + 1
    field = np.zeros((m, m, m), dtype=np.float32)
    torus = np.zeros((n, n, n), dtype=np.float32) if m > n else field
    add_kernels(torus, grid, periodic_images(kernels, lower, upper, cutoff), cutoff, threads)
    if m > n:
        field[:n, :n, :n] = torus
        field[:, :, n] = field[:, :, 0]
        field[:, n] = field[:, 0]
        field[n] = field[0]
    return field
