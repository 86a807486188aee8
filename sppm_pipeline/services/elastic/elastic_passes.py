"""Passes of a multigrid cycle and of conjugate gradients over an elastic body.

A smoothing step from zero is the residual times the weights, so that its displacements need no vector: they are
computed two planes at a time, right before the bricks between them are visited. Residuals are restricted and
corrections interpolated plane by plane, too. A cycle then reads the residual twice and writes its result once.

Displacements may be held at zero: no force, residual or correction is left there, so that the passes are those of the
matrix without these rows and columns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import I32, I64
from sppm_pipeline.services.elastic.elastic_operator import sweep_plane
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.multigrid.rows import APPLY, RESIDUAL, SMOOTH
from sppm_pipeline.services.multigrid.transfer import interpolate_plane, restrict_plane

_0, _1, _3 = np.uint64(0), np.uint64(1), np.uint64(3)


@inline_jit
def _hold(out: NDArray[Any], at: Any, comp: Any, held: I32, first: Any, last: Any, layer: Any) -> None:
    for k in range(first, last):
        place = np.uint64(held[k])
        out[at + place // layer * comp + place % layer] = 0


@jit
def apply_stiffness(
    mode: int,
    v: NDArray[Any],
    r: NDArray[Any],
    weight: NDArray[Any],
    lam: NDArray[Any],
    mu: NDArray[Any],
    c: NDArray[Any],
    shape: I64,
    out: NDArray[Any],
    plane: NDArray[Any],
    s: NDArray[Any],
    held: I32,
    first: I64,
) -> float:
    """Compute forces ``f = K v`` of displacements, their residual, or a smoothing step.

    Parameters
    ----------
    mode : {APPLY, RESIDUAL, SMOOTH}
        `out` and the returned value are f and ``v . f``; or ``r - f`` and 0; or ``z = v + weight (r - f)`` and
        ``r . z``.
    v : (3, nz, ny, nx)
        Displacements.
    r : (3, nz, ny, nx)
        Right-hand side; not read by `APPLY`.
    weight : (nz, ny, nx)
        Damped inverse of the diagonal; read by `SMOOTH`.
    lam, mu : (nz, ny, nx + 1)
        Lamé constants of the voxels, the last voxel of a row first and last; the first one times the last coefficient.
    c : (26,)
        Coefficients from `coefficients`.
    out : (3, nz, ny, nx)
        Must not be `v`, and may be `r`.
    plane : (blocks, ny, 3, STRIDE)
        Scratch.
    s : (SCRATCH_ROWS * STRIDE,)
        Scratch.
    held : (h,) int32
        Displacements that are held at zero, which `v` must be there: places in a plane (3, ny, nx), plane by plane.
    first : (nz + 1,) int64
        Where those of each plane begin. All arrays have the same precision; sums are in double precision.
    """
    planes = np.uint64(shape[2])
    layer = np.uint64(shape[0]) * np.uint64(shape[1])
    comp = planes * layer
    total = 0.0
    for t in range(planes + _1):  # bricks above the last plane come first and last: plane 0 needs their forces
        low, high = (t + planes - _1) % planes, t % planes
        total += sweep_plane(
            mode, v, low * layer, high * layer, comp, r, weight, lam, mu, c, shape, low, t > _0, out, low * layer,
            comp, plane, s,
        )  # fmt: skip
        if t > _0:
            _hold(out, low * layer, comp, held, first[low], first[low + _1], layer)
    return total


@inline_jit
def _weigh_plane(r: NDArray[Any], at: Any, comp: Any, weight: NDArray[Any], out: NDArray[Any], to: Any, n: Any) -> None:
    for c in range(_3):
        source, target = at + c * comp, to + c * n
        for i in range(n):
            out[target + i] = weight[at + i] * r[source + i]


@jit
def descend(
    r: NDArray[Any],
    weight: NDArray[Any],
    lam: NDArray[Any],
    mu: NDArray[Any],
    c: NDArray[Any],
    shape: I64,
    coarse: NDArray[Any],
    shapes: I64,
    ring: NDArray[Any],
    rest: NDArray[Any],
    line: NDArray[Any],
    plane: NDArray[Any],
    s: NDArray[Any],
    held: I32,
    first: I64,
) -> None:
    """Restrict the residual after a smoothing step from zero to the next coarser grid.

    Parameters
    ----------
    r, weight, lam, mu, c, shape, plane, s
        As `apply_stiffness`.
    coarse : flat
        Receives the residual.
    shapes, line
        As `transfer.restrict`, its scratch being `line`.
    ring, rest : (2, 3, ny, nx), (3, ny, nx)
        Scratch.
    """
    planes, layer = np.uint64(shape[2]), np.uint64(shape[0]) * np.uint64(shape[1])
    comp = planes * layer
    coarse[:] = 0
    _weigh_plane(r, (planes - _1) * layer, comp, weight, ring, _3 * layer, layer)
    _hold(ring, _3 * layer, layer, held, first[planes - _1], first[planes], layer)
    for t in range(planes + _1):
        low, high = (t + planes - _1) % planes, t % planes
        a, b = ((t + _1) & _1) * _3 * layer, (t & _1) * _3 * layer
        _weigh_plane(r, high * layer, comp, weight, ring, b, layer)
        _hold(ring, b, layer, held, first[high], first[high + _1], layer)
        sweep_plane(RESIDUAL, ring, a, b, layer, r, weight, lam, mu, c, shape, low, t > _0, rest, _0, layer, plane, s)
        if t > _0:
            _hold(rest, _0, layer, held, first[low], first[low + _1], layer)
            restrict_plane(rest, _0, layer, low, shapes, coarse, line)


@jit
def ascend(
    r: NDArray[Any],
    weight: NDArray[Any],
    lam: NDArray[Any],
    mu: NDArray[Any],
    c: NDArray[Any],
    shape: I64,
    coarse: NDArray[Any],
    shapes: I64,
    ring: NDArray[Any],
    line: NDArray[Any],
    out: NDArray[Any],
    plane: NDArray[Any],
    s: NDArray[Any],
    held: I32,
    first: I64,
) -> float:
    """Smooth from zero, add the correction of the coarser grid, and smooth again; returns ``r . out``.

    Parameters are those of `descend`; `coarse` is the correction, and `out` receives the result.
    """
    planes, layer = np.uint64(shape[2]), np.uint64(shape[0]) * np.uint64(shape[1])
    comp = planes * layer
    total = 0.0
    _weigh_plane(r, (planes - _1) * layer, comp, weight, ring, _3 * layer, layer)
    interpolate_plane(coarse, planes - _1, shapes, ring, _3 * layer, layer, line)
    _hold(ring, _3 * layer, layer, held, first[planes - _1], first[planes], layer)
    for t in range(planes + _1):
        low, high = (t + planes - _1) % planes, t % planes
        a, b = ((t + _1) & _1) * _3 * layer, (t & _1) * _3 * layer
        _weigh_plane(r, high * layer, comp, weight, ring, b, layer)
        interpolate_plane(coarse, high, shapes, ring, b, layer, line)
        _hold(ring, b, layer, held, first[high], first[high + _1], layer)
        total += sweep_plane(
            SMOOTH, ring, a, b, layer, r, weight, lam, mu, c, shape, low, t > _0, out, low * layer, comp, plane, s
        )
        if t > _0:
            _hold(out, low * layer, comp, held, first[low], first[low + _1], layer)
    return total


@inline_jit
def _turn_plane(z: NDArray[Any], beta: Any, p: NDArray[Any], at: Any, comp: Any, n: Any) -> None:
    for c in range(_3):
        start = at + c * comp
        for i in range(start, start + n):
            p[i] = z[i] + beta * p[i]


@jit
def turn_apply(
    z: NDArray[Any],
    beta: Any,
    p: NDArray[Any],
    weight: NDArray[Any],
    lam: NDArray[Any],
    mu: NDArray[Any],
    c: NDArray[Any],
    shape: I64,
    plane: NDArray[Any],
    s: NDArray[Any],
    held: I32,
    first: I64,
) -> float:
    """Compute the next direction ``p = z + beta p`` and its forces, which replace z; returns ``p . K p``.

    Other parameters are those of `apply_stiffness`.
    """
    planes, layer = np.uint64(shape[2]), np.uint64(shape[0]) * np.uint64(shape[1])
    comp, factor = planes * layer, p.dtype.type(beta)
    total = 0.0
    _turn_plane(z, factor, p, (planes - _1) * layer, comp, layer)
    for t in range(planes + _1):
        low, high = (t + planes - _1) % planes, t % planes
        if t + _1 < planes:
            _turn_plane(z, factor, p, high * layer, comp, layer)
        # z of the lower plane has been read
        total += sweep_plane(
            APPLY, p, low * layer, high * layer, comp, p, weight, lam, mu, c, shape, low, t > _0, z, low * layer, comp,
            plane, s,
        )  # fmt: skip
        if t > _0:
            _hold(z, low * layer, comp, held, first[low], first[low + _1], layer)
    return total


@jit
def constant_forces(
    weight: NDArray[Any],
    lam: NDArray[Any],
    mu: NDArray[Any],
    c: NDArray[Any],
    shape: I64,
    nothing: NDArray[Any],
    out: NDArray[Any],
    plane: NDArray[Any],
    s: NDArray[Any],
) -> None:
    """Compute the forces of the constant strain in `c` without displacements.

    Parameters are those of `apply_stiffness`, and `nothing` is zeros for a plane, (3, ny, nx).
    """
    planes, layer = np.uint64(shape[2]), np.uint64(shape[0]) * np.uint64(shape[1])
    comp = planes * layer
    for t in range(planes + _1):
        low = (t + planes - _1) % planes
        sweep_plane(
            APPLY,
            nothing,
            _0,
            _0,
            layer,
            nothing,
            weight,
            lam,
            mu,
            c,
            shape,
            low,
            t > _0,
            out,
            low * layer,
            comp,
            plane,
            s,
        )
