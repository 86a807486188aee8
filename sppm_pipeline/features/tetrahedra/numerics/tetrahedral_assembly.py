"""Stiffness matrices and loads of tetrahedra with straight (4 nodes) or quadratic (10 nodes) displacement."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.tetrahedra.numerics.quadratic import EDGES
from sppm_pipeline.services.jit.compiled import jit

# The quadrature of degree 2 with four points (Hammer, Marlowe and Stroud 1956) suffices for
# straight-sided quadratic tetrahedra, whose gradients are linear.
_A, _B = (5 + 3 * 5**0.5) / 20, (5 - 5**0.5) / 20
_POINTS = np.array([[_A, _B, _B, _B], [_B, _A, _B, _B], [_B, _B, _A, _B], [_B, _B, _B, _A]])
_MIDDLE = np.full((1, 4), 0.25)


class Assembled(NamedTuple):
    """The discrete problem of a cell."""

    matrix: Any  # scipy.sparse.bsr_matrix, (3 n, 3 n), blocks 3 x 3
    # (6, 3 n), forces of unit strains (Voigt, engineering shear); displacements solve ``matrix u = -load``
    loads: NDArray[np.float64]
    # (6, 6), volume times material stiffness: energies of the unit strains without any displacement
    mean: NDArray[np.float64]
    volume: float


def assemble(
    nodes: NDArray[np.float64],
    cells: NDArray[np.int32],
    unknowns: NDArray[np.int64],
    lame: NDArray[np.float64],
    shear: NDArray[np.float64],
) -> Assembled:
    """Assemble the stiffness of a mesh of nodes (n, 3) and cells (m, 4) or (m, 10), in the order of `VolumeMesh`.

    `unknowns`, (n,), number the displacement that each node has from 0 without gaps; nodes that periodicity makes one
    share it. `lame` and `shear`, (m,), are Lamé's first constant and the shear modulus of each cell. ValueError if a
    cell has no positive volume at a point of quadrature.
    """
    from scipy.sparse import bsr_matrix, coo_matrix

    nodes, corners = np.ascontiguousarray(nodes, np.float64), np.ascontiguousarray(cells, np.int64)
    count = int(unknowns.max()) + 1
    gradients = _reference_gradients(corners.shape[1])
    weight = 1 / 6 / len(gradients)
    at = np.ascontiguousarray(unknowns[corners], np.int64)
    m, width = at.shape
    ones = np.ones(m * width * width, np.int8)
    pairs = (np.repeat(at, width, axis=1).reshape(-1), np.tile(at, (1, width)).reshape(-1))
    # the pattern first and the numbers into it: a list of all element matrices would take many times the
    # memory
    pattern = coo_matrix((ones, pairs), shape=(count, count)).tocsr()
    pattern.sort_indices()
    starts, columns = pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64)
    blocks = np.zeros((len(columns), 3, 3))
    loads = np.zeros((6, count, 3))
    mean = np.zeros((6, 6))
    volume, smallest = _scatter(
        nodes, corners, at, np.ascontiguousarray(lame), np.ascontiguousarray(shear), gradients, np.float64(weight),
        starts, columns, blocks, loads, mean,
    )  # fmt: skip
    if not smallest > 0:
        raise ValueError(f"a cell is turned inside out or flat: its Jacobian is {smallest:g}")
    matrix = bsr_matrix((blocks, columns, starts), shape=(3 * count, 3 * count))
    return Assembled(matrix, loads.reshape(6, -1), mean, float(volume))


def _reference_gradients(width: int) -> NDArray[np.float64]:
    """Gradients of the shape functions by the three reference coordinates, (points, width, 3)."""
    # barycentric coordinates are (1 - r - s - t, r, s, t)
    slopes = np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    if width == 4:
        return slopes[None]
    if width != 10:
        raise ValueError(f"tetrahedra have 4 or 10 nodes, got {width}")
    made = np.empty((len(_POINTS), 10, 3))
    for q, point in enumerate(_POINTS):
        made[q, :4] = (4 * point - 1)[:, None] * slopes
        for edge, (a, b) in enumerate(EDGES):
            made[q, 4 + edge] = 4 * (point[a] * slopes[b] + point[b] * slopes[a])
    return made


@jit
def _scatter(
    nodes: NDArray[np.float64], cells: NDArray[np.int64], at: NDArray[np.int64], lame: NDArray[np.float64],
    shear: NDArray[np.float64], reference: NDArray[np.float64], weight: float, starts: NDArray[np.int64],
    columns: NDArray[np.int64], blocks: NDArray[np.float64], loads: NDArray[np.float64], mean: NDArray[np.float64],
) -> tuple[float, float]:  # fmt: skip
    """Add all cells in their order; the volume and the smallest Jacobian."""
    points, width, _ = reference.shape
    g = np.empty((width, 3))
    jacobian = np.empty((3, 3))
    inverse = np.empty((3, 3))
    total, smallest = 0.0, np.inf
    for cell in range(len(cells)):
        lam, mu = lame[cell], shear[cell]
        for q in range(points):
            for i in range(3):
                for j in range(3):
                    value = 0.0
                    for a in range(width):
                        value += nodes[cells[cell, a], i] * reference[q, a, j]
                    jacobian[i, j] = value
            for i in range(3):
                i1, i2 = (i + 1) % 3, (i + 2) % 3
                for j in range(3):
                    j1, j2 = (j + 1) % 3, (j + 2) % 3
                    # cofactors: the inverse but for the determinant
                    inverse[j, i] = jacobian[i1, j1] * jacobian[i2, j2] - jacobian[i1, j2] * jacobian[i2, j1]
            det = jacobian[0, 0] * inverse[0, 0] + jacobian[0, 1] * inverse[1, 0] + jacobian[0, 2] * inverse[2, 0]
            smallest = min(smallest, det)
            dv = det * weight
            total += dv
            for a in range(width):
                for i in range(3):
                    value = 0.0
                    for j in range(3):
                        value += reference[q, a, j] * inverse[j, i]
                    g[a, i] = value / det
            # energy of a unit mean strain, Voigt order xx yy zz yz xz xy, engineering shear
            for i in range(3):
                for j in range(3):
                    mean[i, j] += dv * lam
                mean[i, i] += 2 * dv * mu
                mean[3 + i, 3 + i] += dv * mu
            for a in range(width):
                row = at[cell, a]
                gx, gy, gz = dv * g[a, 0], dv * g[a, 1], dv * g[a, 2]
                for i in range(3):
                    # normal strain along i loads every direction by lame, its own by the shear modulus too
                    loads[i, row, 0] += lam * gx
                    loads[i, row, 1] += lam * gy
                    loads[i, row, 2] += lam * gz
                    loads[i, row, i] += 2 * mu * dv * g[a, i]
                loads[3, row, 1] += mu * gz
                loads[3, row, 2] += mu * gy
                loads[4, row, 0] += mu * gz
                loads[4, row, 2] += mu * gx
                loads[5, row, 0] += mu * gy
                loads[5, row, 1] += mu * gx
                for b in range(width):
                    column = at[cell, b]
                    # binary search in the sorted columns of the row
                    low, high = starts[row], starts[row + 1]
                    while low < high - 1:
                        half = (low + high) // 2
                        if columns[half] <= column:
                            low = half
                        else:
                            high = half
                    dot = g[a, 0] * g[b, 0] + g[a, 1] * g[b, 1] + g[a, 2] * g[b, 2]
                    for i in range(3):
                        for j in range(3):
                            blocks[low, i, j] += dv * (lam * g[a, i] * g[b, j] + mu * g[a, j] * g[b, i])
                        blocks[low, i, i] += dv * mu * dot
    return total, smallest
