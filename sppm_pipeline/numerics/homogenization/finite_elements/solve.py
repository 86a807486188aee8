"""Conjugate gradients with algebraic multigrid, for singular systems and under linear constraints."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

COARSEST = 60
"""Unknowns of the coarsest grid; small enough that its dense solution never runs in several threads, whose number
would show in the last digits."""


class Solution(NamedTuple):
    """What the solver found.

    Attributes
    ----------
    values : (n,) float64
    residual : float
        Norm of what is left over that of the right-hand side.
    iterations : int
    """

    values: Vector
    residual: float
    iterations: int


def rigid_modes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Three translations and three rotations of points (n, 3): (3 n, 6)."""
    x, y, z = (points - points.mean(axis=0)).T
    modes = np.zeros((len(points), 3, 6))
    for axis in range(3):
        modes[:, axis, axis] = 1
    modes[:, 1, 3], modes[:, 2, 3] = -z, y
    modes[:, 0, 4], modes[:, 2, 4] = z, -x
    modes[:, 0, 5], modes[:, 1, 5] = -y, x
    return modes.reshape(-1, 6)


def multigrid(matrix: Any, modes: NDArray[np.float64]) -> Callable[[Vector], Vector]:
    """One V-cycle of smoothed aggregation as a preconditioner.

    Parameters
    ----------
    matrix : scipy.sparse.bsr_matrix, (3 n, 3 n)
        Symmetric, positive semidefinite.
    modes : (3 n, 6) float64
        Motions that cost little energy.

    References
    ----------
    Vaněk, Mandel and Brezina 1996; PyAMG (Bell, Olson, Schroder and Southworth 2023).
    """
    import pyamg

    # PyAMG draws from NumPy's global generator while it estimates eigenvalues: it gets a fixed state, and what was
    # there before is put back.
    kept = np.random.get_state()  # noqa: NPY002
    np.random.seed(0)  # noqa: NPY002
    try:
        hierarchy = pyamg.smoothed_aggregation_solver(
            matrix,
            B=modes,
            strength=("symmetric", {"theta": 0.03}),
            smooth=("jacobi", {"omega": 4.0 / 3.0}),
            presmoother=("block_gauss_seidel", {"sweep": "symmetric"}),
            postsmoother=("block_gauss_seidel", {"sweep": "symmetric"}),
            max_coarse=COARSEST,
            coarse_solver="pinv",
        )
    finally:
        np.random.set_state(kept)  # noqa: NPY002
    operator = hierarchy.aspreconditioner(cycle="V")
    return lambda residual: operator.matvec(residual)


class Projector:
    """The orthogonal projection onto the displacements that fulfil ``constraints @ u = 0`` in each component.

    Constraints may repeat each other; what is left of such a repetition after factorization is removed by iterative
    refinement.

    Parameters
    ----------
    constraints : scipy.sparse matrix, (c, n)
        On one component of the displacement; all three fulfil the same.
    """

    def __init__(self, constraints: Any) -> None:
        from scipy.sparse import identity
        from scipy.sparse.linalg import splu

        self._rows = constraints.tocsr()
        self._columns = self._rows.T.tocsr()
        self._gram = (self._rows @ self._columns).tocsc()
        shift = 1e-10 * float(self._gram.diagonal().max())
        self._factor = splu(self._gram + shift * identity(self._gram.shape[0], format="csc"))

    def __call__(self, values: Vector) -> Vector:
        """Project (3 n,), the components of a node next to each other."""
        by_node = values.reshape(-1, 3)
        excess = self._rows @ by_node
        multipliers = self._factor.solve(excess)
        for _ in range(2):
            multipliers += self._factor.solve(excess - self._gram @ multipliers)
        projected: Vector = (by_node - self._columns @ multipliers).reshape(-1)
        return projected


def conjugate_gradients(
    matrix: Any,
    right: Vector,
    precondition: Callable[[Vector], Vector],
    project: Callable[[Vector], Vector] | None,
    tolerance: float,
    most: int,
) -> Solution:
    """Solve ``matrix x = right`` for a positive semidefinite matrix and a right-hand side in its range.

    Parameters
    ----------
    matrix : scipy.sparse matrix, (n, n)
    right : (n,) float64
    precondition : function
        Symmetric.
    project : function or None
        Projection onto the space that the solution is sought in.
    tolerance : float
        Of the residual's norm over that of the right-hand side.
    most : int
        Iterations after which the best so far is returned; its residual tells.
    """
    keep = project or (lambda values: values)
    x = np.zeros_like(right)
    residual = keep(right.copy())
    start = _norm(residual)
    if start == 0 or not start > 1e-14 * _norm(right):
        return Solution(x, 0.0, 0)
    z = keep(precondition(residual))
    direction, rz = z.copy(), _dot(residual, z)
    for iteration in range(1, most + 1):
        forward = keep(matrix @ direction)
        curvature = _dot(direction, forward)
        if not curvature > 0:  # rounding has eaten the direction: nothing more is to be had
            return Solution(x, _norm(residual) / start, iteration)
        step = rz / curvature
        x += step * direction
        residual -= step * forward
        share = _norm(residual) / start
        if share <= tolerance:
            return Solution(x, share, iteration)
        z = keep(precondition(residual))
        rz, before = _dot(residual, z), rz
        direction = z + (rz / before) * direction
    return Solution(x, _norm(residual) / start, most)


def _dot(a: Vector, b: Vector) -> float:
    # not numpy.dot: BLAS sums in as many parts as it has threads
    return float(np.einsum("i,i->", a, b))


def _norm(a: Vector) -> float:
    return float(np.sqrt(_dot(a, a)))
