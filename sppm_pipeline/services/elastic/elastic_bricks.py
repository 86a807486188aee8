"""Bricks of any stiffness, and the transforms that all bricks share; see `elastic_operator`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import inline_jit
from sppm_pipeline.services.multigrid.rows import HEAD, LANES, STRIDE

_LANES, _HEAD, _1 = np.uint64(LANES), np.uint64(HEAD), np.uint64(1)
_R = tuple(np.uint64(STRIDE * row) for row in range(42))
_N = tuple(np.uint64(number) for number in range(21))


@inline_jit
def modes_of(s: NDArray[Any], e: Any) -> tuple[Any, Any, Any]:
    """Coefficients of the displacements along x, y, z of a brick: 010, 100, 110, 001, 011, 101, 111.

    Names: x100 is the coefficient of ξ of the displacement along x, z011 that of ηζ of the displacement along z.
    """
    # along x: sum and difference of the sums (ss, sd) and of the differences (ds, dd) along z
    a, b = s[e], s[e + _1]
    xss, xsd = a + b, b - a
    a, b = s[e + _R[1]], s[e + _R[1] + _1]
    xds, xdd = a + b, b - a
    a, b = s[e + _R[2]], s[e + _R[2] + _1]
    yss, ysd = a + b, b - a
    a, b = s[e + _R[3]], s[e + _R[3] + _1]
    yds, ydd = a + b, b - a
    a, b = s[e + _R[4]], s[e + _R[4] + _1]
    zss, zsd = a + b, b - a
    a, b = s[e + _R[5]], s[e + _R[5] + _1]
    zds, zdd = a + b, b - a
    # along y
    x010 = xss - s[e + _R[6]]
    x100, x110 = s[e + _R[7]] + xsd, xsd - s[e + _R[7]]
    x001, x011 = s[e + _R[8]] + xds, xds - s[e + _R[8]]
    x101, x111 = s[e + _R[9]] + xdd, xdd - s[e + _R[9]]
    y010 = yss - s[e + _R[10]]
    y100, y110 = s[e + _R[11]] + ysd, ysd - s[e + _R[11]]
    y001, y011 = s[e + _R[12]] + yds, yds - s[e + _R[12]]
    y101, y111 = s[e + _R[13]] + ydd, ydd - s[e + _R[13]]
    z010 = zss - s[e + _R[14]]
    z100, z110 = s[e + _R[15]] + zsd, zsd - s[e + _R[15]]
    z001, z011 = s[e + _R[16]] + zds, zds - s[e + _R[16]]
    z101, z111 = s[e + _R[17]] + zdd, zdd - s[e + _R[17]]
    # keep the modes of this line for the next row of bricks
    s[e + _R[6]], s[e + _R[7]], s[e + _R[8]] = xss, xsd, xds
    s[e + _R[9]], s[e + _R[10]], s[e + _R[11]] = xdd, yss, ysd
    s[e + _R[12]], s[e + _R[13]], s[e + _R[14]] = yds, ydd, zss
    s[e + _R[15]], s[e + _R[16]], s[e + _R[17]] = zsd, zds, zdd
    return (
        (x010, x100, x110, x001, x011, x101, x111),
        (y010, y100, y110, y001, y011, y101, y111),
        (z010, z100, z110, z001, z011, z101, z111),
    )


@inline_jit
def give_back(s: NDArray[Any], e: Any, x: Any, y: Any, z: Any) -> None:
    """Take forces on coefficients back along y: rows 30-41 are complete, rows 18-29 wait for the next row of bricks."""
    x010, x100, x110, x001, x011, x101, x111 = x
    y010, y100, y110, y001, y011, y101, y111 = y
    z010, z100, z110, z001, z011, z101, z111 = z
    s[e + _R[30]], s[e + _R[18]] = s[e + _R[18]] - x010, x010
    s[e + _R[31]], s[e + _R[19]] = s[e + _R[19]] + (x100 - x110), x100 + x110
    s[e + _R[32]], s[e + _R[20]] = s[e + _R[20]] + (x001 - x011), x001 + x011
    s[e + _R[33]], s[e + _R[21]] = s[e + _R[21]] + (x101 - x111), x101 + x111
    s[e + _R[34]], s[e + _R[22]] = s[e + _R[22]] - y010, y010
    s[e + _R[35]], s[e + _R[23]] = s[e + _R[23]] + (y100 - y110), y100 + y110
    s[e + _R[36]], s[e + _R[24]] = s[e + _R[24]] + (y001 - y011), y001 + y011
    s[e + _R[37]], s[e + _R[25]] = s[e + _R[25]] + (y101 - y111), y101 + y111
    s[e + _R[38]], s[e + _R[26]] = s[e + _R[26]] - z010, z010
    s[e + _R[39]], s[e + _R[27]] = s[e + _R[27]] + (z100 - z110), z100 + z110
    s[e + _R[40]], s[e + _R[28]] = s[e + _R[28]] + (z001 - z011), z001 + z011
    s[e + _R[41]], s[e + _R[29]] = s[e + _R[29]] + (z101 - z111), z101 + z111


@inline_jit
def full_row(s: NDArray[Any], lam: NDArray[Any], step: Any, at: Any, c: NDArray[Any], first: Any, width: Any) -> None:
    """Forces of a row of bricks with all constants of a stiffness, `step` apart: 11, 12, ..., 16, 22, ..., 66."""
    gx, gy, gz = c[0], c[1], c[2]
    gx3, gy3, gz3 = c[15], c[16], c[17]
    gx9, gy9, gz9 = gx3 * c[25], gy3 * c[25], gz3 * c[25]
    at -= _HEAD
    # whole vectors: entries beyond the width are scratch that nothing reads
    for e in range(first, first + (width + _LANES - _1) // _LANES * _LANES):
        x, y, z = modes_of(s, e)
        x010, x100, x110, x001, x011, x101, x111 = x
        y010, y100, y110, y001, y011, y101, y111 = y
        z010, z100, z110, z001, z011, z101, z111 = z
        i = at + e
        c11, c12, c13 = lam[i], lam[i + _N[1] * step], lam[i + _N[2] * step]
        c14, c15, c16 = lam[i + _N[3] * step], lam[i + _N[4] * step], lam[i + _N[5] * step]
        c22, c23, c24 = lam[i + _N[6] * step], lam[i + _N[7] * step], lam[i + _N[8] * step]
        c25, c26, c33 = lam[i + _N[9] * step], lam[i + _N[10] * step], lam[i + _N[11] * step]
        c34, c35, c36 = lam[i + _N[12] * step], lam[i + _N[13] * step], lam[i + _N[14] * step]
        c44, c45, c46 = lam[i + _N[15] * step], lam[i + _N[16] * step], lam[i + _N[17] * step]
        c55, c56, c66 = lam[i + _N[18] * step], lam[i + _N[19] * step], lam[i + _N[20] * step]
        # constant strain
        a, b, f = gx * x100, gy * y010, gz * z001
        p, q, t = gz * y001 + gy * z010, gz * x001 + gx * z100, gy * x010 + gx * y100
        s1 = c11 * a + c12 * b + c13 * f + c14 * p + c15 * q + c16 * t
        s2 = c12 * a + c22 * b + c23 * f + c24 * p + c25 * q + c26 * t
        s3 = c13 * a + c23 * b + c33 * f + c34 * p + c35 * q + c36 * t
        s4 = c14 * a + c24 * b + c34 * f + c44 * p + c45 * q + c46 * t
        s5 = c15 * a + c25 * b + c35 * f + c45 * p + c55 * q + c56 * t
        s6 = c16 * a + c26 * b + c36 * f + c46 * p + c56 * q + c66 * t
        x100, y010, z001 = gx * s1, gy * s2, gz * s3
        x010, y100 = gy * s6, gx * s6
        x001, z100 = gz * s5, gx * s5
        y001, z010 = gz * s4, gy * s4
        # along ξ
        a, b, f, p, q = gy * y110, gz * z101, gz * y101 + gy * z110, gz * x101, gy * x110
        s2 = c22 * a + c23 * b + c24 * f + c25 * p + c26 * q
        s3 = c23 * a + c33 * b + c34 * f + c35 * p + c36 * q
        s4 = c24 * a + c34 * b + c44 * f + c45 * p + c46 * q
        s5 = c25 * a + c35 * b + c45 * f + c55 * p + c56 * q
        s6 = c26 * a + c36 * b + c46 * f + c56 * p + c66 * q
        fx110, fx101 = gy3 * s6, gz3 * s5
        fy110, fy101 = gy3 * s2, gz3 * s4
        fz110, fz101 = gy3 * s4, gz3 * s3
        # along η
        a, b, f, p, q = gx * x110, gz * z011, gz * y011, gz * x011 + gx * z110, gx * y110
        s1 = c11 * a + c13 * b + c14 * f + c15 * p + c16 * q
        s3 = c13 * a + c33 * b + c34 * f + c35 * p + c36 * q
        s4 = c14 * a + c34 * b + c44 * f + c45 * p + c46 * q
        s5 = c15 * a + c35 * b + c45 * f + c55 * p + c56 * q
        s6 = c16 * a + c36 * b + c46 * f + c56 * p + c66 * q
        fx110, fx011 = fx110 + gx3 * s1, gz3 * s5
        fy110, fy011 = fy110 + gx3 * s6, gz3 * s4
        fz110, fz011 = fz110 + gx3 * s5, gz3 * s3
        # along ζ
        a, b, f, p, q = gx * x101, gy * y011, gy * z011, gx * z101, gy * x011 + gx * y101
        s1 = c11 * a + c12 * b + c14 * f + c15 * p + c16 * q
        s2 = c12 * a + c22 * b + c24 * f + c25 * p + c26 * q
        s4 = c14 * a + c24 * b + c44 * f + c45 * p + c46 * q
        s5 = c15 * a + c25 * b + c45 * f + c55 * p + c56 * q
        s6 = c16 * a + c26 * b + c46 * f + c56 * p + c66 * q
        x110, x101, x011 = fx110, fx101 + gx3 * s1, fx011 + gy3 * s6
        y110, y101, y011 = fy110, fy101 + gx3 * s6, fy011 + gy3 * s2
        z110, z101, z011 = fz110, fz101 + gx3 * s5, fz011 + gy3 * s4
        # along ξη, ξζ, ηζ
        a, b, f = gz * z111, gz * y111, gz * x111
        s3 = c33 * a + c34 * b + c35 * f
        s4 = c34 * a + c44 * b + c45 * f
        s5 = c35 * a + c45 * b + c55 * f
        fx111, fy111, fz111 = gz9 * s5, gz9 * s4, gz9 * s3
        a, b, f = gy * y111, gy * z111, gy * x111
        s2 = c22 * a + c24 * b + c26 * f
        s4 = c24 * a + c44 * b + c46 * f
        s6 = c26 * a + c46 * b + c66 * f
        fx111, fy111, fz111 = fx111 + gy9 * s6, fy111 + gy9 * s2, fz111 + gy9 * s4
        a, b, f = gx * x111, gx * z111, gx * y111
        s1 = c11 * a + c15 * b + c16 * f
        s5 = c15 * a + c55 * b + c56 * f
        s6 = c16 * a + c56 * b + c66 * f
        x111, y111, z111 = fx111 + gx9 * s1, fy111 + gx9 * s6, fz111 + gx9 * s5
        x = x010, x100, x110, x001, x011, x101, x111
        y = y010, y100, y110, y001, y011, y101, y111
        z = z010, z100, z110, z001, z011, z101, z111
        give_back(s, e, x, y, z)
