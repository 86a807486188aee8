"""Effective stiffness by an assembled matrix, solved by smoothed aggregation (`pip install pyamg`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

CORNERS = np.array([(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)])


def _brick(lam: float, mu: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Stiffness (24, 24) and forces of unit strains (24, 6) of a unit brick, by Gauss integration."""
    c = np.diag([2 * mu] * 3 + [mu] * 3)
    c[:3, :3] += lam
    signs = 2 * CORNERS - 1
    k, f = np.zeros((24, 24)), np.zeros((24, 6))
    for point in signs / np.sqrt(3):
        b = np.zeros((6, 24))
        for d in range(3):
            others = [e for e in range(3) if e != d]
            g = signs[:, d] / 4 * np.prod(1 + signs[:, others] * point[others], axis=1)
            b[d, d::3] = g
            for row, (p, q) in ((3, (1, 2)), (4, (0, 2)), (5, (0, 1))):
                if d in (p, q):
                    b[row, (q if d == p else p) :: 3] += g
        k += b.T @ c @ b / 8
        f += b.T @ c / 8
    return k, f


def assembled_stiffness(lam: NDArray[Any], mu: NDArray[Any], residual: float) -> NDArray[np.float64]:
    """The diagonal of the stiffness of a binary cell; `lam`, `mu` (nz, ny, nx)."""
    import pyamg
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import cg

    nz, ny, nx = lam.shape
    z, y, x = np.nonzero(mu)
    nodes = np.stack([((z + k) % nz * ny + (y + j) % ny) * nx + (x + i) % nx for i, j, k in CORNERS], 1)
    used, nodes = np.unique(nodes, return_inverse=True)
    dofs = (3 * nodes.reshape(-1, 8)[:, :, None] + np.arange(3)).reshape(-1, 24)
    brick, load = _brick(float(lam.max()), float(mu.max()))
    size = 3 * len(used)
    values = np.broadcast_to(brick.reshape(-1), (len(dofs), 576)).reshape(-1)
    places = (np.repeat(dofs, 24, 1).reshape(-1), np.tile(dofs, (1, 24)).reshape(-1))
    matrix = coo_matrix((values, places), (size, size)).tobsr((3, 3))
    forces = np.zeros((size, 6))
    np.add.at(forces, dofs, load)
    modes = np.tile(np.eye(3), (len(used), 1))
    solver = pyamg.smoothed_aggregation_solver(matrix, B=modes, smooth="energy", max_coarse=300)
    precondition = solver.aspreconditioner()
    voigt = [float((lam + 2 * mu).mean(dtype=float))] * 3 + [float(mu.mean(dtype=float))] * 3
    found = np.empty(6)
    for case in range(6):
        u, _ = cg(matrix, -forces[:, case], rtol=residual, M=precondition)
        found[case] = voigt[case] + float(forces[:, case] @ u) / lam.size
    return found
