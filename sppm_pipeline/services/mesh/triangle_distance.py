"""The distance of a point from a triangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import jit


@jit
def squared_to_triangle(t: NDArray[np.float64], x: float, y: float, z: float) -> float:
    """Squared distance of a point from triangle (3, 3): the foot lies inside, on an edge or at a corner."""
    ax, ay, az = t[0, 0], t[0, 1], t[0, 2]
    ux, uy, uz = t[1, 0] - ax, t[1, 1] - ay, t[1, 2] - az
    vx, vy, vz = t[2, 0] - ax, t[2, 1] - ay, t[2, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    pu, pv = px * ux + py * uy + pz * uz, px * vx + py * vy + pz * vz
    det = uu * vv - uv * uv
    s, r = vv * pu - uv * pv, uu * pv - uv * pu
    if det > 0.0 and s >= 0.0 and r >= 0.0 and s + r <= det:
        s, r = s / det, r / det
        dx, dy, dz = px - s * ux - r * vx, py - s * uy - r * vy, pz - s * uz - r * vz
        return float(dx * dx + dy * dy + dz * dz)
    best = np.inf
    for e in range(3):
        b = (e + 1) % 3
        ex, ey, ez = t[b, 0] - t[e, 0], t[b, 1] - t[e, 1], t[b, 2] - t[e, 2]
        qx, qy, qz = x - t[e, 0], y - t[e, 1], z - t[e, 2]
        length = ex * ex + ey * ey + ez * ez
        share = 0.0
        if length > 0.0:
            share = min(1.0, max(0.0, (qx * ex + qy * ey + qz * ez) / length))
        dx, dy, dz = qx - share * ex, qy - share * ey, qz - share * ez
        best = min(best, dx * dx + dy * dy + dz * dz)
    return best
