"""Effective stiffness of a periodic cell of tetrahedra, by conjugate gradients with algebraic multigrid."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.numerics import F64, I32, I64
from sppm_tetrahedra.numerics.mortar import collocation, face_pairs, mortar
from sppm_tetrahedra.numerics.quality import EDGES
from sppm_tetrahedra.numerics.tetrahedral_blocks import CASES, Blocks, Vectors, assemble

COARSEST = 60
"""Unknowns of the coarsest grid; small enough that its dense solution never runs in several threads, whose number
would show in the last digits."""

RIGID = 1e-11
"""Eigenvalues of the coarsest matrix that count as zero, over its largest. Translations have rounding errors there
(1.4e-14 was seen on a mesh of 148 000 nodes, where the smallest of an elastic mode was 0.4) that may pass the cut-off
which SciPy's pseudoinverse has by itself; divided by them, translations grow until the solution is lost."""


def aggregation(matrix: Any, modes: F64, blocks: Blocks | None = None) -> Callable[[Vectors], Vectors]:
    """One V-cycle of smoothed aggregation as a preconditioner of residuals (3 n, 6).

    `matrix` is a bsr_matrix, (3 n, 3 n), symmetric and positive semidefinite, `blocks` the same if it has been made,
    and `modes`, (3 n, 6), are modes of little energy. Vaněk, Mandel and Brezina 1996; PyAMG (Bell, Olson, Schroder and
    Southworth 2023).
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
    finest, below = hierarchy.levels[0], hierarchy.levels[1:]
    rest = pyamg.MultilevelSolver(below or [finest], hierarchy.coarse_solver).aspreconditioner(cycle="V")

    def columns(residuals: Vectors) -> Vectors:
        return np.stack([rest.matvec(residuals[:, case].copy()) for case in range(CASES)], axis=1)

    return two_levels(blocks or Blocks(matrix), finest.P, columns) if below else columns


def linear_below_quadratic(
    matrix: Any, blocks: Blocks, cells: I64, points: F64, modes: Callable[[Vectors], Vectors]
) -> Callable[[Vectors], Vectors]:
    """A preconditioner of quadratic elements, whose coarse space are the linear elements on the same mesh.

    `matrix` is a bsr_matrix, (3 n, 3 n), symmetric and positive semidefinite, `blocks` the same; `cells`, (m, 10), hold
    the unknowns of each tetrahedron, mid-edge nodes last, `points`, (n, 3), are their places, and `modes` makes modes
    of little energy of points.
    """
    from scipy.sparse import identity, kron

    shares = interpolation(cells, len(points))
    corners = np.unique(cells[:, :4])
    inject = kron(shares, identity(3), format="bsr")
    linear = (inject.T.tobsr((3, 3)) @ (matrix @ inject)).tobsr((3, 3))
    linear.sort_indices()
    return two_levels(blocks, shares, aggregation(linear, modes(points[corners])))


def interpolation(cells: I64, count: int) -> Any:
    """Values of linear elements at all nodes of quadratic ones: of a corner its own, of a mid-edge node the ends' mean.

    `cells`, (m, 10), number the nodes from 0 to ``count - 1``; the matrix, (count, corners), has the corners in the
    order of their numbers.
    """
    from scipy.sparse import coo_matrix

    corners, at = np.unique(cells[:, :4], return_inverse=True)
    middles, first = np.unique(cells[:, 4:], return_index=True)
    cell, edge = np.divmod(first, len(EDGES))
    ends = at.reshape(-1, 4)[cell[:, None], EDGES[edge]]
    rows = np.concatenate([corners, np.repeat(middles, 2)])
    columns = np.concatenate([np.arange(len(corners)), ends.reshape(-1)])
    values = np.concatenate([np.ones(len(corners)), np.full(ends.size, 0.5)])
    return coo_matrix((values, (rows, columns)), shape=(count, len(corners))).tocsr()


def two_levels(matrix: Blocks, up: Any, coarse: Callable[[Vectors], Vectors]) -> Callable[[Vectors], Vectors]:
    """A symmetric V-cycle: a sweep forward, the correction on the coarse level, a sweep back.

    The interpolation `up` is a sparse matrix of numbers of unknowns, or of numbers of nodes.
    """
    down = up.T.tocsr()
    up = up.tocsr()

    def cycle(residuals: Vectors) -> Vectors:
        x, left = matrix.relaxed(residuals)
        found = coarse((down @ left.reshape(up.shape[0], -1)).reshape(-1, CASES))
        x += (up @ found.reshape(up.shape[1], -1)).reshape(x.shape)
        matrix.relax_back(residuals, x)
        return x

    return cycle


_SPRINGS = 1.0
"""Stiffness of the springs of `tied` over the mean of the diagonal. Measured on a cell of the paper with quadratic
elements: 59 iterations; 79 and 98 with a tenth and ten times of it; 499 without any."""


class TetHomogenized(NamedTuple):
    """Effective stiffness and how it was computed."""

    stiffness: F64  # (6, 6), Voigt, engineering shear, of the whole box
    iterations: list[int]  # of the six load cases
    residuals: list[float]  # of the six load cases
    unknowns: int
    constraints: int  # rows that join opposite faces; 0 where nodes match
    solid: float  # volume of the mesh


def homogenize_tetrahedra(
    nodes: F64, cells: I32, box: F64, young: F64, poisson: F64, representative: I64 | None, *, faces: str = "mortar",
    face_tolerance: float = 1e-6, tolerance: float = 1e-8, iterations: int = 2000,
    progress: Callable[[int], None] | None = None,
) -> TetHomogenized:  # fmt: skip
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
    shear = young / (2 * (1 + poisson))
    built = assemble(nodes, cells, numbers, young * poisson / ((1 + poisson) * (1 - 2 * poisson)), shear)
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


def rigid_modes(points: F64) -> F64:
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
    matrix: Blocks, right: Vectors, precondition: Callable[[Vectors], Vectors],
    project: Callable[[Vectors], Vectors] | None, tolerance: float, iterations: int,
    progress: Callable[[int], None] | None = None,
) -> Solution:  # fmt: skip
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


def _dots(a: Vectors, b: Vectors) -> F64:
    # not numpy.dot: BLAS sums in as many parts as it has threads
    sums: F64 = np.einsum("ij,ij->j", a, b)
    return sums


def _norms(a: Vectors) -> F64:
    return np.asarray(np.sqrt(_dots(a, a)))
