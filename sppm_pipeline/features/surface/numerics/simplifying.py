"""Fewer triangles within a distance of a surface: edges collapse in the order of their quadric error.

Each vertex keeps the quadric of the planes around it, weighted by area, and an edge collapses into the point where the
sum of both quadrics is least (Garland and Heckbert 1997, "Surface simplification using quadric error metrics"). Edges
go in passes with rising bounds of the error, so that no queue is kept. A collapse is refused if it would change the
topology (the link condition of Dey et al. 1999: the two ends have exactly two neighbors in common), move a vertex or
the middle of a changed triangle farther than the tolerance from the surface given, turn a triangle over, or leave one
that is flatter than `FLATTEST` and than
it was, unless there are fewer such triangles then. Vertices at boundaries and non-manifold edges stay.

The distance of a point is taken from the triangles around the vertex of the given surface that is nearest to it: the
distance from the surface, or in rare cases more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F32, F64, I32, I64, U8
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.nearest import squared_to_triangle

BOUNDS = (0.2, 0.6, 1.0, 1.0)
"""Largest root of the mean squared distance from planes in each pass, as fractions of the tolerance. The distance is
tested apart from this; three passes more leave a fifth less triangles and take a fifth longer."""

FLATTEST = 0.12
"""Quality of triangles, 1 for equal sides, below which a collapse leaves no new ones."""

TURNED = 0.3
"""Cosine of the angle by which a triangle may turn in one collapse."""


class Simplified(NamedTuple):
    """The result of `simplify`."""

    vertices: F64  # (n, 3)
    faces: I32  # (m, 3)
    farthest: float  # largest distance of a vertex or the middle of a changed triangle, an upper bound


def simplify(vertices: F64, faces: I32, tolerance: float) -> Simplified:
    """Collapse edges while all stays within the tolerance, above 0, of the surface given."""
    given, given_faces = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int32)
    if not len(given_faces):
        return Simplified(given, given_faces, 0.0)
    n = len(given)
    first, around = _incident(given_faces, n)
    low, size, shape, cell_first, held = _hashed(given, given_faces, tolerance)
    quadrics, locked = np.zeros((n, 11), np.float32), np.zeros(n, np.uint8)
    points, triangles = given.copy(), given_faces.copy()
    _prepare(points, triangles, first, around, quadrics, locked)
    farthest, tried = np.zeros(1), np.zeros(triangles.shape, np.uint8)
    incident = first, around
    for bound in BOUNDS:
        alive = np.ones(len(triangles), np.uint8)
        _collapse(
            points, triangles, alive, *incident, quadrics, locked, np.zeros(n, np.int64), (bound * tolerance) ** 2,
            tolerance**2, given, given_faces, first, around, low, size, shape, cell_first, held, tried,
            farthest,
        )  # fmt: skip
        stays = alive.view(np.bool_)
        triangles, tried = triangles[stays], tried[stays]
        incident = _incident(triangles, n)
    used, numbered = np.unique(triangles, return_inverse=True)
    return Simplified(points[used], numbered.reshape(-1, 3).astype(np.int32), float(np.sqrt(farthest[0])))


def qualities(vertices: F64, faces: I32) -> F64:
    """Quality of triangles, (m,): area over the mean of the squared sides, 1 for equal sides and 0 for a needle."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    squares = ((b - a) ** 2).sum(1) + ((c - b) ** 2).sum(1) + ((a - c) ** 2).sum(1)
    return np.asarray(4 * np.sqrt(3) * area / np.maximum(squares, 1e-300))


@jit
def _incident(faces: I32, n: int) -> tuple[I32, I32]:
    """The triangles around each vertex v: around[first[v] : first[v + 1]]."""
    first = np.zeros(n + 1, np.int32)
    for f in range(len(faces)):
        for c in range(3):
            first[faces[f, c] + 1] += 1
    for v in range(n):
        first[v + 1] += first[v]
    place = first[:-1].copy()
    around = np.empty(3 * len(faces), np.int32)
    for f in range(len(faces)):
        for c in range(3):
            v = faces[f, c]
            around[place[v]] = f
            place[v] += 1
    return first, around


@jit
def _hashed(points: F64, faces: I32, tolerance: float) -> tuple[F64, float, I64, I32, I32]:
    """Cells about as large as a mean edge, and the vertices in each; two more cells at both ends."""
    total = 0.0
    for f in range(len(faces)):
        for c in range(3):
            a, b = faces[f, c], faces[f, (c + 1) % 3]
            total += np.sqrt(
                (points[a, 0] - points[b, 0]) ** 2
                + (points[a, 1] - points[b, 1]) ** 2
                + (points[a, 2] - points[b, 2]) ** 2
            )
    size = max(total / (3 * len(faces)), 2 * tolerance)
    low, shape = np.empty(3), np.empty(3, np.int64)
    while True:
        for axis in range(3):
            low[axis] = points[:, axis].min() - 2 * size
            shape[axis] = int((points[:, axis].max() - low[axis]) / size) + 3
        if shape[0] * shape[1] * shape[2] <= 32 * len(points) + 64:
            break
        size *= 1.25
    count = shape[0] * shape[1] * shape[2]
    first = np.zeros(count + 1, np.int32)
    cell = np.empty(len(points), np.int64)
    for v in range(len(points)):
        i = int((points[v, 0] - low[0]) / size)
        j = int((points[v, 1] - low[1]) / size)
        k = int((points[v, 2] - low[2]) / size)
        cell[v] = (k * shape[1] + j) * shape[0] + i
        first[cell[v] + 1] += 1
    for c in range(count):
        first[c + 1] += first[c]
    place = first[:-1].copy()
    held = np.empty(len(points), np.int32)
    for v in range(len(points)):
        held[place[cell[v]]] = v
        place[cell[v]] += 1
    return low, size, shape, first, held


@jit
def _normal(points: F64, a: int, b: int, c: int, out: F64) -> float:
    """Normal of a triangle, twice its area long, into `out`; its quality."""
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    out[0], out[1], out[2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    squares = 2 * (ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz - ux * vx - uy * vy - uz * vz)
    double = np.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    return 2 * np.sqrt(3.0) * double / squares if squares > 0 else 0.0


@jit
def _prepare(points: F64, faces: I32, first: I32, around: I32, quadrics: F32, locked: U8) -> None:
    """Quadrics about each vertex itself, and which vertices are not surrounded by one fan of triangles."""
    normal = np.empty(3)
    for v in range(len(points)):
        a = around[first[v] : first[v + 1]]
        # in a closed fan each neighbor follows in one triangle what it precedes in another
        for f in a:
            c = 0 if faces[f, 0] == v else 1 if faces[f, 1] == v else 2
            ahead, behind = faces[f, (c + 1) % 3], faces[f, (c + 2) % 3]
            follows, precedes = 0, 0
            for g in a:
                d = 0 if faces[g, 0] == v else 1 if faces[g, 1] == v else 2
                follows += faces[g, (d + 2) % 3] == ahead
                precedes += faces[g, (d + 1) % 3] == behind
            if follows != 1 or precedes != 1:
                locked[v] = 1
        if len(a):
            # one walk around has to pass all triangles
            f, walked = a[0], 0
            while not locked[v]:
                walked += 1
                c = 0 if faces[f, 0] == v else 1 if faces[f, 1] == v else 2
                behind, f = faces[f, (c + 2) % 3], -1
                for g in a:
                    d = 0 if faces[g, 0] == v else 1 if faces[g, 1] == v else 2
                    if faces[g, (d + 1) % 3] == behind:
                        f = g
                if f == a[0]:
                    break
            if walked != len(a):
                locked[v] = 1
        q = quadrics[v]
        for f in a:
            _normal(points, faces[f, 0], faces[f, 1], faces[f, 2], normal)
            double = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
            if double == 0.0:
                continue
            x, y, z = normal[0] / double, normal[1] / double, normal[2] / double
            w = np.float32(double)
            q[0] += w * x * x
            q[1] += w * x * y
            q[2] += w * x * z
            q[3] += w * y * y
            q[4] += w * y * z
            q[5] += w * z * z
            q[10] += w


@jit
def _moved(q: F32, dx: float, dy: float, dz: float, out: F64) -> None:
    """Add to `out` a quadric about a point, about one that lies (dx, dy, dz) from there."""
    gx = q[0] * dx + q[1] * dy + q[2] * dz
    gy = q[1] * dx + q[3] * dy + q[4] * dz
    gz = q[2] * dx + q[4] * dy + q[5] * dz
    for i in range(6):
        out[i] += q[i]
    out[6] += q[6] + gx
    out[7] += q[7] + gy
    out[8] += q[8] + gz
    out[9] += q[9] + dx * gx + dy * gy + dz * gz + 2 * (q[6] * dx + q[7] * dy + q[8] * dz)
    out[10] += q[10]


@jit
def _error(q: F64, x: float, y: float, z: float) -> float:
    ax = q[0] * x + q[1] * y + q[2] * z + 2 * q[6]
    ay = q[1] * x + q[3] * y + q[4] * z + 2 * q[7]
    az = q[2] * x + q[4] * y + q[5] * z + 2 * q[8]
    return float(x * ax + y * ay + z * az + q[9])


@jit
def _least(q: F64, half: F64, at: F64) -> float:
    """Put the point of least error, about the middle of an edge, into `at`; the error.

    Where planes nearly agree it stays near the middle: the quadric gets a little of the distance from it.
    """
    soft = 1e-3 * (q[0] + q[3] + q[5]) / 3
    a, b, c, d, e, f = q[0] + soft, q[1], q[2], q[3] + soft, q[4], q[5] + soft
    ca, cb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * ca + b * cb + c * cc
    at[:] = 0.0
    if det > 0.0:
        cd, ce, cf = a * f - c * c, b * c - a * e, a * d - b * b
        at[0] = -(ca * q[6] + cb * q[7] + cc * q[8]) / det
        at[1] = -(cb * q[6] + cd * q[7] + ce * q[8]) / det
        at[2] = -(cc * q[6] + ce * q[7] + cf * q[8]) / det
        # not farther than the edge is long
        if at[0] ** 2 + at[1] ** 2 + at[2] ** 2 > 4 * (half[0] ** 2 + half[1] ** 2 + half[2] ** 2):
            at[:] = 0.0
    return _error(q, at[0], at[1], at[2])


@jit
def _squared_from(
    x: float, y: float, z: float, given: F64, given_faces: I32, first: I32, around: I32, low: F64, size: float,
    shape: I64, cell_first: I32, held: I32, t: F64, enough: float,
) -> float:  # fmt: skip
    """Squared distance of a point from the triangles around the nearest given vertex; infinite if none is near.

    A bound of it that is small `enough` will do.
    """
    i, j, k = int((x - low[0]) / size), int((y - low[1]) / size), int((z - low[2]) / size)
    if not (0 < i < shape[0] - 1 and 0 < j < shape[1] - 1 and 0 < k < shape[2] - 1):
        return np.inf
    best, nearest = np.inf, -1
    for kk in range(k - 1, k + 2):
        for jj in range(j - 1, j + 2):
            row = (kk * shape[1] + jj) * shape[0]
            for at in range(cell_first[row + i - 1], cell_first[row + i + 2]):
                v = held[at]
                d = (given[v, 0] - x) ** 2 + (given[v, 1] - y) ** 2 + (given[v, 2] - z) ** 2
                if d < best:
                    best, nearest = d, v
    if nearest < 0:
        return np.inf
    for f in around[first[nearest] : first[nearest + 1]]:
        for c in range(3):
            for axis in range(3):
                t[c, axis] = given[given_faces[f, c], axis]
        best = min(best, squared_to_triangle(t, x, y, z))
        if best <= enough:
            break
    return best


@jit
def _collapse(
    points: F64, faces: I32, alive: U8, first: I32, around: I32, quadrics: F32, locked: U8, mark: I64, bound: float,
    tolerance: float, given: F64, given_faces: I32, given_first: I32, given_around: I32, low: F64, size: float,
    shape: I64, cell_first: I32, held: I32, tried: U8, farthest: F64,
) -> None:  # fmt: skip
    """One pass: collapse all edges of both whose ends none has collapsed yet, whose mean error is within the bound."""
    touched = np.zeros(len(points), np.uint8)
    q, at, half, t = np.empty(11), np.empty(3), np.empty(3), np.empty((3, 3))
    before, after, ring, old = np.empty(3), np.empty(3), np.empty(3), np.empty((2, 3))
    stamp = np.int64(0)
    for f in range(len(faces)):
        for corner in range(3):
            if not alive[f]:
                break
            i, j = faces[f, corner], faces[f, (corner + 1) % 3]
            # an edge is tried once until something beside it changes
            if i > j or tried[f, corner]:
                continue
            if touched[i] or touched[j] or locked[i] or locked[j]:
                continue
            for axis in range(3):
                half[axis] = (points[j, axis] - points[i, axis]) / 2
            q[:] = 0.0
            _moved(quadrics[i], half[0], half[1], half[2], q)
            _moved(quadrics[j], -half[0], -half[1], -half[2], q)
            error = _least(q, half, at)
            if not error <= bound * q[10]:
                continue
            tried[f, corner] = 1
            # the ends have two neighbors in common, and two triangles
            stamp += 3
            shared, common = 0, 0
            for g in around[first[i] : first[i + 1]]:
                if alive[g]:
                    for c in range(3):
                        mark[faces[g, c]] = stamp
            for g in around[first[j] : first[j + 1]]:
                if alive[g]:
                    has = False
                    for c in range(3):
                        v = faces[g, c]
                        has = has or v == i
                        if v != i and v != j and mark[v] == stamp:
                            mark[v] = stamp + 1
                            common += 1
                    shared += has
            if shared != 2 or common != 2:
                continue
            for axis in range(3):
                old[0, axis], old[1, axis] = points[i, axis], points[j, axis]
                at[axis] += (old[0, axis] + old[1, axis]) / 2
            # with both ends moved there, what becomes of the other triangles: their shape, then where they are
            fits, worst = True, 0.0
            ring[:] = 0.0
            flat, flatter = 0, False
            for side in range(2):
                v, other = (i, j) if side == 0 else (j, i)
                for g in around[first[v] : first[v + 1]]:
                    a, b, c = faces[g, 0], faces[g, 1], faces[g, 2]
                    if alive[g] and (side == 0 or not (a == other or b == other or c == other)):
                        flat += _normal(points, a, b, c, before) < FLATTEST
                        ring += before
            for side in range(2):
                v, other = (i, j) if side == 0 else (j, i)
                for g in around[first[v] : first[v + 1]]:
                    a, b, c = faces[g, 0], faces[g, 1], faces[g, 2]
                    if not alive[g] or a == other or b == other or c == other:
                        continue
                    for axis in range(3):
                        points[v, axis] = old[side, axis]
                    quality = _normal(points, a, b, c, before)
                    for axis in range(3):
                        points[v, axis] = at[axis]
                    new = _normal(points, a, b, c, after)
                    flat -= new < FLATTEST
                    flatter = flatter or (new < FLATTEST and new < quality)
                    if new <= 0.0:
                        fits = False
                        break
                    # a needle has no normal to speak of: it follows the triangles around it
                    if quality < FLATTEST:
                        before[:] = ring
                    dot = before[0] * after[0] + before[1] * after[1] + before[2] * after[2]
                    lengths = (before[0] ** 2 + before[1] ** 2 + before[2] ** 2) * (
                        after[0] ** 2 + after[1] ** 2 + after[2] ** 2
                    )
                    if not dot >= TURNED * np.sqrt(lengths):
                        fits = False
                        break
                if not fits:
                    break
            fits = fits and (flat > 0 or not flatter)
            if fits:
                worst = _squared_from(
                    at[0], at[1], at[2], given, given_faces, given_first, given_around, low, size, shape, cell_first,
                    held, t, tolerance,
                )  # fmt: skip
                fits = worst <= tolerance
                for axis in range(3):
                    points[i, axis] = points[j, axis] = at[axis]
            for side in range(2):
                v, other = (i, j) if side == 0 else (j, i)
                for g in around[first[v] : first[v + 1]]:
                    if not fits:
                        break
                    a, b, c = faces[g, 0], faces[g, 1], faces[g, 2]
                    if not alive[g] or a == other or b == other or c == other:
                        continue
                    d = _squared_from(
                        (points[a, 0] + points[b, 0] + points[c, 0]) / 3,
                        (points[a, 1] + points[b, 1] + points[c, 1]) / 3,
                        (points[a, 2] + points[b, 2] + points[c, 2]) / 3,
                        given, given_faces, given_first, given_around, low, size, shape, cell_first, held, t,
                        tolerance,
                    )  # fmt: skip
                    worst = max(worst, d)
                    fits = worst <= tolerance
            if not fits:
                for axis in range(3):
                    points[i, axis], points[j, axis] = old[0, axis], old[1, axis]
                continue
            for axis in range(3):
                points[i, axis] = at[axis]
            # the quadric about the new place
            x, y, z = (
                at[0] - (old[0, 0] + old[1, 0]) / 2, at[1] - (old[0, 1] + old[1, 1]) / 2,
                at[2] - (old[0, 2] + old[1, 2]) / 2,
            )  # fmt: skip
            gx, gy, gz = q[0] * x + q[1] * y + q[2] * z, q[1] * x + q[3] * y + q[4] * z, q[2] * x + q[4] * y + q[5] * z
            for c in range(6):
                quadrics[i, c] = q[c]
            quadrics[i, 6], quadrics[i, 7], quadrics[i, 8] = q[6] + gx, q[7] + gy, q[8] + gz
            quadrics[i, 9], quadrics[i, 10] = max(error, 0.0), q[10]
            touched[i] = touched[j] = 1
            farthest[0] = max(farthest[0], worst)
            for g in around[first[i] : first[i + 1]]:
                tried[g] = 0
            for g in around[first[j] : first[j + 1]]:
                tried[g] = 0
                if alive[g]:
                    for c in range(3):
                        if faces[g, c] == i:
                            alive[g] = 0
                    if alive[g]:
                        for c in range(3):
                            if faces[g, c] == j:
                                faces[g, c] = i
