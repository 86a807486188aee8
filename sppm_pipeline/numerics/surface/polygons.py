"""Polygons in a cube: cut into triangles, and the point nearest to the planes of their corners."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit


@jit
def _area(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> float:
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return math.sqrt(x * x + y * y + z * z)


@jit
def triangulate(
    count: int,
    places: NDArray[np.float64],
    masks: NDArray[np.int64],
    cost: NDArray[np.float64],
    middle: NDArray[np.int64],
    stack: NDArray[np.int64],
    triangles: NDArray[np.int64],
) -> int:
    """Triangles of least area of a polygon, none with a diagonal in a face of the cube; 0 if there are none such."""
    for width in range(1, count):
        for i in range(count - width):
            j = i + width
            if width == 1:
                cost[i, j] = 0.0
                continue
            cost[i, j] = np.inf
            if width < count - 1 and masks[i] & masks[j]:
                continue
            for k in range(i + 1, j):
                total = cost[i, k] + cost[k, j] + _area(places[i], places[k], places[j])
                if total < cost[i, j]:
                    cost[i, j] = total
                    middle[i, j] = k
    if not cost[0, count - 1] < np.inf:
        return 0
    n, left = 0, 1
    stack[0, 0], stack[0, 1] = 0, count - 1
    while left:
        left -= 1
        i, j = stack[left, 0], stack[left, 1]
        if j - i < 2:
            continue
        k = middle[i, j]
        triangles[n, 0], triangles[n, 1], triangles[n, 2] = i, k, j
        n += 1
        stack[left, 0], stack[left, 1] = i, k
        stack[left + 1, 0], stack[left + 1, 1] = k, j
        left += 2
    return n


@jit
def nearest_to_all(
    count: int,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    middle: NDArray[np.float64],
    spacing: NDArray[np.float64],
) -> None:
    """Move `middle` to the point nearest to some planes, in the sense of least squares (Kobbelt et al. 2001)."""
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for r in range(count):
        off = 0.0
        for a in range(3):
            off += normals[r, a] * (points[r, a] - middle[a])
        for a in range(3):
            right[a] += normals[r, a] * off
            for b in range(3):
                matrix[a, b] += normals[r, a] * normals[r, b]
    for a in range(3):
        matrix[a, a] += 1e-3
    # Cramer's rule; the matrix is positive definite
    m = matrix
    det = (
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
        - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )
    x = np.empty(3)
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        # the inverse of a symmetric matrix, row by row
        x[a] = (
            right[a] * (m[b, b] * m[c, c] - m[b, c] * m[c, b])
            + right[b] * (m[c, b] * m[a, c] - m[a, b] * m[c, c])
            + right[c] * (m[a, b] * m[b, c] - m[b, b] * m[a, c])
        ) / det
    for a in range(3):
        middle[a] += x[a]
