"""Effective stiffness of a periodic cell of tetrahedra, by conjugate gradients with algebraic multigrid."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.tetrahedra.numerics.mortar import collocation, face_pairs, mortar
from sppm_pipeline.features.tetrahedra.numerics.tetrahedral_assembly import assemble
from sppm_pipeline.features.tetrahedra.numerics.tetrahedral_blocks import Blocks, Vectors
from sppm_pipeline.features.tetrahedra.numerics.tetrahedral_multigrid import aggregation, linear_below_quadratic
from sppm_pipeline.services.elastic.voigt import lame

_SPRINGS = 1.0
"""Stiffness of the springs of `tied` over the mean of the diagonal. Measured on a cell of the paper with quadratic
elements: 59 iterations; 79 and 98 with a tenth and ten times of it; 499 without any."""


class TetHomogenized(NamedTuple):
    """Effective stiffness and how it was computed."""

    stiffness: NDArray[np.float64]  # (6, 6), Voigt, engineering shear, of the whole box
    iterations: list[int]  # of the six load cases
    residuals: list[float]  # of the six load cases
    unknowns: int
    constraints: int  # rows that join opposite faces; 0 where nodes match
    solid: float  # volume of the mesh


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
    """Homogenize linear elasticity on a mesh of a periodic cell: nodes (n, 3), cells (m, 4) or (m, 10), box (2, 3).

    `young` and `poisson`, (m,), are those of each cell. For meshes whose opposite faces match, `representative`, (n,),
    is the node that stands for all periodic copies of each; None joins the faces by constraints, as `faces` says:
    "mortar" or "collocation". `face_tolerance` is how far nodes of a face may lie from the box, over its longest edge;
    `tolerance` the residual of each load case over its load, within a maximum number of `iterations`; `progress` is
    called with the number of load cases that are done. Michel, Moulinec and Suquet 1999 for the cell problem; the
    energy form makes the error of the stiffness that of the displacements squared.
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
    loads, mean, volume = built.loads, built.mean, built.volume
    # of displacements that fulfill the constraints both are the same, and one of them is enough to hold
    held = built.matrix if project is None else tied(built.matrix, joined)
    del built
    points, matrix = nodes[kept], Blocks(held)
    # quadratic elements have a coarse problem at hand: the straight tetrahedra of their corners
    if cells.shape[1] == 4:
        precondition = aggregation(held, rigid_modes(points), matrix)
    else:
        precondition = linear_below_quadratic(held, matrix, numbers[cells], points, rigid_modes)
    del held
    found = conjugate_gradients(matrix, -loads.T, precondition, project, tolerance, iterations, progress)
    u = np.ascontiguousarray(found.values.T)
    # energy of mean strain and fluctuation together: its error is that of the displacements squared
    forces = np.ascontiguousarray(matrix.product(found.values).T)
    work = np.einsum("in,jn->ij", u, loads)
    energy = mean + work + work.T + np.einsum("in,jn->ij", u, forces)
    stiffness = (energy + energy.T) / 2 / float(np.prod(box[1] - box[0]))
    return TetHomogenized(stiffness, found.iterations, found.residuals, 3 * len(kept), 3 * count, volume)


class Solution(NamedTuple):
    """Solutions and how accurate they are."""

    values: Vectors  # (n, 6)
    residuals: list[float]  # norm of each residual over that of the right-hand side
    iterations: list[int]


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


def tied(matrix: Any, constraints: Any) -> Any:
    """The matrix, bsr (3 n, 3 n), with springs between what constraints join: the same where they are fulfilled.

    Without them a preconditioner takes faces that are joined for free ones, which are much softer. `constraints`, (c,
    n), are those on one component of the displacement.
    """
    from scipy.sparse import bsr_matrix, diags

    squares = np.asarray(constraints.multiply(constraints).sum(axis=1)).reshape(-1)
    stiff = _SPRINGS * float(matrix.diagonal().mean())
    springs = (constraints.T @ diags(stiff / squares) @ constraints).tocsr()
    springs.sort_indices()
    blocks = springs.data[:, None, None] * np.eye(3)
    made = matrix + bsr_matrix((blocks, springs.indices, springs.indptr), shape=matrix.shape)
    made.sort_indices()
    return made


class Projector:
    """The orthogonal projection onto the displacements with ``constraints @ u = 0``, (c, n), in each component.

    Constraints may repeat each other; what is left of such a repetition after factorization is removed by iterative
    refinement.
    """

    def __init__(self, constraints: Any) -> None:
        from scipy.sparse import identity
        from scipy.sparse.linalg import splu

        self._rows = constraints.tocsr()
        self._columns = self._rows.T.tocsr()
        self._gram = (self._rows @ self._columns).tocsc()
        # constraints that repeat each other make the matrix singular, which LU factorization would divide by
        shift = 1e-10 * float(self._gram.diagonal().max())
        # as is usual for a symmetric matrix: two thirds of the factors, which are read at every solution
        order = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        self._factor = splu(self._gram + shift * identity(self._gram.shape[0], format="csc"), **order)

    def __call__(self, values: Vectors) -> Vectors:
        """Project (3 n, 6), the components of a node next to each other."""
        by_node = values.reshape(self._rows.shape[1], -1)
        excess = self._rows @ by_node
        # three columns at a time: SuperLU takes longer for more of them at once than for one group after the other
        groups = [np.ascontiguousarray(excess[:, at : at + 3]) for at in range(0, excess.shape[1], 3)]
        multipliers = np.concatenate([self._multipliers(group) for group in groups], axis=1)
        projected: Vectors = (by_node - self._columns @ multipliers).reshape(values.shape)
        return projected

    def _multipliers(self, excess: Vectors) -> Vectors:
        found: Vectors = self._factor.solve(excess)
        found += self._factor.solve(excess - self._gram @ found)
        return found


def conjugate_gradients(
    matrix: Blocks,
    right: Vectors,
    precondition: Callable[[Vectors], Vectors],
    project: Callable[[Vectors], Vectors] | None,
    tolerance: float,
    iterations: int,
    progress: Callable[[int], None] | None = None,
) -> Solution:
    """Solve ``matrix x = right`` for a positive semidefinite matrix and six right-hand sides (n, 6) in its range.

    Each has conjugate directions of its own, all take their steps together, and one that is done stands still.
    `precondition` is symmetric; `project`, if any, goes onto the space that the solutions are sought in. `tolerance` is
    that of the residual's norm over that of the right-hand side; after the maximum number of `iterations` the solution
    so far is returned with its residual. `progress` is called with the number of right-hand sides that are done.
    """
    keep = project or (lambda values: values)
    right = np.ascontiguousarray(right)
    x = np.zeros_like(right)
    residual = keep(right.copy())
    start = _norms(residual)
    open_ = (start > 0) & (start > 1e-14 * _norms(right))
    scale = np.where(open_, start, 1.0)
    shares, counts = open_.astype(float), np.zeros(len(start), int)
    direction, rz = np.zeros_like(right), np.ones(len(start))
    for iteration in range(1, iterations + 1):
        if not open_.any():
            break
        z = keep(precondition(residual))
        before, rz = rz, _dots(residual, z)
        # divided where a case goes on only: what is done may have nothing left
        direction *= np.divide(rz, before, out=np.zeros_like(rz), where=open_)
        direction += z
        forward = keep(matrix.product(direction))
        curvature = _dots(direction, forward)
        counts[open_] = iteration
        going = open_ & (curvature > 0)  # else lost to rounding: no further progress is possible
        step = np.divide(rz, curvature, out=np.zeros_like(rz), where=going)
        x += step * direction
        residual -= step * forward
        shares = np.where(going, _norms(residual) / scale, shares)
        left = going & (shares > tolerance)
        if progress is not None and left.sum() < open_.sum():
            progress(int(len(left) - left.sum()))
        open_ = left
    return Solution(x, shares.tolist(), counts.tolist())


def _dots(a: Vectors, b: Vectors) -> NDArray[np.float64]:
    # not numpy.dot: BLAS sums in as many parts as it has threads
    sums: NDArray[np.float64] = np.einsum("ij,ij->j", a, b)
    return sums


def _norms(a: Vectors) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(_dots(a, a)))
