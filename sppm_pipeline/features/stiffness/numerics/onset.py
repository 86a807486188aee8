"""Where the solid of a cell yields first, from linear solutions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.stiffness.numerics.elasticity import Homogenized
from sppm_pipeline.services.jit.compiled import jit

_LOADED = 1e-3
"""Stress that may be left over, over that applied, where a cell bears it: else it has no load path."""


def uniaxial_strain(stiffness: NDArray[np.float64], axis: int) -> NDArray[np.float64] | None:
    """Mean strain (6,) of a mean stress of 1 along `axis` alone; None if the cell has no load path along it."""
    stress = np.eye(6)[axis]
    strain = np.linalg.lstsq(stiffness, stress, rcond=1e-9)[0]
    left = float(np.abs(stiffness @ strain - stress).max())
    return np.asarray(strain) if left < _LOADED else None


def stress_ratios(
    found: Homogenized, strain: NDArray[np.float64], modulus: NDArray[Any], edges: tuple[float, float, float]
) -> NDArray[np.float32]:
    """Von Mises stress over yield stress at the eight Gauss points of each solid voxel (solid voxels, 8).

    Parameters
    ----------
    found : Homogenized
        With fields.
    strain : (6,)
        Mean strain xx, yy, zz, yz, xz, xy (engineering shear).
    modulus : (nz, ny, nx) float
        Shear modulus of the solid of each voxel over its yield stress; 0 where nothing yields.
    edges : (hx, hy, hz)
        Of a voxel.
    """
    u = np.zeros((3, *modulus.shape), np.float32)
    for part, (packed, step) in zip(strain, found.fields, strict=True):
        u += np.float32(part * step) * packed.reshape(u.shape)
    # displacements are in the unit of the longest edge
    h = np.array(edges, np.float64) / max(edges)
    signs = np.array([(i, j, k) for k in (-1, 1) for j in (-1, 1) for i in (-1, 1)], np.float64)
    factors = 1 + signs[:, None] * signs / np.sqrt(3)
    slopes = np.stack(
        [signs[:, d] * np.prod(np.delete(factors, d, 2), 2) / (4 * h[d]) for d in range(3)], axis=2
    )  # fmt: skip
    out = np.empty((np.count_nonzero(modulus), 8), np.float32)
    _stresses(u, strain, np.ascontiguousarray(modulus, np.float64), slopes, out)
    return out


@jit
def _stresses(
    u: NDArray[Any], strain: NDArray[Any], modulus: NDArray[Any], slopes: NDArray[Any], out: NDArray[Any]
) -> None:
    """Write von Mises stresses; `slopes` (8, 8, 3) are those of the corners' shape functions at each Gauss point."""
    nz, ny, nx = modulus.shape
    c = np.empty((8, 3))
    at = 0
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                mu = modulus[k, j, i]
                if mu == 0.0:
                    continue
                for a in range(8):
                    z, y, x = (k + (a >> 2)) % nz, (j + (a >> 1 & 1)) % ny, (i + (a & 1)) % nx
                    c[a, 0], c[a, 1], c[a, 2] = u[0, z, y, x], u[1, z, y, x], u[2, z, y, x]
                for g in range(8):
                    xx, yy, zz, yz, xz, xy = strain[0], strain[1], strain[2], strain[3], strain[4], strain[5]
                    for a in range(8):
                        sx, sy, sz = slopes[g, a, 0], slopes[g, a, 1], slopes[g, a, 2]
                        xx += sx * c[a, 0]
                        yy += sy * c[a, 1]
                        zz += sz * c[a, 2]
                        yz += sy * c[a, 2] + sz * c[a, 1]
                        xz += sx * c[a, 2] + sz * c[a, 0]
                        xy += sx * c[a, 1] + sy * c[a, 0]
                    shear = 0.75 * (yz * yz + xz * xz + xy * xy)
                    normal = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2)
                    # the square of von Mises stress is 3 J2, with deviatoric stress 2 mu times deviatoric strain
                    out[at, g] = 2 * mu * np.sqrt(normal + shear)
                at += 1


def onsets(
    ratios: NDArray[np.float32], weights: NDArray[np.float64], shares: Sequence[float]
) -> tuple[float, ...]:  # fmt: skip
    """Mean stresses at which these shares of the solid yield, from stress ratios (n, 8) at a mean stress of 1.

    `weights` (n,) are the volumes of solid of the voxels. Stresses are linear: nothing has yielded before.
    """
    flat = ratios.reshape(-1)
    order = np.argsort(-flat, kind="stable")
    above = np.cumsum(np.repeat(weights, 8)[order])
    places = np.searchsorted(above, np.array(shares) * above[-1] * (1 - 1e-12))
    return tuple(float(1 / flat[order[place]]) for place in np.minimum(places, len(flat) - 1))
