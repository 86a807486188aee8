"""Matrix-free product with the stiffness of a grid of trilinear bricks.

Displacements live on the nodes of a periodic grid: node (i, j, k) is the low corner of voxel (i, j, k). In each voxel
they are the eight products of (1, ξ)(1, η)(1, ζ), each with a coefficient for every component; these modes follow from
the corner values by sums and differences alone (a Walsh-Hadamard transform, here without its factor 1/8). The strain of
a mode is one monomial, monomials are orthogonal over a brick, and so full integration leaves a few products: weight 1
for constants, 1/3 for linear and 1/9 for bilinear terms. A brick costs 170 operations, a stored 24 x 24 matrix 1152.

Bricks are taken row by row along x. Sums and differences along z and x of a line of nodes serve the rows of bricks on
both of its sides, as do those of the forces; intermediate values lie in a small scratch array whose rows have a
constant distance, so that the compiler can prove that they never overlap and uses vector instructions throughout. Rows
of the three components share one loop: three calls of the kernels in `multigrid.rows` take 1.3 to 2.2 times as long.

Bricks are isotropic, or have all 21 constants of a stiffness, twice the operations: then `lam` holds the upper
triangles of the matrices, constant by constant, and `mu` only counts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import I64
from sppm_pipeline.services.elastic.elastic_bricks import full_row, give_back, modes_of
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.multigrid.rows import APPLY, BLOCK, HEAD, LANES, SMOOTH, STRIDE

#: Rows of scratch: 6 sums and differences along z, 12 modes of the line before, 12 forces carried to the next line,
#: 12 forces of the line, 3 forces of a row of nodes.
SCRATCH_ROWS = 45

_LANES = np.uint64(LANES)
_1 = np.uint64(1)
_R = tuple(np.uint64(STRIDE * row) for row in range(SCRATCH_ROWS))
_ZERO = np.uint64(0)
_HEAD = np.uint64(HEAD)
_BLOCK = np.uint64(BLOCK)
_LINE = np.uint64(30 * STRIDE)
_FORCE = np.uint64(42 * STRIDE)


@inline_jit
def _first_line(s: NDArray[Any], width: Any) -> None:
    """Compute the modes along x of the first line, and clear the carried forces."""
    zero = s.dtype.type(0)
    for e in range(_HEAD - _1, _HEAD + width):
        a, b = s[e], s[e + _1]
        s[e + _R[6]], s[e + _R[7]] = a + b, b - a
        a, b = s[e + _R[1]], s[e + _R[1] + _1]
        s[e + _R[8]], s[e + _R[9]] = a + b, b - a
        a, b = s[e + _R[2]], s[e + _R[2] + _1]
        s[e + _R[10]], s[e + _R[11]] = a + b, b - a
        a, b = s[e + _R[3]], s[e + _R[3] + _1]
        s[e + _R[12]], s[e + _R[13]] = a + b, b - a
        a, b = s[e + _R[4]], s[e + _R[4] + _1]
        s[e + _R[14]], s[e + _R[15]] = a + b, b - a
        a, b = s[e + _R[5]], s[e + _R[5] + _1]
        s[e + _R[16]], s[e + _R[17]] = a + b, b - a
    for e in range(np.uint64(18 * STRIDE), np.uint64(30 * STRIDE)):
        s[e] = zero


@inline_jit
def _brick_row(
    s: NDArray[Any], lam: NDArray[Any], mu: NDArray[Any], at: Any, c: NDArray[Any], first: Any, width: Any
) -> None:
    """Forces of a row of bricks between the line before and the line whose sums along z are in scratch."""
    gx, gy, gz = c[0], c[1], c[2]
    nxy, nxz, nyx, nyz, nzx, nzy = c[3], c[4], c[5], c[6], c[7], c[8]
    lx, ly, lz = c[9], c[10], c[11]
    mx, my, mz = c[12], c[13], c[14]
    gx3, gy3, gz3 = c[15], c[16], c[17]
    exx, eyy, ezz, eyz, exz, exy, factor = c[18], c[19], c[20], c[21], c[22], c[23], c[24]
    at -= _HEAD
    # whole vectors: entries beyond the width are scratch that nothing reads
    for e in range(first, first + (width + _LANES - _1) // _LANES * _LANES):
        x, y, z = modes_of(s, e)
        x010, x100, x110, x001, x011, x101, x111 = x
        y010, y100, y110, y001, y011, y101, y111 = y
        z010, z100, z110, z001, z011, z101, z111 = z
        k, m = factor * lam[at + e], mu[at + e]
        # constant strain
        ax, ay, az = gx * x100 + exx, gy * y010 + eyy, gz * z001 + ezz
        p = k * (ax + ay + az)
        m2 = m + m
        x100, y010, z001 = gx * (p + m2 * ax), gy * (p + m2 * ay), gz * (p + m2 * az)
        t = m * (gy * x010 + gx * y100 + exy)
        x010, y100 = gy * t, gx * t
        t = m * (gz * x001 + gx * z100 + exz)
        x001, z100 = gz * t, gx * t
        t = m * (gz * y001 + gy * z010 + eyz)
        y001, z010 = gz * t, gy * t
        # dilatation along η, ζ, ξ, and the shears that go with the same modes
        p = k * (gx * x110 + gz * z011)
        x110, z011 = gx3 * p + nxy * m * x110, gz3 * p + nzy * m * z011
        p = k * (gx * x101 + gy * y011)
        x101, y011 = gx3 * p + nxz * m * x101, gy3 * p + nyz * m * y011
        p = k * (gy * y110 + gz * z101)
        y110, z101 = gy3 * p + nyx * m * y110, gz3 * p + nzx * m * z101
        # shears along ζ, η, ξ
        p = m * (gy3 * x011 + gx3 * y101)
        q = m * (gz3 * x011 + gx3 * z110)
        t = m * (gz3 * y101 + gy3 * z110)
        x011, y101, z110 = gy * p + gz * q, gx * p + gz * t, gx * q + gy * t
        # bilinear terms
        x111, y111, z111 = (lx * k + mx * m) * x111, (ly * k + my * m) * y111, (lz * k + mz * m) * z111
        x = x010, x100, x110, x001, x011, x101, x111
        y = y010, y100, y110, y001, y011, y101, y111
        z = z010, z100, z110, z001, z011, z101, z111
        give_back(s, e, x, y, z)


@inline_jit
def _gather_node(v: NDArray[Any], a: Any, b: Any, comp: Any, s: NDArray[Any], to: Any) -> None:
    c = comp + comp
    s[to], s[to + _R[1]] = v[a] + v[b], v[b] - v[a]
    s[to + _R[2]], s[to + _R[3]] = v[a + comp] + v[b + comp], v[b + comp] - v[a + comp]
    s[to + _R[4]], s[to + _R[5]] = v[a + c] + v[b + c], v[b + c] - v[a + c]


@inline_jit
def _gather_rows(v: NDArray[Any], a: Any, b: Any, comp: Any, n: Any, start: Any, width: Any, s: NDArray[Any]) -> None:
    """Write sums and differences of two rows of nodes, ``start - 1`` to ``start + width``, to scratch rows 0-5.

    `a` and `b` are the offsets of the rows in the planes below and above, `comp` the distance of components, `n` the
    length of a row; `start` and `width` define the block.
    """
    c = comp + comp
    low, high = a + start, b + start
    for i in range(width):
        p, q, to = low + i, high + i, _HEAD + i
        x, y = v[p], v[q]
        s[to], s[to + _R[1]] = x + y, y - x
        x, y = v[p + comp], v[q + comp]
        s[to + _R[2]], s[to + _R[3]] = x + y, y - x
        x, y = v[p + c], v[q + c]
        s[to + _R[4]], s[to + _R[5]] = x + y, y - x
    # the row is periodic
    before = start - _1 if start > 0 else n - _1
    _gather_node(v, a + before, b + before, comp, s, _HEAD - _1)
    after = start + width if start + width < n else start - start
    _gather_node(v, a + after, b + after, comp, s, _HEAD + width)


@inline_jit
def _scatter_rows(s: NDArray[Any], plane: NDArray[Any], at: Any, width: Any) -> None:
    """Convert forces of bricks in modes of x and z (rows 30 to 41) to forces of nodes (rows 42 to 44).

    `plane`, from `at` on, holds the contributions of the bricks below to these nodes, components a stride apart, and
    receives those for the plane above.
    """
    for i in range(width):
        b = _HEAD + i
        a = b - _1
        p = at + i
        low = (s[a + _R[30]] + s[a + _R[31]]) + (s[b + _R[30]] - s[b + _R[31]])
        high = (s[a + _R[32]] + s[a + _R[33]]) + (s[b + _R[32]] - s[b + _R[33]])
        s[i + _R[42]] = plane[p] + (low - high)
        plane[p] = low + high
        low = (s[a + _R[34]] + s[a + _R[35]]) + (s[b + _R[34]] - s[b + _R[35]])
        high = (s[a + _R[36]] + s[a + _R[37]]) + (s[b + _R[36]] - s[b + _R[37]])
        s[i + _R[43]] = plane[p + _R[1]] + (low - high)
        plane[p + _R[1]] = low + high
        low = (s[a + _R[38]] + s[a + _R[39]]) + (s[b + _R[38]] - s[b + _R[39]])
        high = (s[a + _R[40]] + s[a + _R[41]]) + (s[b + _R[40]] - s[b + _R[41]])
        s[i + _R[44]] = plane[p + _R[2]] + (low - high)
        plane[p + _R[2]] = low + high


@inline_jit
def _write_rows(s: NDArray[Any], out: NDArray[Any], at: Any, comp: Any, width: Any) -> None:
    c = comp + comp
    for i in range(width):
        o = at + i
        out[o] = s[i + _R[42]]
        out[o + comp] = s[i + _R[43]]
        out[o + c] = s[i + _R[44]]


@inline_jit
def _product_rows(v: NDArray[Any], at: Any, comp: Any, s: NDArray[Any], width: Any) -> float:
    c = comp + comp
    total = 0.0
    for i in range(width):
        o = at + i
        total += np.float64(v[o]) * np.float64(s[i + _R[42]])
        total += np.float64(v[o + comp]) * np.float64(s[i + _R[43]])
        total += np.float64(v[o + c]) * np.float64(s[i + _R[44]])
    return total


@inline_jit
def _residual_rows(
    r: NDArray[Any], at: Any, comp: Any, s: NDArray[Any], out: NDArray[Any], oat: Any, ocomp: Any, width: Any
) -> None:
    c, oc = comp + comp, ocomp + ocomp
    for i in range(width):
        a, o = at + i, oat + i
        out[o] = r[a] - s[i + _R[42]]
        out[o + ocomp] = r[a + comp] - s[i + _R[43]]
        out[o + oc] = r[a + c] - s[i + _R[44]]


@inline_jit
def _smooth_rows(
    v: NDArray[Any], vat: Any, vcomp: Any, r: NDArray[Any], at: Any, comp: Any, weight: NDArray[Any], wat: Any,
    s: NDArray[Any], width: Any,
) -> None:  # fmt: skip
    c, vc = comp + comp, vcomp + vcomp
    for i in range(width):
        o, e, w = at + i, vat + i, weight[wat + i]
        s[i + _R[42]] = v[e] + w * (r[o] - s[i + _R[42]])
        s[i + _R[43]] = v[e + vcomp] + w * (r[o + comp] - s[i + _R[43]])
        s[i + _R[44]] = v[e + vc] + w * (r[o + c] - s[i + _R[44]])


@jit
def sweep_plane(
    mode: int,
    v: NDArray[Any],
    vlow: Any,
    vhigh: Any,
    vcomp: Any,
    r: NDArray[Any],
    weight: NDArray[Any],
    lam: NDArray[Any],
    mu: NDArray[Any],
    c: NDArray[Any],
    shape: I64,
    low: Any,
    finish: Any,
    out: NDArray[Any],
    oat: Any,
    ocomp: Any,
    plane: NDArray[Any],
    s: NDArray[Any],
) -> float:
    """Visit the bricks between two planes of nodes, and evaluate the pass on the lower one.

    Parameters
    ----------
    mode, r, weight, lam, mu, c, shape, plane, s
        As `elastic_passes.apply_stiffness`.
    v : flat
        Displacements; `vlow` and `vhigh` are the offsets of both planes, `vcomp` the distance of components.
    low : uint64
        The lower plane.
    finish : bool
        True if the bricks below that plane have been visited; else nothing is written.
    out : flat
        Receives the plane from `oat` on, components `ocomp` apart.
    """
    n, lines, planes = np.uint64(shape[0]), np.uint64(shape[1]), np.uint64(shape[2])
    padded = np.uint64(len(mu)) // (lines * planes)
    step, general = np.uint64(len(mu)), len(lam) > len(mu)
    blocks = (n + _BLOCK - _1) // _BLOCK
    comp = planes * lines * n
    total = 0.0
    for block in range(blocks):
        start = block * _BLOCK
        width = min(_BLOCK, n - start)
        for line in range(lines + _1 + _1):
            # the last line, to begin with; the bricks between it and the first one; then all others
            y = (line + lines - _1) % lines
            _gather_rows(v, vlow + y * n, vhigh + y * n, vcomp, n, start, width, s)
            if line == _ZERO:
                _first_line(s, width)
                continue
            row = (y + lines - _1) % lines
            bricks = (low * lines + row) * padded + start + _HEAD
            if blocks == _1:
                # the last brick of the row lies before the first one, too
                if general:
                    full_row(s, lam, step, bricks, c, _HEAD, width)
                else:
                    _brick_row(s, lam, mu, bricks, c, _HEAD, width)
                for i in range(_LINE, _FORCE, _R[1]):
                    s[i + _HEAD - _1] = s[i + _HEAD + width - _1]
            elif general:
                full_row(s, lam, step, bricks, c, _HEAD - _1, width + _1)
            else:
                _brick_row(s, lam, mu, bricks, c, _HEAD - _1, width + _1)
            if line == _1:
                continue
            _scatter_rows(s, plane, (block * lines + row) * _R[3], width)
            if not finish:
                continue
            place = row * n + start
            at, vat, to = low * lines * n + place, vlow + place, oat + place
            if mode == APPLY:
                _write_rows(s, out, to, ocomp, width)
                total += _product_rows(v, vat, vcomp, s, width)
            elif mode == SMOOTH:
                _smooth_rows(v, vat, vcomp, r, at, comp, weight, at, s, width)
                _write_rows(s, out, to, ocomp, width)
                total += _product_rows(r, at, comp, s, width)
            else:
                _residual_rows(r, at, comp, s, out, to, ocomp, width)
    return total
