"""Polygons in a cube: cut into triangles, and the point nearest to the planes of their corners."""

from __future__ import annotations

import math

import numpy as np

from sppm_pipeline.services.arrays import F32, F64, I64
from sppm_pipeline.services.jit.compiled import jit


@jit
def _area(a: F64, b: F64, c: F64) -> float:
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return math.sqrt(x * x + y * y + z * z)


@jit
def fans_from_ends(part: I64, length: int, single: bool, places: F64, masks: I64, made: int, triangles: I64) -> int:
    """Triangles of a polygon, each with its first or last corner, of least area, none with a diagonal in a face.

    `part`, (length,), are corners as rows of `places` and of `masks` (the faces of the cube on which they lie). If
    `single`, all triangles shall have the first corner. New triangles go behind the `made` ones before, as rows of
    `places`; returned is the number of all, `made` if there are none such.
    """
    first, last = part[0], part[length - 1]
    least, best = np.inf, 0
    for turn in range(length - 2 if single else 1, length - 1):  # the corner from which sides belong to the last one
        area = _area(places[first], places[part[turn]], places[last])
        allowed = True
        for t in range(1, length - 2):
            end = first if t < turn else last
            area += _area(places[end], places[part[t]], places[part[t + 1]])
        for t in range(2, turn + 1):
            allowed &= not masks[first] & masks[part[t]]
        for t in range(turn, length - 2):
            allowed &= not masks[last] & masks[part[t]]
        if allowed and area < least:
            least, best = area, turn
    if best == 0:
        return made
    for t in range(1, length - 2):
        triangles[made, 0], triangles[made, 1] = part[t], part[t + 1]
        triangles[made, 2] = first if t < best else last
        made += 1
    triangles[made, 0], triangles[made, 1], triangles[made, 2] = first, part[best], last
    return made + 1


@jit
def _volume(a: F64, b: F64, c: F64, d: F64) -> float:
    """Six times the signed volume of a tetrahedron."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return float(x * (d[0] - a[0]) + y * (d[1] - a[1]) + z * (d[2] - a[2]))


@jit
def crossing(triangles: I64, count: int, places: F64) -> bool:
    """Test whether a side of one of the triangles, whose corners are rows of `places`, passes through another one."""
    for t in range(count):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for s in range(count):
            for e in range(3):
                p, q = triangles[s, e], triangles[s, (e + 1) % 3]
                if p in (a, b, c) or q in (a, b, c):
                    continue
                of_p = _volume(places[a], places[b], places[c], places[p])
                of_q = _volume(places[a], places[b], places[c], places[q])
                if not of_p * of_q < 0.0:
                    continue
                one = _volume(places[p], places[q], places[a], places[b])
                two = _volume(places[p], places[q], places[b], places[c])
                three = _volume(places[p], places[q], places[c], places[a])
                if min(one, two, three) >= 0.0 or max(one, two, three) <= 0.0:
                    return True
    return False


@jit
def nearest_to_all(count: int, points: F64, normals: F64, middle: F64, spacing: F64) -> None:
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
        # regularization: directions in which the planes say nothing keep the middle
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


@jit
def mean_slope(values: F32, i: int, j: int, k: int, a: int) -> float:
    """Mean difference of samples along an axis of a cube, times 4."""
    slope = 0.0
    for c in range(4):
        e, g = c & 1, c >> 1
        if a == 0:
            slope += np.float64(values[k + g, j + e, i + 1]) - values[k + g, j + e, i]
        elif a == 1:
            slope += np.float64(values[k + g, j + 1, i + e]) - values[k + g, j, i + e]
        else:
            slope += np.float64(values[k + 1, j + g, i + e]) - values[k, j + g, i + e]
    return slope
