"""The permeability of a periodic cell: Stokes flow on a staggered grid, driven by a unit pressure gradient.

Velocities u on faces and pressures p in voxels solve ``A u + W G p = W e_i`` and ``-div W u = 0``, A the negative
Laplacian and W the weights of faces beside walls, for each axis i; the permeability is ``k_ij = <W u_j>`` (Darcy's law
for unit viscosity). The matrix is symmetric and indefinite, so the iteration is MINRES (Paige and Saunders 1975; as
written in Elman, Silvester and Wathen, "Finite Elements and Fast Iterative Solvers"), preconditioned by one multigrid
cycle for each component of the velocity and by

    1 + (-div W psi grad)^-1

for the pressure. Its 1 is right for short waves, where the pressure Schur complement ``div A^-1 grad`` is the identity.
For long ones the complement is Darcy's operator, and the torsion field psi, ``A psi = W 1``, zero on walls, is
the conductance of a straight channel of any section, and nearly that of a throat. The mean of psi is at the same time
the thermal permeability.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.flow.numerics.channel_grids import ChannelGrids, ChannelWork
from sppm_pipeline.features.flow.numerics.faces import Faces
from sppm_pipeline.features.flow.numerics.seven_point import SCRATCH_ROWS, SevenPointLevel, hierarchy_of
from sppm_pipeline.numerics import APPLY, STRIDE, Hierarchy, Solved, Workspace, dot, inline_jit, jit, solve
from sppm_pipeline.numerics import SolverStop as Stop

_CONDUCTS = 0.35
"""Part of the torsion field that conducts pressure. Measured on cells of the paper, graphs and blobs of porosities from
0.15 to 0.7 at 32 and 48 voxels: up to two fifths fewer iterations than with all of it, and at most one more."""

_TORSION = Stop(0.0, 1e-4, 100)
"""When the torsion field is good enough, for the preconditioner and the thermal permeability."""

_FLOOR = 1e-6
"""Permeability over the thermal one, which is never smaller, below which no accuracy is requested."""

_SPAN, _SLOWEST = 6, 0.98
"""So many changes tell what is to come; the fall from one to the next that counts at most."""

_SAFETY = 2.0
"""Measured: at porosities of 0.1 and of 0.8 to 0.9 the estimate without it is at most 1.9 times too small."""

_SINGLE = 1e-5
"""Tolerances and residuals below this are beyond single precision. A factor of two changes memory and speed only."""

_CHUNK = 16384
"""Entries of vectors that are updated at once, so that they stay in the cache from one operation to the next."""

_0, _1 = np.uint64(0), np.uint64(1)


class Flow(NamedTuple):
    """Flow through a cell, along x, y, z."""

    permeability: NDArray[np.float64]  # (3, 3), symmetric; the unit of the edges squared
    thermal_permeability: float  # mean of the torsion field over the cell, the same unit
    # ``phi <u.u> / <u>^2`` of each flow, means over the cell and phi the porosity; infinite without flow
    viscous_tortuosity: tuple[float, ...]
    thermal_tortuosity: float  # ``phi <psi^2> / <psi>^2``; infinite without pores
    # ``<|u|> / <u_i>``: mean length of the paths of the fluid over that of the cell; infinite without flow
    hydraulic_tortuosity: tuple[float, ...]
    # speed in the middle plane along each axis (columns) and the next one (rows), over the mean velocity; NaN in solid
    slices: tuple[NDArray[np.float32], ...]
    solved: tuple[Solved, ...]  # their energy is the permeability along the axis
    precision: str


def stokes_flow(
    faces: Faces, porosity: float, axes: tuple[bool, bool, bool] = (True, True, True), *, residual: float = 0.0,
    tolerance: float = 1e-3, iterations: int = 500, precision: Any = np.float32, threads: int = 1,
) -> Flow:  # fmt: skip
    """Solve for the flow along each axis of `axes`, those with a way through; nothing flows along others.

    `faces` are without pockets; `porosity` is the fraction of the cell that is open, for the tortuosities; the rest is
    as for `elasticity.stiffness`, but cycles of the preconditioner are always in single precision. `ArithmeticError`
    if the iteration fails in double precision, too.
    """
    stop, dtype = Stop(residual, tolerance, iterations), np.dtype(precision)
    if 0 < tolerance < _SINGLE or 0 < residual < _SINGLE:
        # in single precision, rounding stops the iteration before
        dtype = np.dtype(np.float64)
    # all of a periodic cell at once; between mirrors a flow along each axis has a cell of its own
    cells = [faces.driven(d) for d in range(3)] if faces.mirrored else [faces]
    longest = max(faces.edges)
    edges = tuple(h / longest for h in faces.edges)
    velocity = [_velocity_hierarchy(cells[d % len(cells)], edges, d, longest) for d in range(3)]
    weights = [cells[d % len(cells)].weights[d].reshape(-1) for d in range(3)]
    torsion = _torsion_fields(velocity, weights, threads)
    weighted = [w * psi for w, psi in zip(weights, torsion, strict=True)]
    thermal = float(np.mean([psi.mean(dtype=np.float64) for psi in weighted]))
    squares = float(np.mean([dot(v, psi) / psi.size for v, psi in zip(weighted, torsion, strict=True)]))
    wanted = [d for d in range(3) if axes[d] and thermal > 0]
    flows = []
    for d, cell in enumerate(cells):
        own, conducting, operators = wanted, torsion, velocity
        if faces.mirrored:
            own = [d] if d in wanted else []
            shapes = [cells[e].active[e].shape for e in range(3)]
            conducting = [psi if e == d else _turned(psi, shapes[e], e, d) for e, psi in enumerate(torsion)]
            operators = [
                of if e == d or not own else _velocity_hierarchy(cell, edges, e, longest)
                for e, of in enumerate(velocity)
            ]
        flows.append(
            _driven(cell, edges, operators, conducting, own, stop, dtype, porosity, thermal, squares, longest, threads)
        )
    if not faces.mirrored:
        return flows[0]
    firsts = [flow.slices[d][:, : flow.slices[d].shape[1] // 2] for d, flow in enumerate(flows)]
    return Flow(
        np.diag([flow.permeability[d, d] for d, flow in enumerate(flows)]), thermal * longest**2,
        tuple(flow.viscous_tortuosity[d] for d, flow in enumerate(flows)), flows[0].thermal_tortuosity,
        tuple(flow.hydraulic_tortuosity[d] for d, flow in enumerate(flows)), tuple(firsts),
        tuple(flow.solved[d] for d, flow in enumerate(flows)), max((flow.precision for flow in flows), key=_digits),
    )  # fmt: skip


def _digits(precision: str) -> int:
    return np.dtype(precision).itemsize


def _turned(psi: NDArray[np.float32], shape: tuple[int, ...], e: int, d: int) -> NDArray[np.float32]:
    """A torsion field of the cell of a flow along axis `e`, in that of a flow along `d`."""
    values = np.moveaxis(psi.reshape(shape), (2 - e, 2 - d), (0, 1))
    half = values[: len(values) // 2]
    return np.moveaxis(np.concatenate((half, half[:, ::-1]), 1), (0, 1), (2 - e, 2 - d)).reshape(-1)


def _driven(
    faces: Faces, edges: tuple[float, ...], velocity: list[Hierarchy], torsion: list[NDArray[np.float32]],
    wanted: list[int], stop: Stop, dtype: np.dtype[Any], porosity: float, thermal: float, squares: float,
    longest: float, threads: int,
) -> Flow:  # fmt: skip
    """The flows along the axes `wanted`."""
    weights = np.concatenate([weight.reshape(-1) for weight in faces.weights])
    if not wanted:
        return _flow(faces, weights, {}, porosity, thermal, squares, longest**2, dtype.name)
    weighted = [w * psi for w, psi in zip(np.split(weights, 3), torsion, strict=True)]
    problem = _Problem(weights, edges, velocity, weighted, faces.active[0].shape)
    # MINRES needs a definite preconditioner, which rounding may spoil in single precision
    for attempt in (dtype, np.dtype(np.float64)):
        fields, solved = problem.solve(wanted, stop, _FLOOR * thermal, attempt, threads)
        if all(case.definite for case in solved):
            break
    else:
        raise ArithmeticError("the iteration does not converge, not even in double precision")
    by_axis = dict(zip(wanted, zip(fields, solved, strict=True), strict=True))
    return _flow(faces, weights, by_axis, porosity, thermal, squares, longest**2, attempt.name)


def _flow(
    faces: Faces, weights: NDArray[np.float32], by_axis: dict[int, tuple[NDArray[Any], Solved]], porosity: float,
    thermal: float, squares: float, unit: float, precision: str,
) -> Flow:  # fmt: skip
    shape = faces.active[0].shape
    k, pores = np.zeros((3, 3)), faces.voxels()
    viscous, hydraulic, slices, solved = [], [], [], []
    for d in range(3):
        if d not in by_axis:
            viscous.append(math.inf)
            hydraulic.append(math.inf)
            slices.append(np.where(middle_plane(pores, d), np.float32(0), np.float32(np.nan)))
            solved.append(Solved(0, 0.0, 0.0, 0.0, True, True))
            continue
        u, case = by_axis[d]
        passing = u * weights
        # Darcy: the mean velocity for a unit force along d is a row of the permeability
        k[d] = passing.reshape(3, -1).mean(axis=1, dtype=np.float64)
        viscous.append(porosity * dot(u, passing) / (u.size // 3) / k[d, d] ** 2)
        speed = _speed(passing.reshape(3, *shape))
        hydraulic.append(float(speed.mean(dtype=np.float64)) / k[d, d])
        slices.append(np.where(middle_plane(pores, d), middle_plane(speed, d) / k[d, d], np.nan).astype(np.float32))
        solved.append(case._replace(energy=case.energy * unit))
    missing = [d for d in range(3) if d not in by_axis]
    k[:, missing] = 0
    return Flow(
        # symmetric by the reciprocity of Stokes flow, up to the error of the solver
        (k + k.T) / 2 * unit,
        thermal * unit,
        tuple(viscous),
        porosity * squares / thermal**2 if thermal > 0 else math.inf,
        tuple(hydraulic),
        tuple(slices),
        tuple(solved),
        precision,
    )


def middle_plane(values: NDArray[Any], d: int) -> NDArray[Any]:
    """The middle plane along an axis and the next one, (next axis, axis)."""
    x = values.transpose(2, 1, 0)
    across = (d + 2) % 3
    plane: NDArray[Any] = np.take(x, x.shape[across] // 2, across)
    # the axes that are left, in their order
    return plane.T if d == min({0, 1, 2} - {across}) else plane


def _speed(u: NDArray[Any]) -> NDArray[Any]:
    """Speed in the voxels, (nz, ny, nx), from velocities on their faces."""
    total = np.zeros_like(u[0])
    for d in range(3):
        # both faces of a voxel along d, averaged to its center
        total += ((u[d] + np.roll(u[d], -1, 2 - d)) / 2) ** 2
    return np.asarray(np.sqrt(total))


def _velocity_hierarchy(faces: Faces, edges: tuple[float, ...], d: int, longest: float) -> Hierarchy:
    """Grids of one component of the velocity."""
    active = faces.active[d]
    # the Laplacian joins active faces; a wall between two counts by its drag alone
    weights = []
    for axis in range(3):
        pairs = active & np.roll(active, 1, 2 - axis)
        if faces.ends[axis]:
            np.moveaxis(pairs, 2 - axis, 0)[0] = False
        weights.append(pairs * np.float32(1 / edges[axis] ** 2))
    return hierarchy_of(faces.walls[d] * np.float32(longest**2), (weights[0], weights[1], weights[2]))


def _torsion_fields(
    velocity: list[Hierarchy], weights: list[NDArray[np.float32]], threads: int
) -> list[NDArray[np.float32]]:
    """``-lap psi = 1`` on the faces of each family."""

    def field(hierarchy: Hierarchy, weight: NDArray[np.float32]) -> NDArray[np.float32]:
        b, psi = weight.copy(), np.zeros_like(weight)
        solve(hierarchy, b, psi, np.empty_like(b), hierarchy.workspace(), _TORSION, 0.0, 1e-30)
        # the exact field is positive; what the solver leaves below zero would make the pressure indefinite
        return np.maximum(psi, 0, out=psi)

    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(field, velocity, weights))


class _Problem:
    """The matrix and its preconditioner."""

    def __init__(
        self, weights: NDArray[np.float32], edges: tuple[float, ...], velocity: list[Hierarchy],
        torsion: list[NDArray[np.float32]], shape: tuple[int, ...],
    ) -> None:  # fmt: skip
        self.velocity = velocity
        conductances = tuple(
            psi.reshape(shape) * np.float32(_CONDUCTS / h**2) for psi, h in zip(torsion, edges, strict=True)
        )
        self.pressure = ChannelGrids(conductances)
        self.weights = weights
        self.inverse_edges = 1 / np.array(edges)
        self.size = np.array(shape[::-1], np.int64)

    def solve(
        self, axes: list[int], stop: Stop, floor: float, dtype: np.dtype[Any], threads: int
    ) -> tuple[list[NDArray[Any]], list[Solved]]:
        """Velocities (3 n,) and outcome for a force along each axis."""
        if not axes:
            return [], []
        with ThreadPoolExecutor(min(threads, len(axes))) as pool:
            found = list(pool.map(lambda d: self._minres(d, stop, floor, dtype), axes))
        return [u for u, _ in found], [case for _, case in found]

    def apply(self, x: NDArray[Any], out: NDArray[Any], rows: NDArray[Any]) -> None:
        """The matrix times velocities and pressures (4 n,)."""
        n = len(x) // 4
        for d, hierarchy in enumerate(self.velocity):
            level, part = hierarchy.levels[0], slice(d * n, (d + 1) * n)
            assert isinstance(level, SevenPointLevel)
            level.apply_by(APPLY, x[part], x[part], out[part], rows)
        couple(x[: 3 * n], x[3 * n :], self.weights, self.inverse_edges.astype(x.dtype), self.size,
               out[: 3 * n], out[3 * n :])  # fmt: skip

    def precondition(self, r: NDArray[Any], out: NDArray[Any], work: Workspace, own: ChannelWork) -> None:
        """An approximate inverse times a residual."""
        n = len(r) // 4
        for d, hierarchy in enumerate(self.velocity):
            part = slice(d * n, (d + 1) * n)
            out[part] = hierarchy.cycle(np.asarray(r[part], np.float32), work)[0]
        out[3 * n :] = self.pressure.cycle(np.asarray(r[3 * n :], np.float32), work, own)
        # the 1 of `1 + (-div psi grad)^-1`: short waves of the pressure (Cahouet and Chabard 1988)
        out[3 * n :] += r[3 * n :]

    def _minres(self, axis: int, stop: Stop, floor: float, dtype: np.dtype[Any]) -> tuple[NDArray[Any], Solved]:
        """MINRES for a unit force along an axis; vectors of the pressure are kept only where they are needed."""
        n = len(self.weights) // 3
        work, own = self.velocity[0].workspace(), self.pressure.workspace()
        rows = np.zeros(SCRATCH_ROWS * STRIDE, dtype)
        v, before, q, z = (np.zeros(4 * n, dtype) for _ in range(4))
        u, w, w_before = (np.zeros(3 * n, dtype) for _ in range(3))
        driven = slice(axis * n, (axis + 1) * n)
        force = self.weights[driven].astype(dtype)
        v[driven] = force
        self.precondition(v, z, work, own)
        start = gamma = math.sqrt(dot(z, v))
        eta, gamma_before, c, c_before, s, s_before = gamma, 1.0, 1.0, 1.0, 0.0, 0.0
        k, error, changes = 0.0, math.inf, list[float]()
        # below this, changes of k are rounding
        rounding = 4 * float(np.finfo(dtype).eps)
        for iteration in range(1, stop.iterations + 1):
            z *= dtype.type(1 / gamma)
            self.apply(z, q, rows)
            delta = dot(z, q)
            _combine(q, v, -delta / gamma, before, -gamma / gamma_before)
            # the two last Givens rotations applied to the new column of the tridiagonal Lanczos matrix
            a0, a2, a3 = c * delta - c_before * s * gamma, s * delta + c_before * c * gamma, s_before * gamma
            gamma_before, direction = gamma, z[: 3 * n]
            before, v, q = v, q, before
            # the next direction, but for its length a1, which the next gamma gives
            _combine(w_before, direction, 1.0, w, -a2, -a3)
            w, w_before = w_before, w
            self.precondition(v, z, work, own)
            square = dot(z, v)
            a1 = math.hypot(a0, math.sqrt(max(square, 0.0)))
            if not (math.isfinite(square) and square >= 0 and a1 > 0):
                return u, Solved(iteration, abs(eta) / start, k, error, False, False)
            gamma = math.sqrt(square)
            w *= dtype.type(1 / a1)
            c_before, c, s_before, s = c, a0 / a1, s, gamma / a1
            _combine(u, w, c * eta)
            changes.append(c * eta * dot(w[driven], force) / n)
            k = dot(u[driven], force) / n
            # |eta| is the norm of the residual in the metric of the preconditioner
            eta *= -s
            error = _remaining(changes) / max(abs(k), floor)
            reached = abs(eta) <= start * stop.residual or error <= stop.energy
            if reached or abs(eta) <= start * rounding or gamma == 0:
                return u, Solved(iteration, abs(eta) / start, k, error, reached or stop.energy > 0, True)
        return u, Solved(stop.iterations, abs(eta) / start, k, error, False, True)


def _remaining(changes: list[float]) -> float:
    """Estimate of what further iterations will change: the largest of the last changes, more if they fall slowly."""
    # changes come in pairs, small and large. Measured on gyroids, spheres and blobs: the true error stays below it
    if len(changes) < _SPAN:
        return math.inf
    late, before = max(map(abs, changes[-_SPAN:])), changes[-2 * _SPAN : -_SPAN]
    early = max(map(abs, before)) if len(before) == _SPAN else 0.0
    fall = min((late / early) ** (1 / _SPAN), _SLOWEST) if early > 0 else 0.0
    return _SAFETY * late * max(1.0, fall / (1 - fall) / 4)


def _combine(
    x: NDArray[Any], a: NDArray[Any], alpha: float, b: NDArray[Any] | None = None, beta: float = 0.0, own: float = 1.0
) -> None:
    """``x = own x + alpha a + beta b``."""
    scale, first, second = x.dtype.type(own), x.dtype.type(alpha), x.dtype.type(beta)
    scratch = np.empty(min(_CHUNK, len(x)), x.dtype)
    for start in range(0, len(x), _CHUNK):
        part = slice(start, start + _CHUNK)
        target = x[part]
        term = scratch[: len(target)]
        if own != 1:
            target *= scale
        np.multiply(a[part], first, out=term)
        target += term
        if b is not None:
            np.multiply(b[part], second, out=term)
            target += term


@inline_jit
def _slope(
    q: NDArray[Any], weights: NDArray[Any], at: Any, p: NDArray[Any], here: Any, there: Any, factor: Any, n: Any
) -> None:
    for i in range(n):
        q[at + i] += weights[at + i] * factor * (p[here + i] - p[there + i])


@inline_jit
def _outflow(
    u: NDArray[Any], weights: NDArray[Any], here: Any, there: Any, factor: Any, q: NDArray[Any], at: Any, n: Any
) -> None:
    for i in range(n):
        q[at + i] += factor * (weights[here + i] * u[here + i] - weights[there + i] * u[there + i])


@jit
def couple(
    u: NDArray[Any], p: NDArray[Any], weights: NDArray[np.float32], factors: NDArray[Any], shape: NDArray[np.int64],
    gradient: NDArray[Any], inflow: NDArray[Any],
) -> None:  # fmt: skip
    """Add the gradient of the pressure to what acts on faces, and write the inflow into each voxel.

    `u`, `weights` and `gradient` are on the faces of the families x, y, z, (3 nz ny nx,), and the weights count in
    both; `p` and `inflow` are (nz ny nx,), `factors` (3,) inverse edges of a voxel, `shape` (nx, ny, nz).
    """
    n, lines, planes = np.uint64(shape[0]), np.uint64(shape[1]), np.uint64(shape[2])
    size = n * lines * planes
    fx, fy, fz = factors[0], factors[1], factors[2]
    last = n - _1
    for z in range(planes):
        for y in range(lines):
            at = (z * lines + y) * n
            before, behind = (z * lines + (y + lines - _1) % lines) * n, (z * lines + (y + _1) % lines) * n
            low, high = ((z + planes - _1) % planes * lines + y) * n, ((z + _1) % planes * lines + y) * n
            gradient[at] += weights[at] * fx * (p[at] - p[at + last])
            _slope(gradient, weights, at + _1, p, at + _1, at, fx, last)
            _slope(gradient, weights, size + at, p, at, before, fy, n)
            _slope(gradient, weights, size + size + at, p, at, low, fz, n)
            for i in range(n):
                inflow[at + i] = p.dtype.type(0)
            _outflow(u, weights, at, at + _1, fx, inflow, at, last)
            inflow[at + last] += fx * (weights[at + last] * u[at + last] - weights[at] * u[at])
            _outflow(u, weights, size + at, size + behind, fy, inflow, at, n)
            _outflow(u, weights, size + size + at, size + size + high, fz, inflow, at, n)
