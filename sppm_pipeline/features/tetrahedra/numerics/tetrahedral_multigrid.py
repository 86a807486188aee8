"""Multigrid for six load cases on tetrahedra at a time: quadratic over linear elements over smoothed aggregation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.tetrahedra.numerics.quadratic import EDGES
from sppm_pipeline.features.tetrahedra.numerics.tetrahedral_blocks import CASES, Blocks, Vectors

COARSEST = 60
"""Unknowns of the coarsest grid; small enough that its dense solution never runs in several threads, whose number
would show in the last digits."""

RIGID = 1e-11
"""Eigenvalues of the coarsest matrix that count as zero, over its largest. Translations have rounding errors there
(1.4e-14 was seen on a mesh of 148 000 nodes, where the smallest of an elastic mode was 0.4) that may pass the cut-off
which SciPy's pseudoinverse has by itself; divided by them, translations grow until the solution is lost."""


def aggregation(matrix: Any, modes: NDArray[np.float64], blocks: Blocks | None = None) -> Callable[[Vectors], Vectors]:
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
    matrix: Any,
    blocks: Blocks,
    cells: NDArray[np.int64],
    points: NDArray[np.float64],
    modes: Callable[[Vectors], Vectors],
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


def interpolation(cells: NDArray[np.int64], count: int) -> Any:
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
