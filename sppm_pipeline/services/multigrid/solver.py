"""Conjugate gradients with a multigrid cycle as preconditioner, for all load cases of a cell problem.

An iteration stops on the residual, or on the estimated energy that is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.multigrid.hierarchy import Body, Hierarchy, PlanarLevel, Workspace
from sppm_pipeline.services.multigrid.rows import APPLY
from sppm_pipeline.services.multigrid.vectors import dot, step, turn

_ROUNDED = 1000
"""Rounding errors of restricted residuals are below so many times the precision; at ten times as many, no start of the
cells that were tried would be another."""

_AGREEMENT = 1e-3
"""Relative difference of energies that rounding may cause."""

_SPANS = (1, 2, 4, 8, 16)
"""The gains of so many iterations are compared with those of as many before; the slowest fall counts."""

_FASTEST, _SLOWEST = 0.2, 0.97
"""Bounds of the fall from one iteration to the next: the first gains fall steeply and promise too much."""

CORRECTED = 12
"""Iterations after which a caller may correct what is slow. In cubes of 8^3 cells of the paper slow places stand out
after 12 iterations at porosity 0.55, after 12 or 24 at 0.72; what has none is often done by then."""

WORTH = 5.0
"""Estimated error over that which is allowed from which on it is: it costs as much as some six iterations."""

_SAFETY = 4.0
"""Measured: on open foams, lattices and random blobs full of hinges the true error stays below the estimate."""


class Stop(NamedTuple):
    """When an iteration ends.

    Attributes
    ----------
    residual : float
        ... ends it when the residual is this part of the right-hand side; 0 for never.
    energy : float
        ... ends it when the remaining error is this part of the energy; 0 for never.
    iterations : int
        ... ends it in any case.
    """

    residual: float
    energy: float
    iterations: int


class Solved(NamedTuple):
    """The outcome of an iteration.

    Attributes
    ----------
    iterations : int
    residual : float
        Over the right-hand side, 2-norm, as updated by the iteration.
    energy : float
        Of the solution.
    error : float
        Estimated relative error of that.
    converged : bool
    definite : bool
        False if the preconditioner turned out not to be positive definite; then the solution is useless.
    """

    iterations: int
    residual: float
    energy: float
    error: float
    converged: bool
    definite: bool


class Measure(Protocol):
    """Consumer of the solutions of the load cases of one cell."""

    def target(self, case: int) -> NDArray[Any] | None:
        """Array to write the solution of a load case to; None if it is not needed after `record`."""
        ...

    def keep(self, case: int, u: NDArray[Any]) -> None:
        """Keep what later load cases need of a solution."""
        ...

    def record(self, case: int, u: NDArray[Any], spare: NDArray[Any], work: Workspace) -> None:
        """Measure a solution, after all cases before it have been kept; `spare` is scratch of its length."""
        ...

    def energies(self, threads: int) -> F64:
        """Mutual energies of all load cases over the volume, (m, m)."""
        ...


def solve(
    hierarchy: Hierarchy,
    b: NDArray[Any],
    u: NDArray[Any],
    p: NDArray[Any],
    work: Workspace,
    stop: Stop,
    energy: float,
    floor: float,
    nested: int = 0,
    correct: Callable[[NDArray[Any], NDArray[Any], NDArray[Any]], tuple[float, float]] | None = None,
) -> Solved:
    """Solve ``K u = b`` from zero, or from the solution of a coarser grid.

    Each iteration lowers the energy ``energy - b . u`` by a known amount, and the sum of all amounts that are still to
    come is its error (Hestenes and Stiefel). What is to come is estimated from the last amounts and how they fell, so
    that slow convergence makes the iteration wait longer; unlike the bounds of Meurant, Papez and Tichý ("Accurate
    error estimation in CG", 2021) this needs no delay, but is no bound.

    Parameters
    ----------
    hierarchy : Hierarchy
    b : flat
        Right-hand side; becomes the residual.
    u : flat
        Receives the solution.
    p : flat
        Scratch of the same length.
    work : Workspace
    stop : Stop
    energy : float
        Energy of ``u = 0``, from which `Stop.energy` is measured; 0 for a force alone, whose energy is negative.
    floor : float
        Energies below this count as this, so that an energy of zero is reached at all.
    nested : int
        Iterations on each coarser grid, for a start from its solution; 0 to start from zero.
    correct : callable, optional
        Called after every `CORRECTED` iterations with the residual, the solution and the last direction: it may change
        the first two, and returns what this gains, 0 if nothing was changed, and what it leaves where it changed them:
        twice the energies.
    """
    level = hierarchy.levels[0]
    u[:] = 0
    start = dot(b, b)
    if start == 0:
        return Solved(0, 0.0, energy, 0.0, True, True)
    gains: list[float] = []
    rounding = 4 * float(np.finfo(b.dtype).eps)
    rr, error, left = start, math.inf, 0.0
    if nested and len(hierarchy.levels) > 2:
        gain, rr = _nested_start(hierarchy, b, u, p, work, nested, rr)
        energy -= gain
    z, rz = hierarchy.cycle(b, work)
    p[:] = z
    pq = level.apply(APPLY, p, p, work.z[0], work)
    for iteration in range(1, stop.iterations + 1):
        q = work.z[0]
        if not (rz > 0 and pq > 0 and math.isfinite(rz) and math.isfinite(pq)):
            return Solved(iteration, math.sqrt(rr / start), energy, error, False, False)
        alpha = rz / pq
        rr = step(u, b, p, q, alpha)
        gains.append(alpha * rz)
        energy -= gains[-1]
        error = (remaining(gains) + left) / max(abs(energy), floor)
        reached = rr <= start * stop.residual**2 or error <= stop.energy
        # what is left is rounding: the energy, of second order in it, is exact
        if reached or rr <= start * rounding**2:
            return Solved(iteration, math.sqrt(rr / start), energy, error, reached or stop.energy > 0, True)
        if iteration == stop.iterations:
            break
        if correct is not None and iteration % CORRECTED == 0 and error > WORTH * stop.energy:
            gain, left = correct(b, u, p)
            if gain:
                # directions up to here are conjugate to what is new no more: the iteration begins again from there
                energy -= gain
                gains.clear()
                z, rz = hierarchy.cycle(b, work)
                p[:] = z
                pq = level.apply(APPLY, p, p, work.z[0], work)
                continue
        z, after = hierarchy.cycle(b, work)
        # Fletcher and Reeves: the preconditioner is the same in all iterations and symmetric
        pq = _turn_apply(hierarchy, z, after / rz, p, work)
        rz = after
    return Solved(stop.iterations, math.sqrt(rr / start), energy, error, False, True)


def _turn_apply(hierarchy: Hierarchy, z: NDArray[Any], beta: float, p: NDArray[Any], work: Workspace) -> float:
    """The next direction ``p = z + beta p``, and its forces, written to ``work.z[0]``; returns their product."""
    level = hierarchy.levels[0]
    if hierarchy.planar:
        return cast(PlanarLevel, level).turn_apply(z, beta, p, work)
    turn(z, beta, p)
    return level.apply(APPLY, p, p, work.z[0], work)


def _nested_start(
    hierarchy: Hierarchy, b: NDArray[Any], u: NDArray[Any], p: NDArray[Any], work: Workspace, iterations: int, rr: float
) -> tuple[float, float]:
    """Set `u` to the solution on the next coarser grid, as far as that lowers the energy.

    Coarse grids are stiffer than they should be; the best multiple of their solution makes up for most of it.

    Returns
    -------
    gain : float
        Of energy.
    rr : float
        Square of the residual, which `b` becomes.
    """
    coarse, below = hierarchy.below(), work.below()
    length = len(below.z[0])
    hierarchy.transfers[0].restrict(b, work.r[1], work.line)
    if dot(work.r[1], work.r[1]) <= (_ROUNDED * float(np.finfo(b.dtype).eps)) ** 2 * rr:
        return 0.0, rr  # rounding of a load that this grid can't have, such as a shear across one voxel
    found = solve(coarse, work.r[1], work.sum[1], p[:length], below, Stop(0.0, 0.0, iterations), 0.0, 1.0, iterations)
    if not found.definite:
        return 0.0, rr  # a start is a bonus; the cycle of the finest grid may still work
    p[:] = 0
    hierarchy.transfers[0].interpolate_add(work.sum[1], p, work.line)
    q = work.z[0]
    pq, pb = hierarchy.levels[0].apply(APPLY, p, p, q, work), dot(p, b)
    if not (pb > 0 and pq > 0 and math.isfinite(pb) and math.isfinite(pq)):
        return 0.0, rr
    return pb**2 / pq, step(u, b, p, q, pb / pq)


def remaining(gains: list[float]) -> float:
    """Estimate of what all further iterations will gain."""
    done = len(gains)
    if done < 3:
        return math.inf
    worst = 0.0
    for span in _SPANS:
        if 2 * span > done:
            break
        if span == 1 and done > 5:
            # single gains go up and down
            continue
        late = sum(gains[-span:])
        fall = min(max(late / sum(gains[-2 * span : -span]), _FASTEST**span), _SLOWEST**span)
        worst = max(worst, late * fall / (1 - fall))
    return _SAFETY * worst


def load_cases(
    hierarchy_of: Callable[[np.dtype[Any], bool], Hierarchy],
    measure_of: Callable[[Hierarchy], Measure],
    mean: F64,
    stop: Stop,
    floor: float,
    dtype: np.dtype[Any],
    threads: int,
    nested: int = 0,
) -> tuple[F64, tuple[Solved, ...], str]:
    """Solve one load case for each constant load, and return the mutual energies of the solutions over the volume.

    If the preconditioner turns out not to be positive definite, all is solved again with a safe one; if rounding
    dominates, in double precision.

    Parameters
    ----------
    hierarchy_of : callable
        From a precision, and whether the cycle has to be safe, to the grids.
    measure_of : callable
        From the grids to what measures the solutions.
    mean : (m,)
        Energies over the volume of the constant loads alone.
    stop : Stop
    floor : float
        Part of `mean` below which no accuracy is requested.
    dtype : dtype
    threads : int
    nested : int
        As of `solve`.

    Returns
    -------
    matrix : (m, m) float64
    solved : tuple of m Solved
    precision : str

    Raises
    ------
    ArithmeticError
        If the iteration fails in double precision, too.
    """
    for attempt, safe in ((dtype, False), (dtype, True), (np.dtype(np.float64), True)):
        hierarchy = hierarchy_of(attempt, safe)
        level = cast(Body, hierarchy.levels[0])
        volume = float(np.prod(level.edges)) * level.weight.size
        measure = measure_of(hierarchy)
        solved = _solve_all(hierarchy, measure, volume * mean, stop, floor, threads, nested)
        if not all(case.definite for case in solved):
            continue
        matrix = measure.energies(threads)
        # energies as the iterations kept count of them: if rounding took over, they differ by more than matters
        counted = np.array([case.energy for case in solved]) / volume
        slack = (_AGREEMENT + stop.energy) * np.abs(counted) + (floor + 100 * np.finfo(attempt).eps) * mean
        if (np.abs(counted - np.diag(matrix)) <= slack).all():
            return matrix, solved, attempt.name
    raise ArithmeticError("the iteration does not converge, not even in double precision")


def _solve_all(
    hierarchy: Hierarchy, measure: Measure, energy: F64, stop: Stop, floor: float, threads: int, nested: int
) -> tuple[Solved, ...]:
    level = cast(Body, hierarchy.levels[0])
    count, length = len(energy), level.components * level.weight.size
    spare: list[tuple[Workspace, list[NDArray[Any]]]] = []
    # each case is measured against those before it, in whatever order they end
    kept, failed = [Event() for _ in range(count)], Event()

    def load_case(case: int) -> Solved:
        solved = Solved(0, 1.0, float(energy[case]), math.inf, False, False)
        if failed.is_set():
            return solved
        try:
            try:
                work, vectors = spare.pop()
            except IndexError:  # another thread may take the last one at any time
                work, vectors = hierarchy.workspace(), []
            target = measure.target(case)
            while len(vectors) < (2 if target is not None else 3):
                vectors.append(np.empty(length, level.weight.dtype))
            b, p = vectors[:2]
            u = vectors[2] if target is None else target
            level.forces(np.eye(count)[case], b, work)
            np.negative(b, out=b)
            # layers load no node along their normal: what is left is rounding, and has no solution
            if dot(b, b) <= level.rounding() ** 2 * length:
                b[:] = 0
            known = float(energy[case])
            solved = solve(hierarchy, b, u, p, work, stop, known, floor * known, nested)
            # kept before the wait below, so that no two cases wait for each other
            if solved.definite:
                measure.keep(case, u)
        finally:
            if not solved.definite:
                failed.set()
            kept[case].set()
        for earlier in kept[:case]:
            earlier.wait()
        if not failed.is_set():
            measure.record(case, u, b, work)
        spare.append((work, vectors))
        return solved

    if threads == 1:
        return tuple(load_case(case) for case in range(count))
    with ThreadPoolExecutor(min(threads, count)) as pool:
        return tuple(pool.map(load_case, range(count)))
