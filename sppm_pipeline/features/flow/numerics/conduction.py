"""The effective conductivity of a periodic voxel cell, by three load cases: of heat, charge, or what diffuses.

The scalar sibling of `elasticity` and `elastic_operator`; the latter explains modes, rows and scratch.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import (
    APPLY,
    BLOCK,
    HEAD,
    LANES,
    STRIDE,
    Hierarchy,
    Solved,
    Workspace,
    coarsened,
    coarser,
    coarser_widths,
    finish_row,
    gather_row,
    inline_jit,
    jit,
    load_cases,
    node_sums,
    padded,
    scatter_row,
    shortness,
)
from sppm_pipeline.numerics import SolverStop as Stop

_LAYERS = 8
"""Layers of voxels whose energies are summed at once; a constant, so that sums do not depend on threads."""

_FLOOR = 1e-6
"""Conductivity over the mean of the voxels' below which no accuracy is requested ..."""

NO_FLUX = 1e-9
"""... and below which a direction has no path of conduction."""

#: Rows of scratch: sum and difference along z, 4 modes of the line before, 4 flows carried to the next line, 4 flows
#: of the line, the flows of a row of nodes.
SCRATCH_ROWS = 15

_0, _1, _3 = np.uint64(0), np.uint64(1), np.uint64(3)
_LANES, _HEAD, _BLOCK = np.uint64(LANES), np.uint64(HEAD), np.uint64(BLOCK)
_R = tuple(np.uint64(STRIDE * row) for row in range(SCRATCH_ROWS))


class Conducted(NamedTuple):
    """Effective conductivity (3, 3), mean flux over mean gradient in the unit of the voxels', and its solves."""

    conductivity: NDArray[np.float64]
    solved: tuple[Solved, ...]
    precision: str


def conductivity(
    k: NDArray[Any], edges: tuple[float, float, float] = (1.0, 1.0, 1.0), *, residual: float = 0.0,
    tolerance: float = 1e-4, iterations: int = 1000, precision: Any = np.float32, threads: int = 1,
) -> Conducted:  # fmt: skip
    """Effective conductivity of a periodic cell of isotropic voxels, trilinear bricks with full integration.

    `k` (nz, ny, nx) are the conductivities of the voxels, 0 for insulators, and `edges` those of a voxel (hx, hy, hz)
    in any unit; the rest is as for `elasticity.stiffness`. `ValueError` if a conductivity is negative or not finite,
    `ArithmeticError` if the iteration fails in double precision, too.
    """
    dtype = np.dtype(precision)
    k = np.asarray(k, dtype)
    if k.ndim != 3 or not k.size:
        raise ValueError(f"conductivities need three axes, got {k.shape}")
    if not (k.min() >= 0 and np.isfinite(k).all()):
        raise ValueError("the conductivity of a voxel must be finite and not negative")
    if not k.any():
        return Conducted(np.zeros((3, 3)), (Solved(0, 0.0, 0.0, 0.0, True, True),) * 3, dtype.name)
    scale = float(k.max())
    k = k / dtype.type(scale)
    # unit conductivity and longest edge 1: single precision has 7 digits, and stops depend on no unit
    longest = max(edges)
    edges = (edges[0] / longest, edges[1] / longest, edges[2] / longest)
    mean = np.full(3, float(k.mean(dtype=np.float64)))

    def hierarchy(precision: np.dtype[Any], safe: bool) -> Hierarchy:
        return conduction_hierarchy(k, edges, precision, safe=safe)

    matrix, solved, reached = load_cases(
        hierarchy, _Potentials, mean, Stop(residual, tolerance, iterations), _FLOOR, dtype, threads
    )
    # an axis without a path leaves rounding only, which would make a tortuosity of it
    nothing = np.diag(matrix) < NO_FLUX * mean
    matrix[nothing] = 0
    matrix[:, nothing] = 0
    return Conducted(matrix * scale, solved, reached)


class _Potentials:
    """The solutions of all load cases, and their energies; see `solver.Measure`."""

    def __init__(self, hierarchy: Hierarchy) -> None:
        level = hierarchy.levels[0]
        assert isinstance(level, ConductionLevel)
        self.level = level
        self.fields = np.empty((3, level.weight.size), level.weight.dtype)

    def target(self, case: int) -> NDArray[Any]:
        """The potential of a load case."""
        field: NDArray[Any] = self.fields[case]
        return field

    def keep(self, case: int, u: NDArray[Any]) -> None:
        """All potentials are kept anyway."""

    def record(self, case: int, u: NDArray[Any], spare: NDArray[Any], work: Workspace) -> None:
        """Energies are summed when all potentials are there."""

    def energies(self, threads: int) -> NDArray[np.float64]:
        """Mutual energies over the volume, (3, 3)."""
        level = self.level
        nz, ny, nx = level.shape
        c = conduction_coefficients(level.edges, np.ones(3))
        k, u = level.k.reshape(nz, ny, -1), self.fields.reshape(3, nz, ny, nx)

        def layers(first: int) -> NDArray[np.float64]:
            out = np.zeros((3, 3))
            flow_energies(u, k, c, level.size, first, min(first + _LAYERS, nz), out)
            return out

        # parts are added in the order of layers, so that the sum does not depend on threads
        with ThreadPoolExecutor(threads) as pool:
            parts = list(pool.map(layers, range(0, nz, _LAYERS)))
        total = np.zeros((3, 3))
        for part in parts:
            total += part
        total /= nz * ny * nx * float(np.prod(level.edges))
        return total


def tortuosity(effective: NDArray[np.float64], fraction: float, bulk: float = 1.0) -> list[float | None]:
    """``fraction * bulk / effective`` along x, y, z: the squared ratio of path lengths; None without flux.

    `effective` (3, 3) is the conductivity of a phase, of volume fraction `fraction` and conductivity `bulk`, in an
    insulator.
    """
    return [fraction * bulk / float(value) if value > 0 else None for value in np.diag(effective)]


class ConductionLevel:
    """One grid of conductivities `k` (nz, ny, nx), voxels of `edges` (hx, hy, hz); see `multigrid.hierarchy.Level`."""

    components = 1

    def __init__(self, k: NDArray[Any], edges: tuple[float, float, float], dtype: Any) -> None:
        nz, ny, nx = k.shape
        self.shape = (nz, ny, nx)
        self.edges = edges
        self.k = padded(k, dtype)
        self.c = conduction_coefficients(edges).astype(dtype)
        self.size = np.array([nx, ny, nz], np.int64)
        # the diagonal of a brick: 16/9 for the weights 1, 1/3, 1/3, 1/9 of its modes
        self.diagonal = node_sums(16 / 9 * float(self.c[:3] @ self.c[:3]) * k).reshape(-1)
        self.weight = np.zeros(nx * ny * nz, dtype)
        self.held = np.zeros(0, np.int64)

    def hold(self, fixed: NDArray[np.bool_]) -> None:
        """Hold potentials (1, nz, ny, nx) at zero: without a weight, steps leave them there."""
        self.held = np.flatnonzero(fixed)
        self.diagonal[self.held] = 0

    def apply(self, mode: int, v: NDArray[Any], r: NDArray[Any], out: NDArray[Any], work: Workspace) -> float:
        """See `apply_conductivity`; what flows out of held nodes counts as nothing."""
        total = apply_conductivity(mode, v, r, self.weight, self.k, self.c, self.size, out, work.plane, work.rows)
        if mode == APPLY:
            out[self.held] = 0
        return total

    def forces(self, gradient: NDArray[np.float64], out: NDArray[Any], work: Workspace) -> None:
        """Flows out of the nodes for a constant gradient (3,), written to `out`."""
        c = conduction_coefficients(self.edges, gradient).astype(self.c.dtype)
        zero = np.zeros_like(out)
        apply_conductivity(APPLY, zero, zero, self.weight, self.k, c, self.size, out, work.plane, work.rows)

    def rounding(self) -> float:
        """Rounding error to expect in the fluxes of a homogeneous conductor."""
        largest = float(np.abs(self.c[:3]).max()) * float(self.k.max())
        return 8 * float(np.finfo(self.c.dtype).eps) * largest * float(np.sqrt(np.prod(self.edges)))


def conduction_hierarchy(k: NDArray[Any], edges: tuple[float, float, float], dtype: Any, *, safe: bool) -> Hierarchy:
    """All grids of a periodic conductor, coarse ones with the mean conductivity of eight voxels."""
    levels, bound = [ConductionLevel(k, edges, dtype)], largest_eigenvalue(edges)
    widths = [np.ones(n) for n in k.shape]
    while coarser(levels[-1].shape) is not None:
        doubled = [h * (2 if n > 1 else 1) for h, n in zip(edges, k.shape[::-1], strict=True)]
        edges = (doubled[0], doubled[1], doubled[2])
        k, widths = coarsened(k), coarser_widths(widths)
        levels.append(ConductionLevel(k * shortness(widths).astype(k.dtype), edges, dtype))
        bound = max(bound, largest_eigenvalue(edges))
    return Hierarchy.of(list(levels), SCRATCH_ROWS, bound if safe else 0.0)


def largest_eigenvalue(edges: tuple[float, float, float]) -> float:
    """A bound of the eigenvalues over the diagonal: that of the stiffest mode of a brick."""
    q = 1 / np.array(edges) ** 2
    return float(8 * max(q.max(), np.sort(q)[1:].sum() / 3, q.sum() / 9) / (16 / 9 * q.sum()))


def conduction_coefficients(
    edges: tuple[float, float, float], gradient: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Weights of the modes of a brick for `apply_conductivity`, and a constant gradient (3,) that is added; (10,)."""
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
def apply_conductivity(
    mode: int, v: NDArray[Any], r: NDArray[Any], weight: NDArray[Any], k: NDArray[Any], c: NDArray[Any],
    shape: NDArray[np.int64], out: NDArray[Any], plane: NDArray[Any], s: NDArray[Any],
) -> float:  # fmt: skip
    """Fluxes ``f = K v`` of potentials, or what a solver needs of them; compare `elastic_operator.apply_stiffness`.

    `v`, `r`, `weight` and `out` are (nz, ny, nx) flat, `plane` is (ny, nx) flat; `k` has rows padded as by
    `multigrid.hierarchy.padded`, `c` (10,) comes from `conduction_coefficients`, `shape` is (nx, ny, nz), and `s` is
    scratch of SCRATCH_ROWS * STRIDE.
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
    u: NDArray[Any], k: NDArray[Any], c: NDArray[Any], shape: NDArray[np.int64], first: int, last: int,
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    """Add the mutual energies (3, 3) of the potentials `u` (3, nz, ny, nx), whose mean gradients are along x, y, z, in
    the layers ``first <= z < last`` of voxels; in `c` (10,) all gradients that are added are one. See
    `elastic_energy.energies`.
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
