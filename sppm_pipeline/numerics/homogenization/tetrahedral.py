"""Effective stiffness of a periodic cell of tetrahedra, by conjugate gradients with algebraic multigrid."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.homogenization.mortar import collocation, face_pairs, mortar
from sppm_pipeline.numerics.homogenization.stiffness.voigt import lame
from sppm_pipeline.numerics.homogenization.tetrahedral_assembly import assemble

Vector = NDArray[np.float64]

COARSEST = 60
"""Unknowns of the coarsest grid; small enough that its dense solution never runs in several threads, whose number
would show in the last digits."""

RIGID = 1e-11
"""Eigenvalues of the coarsest matrix that count as zero, over its largest. Translations have rounding errors there
(1.4e-14 was seen on a mesh of 148 000 nodes, where the smallest of an elastic mode was 0.4) that may pass the cut-off
which SciPy's pseudoinverse has by itself; divided by them, translations grow until the solution is lost."""


class TetHomogenized(NamedTuple):
    """Effective stiffness and how it was computed.

    Attributes
    ----------
    stiffness : (6, 6) float64
        Voigt, engineering shear, of the whole box.
    iterations : list of 6 ints
    residuals : list of 6 floats
    unknowns : int
    constraints : int
        Rows that join opposite faces; 0 where nodes match.
    solid : float
        Volume of the mesh.
    """

    stiffness: NDArray[np.float64]
    iterations: list[int]
    residuals: list[float]
    unknowns: int
    constraints: int
    solid: float


def homogenize_tetrahedra(
    nodes: NDArray[np.float64],
    cells: NDArray[np.int32],
    box: NDArray[np.float64],
    young: NDArray[np.float64],
    poisson: NDArray[np.float64],
    representative: NDArray[np.int64] | None,
    *,
    faces: str = "mortar",
    face_tolerance: float = 1e-6,
    tolerance: float = 1e-8,
    iterations: int = 2000,
    progress: Callable[[int], None] | None = None,
) -> TetHomogenized:
    """Homogenize linear elasticity on a mesh of a periodic cell.

    Parameters
    ----------
    nodes : (n, 3) float64
    cells : (m, 4) or (m, 10) int32
    box : (2, 3) float64
        Corners of the periodic cell.
    young, poisson : (m,) float64
        Of each cell.
    representative : (n,) int64 or None
        For meshes whose opposite faces match: for each node the one that stands for all its periodic copies. None joins
        the faces by constraints.
    faces : {"mortar", "collocation"}
        How faces that do not match are joined.
    face_tolerance : float
        How far nodes of a face may lie from the box, over the longest edge of the box.
    tolerance : float
        Residual of each load case over its load.
    iterations : int
        Maximum number of iterations of one load case.
    progress : function, optional
        Called with the number of load cases that are done.

    References
    ----------
    Michel, Moulinec and Suquet 1999 for the cell problem; the energy form makes the error of the stiffness that of the
    displacements squared.
    """
    used = np.zeros(len(nodes), bool)
    used[cells] = True
    stand_in = np.arange(len(nodes)) if representative is None else np.asarray(representative)
    kept, unknowns = np.unique(stand_in[used], return_inverse=True)
    numbers = np.zeros(len(nodes), np.int64)
    numbers[used] = unknowns
    # one number for all nodes of the mesh: those that no cell uses take that of the first, and nothing refers to them
    built = assemble(nodes, cells, numbers, *lame(young, poisson))
    project, count = None, 0
    if representative is None:
        from scipy.sparse import vstack

        join = {"mortar": mortar, "collocation": collocation}[faces]
        reach = face_tolerance * float((box[1] - box[0]).max())
        rows = [join(nodes, pair) for pair in face_pairs(nodes, cells, box, reach)]
        joined = vstack([part[:, kept] for part in rows])
        count = joined.shape[0]
        if count:
            project = Projector(joined)
    precondition = multigrid(built.matrix, rigid_modes(nodes[kept]))
    fields, counts, residuals = [], [], []
    for number, load in enumerate(built.loads):
        found = conjugate_gradients(built.matrix, -load, precondition, project, tolerance, iterations)
        fields.append(found.values)
        counts.append(found.iterations)
        residuals.append(found.residual)
        if progress is not None:
            progress(number + 1)
    u = np.array(fields)
    forces = np.array([built.matrix @ field for field in fields])
    work = np.einsum("in,jn->ij", u, built.loads)
    energy = built.mean + work + work.T + np.einsum("in,jn->ij", u, forces)
    stiffness = (energy + energy.T) / 2 / float(np.prod(box[1] - box[0]))
    return TetHomogenized(stiffness, counts, residuals, 3 * len(kept), 3 * count, built.volume)


class Solution(NamedTuple):
    """A solution and how accurate it is.

    Attributes
    ----------
    values : (n,) float64
    residual : float
        Norm of the residual over that of the right-hand side.
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
        Modes of little energy.

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
            # the factor of Vaněk, Mandel and Brezina, over the largest eigenvalue
            smooth=("jacobi", {"omega": 4.0 / 3.0}),
            presmoother=("block_gauss_seidel", {"sweep": "symmetric"}),
            postsmoother=("block_gauss_seidel", {"sweep": "symmetric"}),
            max_coarse=COARSEST,
            coarse_solver=("pinv", {"rtol": RIGID}),
        )
    finally:
        np.random.set_state(kept)  # noqa: NPY002
    operator = hierarchy.aspreconditioner(cycle="V")
    return lambda residual: operator.matvec(residual)


class Projector:
    """The orthogonal projection onto the displacements with ``constraints @ u = 0`` in each component.

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
    iterations: int,
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
    iterations : int
        Maximum number of iterations; the solution so far is returned with its residual.
    """
    keep = project or (lambda values: values)
    x = np.zeros_like(right)
    residual = keep(right.copy())
    start = _norm(residual)
    if start == 0 or not start > 1e-14 * _norm(right):
        return Solution(x, 0.0, 0)
    z = keep(precondition(residual))
    direction, rz = z.copy(), _dot(residual, z)
    for iteration in range(1, iterations + 1):
        forward = keep(matrix @ direction)
        curvature = _dot(direction, forward)
        if not curvature > 0:  # lost to rounding: no further progress is possible
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
    return Solution(x, _norm(residual) / start, iterations)


def _dot(a: Vector, b: Vector) -> float:
    # not numpy.dot: BLAS sums in as many parts as it has threads
    return float(np.einsum("i,i->", a, b))


def _norm(a: Vector) -> float:
    return float(np.sqrt(_dot(a, a)))
