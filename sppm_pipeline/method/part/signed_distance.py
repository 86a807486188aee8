"""Distance of grid points from a triangle mesh, exact near the surface; its sign is that of the voxels of layers.

Every triangle writes its exact distance to the samples within two spacings of it; from there the nearest triangle is
handed from sample to sample in eight sweeps, and each sample keeps the exact distance to the best triangle it was
offered (closest-point propagation, as in Bridson 2015, "Fluid Simulation for Computer Graphics", chapter 4). Beyond the
band a sample may miss its nearest triangle by a neighboring one, which errs by a small fraction of the spacing.
"""

from __future__ import annotations

import math

import numpy as np

from sppm_pipeline.services.arrays import F32, F64, I32, U8
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.nearest import squared_to_triangle


def distance_layers(triangles: F64, grid: Grid, start: int, stop: int, reach: float) -> F32:
    """Distance of the layers start <= k < stop of a grid from the nearest of some triangles (m, 3, 3), without a sign.

    What lies farther off than the reach gets the reach. Up to a reach of one spacing the distances are exact, and so
    the same however a grid is cut into layers; farther ones may differ in what closest-point propagation misses.
    """
    nx, ny, nz = grid.shape
    step = grid.spacing[2]
    swept = reach > 2 * min(grid.spacing)
    # the way from a triangle to a sample within reach of it must not leave the layers that are looked at
    halo = math.ceil(reach / step) + 2 if swept else 0
    first, last = max(0, start - halo), min(nz, stop + halo)
    window = grid.layers(first, last)
    heights = triangles[:, :, 2]
    low, high = window.origin[2] - 2 * step, window.origin[2] + (last - first + 1) * step
    near = np.ascontiguousarray(triangles[(heights.max(1) >= low) & (heights.min(1) <= high)])
    squared = np.full((last - first, ny, nx), reach * reach, np.float32)
    nearest = np.full(squared.shape, -1, np.int32)
    origin, spacing = np.array(window.origin), np.array(window.spacing)
    _near_band(near, origin, spacing, squared, nearest)
    if swept:
        _sweep(near, origin, spacing, squared, nearest)
    wanted = squared[start - first : stop - first]
    return np.sqrt(wanted, out=wanted)


def reach_bare_borders(distance: F32, inside: U8, below: int, spacing: tuple[float, float, float]) -> None:
    """Measure from the border of the inside where it lies in a hole of the mesh, to half a spacing; in place.

    On the way to the nearest sample of the other kind one passes the border. If no triangle is as near as that sample,
    there is none on the way. Distances (n, ny, nx) are without a sign; `inside` has as many layers more below and above
    as lie within reach of the distances, or what there is.
    """
    from scipy.ndimage import distance_transform_edt

    own = slice(below, below + len(distance))
    for kind in (inside, 1 - inside):
        if kind.any() and not kind.all():
            other = distance_transform_edt(kind, sampling=spacing[::-1])[own]
            bare = kind[own].view(bool) & (other < distance)
            distance[bare] = other[bare] - min(spacing) / 2


@jit
def _near_band(triangles: F64, origin: F64, spacing: F64, squared: F32, nearest: I32) -> None:
    """Exact distances within two spacings of each triangle's box."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for f in range(triangles.shape[0]):
        t = triangles[f]
        for a in range(3):
            n = squared.shape[2 - a]
            least = min(t[0, a], t[1, a], t[2, a])
            most = max(t[0, a], t[1, a], t[2, a])
            low[a] = min(max(np.int64(np.floor((least - origin[a]) / spacing[a])) - 1, 0), n)
            high[a] = min(max(np.int64(np.ceil((most - origin[a]) / spacing[a])) + 2, 0), n)
        for k in range(low[2], high[2]):
            for j in range(low[1], high[1]):
                for i in range(low[0], high[0]):
                    d = squared_to_triangle(
                        t, origin[0] + i * spacing[0], origin[1] + j * spacing[1], origin[2] + k * spacing[2]
                    )
                    if d < squared[k, j, i]:
                        squared[k, j, i] = d
                        nearest[k, j, i] = f


@jit
def _sweep(triangles: F64, origin: F64, spacing: F64, squared: F32, nearest: I32) -> None:
    """Offer each sample the triangles of its neighbors behind it, in all eight directions of travel."""
    nz, ny, nx = squared.shape
    # one sweep for each octant that the nearest triangle may lie in (fast sweeping)
    for way in range(8):
        dk, dj, di = 1 - 2 * (way >> 2 & 1), 1 - 2 * (way >> 1 & 1), 1 - 2 * (way & 1)
        for ck in range(nz):
            k = ck if dk > 0 else nz - 1 - ck
            for cj in range(ny):
                j = cj if dj > 0 else ny - 1 - cj
                for ci in range(nx):
                    i = ci if di > 0 else nx - 1 - ci
                    last = nearest[k, j, i]
                    for step in range(1, 8):
                        kk, jj, ii = k - dk * (step >> 2 & 1), j - dj * (step >> 1 & 1), i - di * (step & 1)
                        if kk < 0 or jj < 0 or ii < 0 or kk >= nz or jj >= ny or ii >= nx:
                            continue
                        f = nearest[kk, jj, ii]
                        if f < 0 or f == last or f == nearest[k, j, i]:
                            continue
                        last = f
                        d = squared_to_triangle(
                            triangles[f],
                            origin[0] + i * spacing[0],
                            origin[1] + j * spacing[1],
                            origin[2] + k * spacing[2],
                        )
                        if d < squared[k, j, i]:
                            squared[k, j, i] = d
                            nearest[k, j, i] = f
