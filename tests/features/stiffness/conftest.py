"""The obvious way: stiffness matrices by Gauss integration, assembled, solved directly, for small cells."""

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

CORNERS = np.array([(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)])


def strain_matrices(edges):
    """(8, 6, 24) strain matrices at the Gauss points, and their weight."""
    matrices = []
    for point in (2 * CORNERS - 1) / np.sqrt(3):
        b = np.zeros((6, 24))
        for a, corner in enumerate(2 * CORNERS - 1):
            g = [
                corner[d] / 8 * np.prod([1 + corner[e] * point[e] for e in range(3) if e != d]) * 2 / edges[d]
                for d in range(3)
            ]
            x, y, z = 3 * a, 3 * a + 1, 3 * a + 2
            b[0, x], b[1, y], b[2, z] = g
            b[3, y], b[3, z] = g[2], g[1]
            b[4, x], b[4, z] = g[2], g[0]
            b[5, x], b[5, y] = g[1], g[0]
        matrices.append(b)
    return np.array(matrices), np.prod(edges) / 8


def isotropic(lam, mu):
    return np.diag([2 * mu] * 3 + [mu] * 3) + lam * np.pad(np.ones((3, 3)), (0, 3))


def _assemble(lam, mu, edges=(1.0, 1.0, 1.0)):
    """Stiffness, (n, 6) forces of the unit strains, and the mean stiffness times the volume; dofs 3 * node + c.

    `lam`, `mu` are (nz, ny, nx).
    """
    nz, ny, nx = lam.shape
    b, weight = strain_matrices(edges)
    unit = [weight * np.einsum("gia,ij,gjb->ab", b, isotropic(*c), b) for c in ((1, 0), (0, 1))]
    load = [weight * np.einsum("gia,ij->aj", b, isotropic(*c)) for c in ((1, 0), (0, 1))]
    z, y, x = np.indices(lam.shape).reshape(3, -1)
    nodes = np.stack([((z + k) % nz * ny + (y + j) % ny) * nx + (x + i) % nx for i, j, k in CORNERS], axis=1)
    dofs = (3 * nodes[:, :, None] + np.arange(3)).reshape(-1, 24)
    values = lam.reshape(-1, 1, 1) * unit[0] + mu.reshape(-1, 1, 1) * unit[1]
    rows, columns = np.repeat(dofs, 24, axis=1), np.tile(dofs, (1, 24))
    size = 3 * lam.size
    matrix = coo_matrix((values.reshape(-1), (rows.reshape(-1), columns.reshape(-1))), (size, size)).tocsc()
    forces = np.zeros((size, 6))
    np.add.at(forces, dofs, lam.reshape(-1, 1, 1) * load[0] + mu.reshape(-1, 1, 1) * load[1])
    mean = np.prod(edges) * isotropic(lam.sum(), mu.sum())
    return matrix, forces, mean


def _assembled_stiffness(lam, mu, edges=(1.0, 1.0, 1.0)):
    """Effective stiffness of a cell whose solid is one piece that leaves no node free but in the void."""
    matrix, forces, mean = _assemble(lam, mu, edges)
    held = matrix.diagonal() > 0
    held[np.flatnonzero(held)[:3]] = False
    u = np.zeros_like(forces)
    u[held] = splu(matrix[held][:, held].tocsc()).solve(-forces[held])
    return (mean + forces.T @ u) / (lam.size * np.prod(edges))


@pytest.fixture(scope="session")
def assemble():
    """The matrices of a cell."""
    return _assemble


@pytest.fixture(scope="session")
def assembled_stiffness():
    """The effective stiffness of a cell, by a direct solver."""
    return _assembled_stiffness
