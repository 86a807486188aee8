"""Strain energy and mean stress of a displacement field, from which the effective stiffness follows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.multigrid.rows import BLOCK, HEAD, STRIDE, gather_row

# weighted strains of a brick whose squares make its energy: 7 times lambda, 18 times mu
_MODES = 25
#: Rows of scratch: sums and differences along z of two lines, then the strains.
ENERGY_ROWS = 12 + _MODES

_0, _1, _2, _3 = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)
_HEAD, _BLOCK, _ROW = np.uint64(HEAD), np.uint64(BLOCK), np.uint64(STRIDE)
_SECOND = np.uint64(6 * STRIDE)
_STRAINS = np.uint64(12 * STRIDE)

_R = tuple(np.uint64(STRIDE * row) for row in range(_MODES))


@inline_jit
def _strain_row(s: NDArray[Any], to: Any, c: NDArray[Any], strain: NDArray[Any], width: Any) -> None:
    """Weighted strains of a row of bricks: the energy is lam times the first 7 squared plus mu times the others."""
    # names as in `elastic_operator`: x100 is the coefficient of ξ of the displacement along x
    gx, gy, gz = c[0], c[1], c[2]
    nxy, nxz, nyx, nyz, nzx, nzy = c[3], c[4], c[5], c[6], c[7], c[8]
    third, root = c[9], c[10]
    mx, my, mz = c[11], c[12], c[13]
    exx, eyy, ezz, eyz, exz, exy = strain[0], strain[1], strain[2], strain[3], strain[4], strain[5]
    for e in range(_HEAD, _HEAD + width):
        o = to + e
        # differences along x and y of the sums and differences along z that `gather_row` left
        a, b, f, g = s[e + _R[0]], s[e + _R[0] + _1], s[e + _R[6]], s[e + _R[6] + _1]
        x010 = (f + g) - (a + b)
        x100 = (b - a) + (g - f)
        x110 = (g - f) - (b - a)
        a, b, f, g = s[e + _R[1]], s[e + _R[1] + _1], s[e + _R[7]], s[e + _R[7] + _1]
        x001 = (a + b) + (f + g)
        x011 = (f + g) - (a + b)
        x101 = (b - a) + (g - f)
        x111 = (g - f) - (b - a)
        a, b, f, g = s[e + _R[2]], s[e + _R[2] + _1], s[e + _R[8]], s[e + _R[8] + _1]
        y010 = (f + g) - (a + b)
        y100 = (b - a) + (g - f)
        y110 = (g - f) - (b - a)
        a, b, f, g = s[e + _R[3]], s[e + _R[3] + _1], s[e + _R[9]], s[e + _R[9] + _1]
        y001 = (a + b) + (f + g)
        y011 = (f + g) - (a + b)
        y101 = (b - a) + (g - f)
        y111 = (g - f) - (b - a)
        a, b, f, g = s[e + _R[4]], s[e + _R[4] + _1], s[e + _R[10]], s[e + _R[10] + _1]
        z010 = (f + g) - (a + b)
        z100 = (b - a) + (g - f)
        z110 = (g - f) - (b - a)
        a, b, f, g = s[e + _R[5]], s[e + _R[5] + _1], s[e + _R[11]], s[e + _R[11] + _1]
        z001 = (a + b) + (f + g)
        z011 = (f + g) - (a + b)
        z101 = (b - a) + (g - f)
        z111 = (g - f) - (b - a)
        # constant strains; each mode is a square of its own, since monomials are orthogonal over a brick
        ax, ay, az = gx * x100 + exx, gy * y010 + eyy, gz * z001 + ezz
        s[o + _R[0]] = ax + ay + az
        s[o + _R[1]] = third * (gx * x110 + gz * z011)
        s[o + _R[2]] = third * (gx * x101 + gy * y011)
        s[o + _R[3]] = third * (gy * y110 + gz * z101)
        s[o + _R[4]] = third * third * gx * x111
        s[o + _R[5]] = third * third * gy * y111
        s[o + _R[6]] = third * third * gz * z111
        s[o + _R[7]] = root * ax
        s[o + _R[8]] = root * ay
        s[o + _R[9]] = root * az
        s[o + _R[10]] = gz * y001 + gy * z010 + eyz
        s[o + _R[11]] = gz * x001 + gx * z100 + exz
        s[o + _R[12]] = gy * x010 + gx * y100 + exy
        s[o + _R[13]] = nxy * x110
        s[o + _R[14]] = nxz * x101
        s[o + _R[15]] = nyx * y110
        s[o + _R[16]] = nyz * y011
        s[o + _R[17]] = nzx * z101
        s[o + _R[18]] = nzy * z011
        s[o + _R[19]] = third * (gy * x011 + gx * y101)
        s[o + _R[20]] = third * (gz * x011 + gx * z110)
        s[o + _R[21]] = third * (gz * y101 + gy * z110)
        s[o + _R[22]] = mx * x111
        s[o + _R[23]] = my * y111
        s[o + _R[24]] = mz * z111


@inline_jit
def _energy_row(
    s: NDArray[Any], a: Any, lam: NDArray[Any], mu: NDArray[Any], factor: Any, at: Any, width: Any
) -> float:
    """Energy of a row of strains."""
    total = 0.0  # in double precision, as all sums over voxels
    for e in range(_HEAD, _HEAD + width):
        i = a + e
        dilatation = (
            s[i + _R[0]] * s[i + _R[0]]
            + s[i + _R[1]] * s[i + _R[1]]
            + s[i + _R[2]] * s[i + _R[2]]
            + s[i + _R[3]] * s[i + _R[3]]
            + s[i + _R[4]] * s[i + _R[4]]
            + s[i + _R[5]] * s[i + _R[5]]
            + s[i + _R[6]] * s[i + _R[6]]
        )
        rest = (
            s[i + _R[7]] * s[i + _R[7]]
            + s[i + _R[8]] * s[i + _R[8]]
            + s[i + _R[9]] * s[i + _R[9]]
            + s[i + _R[10]] * s[i + _R[10]]
            + s[i + _R[11]] * s[i + _R[11]]
            + s[i + _R[12]] * s[i + _R[12]]
            + s[i + _R[13]] * s[i + _R[13]]
            + s[i + _R[14]] * s[i + _R[14]]
            + s[i + _R[15]] * s[i + _R[15]]
            + s[i + _R[16]] * s[i + _R[16]]
            + s[i + _R[17]] * s[i + _R[17]]
            + s[i + _R[18]] * s[i + _R[18]]
            + s[i + _R[19]] * s[i + _R[19]]
            + s[i + _R[20]] * s[i + _R[20]]
            + s[i + _R[21]] * s[i + _R[21]]
            + s[i + _R[22]] * s[i + _R[22]]
            + s[i + _R[23]] * s[i + _R[23]]
            + s[i + _R[24]] * s[i + _R[24]]
        )
        total += np.float64(factor * lam[at + e] * dilatation + mu[at + e] * rest)
    return total


@inline_jit
def _normal_row(
    s: NDArray[Any], a: Any, mode: Any, root: Any, lam: NDArray[Any], mu: NDArray[Any], factor: Any, at: Any, width: Any
) -> float:
    """Normal stress summed over a row, from constant strains times the root of 2."""
    total = 0.0
    for e in range(_HEAD, _HEAD + width):
        total += np.float64(factor * lam[at + e] * s[a + e] + mu[at + e] * (root * s[mode + e]))
    return total


@inline_jit
def _shear_row(s: NDArray[Any], mode: Any, mu: NDArray[Any], at: Any, width: Any) -> float:
    """Shear stress summed over a row."""
    total = 0.0
    for e in range(_HEAD, _HEAD + width):
        total += np.float64(mu[at + e] * s[mode + e])
    return total


@jit
def energy_and_stress(
    u: NDArray[Any],
    lam: NDArray[Any],
    mu: NDArray[Any],
    factor: Any,
    c: NDArray[Any],
    strain: NDArray[Any],
    shape: I64,
    s: NDArray[Any],
    out: F64,
) -> None:
    """Sum the energy and the stresses of a field over all voxels.

    The energy is a sum of squares: where strains vanish, as in parts without a load path, so do rounding errors.

    Parameters
    ----------
    u : (3 nz ny nx,)
        Displacements.
    lam, mu : flat
        Lamé constants as for `apply_stiffness`; `factor` multiplies the first one.
    c : (14,)
        From `energy_coefficients`.
    strain : (6,)
        Additional constant strain, times the root of a voxel's volume.
    shape : (3,) int64
        nx, ny, nz.
    s : (ENERGY_ROWS * STRIDE,)
        Scratch.
    out : (7,) float64
        Receives the energy, and the stresses xx, yy, zz, yz, xz, xy times the root of a voxel's volume.
    """
    n, lines, planes = np.uint64(shape[0]), np.uint64(shape[1]), np.uint64(shape[2])
    padded = np.uint64(len(lam)) // (lines * planes)
    root = c[10]
    out[:] = 0
    # periodic: the neighbors of the last plane and line are the first ones
    for z in range(planes):
        above = (z + _1) % planes
        for y in range(lines):
            behind = (y + _1) % lines
            bricks = (z * lines + y) * padded
            for start in range(_0, n, _BLOCK):
                width = min(_BLOCK, n - start)
                for i in range(_3):
                    p, q = i * planes + z, i * planes + above
                    gather_row(u, (p * lines + y) * n, (q * lines + y) * n, n, start, width, s, (i + i) * _ROW)
                    to = _SECOND + (i + i) * _ROW
                    gather_row(u, (p * lines + behind) * n, (q * lines + behind) * n, n, start, width, s, to)
                _strain_row(s, _STRAINS, c, strain, width)
                at = bricks + start
                out[0] += _energy_row(s, _STRAINS, lam, mu, factor, at, width)
                for i in range(_3):
                    mode = _STRAINS + _R[7] + i * _ROW
                    out[_1 + i] += _normal_row(s, _STRAINS, mode, root, lam, mu, factor, at, width)
                    out[_1 + _3 + i] += _shear_row(s, mode + _R[3], mu, at, width)


def energy_coefficients(edges: tuple[float, float, float]) -> F64:
    """Square roots of the weights of the modes of a brick with edges (hx, hy, hz), (14,)."""
    h = np.array(edges, np.float64)
    g = np.sqrt(h.prod()) / (4 * h)
    q = g * g
    linear = [np.sqrt((2 * q[a] + q[b]) / 3) for a, b in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))]
    return np.concatenate([g, linear, [np.sqrt(1 / 3), np.sqrt(2)], np.sqrt((q + q.sum()) / 9)])
