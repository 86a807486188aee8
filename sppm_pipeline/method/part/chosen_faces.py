"""A skin on some triangles of a part only: which these are, and the voxels within a distance of them.

The points within a distance of a triangle are convex, so on a row of voxels they are one interval. Its ends are the
least and the greatest of those of seven simpler convex bodies that make it up: a slab above and below the triangle,
three cylinders around its edges, three balls around its corners.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.services.arrays import F64, I32, U8, Bools
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.nearest import squared_to_triangle

SLACK = 1.0 + 1e-6
"""A distance that equals the thickness up to rounding counts as within, as in `skin_layers`."""


def faces_toward(vertices: F64, faces: I32, directions: ArrayLike, angle: float) -> Bools:
    """Triangles whose normal is within an angle (degrees) of one of some directions (n, 3); (m,) bool.

    Triangles without an area have no normal, and are never chosen.
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    ways = np.reshape(np.asarray(directions, np.float64), (-1, 3))
    ways = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    # not divided by the length: triangles without an area would give 0 / 0
    cosines = (normals @ ways.T).max(1, initial=-np.inf)
    # a face at the very angle counts, whichever way its cosine is rounded
    chosen: Bools = (length > 0) & (cosines >= (math.cos(math.radians(angle)) - 1e-9) * length)
    return chosen


def faces_within(vertices: F64, faces: I32, others: F64, distance: float) -> Bools:
    """Triangles of which all corners are within a distance of other triangles (k, 3, 3); (m,) bool."""
    # sorted along x, so that a triangle looks at the points between two planes only
    order = np.argsort(vertices[:, 0], kind="stable")
    near = np.zeros(len(vertices), np.bool_)
    found = np.zeros(len(vertices), np.bool_)
    _near_points(np.ascontiguousarray(vertices[order]), np.ascontiguousarray(others), distance * SLACK, found)
    near[order] = found
    return near[faces[:, 0]] & near[faces[:, 1]] & near[faces[:, 2]]


@jit
def _near_points(points: F64, triangles: F64, reach: float, found: Bools) -> None:
    """Mark points, sorted along x, that are within reach of a triangle."""
    for f in range(triangles.shape[0]):
        t = triangles[f]
        x0, x1 = min(t[0, 0], t[1, 0], t[2, 0]) - reach, max(t[0, 0], t[1, 0], t[2, 0]) + reach
        y0, y1 = min(t[0, 1], t[1, 1], t[2, 1]) - reach, max(t[0, 1], t[1, 1], t[2, 1]) + reach
        z0, z1 = min(t[0, 2], t[1, 2], t[2, 2]) - reach, max(t[0, 2], t[1, 2], t[2, 2]) + reach
        for i in range(np.searchsorted(points[:, 0], x0), points.shape[0]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            if x > x1:
                break
            if found[i] or y < y0 or y > y1 or z < z0 or z > z1:
                continue
            found[i] = squared_to_triangle(t, x, y, z) <= reach * reach


def add_skin_on(triangles: F64, grid: Grid, start: int, thickness: float, inside: U8, solid: U8) -> None:
    """Make voxels solid that are inside and whose center is within a distance of some triangles (m, 3, 3); in place.

    The arrays (nz, ny, nx) hold layers of the grid from `start` on; how they are cut changes nothing.
    """
    heights, step, reach = triangles[:, :, 2], grid.spacing[2], thickness * SLACK
    low, high = grid.origin[2] + start * step - reach, grid.origin[2] + (start + len(solid)) * step + reach
    near = np.ascontiguousarray(triangles[(heights.max(1) >= low) & (heights.min(1) <= high)])
    _paint(near, np.array(grid.origin), np.array(grid.spacing), start, reach, inside, solid)


@jit
def _paint(triangles: F64, origin: F64, spacing: F64, start: int, reach: float, inside: U8, solid: U8) -> None:
    nz, ny, nx = solid.shape
    ends = np.empty(2)
    frame = np.empty((4, 3))
    for f in range(triangles.shape[0]):
        t = triangles[f]
        plane = _frame(t, frame)
        z0, z1 = min(t[0, 2], t[1, 2], t[2, 2]) - reach, max(t[0, 2], t[1, 2], t[2, 2]) + reach
        y0, y1 = min(t[0, 1], t[1, 1], t[2, 1]) - reach, max(t[0, 1], t[1, 1], t[2, 1]) + reach
        k0 = max(0, int(np.ceil((z0 - origin[2]) / spacing[2])) - start)
        k1 = min(nz - 1, int(np.floor((z1 - origin[2]) / spacing[2])) - start)
        j0 = max(0, int(np.ceil((y0 - origin[1]) / spacing[1])))
        j1 = min(ny - 1, int(np.floor((y1 - origin[1]) / spacing[1])))
        for k in range(k0, k1 + 1):
            z = origin[2] + (start + k) * spacing[2]
            for j in range(j0, j1 + 1):
                _row_interval(t, frame, plane, origin[1] + j * spacing[1], z, reach, ends)
                if ends[0] > ends[1]:
                    continue
                i0 = max(0, int(np.ceil((ends[0] - origin[0]) / spacing[0])))
                i1 = min(nx - 1, int(np.floor((ends[1] - origin[0]) / spacing[0])))
                for i in range(i0, i1 + 1):
                    # the skin lies within the part: the far side of a face stays void
                    solid[k, j, i] |= inside[k, j, i]


@jit
def _frame(t: F64, frame: F64) -> bool:
    """Unit normal, and for each edge the direction in the plane that points inwards; False without an area."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        frame[0, a] = (t[1, b] - t[0, b]) * (t[2, c] - t[0, c]) - (t[1, c] - t[0, c]) * (t[2, b] - t[0, b])
    length = np.sqrt(frame[0, 0] ** 2 + frame[0, 1] ** 2 + frame[0, 2] ** 2)
    if not length > 0.0:
        return False
    for a in range(3):
        frame[0, a] /= length
    for e in range(3):
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            after = (e + 1) % 3
            frame[1 + e, a] = frame[0, b] * (t[after, c] - t[e, c]) - frame[0, c] * (t[after, b] - t[e, b])
    return True


@jit
def _row_interval(t: F64, frame: F64, plane: bool, y: float, z: float, reach: float, ends: F64) -> None:
    """Least and greatest x within reach of a triangle on a line along x; the least is greater if there is none."""
    low, high = np.inf, -np.inf
    if plane:  # the slab: |n (p - a)| <= reach, and inside of all three edges
        first, last = -np.inf, np.inf
        for c in range(5):
            row = max(0, c - 1)
            v = max(0, c - 2)
            slope = frame[row, 0]
            at = frame[row, 1] * (y - t[v, 1]) + frame[row, 2] * (z - t[v, 2]) - slope * t[v, 0]
            if c == 0:
                at += reach
            elif c == 1:
                slope, at = -frame[0, 0], reach - (frame[0, 1] * (y - t[0, 1]) + frame[0, 2] * (z - t[0, 2]))
                at += frame[0, 0] * t[0, 0]
            if slope > 0.0:
                first = max(first, -at / slope)
            elif slope < 0.0:
                last = min(last, -at / slope)
            elif at < 0.0:
                last = -np.inf
        if first <= last:
            low, high = first, last
    for e in range(3):
        dy, dz = y - t[e, 1], z - t[e, 2]
        rest = reach * reach - dy * dy - dz * dz
        if rest >= 0.0:
            half = np.sqrt(rest)
            low, high = min(low, t[e, 0] - half), max(high, t[e, 0] + half)
        after = (e + 1) % 3
        ux, uy, uz = t[after, 0] - t[e, 0], t[after, 1] - t[e, 1], t[after, 2] - t[e, 2]
        uu = ux * ux + uy * uy + uz * uz
        across = uu - ux * ux
        if not across > 1e-14 * uu:
            continue  # an edge along the row ends where its balls do
        # with x from the corner: |p|^2 - (p u)^2 / uu <= reach^2 and 0 <= p u <= uu
        s = dy * uy + dz * uz
        b = -ux * s
        c2 = (dy * dy + dz * dz - reach * reach) * uu - s * s
        root = b * b - across * c2
        if root < 0.0:
            continue
        root = np.sqrt(root)
        first, last = (-b - root) / across, (-b + root) / across
        if ux > 0.0:
            first, last = max(first, -s / ux), min(last, (uu - s) / ux)
        elif ux < 0.0:
            first, last = max(first, (uu - s) / ux), min(last, -s / ux)
        elif s < 0.0 or s > uu:
            continue
        if first <= last:
            low, high = min(low, t[e, 0] + first), max(high, t[e, 0] + last)
    ends[0], ends[1] = low, high
