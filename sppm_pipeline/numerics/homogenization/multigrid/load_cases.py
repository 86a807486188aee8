"""The load cases of a cell problem, and the energies that are its effective property."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.homogenization.multigrid.hierarchy import Hierarchy, Workspace
from sppm_pipeline.numerics.homogenization.multigrid.pcg import Solved, Stop, solve
from sppm_pipeline.numerics.homogenization.multigrid.vectors import dot

_AGREEMENT = 1e-3
"""Relative difference of energies that rounding may cause."""


def load_cases(
    hierarchy_of: Callable[[np.dtype[Any], bool], Hierarchy],
    energies: Callable[[Hierarchy, NDArray[Any], int], NDArray[np.float64]],
    mean: NDArray[np.float64],
    stop: Stop,
    floor: float,
    dtype: np.dtype[Any],
    threads: int,
) -> tuple[NDArray[np.float64], tuple[Solved, ...], str]:
    """Solve one load case for each constant load, and return the mutual energies of the solutions over the volume.

    If the damping or the visits of the cycle turn out to be too bold, all is done again without risk; if rounding takes
    over, in double precision.

    Parameters
    ----------
    hierarchy_of : callable
        From a precision, and whether to take no risks, to the grids.
    energies : callable
        From the grids, the solutions and a number of threads to the (m, m) matrix of energies.
    mean : (m,)
        Energies over the volume of the constant loads alone.
    stop : Stop
    floor : float
        Part of `mean` below which no digits are asked for.
    dtype : dtype
    threads : int

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
        level = hierarchy.levels[0]
        volume = float(np.prod(level.edges)) * level.weight.size
        fields = np.empty((len(mean), level.components * level.weight.size), attempt)
        solved = _solve_all(hierarchy, fields, volume * mean, stop, floor, threads)
        if not all(case.definite for case in solved):
            continue
        matrix = energies(hierarchy, fields, threads)
        # energies as the iterations kept count of them: if rounding took over, they differ
        counted = np.array([case.energy for case in solved]) / volume
        slack = (_AGREEMENT + stop.energy) * np.abs(counted) + 100 * np.finfo(attempt).eps * mean
        if (np.abs(counted - np.diag(matrix)) <= slack).all():
            return matrix, solved, attempt.name
    raise ArithmeticError("the iteration does not converge, not even in double precision")


def _solve_all(
    hierarchy: Hierarchy,
    fields: NDArray[Any],
    energy: NDArray[np.float64],
    stop: Stop,
    floor: float,
    threads: int,
) -> tuple[Solved, ...]:
    level = hierarchy.levels[0]
    count, length = fields.shape
    spare: list[tuple[Workspace, NDArray[Any], NDArray[Any]]] = []

    def load_case(case: int) -> Solved:
        work, b, p = spare.pop() if spare else (hierarchy.workspace(), *np.empty((2, length), fields.dtype))
        level.forces(np.eye(count)[case], b, work)
        np.negative(b, out=b)
        if dot(b, b) <= level.rounding() ** 2 * length:
            b[:] = 0
        solved = solve(hierarchy, b, fields[case], p, work, stop, float(energy[case]), floor * float(energy[case]))
        spare.append((work, b, p))
        return solved

    if threads == 1:
        return tuple(load_case(case) for case in range(count))
    with ThreadPoolExecutor(min(threads, count)) as pool:
        return tuple(pool.map(load_case, range(count)))
