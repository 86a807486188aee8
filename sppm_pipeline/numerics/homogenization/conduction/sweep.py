"""One pass over a voxel grid with the conductivity of all trilinear bricks, without a matrix.

The scalar sibling of `elasticity.sweep`, which explains modes, rows and scratch.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import inline_jit, jit
from sppm_pipeline.numerics.homogenization.multigrid.rows import (
    BLOCK,
    HEAD,
    LANES,
    STRIDE,
    finish_row,
    gather_row,
    scatter_row,
)

#: Rows of scratch: sum and difference along z, 4 modes of the line before, 4 flows carried to the next line, 4 flows
#: of the line, the flows of a row of nodes.
SCRATCH_ROWS = 15

_0, _1, _3 = np.uint64(0), np.uint64(1), np.uint64(3)
_LANES, _HEAD, _BLOCK = np.uint64(LANES), np.uint64(HEAD), np.uint64(BLOCK)
_R = tuple(np.uint64(STRIDE * row) for row in range(SCRATCH_ROWS))


def conduction_coefficients(
    edges: tuple[float, float, float], gradient: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """What `sweep` needs to know of a brick with these edges, and a constant gradient (3,) that is added, (10,)."""
    h = np.array(edges, np.float64)
    volume = h.prod()
    # from sums over corners to gradients times the root of the volume
    g = np.sqrt(volume) / (4 * h)
    q = g * g
    linear = [(q[0] + q[1]) / 3, (q[0] + q[2]) / 3, (q[1] + q[2]) / 3]
    constant = np.zeros(3) if gradient is None else np.sqrt(volume) * gradient
    return np.concatenate([g, linear, [q.sum() / 9], constant])


@inline_jit
def _first_line(s: NDArray[Any], width: Any) -> None:
    """Modes along x of the first line; nothing is carried to it."""
    zero = s.dtype.type(0)
    for e in range(_HEAD - _1, _HEAD + width):
        a, b = s[e], s[e + _1]
        s[e + _R[2]], s[e + _R[3]] = a + b, b - a
        a, b = s[e + _R[1]], s[e + _R[1] + _1]
        s[e + _R[4]], s[e + _R[5]] = a + b, b - a
    for e in range(_R[6], _R[10]):
        s[e] = zero


@inline_jit
def _brick_row(s: NDArray[Any], k: NDArray[Any], at: Any, c: NDArray[Any], first: Any, width: Any) -> None:
    """Flows of a row of bricks between the line before and the line whose sums along z are in scratch."""
    gx, gy, gz = c[0], c[1], c[2]
    nxy, nxz, nyz, n = c[3], c[4], c[5], c[6]
    ex, ey, ez = c[7], c[8], c[9]
    at -= _HEAD
    for e in range(first, first + (width + _LANES - _1) // _LANES * _LANES):
        a, b = s[e], s[e + _1]
        ss, sd = a + b, b - a
        a, b = s[e + _R[1]], s[e + _R[1] + _1]
        ds, dd = a + b, b - a
        u010 = ss - s[e + _R[2]]
        u100, u110 = s[e + _R[3]] + sd, sd - s[e + _R[3]]
        u001, u011 = s[e + _R[4]] + ds, ds - s[e + _R[4]]
        u101, u111 = s[e + _R[5]] + dd, dd - s[e + _R[5]]
        s[e + _R[2]] = ss
        s[e + _R[3]] = sd
        s[e + _R[4]] = ds
        s[e + _R[5]] = dd
        m = k[at + e]
        u100, u010, u001 = m * gx * (gx * u100 + ex), m * gy * (gy * u010 + ey), m * gz * (gz * u001 + ez)
        u110, u101, u011, u111 = m * nxy * u110, m * nxz * u101, m * nyz * u011, m * n * u111
        s[e + _R[10]] = s[e + _R[6]] - u010
        s[e + _R[6]] = u010
        s[e + _R[11]] = s[e + _R[7]] + (u100 - u110)
        s[e + _R[7]] = u100 + u110
        s[e + _R[12]] = s[e + _R[8]] + (u001 - u011)
        s[e + _R[8]] = u001 + u011
        s[e + _R[13]] = s[e + _R[9]] + (u101 - u111)
        s[e + _R[9]] = u101 + u111


@jit
def sweep(
    mode: int,
    v: NDArray[Any],
    r: NDArray[Any],
    weight: NDArray[Any],
    k: NDArray[Any],
    c: NDArray[Any],
    shape: NDArray[np.int64],
    out: NDArray[Any],
    plane: NDArray[Any],
    s: NDArray[Any],
) -> float:
    """Flows ``f = K v`` of potentials, and at once what is wanted of them; compare `elasticity.sweep.sweep`.

    Parameters
    ----------
    mode : {APPLY, RESIDUAL, SMOOTH}
    v, r, weight, out : (nz, ny, nx) flat
    k : flat
        Conductivities of the voxels, rows padded as by `multigrid.hierarchy.padded`.
    c : (10,)
        From `conduction_coefficients`.
    shape : (3,) int64
        nx, ny, nz.
    plane : (ny, nx) flat
    s : (SCRATCH_ROWS * STRIDE,)
    """
    n, lines, planes = np.uint64(shape[0]), np.uint64(shape[1]), np.uint64(shape[2])
    padded = np.uint64(len(k)) // (lines * planes)
    blocks = (n + _BLOCK - _1) // _BLOCK
    total = 0.0
    for t in range(planes + _1):
        low, high = (t + planes - _1) % planes, t % planes
        for block in range(blocks):
            start = block * _BLOCK
            width = min(_BLOCK, n - start)
            for line in range(lines + _1 + _1):
                y = (line + lines - _1) % lines
                gather_row(v, (low * lines + y) * n, (high * lines + y) * n, n, start, width, s, _0)
                if line == _0:
                    _first_line(s, width)
                    continue
                row = (y + lines - _1) % lines
                bricks = (low * lines + row) * padded + start + _HEAD
                if blocks == _1:
                    _brick_row(s, k, bricks, c, _HEAD, width)
                    for i in range(_R[10], _R[14], _R[1]):
                        s[i + _HEAD - _1] = s[i + _HEAD + width - _1]
                else:
                    _brick_row(s, k, bricks, c, _HEAD - _1, width + _1)
                if line == _1:
                    continue
                scatter_row(s, _R[10], _R[14], plane, row * n + start, width)
                if t > _0:
                    at = (low * lines + row) * n + start
                    total += finish_row(mode, v, r, at, weight, at, s, _R[14], out, width)
    return total


@jit
def flow_energies(
    u: NDArray[Any],
    k: NDArray[Any],
    c: NDArray[Any],
    shape: NDArray[np.int64],
    first: int,
    last: int,
    out: NDArray[np.float64],
) -> None:
    """Add the mutual energies of three potentials in the layers ``first <= z < last`` of voxels.

    Parameters
    ----------
    u : (3, nz, ny, nx)
        The potentials whose mean gradients are along x, y, z.
    k : (nz, ny, padded)
    c : (10,)
        Coefficients; the gradients that are added are all one.
    shape, first, last
        As for `elasticity.energy.energies`.
    out : (3, 3) float64
    """
    nx, ny, nz = shape
    gx, gy, gz = np.float64(c[0]), np.float64(c[1]), np.float64(c[2])
    mean = np.float64(c[7])
    e = np.empty((3, 7))
    for z in range(first, last):
        above = (z + 1) % nz
        for y in range(ny):
            behind = (y + 1) % ny
            for x in range(nx):
                value = np.float64(k[z, y, x + HEAD])
                if value == 0.0:
                    continue
                right = (x + 1) % nx
                for i in range(3):
                    a, b = np.float64(u[i, z, y, x]), np.float64(u[i, z, y, right])
                    p, q = np.float64(u[i, z, behind, x]), np.float64(u[i, z, behind, right])
                    f, g = np.float64(u[i, above, y, x]), np.float64(u[i, above, y, right])
                    m, n = np.float64(u[i, above, behind, x]), np.float64(u[i, above, behind, right])
                    e[i, 0] = gx * ((b - a) + (q - p) + (g - f) + (n - m)) + (mean if i == 0 else 0.0)
                    e[i, 1] = gy * ((p - a) + (q - b) + (m - f) + (n - g)) + (mean if i == 1 else 0.0)
                    e[i, 2] = gz * ((f - a) + (g - b) + (m - p) + (n - q)) + (mean if i == 2 else 0.0)
                    e[i, 3] = ((q - p) - (b - a)) + ((n - m) - (g - f))
                    e[i, 4] = ((g - f) - (b - a)) + ((n - m) - (q - p))
                    e[i, 5] = ((m - f) - (p - a)) + ((n - g) - (q - b))
                    e[i, 6] = ((n - m) - (g - f)) - ((q - p) - (b - a))
                for i in range(3):
                    for j in range(3):
                        total = e[i, 0] * e[j, 0] + e[i, 1] * e[j, 1] + e[i, 2] * e[j, 2]
                        for mode in range(4):
                            total += np.float64(c[3 + mode]) * e[i, 3 + mode] * e[j, 3 + mode]
                        out[i, j] += value * total
