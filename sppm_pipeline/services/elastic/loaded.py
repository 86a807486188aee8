"""A body of voxels that is held somewhere and loaded: displacements, reactions, and the strains that they make.

The grids have open ends, so that sides of the body never meet, and nodes that are held are left out on all of them: a
node of a coarse grid is held if any node that it is interpolated to is. Bricks are those of `elastic_operator`.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F32, F64, Bools
from sppm_pipeline.services.elastic.elastic_level import STRETCH, ElasticLevel, Moduli, coefficients, largest_eigenvalue
from sppm_pipeline.services.elastic.elastic_operator import SCRATCH_ROWS
from sppm_pipeline.services.elastic.local_solves import correct_locally
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.multigrid.hierarchy import Hierarchy, coarser, node_sums, padded
from sppm_pipeline.services.multigrid.rows import APPLY
from sppm_pipeline.services.multigrid.solver import Solved, Stop, solve
from sppm_pipeline.services.multigrid.transfer import NodalTransfer, coarsened
from sppm_pipeline.services.multigrid.vectors import dot

UPPER = np.triu_indices(6)
"""Rows and columns of the 21 constants of a stiffness."""

_RESTARTS = 5
"""Times that the iteration begins again from the true residual, which rounding drives away from the updated one."""

_FLOOR = 1e-6
"""Part of the energy of a guess below which what is left counts as this: single precision has about six digits."""

_SAMPLED = 64
"""Voxels of different stiffness whose largest eigenvalue is looked for; it hardly varies along a smooth law."""

_MARGIN = 1.05
"""Factor of the largest of those."""


def packed(matrices: F64) -> F64:
    """The 21 constants (21, ...) of stiffness matrices (..., 6, 6)."""
    return np.moveaxis(matrices[..., UPPER[0], UPPER[1]], -1, 0)


def unpacked(constants: NDArray[Any]) -> F64:
    """Stiffness matrices (..., 6, 6) of their 21 constants (21, ...)."""
    made = np.empty((*constants.shape[1:], 6, 6))
    made[..., UPPER[0], UPPER[1]] = made[..., UPPER[1], UPPER[0]] = np.moveaxis(constants, 0, -1)
    return made


class GeneralLevel(ElasticLevel):
    """A grid of voxels of any stiffness.

    Parameters
    ----------
    constants : (21, nz, ny, nx) float
        Voigt order xx, yy, zz, yz, xz, xy, engineering shear strains; 0 in the void.
    edges : (hx, hy, hz)
    dtype : float32 or float64
    """

    def __init__(self, constants: NDArray[Any], edges: tuple[float, float, float], dtype: Any) -> None:
        _, nz, ny, nx = constants.shape
        self.shape, self.edges, self.ratio = (nz, ny, nx), edges, 1.0
        self.lam = np.concatenate([padded(one, dtype) for one in constants])
        self.mu = self.lam[: len(self.lam) // 21]  # only its length counts
        self.c = coefficients(edges).astype(dtype)
        self.size = np.array([nx, ny, nz], np.int64)
        self.weight = np.zeros(nx * ny * nz, dtype)
        self.held, self.first = np.zeros(0, np.int32), np.zeros(nz + 1, np.int64)
        g = self.c[:3].astype(np.float64) ** 2
        pull = [sum(g[d] * constants[k] for d, k in enumerate(row)) for row in ((0, 20, 18), (20, 6, 15), (18, 15, 11))]
        self._diagonal = node_sums(np.asarray(16 / 27 * sum(pull), dtype)).reshape(-1)

    @property
    def diagonal(self) -> NDArray[Any]:
        return self._diagonal


def brick_strains(edges: tuple[float, float, float]) -> tuple[F64, F64]:
    """Strains (7, 6, 24) of the monomials 1, ξ, η, ζ, ξη, ξζ, ηζ of a brick, and the weights (7,) of their squares.

    Displacements are those of corners i + 2 j + 4 k, x, y, z of each; strains are not scaled, weights hold the volume.
    """
    corners = np.array([[(a >> d & 1) * 2 - 1 for d in range(3)] for a in range(8)], np.float64)
    powers: list[tuple[int, ...]] = [*product((0, 1), repeat=3)]
    powers.sort(key=lambda p: (sum(p), -p[0], -p[1]))
    h = np.array(edges, np.float64)
    # coefficient of each monomial from the corners
    modes = np.array([np.prod(corners**p, axis=1) / 8 for p in powers])
    found = np.zeros((7, 6, 8, 3))
    shear = {(1, 2): 3, (0, 2): 4, (0, 1): 5}
    for number, power in enumerate(powers):
        for d in range(3):
            if not power[d]:
                continue
            left = tuple(p - (k == d) for k, p in enumerate(power))
            slope = 2 / h[d] * modes[number]
            for c in range(3):  # derivative along d of the displacement along c
                row = c if c == d else shear[(min(c, d), max(c, d))]
                found[powers.index(left), row][:, c] += slope
    weights = h.prod() / 3.0 ** np.array([0, 1, 1, 1, 2, 2, 2])
    return found.reshape(7, 6, 24), weights


def largest_of(constants: NDArray[Any], edges: tuple[float, float, float]) -> float:
    """The largest eigenvalue of bricks with these constants (21, m) over their mean diagonal."""
    strains, weights = brick_strains(edges)
    matrices = np.einsum("m,mai,nab,mbj->nij", weights, strains, unpacked(constants), strains, optimize=True)
    diagonal = np.trace(matrices, axis1=1, axis2=2) / 24
    return float((np.linalg.eigvalsh(matrices)[:, -1] / diagonal).max())


def _held_below(fixed: Bools, shape: tuple[int, int, int]) -> Bools:
    """Which displacements (3, nz, ny, nx) of the next grid are held: those that reach one that is."""
    for axis, (n, m) in enumerate(zip(fixed.shape[1:], shape, strict=True), 1):
        if n == m:
            continue
        along = np.moveaxis(fixed, axis, 0)
        even, odd = along[0::2], along[1::2]
        coarse = np.zeros((m, *along.shape[1:]), bool)
        coarse[: len(even)] |= even
        coarse[: len(odd)] |= odd
        coarse[1 : len(odd) + 1] |= odd
        fixed = np.moveaxis(coarse, 0, axis)
    return np.ascontiguousarray(fixed)


class NodalValues(NamedTuple):
    """Values of some of the unknowns, which are components first: places in the flat array (m,), and values (m,)."""

    at: NDArray[np.int64]
    values: NDArray[np.float64]

    @classmethod
    def of(cls, dense: NDArray[Any]) -> NodalValues:
        """Those of a whole array that are not zero."""
        at = np.flatnonzero(dense)
        return cls(at, dense.reshape(-1)[at].astype(np.float64))

    def dense(self, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """The whole array."""
        made = np.zeros(int(np.prod(shape)))
        made[self.at] = self.values
        return made.reshape(shape)


class Loaded(NamedTuple):
    """Displacements (3, nz + 1, ny + 1, nx + 1) of a body of nz, ny, nx voxels, and how they were found."""

    displacement: NDArray[Any]
    solved: Solved


class HeldBody:
    """A body of voxels held at some of its nodes.

    Parameters
    ----------
    moduli : Moduli, or (21, nz, ny, nx) float
        Of its voxels; 0 in the void.
    edges : (hx, hy, hz)
        Of a voxel.
    fixed : (3, nz + 1, ny + 1, nx + 1) bool
        Displacements that are given. Each piece of the solid must be held, or else loads on it have no answer.
    dtype : float32 or float64
    """

    def __init__(
        self, moduli: Moduli | NDArray[Any], edges: tuple[float, float, float], fixed: Bools, dtype: Any
    ) -> None:
        def with_margin(values: NDArray[Any]) -> NDArray[Any]:
            return np.pad(values, [(0, 0)] * (values.ndim - 3) + [(0, 1)] * 3)

        self.fixed = fixed
        general = not isinstance(moduli, Moduli)
        given: Any = with_margin(moduli) if general else moduli.each(with_margin)  # type: ignore[arg-type,union-attr]
        samples = np.zeros((21, 0))
        if general:
            flat = given.reshape(21, -1)
            solid = np.flatnonzero(flat[0])
            samples = flat[:, solid[:: max(1, len(solid) // _SAMPLED)]].astype(np.float64)
        make: Any = GeneralLevel if general else ElasticLevel
        self.build(
            given, edges, lambda values, h: make(values, h, dtype),
            lambda values, h: _MARGIN * largest_of(samples, h) if general else largest_eigenvalue(values, h),
            lambda values, mean: np.stack([mean(one) for one in values]) if general else values.each(mean),
            SCRATCH_ROWS, planar=True, stretch=STRETCH,
        )  # fmt: skip

    def build(
        self, given: Any, edges: tuple[float, float, float], make: Callable[..., Any], largest: Callable[..., float],
        each: Callable[..., Any], scratch_rows: int, **options: Any,
    ) -> None:  # fmt: skip
        """Make all grids of voxels with a margin of void, held where `fixed` says: for other equations than elasticity.

        Parameters
        ----------
        given : any
            What the finest grid is made of.
        edges : (hx, hy, hz)
        make : callable
            From what is given, and edges, to a level that can `hold` its nodes.
        largest : callable
            From the same to a bound of the eigenvalues over the diagonal.
        each : callable
            From what is given, and a function that takes the mean of blocks of an array, to that of the next grid.
        scratch_rows : int
        **options
            Of `Hierarchy.of`.
        """
        levels: list[Any] = []
        held, bound = self.fixed, 0.0
        while True:
            levels.append(make(given, edges))
            levels[-1].hold(held)
            bound = max(bound, largest(given, edges))
            fine = levels[-1].shape
            if (shape := coarser(fine, edges, open_ends=True)) is None:
                break
            x, y, z = (h if n == m else 2 * h for h, n, m in zip(edges, fine[::-1], shape[::-1], strict=True))
            edges = (x, y, z)

            def mean(values: NDArray[Any], shape: tuple[int, int, int] = shape) -> NDArray[Any]:
                return coarsened(values, shape, open_ends=True)

            given = each(given, mean)
            held = _held_below(held, shape)
        transfers = [NodalTransfer.between(a.shape, b.shape, open_ends=True) for a, b in pairwise(levels)]
        self.hierarchy = Hierarchy.of(levels, scratch_rows, bound, transfers=transfers, twice=True, **options)
        self._work = self.hierarchy.workspace()
        self._free = copy(levels[0])
        self._free.hold(np.zeros_like(self.fixed))

    def _correct(self, b: NDArray[Any], u: NDArray[Any], p: NDArray[Any]) -> tuple[float, float]:
        """`correct_locally`; only voxels of one Poisson's ratio, the resolved ones, have what is slow."""
        level = self.hierarchy.levels[0]
        if type(level) is not ElasticLevel:
            return 0.0, 0.0
        nz, ny, nx = level.shape
        moduli = level.moduli.each(lambda values: values[: nz - 1, : ny - 1, : nx - 1])
        return correct_locally(
            moduli, self.fixed, level.weight.reshape(level.shape),
            lambda some, held: HeldBody(some, level.edges, held, self._free.c.dtype), b, u, p,
        )  # fmt: skip

    def forces(self, u: NDArray[Any]) -> NDArray[Any]:
        """Nodal forces of displacements, those held included: less the loads they are the reactions."""
        out = np.empty(u.size, self._free.c.dtype)
        v = np.ascontiguousarray(u.reshape(-1), out.dtype)
        self._free.apply(APPLY, v, v, out, self._work)
        return out.reshape(u.shape)

    def solve(
        self,
        loads: NDArray[Any] | NodalValues, given: NDArray[Any] | NodalValues | None = None,
        start: NDArray[Any] | None = None, *, residual: float = 1e-6, energy: float = 0.0, iterations: int = 1000,
        stored: float = 0.0, local: bool = True,
    ) -> Loaded:  # fmt: skip
        """Displacements under nodal forces.

        Parameters
        ----------
        loads : (3, nz + 1, ny + 1, nx + 1), or NodalValues
            Nodal forces.
        given : the same, optional
            Displacements where they are held; zero if omitted.
        start : (3, nz + 1, ny + 1, nx + 1), optional
            A guess, such as the solution for a body of nearly the same stiffness.
        residual : float
            Part of the loads, and of what given displacements cause, that may be left over.
        energy : float
            ... or estimated relative error of the energy that the iteration gains, or of what is left of `stored` or of
            what given displacements store.
        iterations : int
            Of all restarts together.
        stored : float
            Twice the energy of the guess, without loads.
        local : bool
            Whether few small places where the iteration is slow are solved by themselves; see `local_solves`.

        Raises
        ------
        ArithmeticError
            If the preconditioner breaks down, as rounding makes it where nothing holds a piece.
        """
        dtype, fixed = self._free.c.dtype, self.fixed.reshape(-1)
        pulled = loads if isinstance(loads, NodalValues) else NodalValues.of(loads)
        moved = given if isinstance(given, NodalValues | None) else NodalValues.of(np.where(self.fixed, given, 0))
        b, p, u = np.empty(fixed.size, dtype), np.empty(fixed.size, dtype), np.zeros(fixed.size, dtype)
        if moved is not None:
            u[moved.at] = moved.values

        def left_over(u: NDArray[Any]) -> float:
            b[:] = 0
            if u.any():
                self._free.apply(APPLY, u, u, b, self._work)
                np.negative(b, out=b)
            np.add.at(b, pulled.at, pulled.values.astype(dtype))
            b[fixed] = 0
            return float(np.sqrt(dot(b, b)))

        if moved is not None and start is None:
            # a step at the nodes that are moved stores far more than what is left in the end, of which errors are parts
            self._free.apply(APPLY, u, u, b, self._work)
            stored = dot(u, b)
        whole = first = left_over(u)
        # measured against what there is without the guess; where nothing pulls, nothing moves
        if start is not None and whole:
            np.copyto(u, start.reshape(-1), where=~fixed, casting="same_kind")
            first = left_over(u)
        floor = max(_FLOOR * stored, 1e-300)
        done, error, converged = 0, np.inf, whole == 0 or first <= residual * whole
        for _ in range(_RESTARTS):
            if converged or done >= iterations:
                break
            stop = Stop(residual * whole / first, energy, iterations - done)
            step = np.empty_like(u) if u.any() else u  # large bodies have no room for another vector
            found = solve(
                self.hierarchy, b, step, p, self._work, stop, stored, floor, correct=self._correct if local else None
            )
            done += found.iterations
            if not found.definite:
                if not self.hierarchy.twice:
                    raise ArithmeticError("the preconditioner is not positive definite")
                # a cycle that visits coarse grids once, and corrects by no more than they say, always is
                self.hierarchy = replace(self.hierarchy, twice=False, stretch=1.0)
                if step is u:
                    u[:] = 0
                left_over(u)
                continue
            if step is not u:
                u += step
            stored = found.energy if stored else 0.0
            error, last, first = found.error, first, left_over(u)
            converged = first <= residual * whole or 0 < energy >= error
            if first > 0.5 * last:  # rounding
                break
        part = first / whole if whole else 0.0
        return Loaded(u.reshape(self.fixed.shape), Solved(done, part, 0.0, float(error), bool(converged), True))


@jit
def _mean_and_second(u: NDArray[Any], solid: Bools, strains: F64, weights: F64, mean: F64, second: F64) -> None:
    nz, ny, nx = solid.shape
    v, e = np.empty(24), np.empty(6)
    at = 0
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                if not solid[k, j, i]:
                    continue
                for a in range(8):
                    for c in range(3):
                        v[3 * a + c] = u[c, k + (a >> 2), j + (a >> 1 & 1), i + (a & 1)]
                for m in range(7):
                    for r in range(6):
                        e[r] = 0.0
                        for n in range(24):
                            e[r] += strains[m, r, n] * v[n]
                        if m == 0:
                            mean[r, at] = e[r]
                    q = 0
                    for r in range(6):
                        for t in range(r, 6):
                            second[q, at] += weights[m] * e[r] * e[t] * (1.0 if r == t else 2.0)
                            q += 1
                at += 1


def strains_of(u: NDArray[Any], solid: Bools, edges: tuple[float, float, float]) -> tuple[F64, F64]:
    """Mean strains (6, m) of the solid voxels, in C order of (z, y, x), and what their energy is linear in, (21, m).

    Twice the energy of a voxel is the sum of the products of its 21 constants with the latter, so that these are also
    the derivatives of twice the energy by the constants, at fixed displacements.
    """
    count = int(np.count_nonzero(solid))
    mean, second = np.empty((6, count)), np.zeros((21, count))
    _mean_and_second(u, solid, *brick_strains(edges), mean, second)
    return mean, second


@jit
def von_mises(u: NDArray[Any], mu: NDArray[Any], edges: F64, out: F32) -> None:
    """Von Mises stress of the mean strain of isotropic voxels (nz, ny, nx), from their shear moduli."""
    nz, ny, nx = mu.shape
    g = np.empty((3, 3))
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                if mu[k, j, i] == 0:
                    out[k, j, i] = 0
                    continue
                for c in range(3):
                    for d in range(3):
                        g[c, d] = 0.0
                    for a in range(8):
                        value = np.float64(u[c, k + (a >> 2), j + (a >> 1 & 1), i + (a & 1)])
                        for d in range(3):
                            g[c, d] += value if a >> d & 1 else -value
                    for d in range(3):
                        g[c, d] /= 4 * edges[d]
                normal = (g[0, 0] - g[1, 1]) ** 2 + (g[1, 1] - g[2, 2]) ** 2 + (g[2, 2] - g[0, 0]) ** 2
                shear = (g[0, 1] + g[1, 0]) ** 2 + (g[0, 2] + g[2, 0]) ** 2 + (g[1, 2] + g[2, 1]) ** 2
                out[k, j, i] = 2 * mu[k, j, i] * np.sqrt(0.5 * normal + 0.75 * shear)
