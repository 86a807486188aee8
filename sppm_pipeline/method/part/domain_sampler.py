"""Inside test of, and signed distance from, a mesh, layer by layer of one grid."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.services.arrays import F32, F64, I32, U8, U64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.nearest import squared_to_triangle

if TYPE_CHECKING:
    from sppm_pipeline.method.part.crossings import Crossings
    from sppm_pipeline.method.part.inside import Method
    from sppm_pipeline.method.part.ray_crossings import Scan
    from sppm_pipeline.method.part.scanline import ThreeAxisScan
    from sppm_pipeline.method.part.spanned import SpannedScan


def distance_layers(triangles: F64, grid: Grid, start: int, stop: int, reach: float) -> F32:
    """Distance of the layers start <= k < stop of a grid from the nearest of some triangles (m, 3, 3), without a sign.

    Every triangle writes its exact distance to the samples within two spacings of it; from there the nearest triangle
    is handed from sample to sample in eight sweeps, and each sample keeps the exact distance to the best triangle it
    was offered (closest-point propagation, as in Bridson 2015, "Fluid Simulation for Computer Graphics", chapter 4).
    What lies farther off than the reach gets the reach. Up to a reach of one spacing the distances are exact, and so
    the same however a grid is cut into layers; beyond the band a sample may miss its nearest triangle by a neighboring
    one, which errs by a small fraction of the spacing.
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


DISTANCE_SAMPLES = 2**22
"""Samples whose distance from the domain is computed at a time: 16 MB. Not sensitive: only memory."""

ROUNDING = 2.0**-20
"""Distances from the domain below this fraction of the spacing are taken for zero: eight times the rounding of float32
numbers of the size of the spacing. A factor of two moves no surface by more than a millionth of a voxel."""

VOTED_LAYERS = 64
"""Layers that are decided together where rays along all axes vote: each block looks at all triangles. Only speed."""


class DomainSampler:
    """A domain on one grid: what all layers need is prepared once, and the last block of layers is kept.

    `of` is the grid as the caller knows it, `world` the same in mm; distances are needed up to `skin_mm`, and from the
    triangles `skin_faces` alone, if given.
    """

    def __init__(
        self, domain: SurfaceMesh, of: Grid, world: Grid, skin_mm: float, method: Method, skin_faces: I32 | None = None
    ) -> None:
        self.of = of
        self._domain = domain
        self._world = world
        self._skin_mm = skin_mm
        self._method = method
        self._scan: Scan | SpannedScan | ThreeAxisScan | None = None
        self._voted: tuple[int, int, U8] | None = None
        self._triangles: F64 | None = None
        self._normals: F64 | None = None
        self._skin_faces = skin_faces
        self._skin_corners: F64 | None = None
        self._kept: dict[str, tuple[int, F32]] = {}

    def inside(self, start: int, stop: int) -> U8:
        """Which voxels of the layers start <= k < stop lie in the domain."""
        from sppm_pipeline.method.part.inside import inside_layers, prepare_inside

        if self._scan is None:
            self._scan = prepare_inside(self._domain.vertices, self._domain.faces, self._world, self._method)
        if self._method != "vote":
            return inside_layers(self._scan, start, stop).mask
        # a vote costs as much for one layer as for many, so layers are asked for in thick blocks
        if self._voted is None or not self._voted[0] <= start <= stop <= self._voted[1]:
            last = min(self._world.shape[2], max(stop, start + VOTED_LAYERS))
            self._voted = (start, last, inside_layers(self._scan, start, last).mask)
        first, _, block = self._voted
        return block[start - first : stop - first].copy()

    def inside_bits(self, start: int, stop: int) -> U64:
        """`inside` as bits, (stop - start, ny, words), see `services.bit_rows`."""
        from sppm_pipeline.method.part.inside import prepare_inside
        from sppm_pipeline.method.part.ray_crossings import Scan
        from sppm_pipeline.method.part.scanline import scan_bits
        from sppm_pipeline.services.bit_rows import pack

        if self._scan is None:
            self._scan = prepare_inside(self._domain.vertices, self._domain.faces, self._world, self._method)
        if isinstance(self._scan, Scan):
            return scan_bits(self._scan, start, stop)
        return pack(self.inside(start, stop))

    def distance(self, start: int, stop: int) -> F32:
        """Signed distance from the domain in the layers start <= k < stop, mm."""
        return self._in_blocks("domain", start, stop)

    def skin_distance(self, start: int, stop: int) -> F32:
        """Distance from the triangles that have a skin, without a sign, in the layers start <= k < stop, mm."""
        return self._in_blocks("skin", start, stop)

    def add_skin(self, start: int, inside: U8, solid: U8) -> None:
        """Make solid what is inside and within the skin of its triangles, in layers from `start` on; in place."""
        from sppm_pipeline.method.part.chosen_faces import add_skin_on

        add_skin_on(self._chosen(), self._world, start, self._skin_mm, inside, solid)

    def _in_blocks(self, what: str, start: int, stop: int) -> F32:
        """Distances in layers start <= k < stop.

        Each is computed in blocks that belong to the grid, whichever layers are asked for: where the skin is thick, the
        distance in a block depends a little on where the block ends.
        """
        nx, ny, nz = self._world.shape
        block = max(1, DISTANCE_SAMPLES // (nx * ny), 4 * math.ceil(self._skin_mm / self._world.spacing[2]))
        out = np.empty((stop - start, ny, nx), np.float32)
        for number in range(start // block, -(-stop // block)):
            # blocks of the grid, not of the request, so that every request gets the same bits
            first, last = number * block, min(nz, (number + 1) * block)
            if what not in self._kept or self._kept[what][0] != number:
                compute = self._signed_distance if what == "domain" else self._skin_distance
                self._kept[what] = number, compute(first, last)
            low, high = max(start, first), min(stop, last)
            out[low - start : high - start] = self._kept[what][1][low - first : high - first]
        return out

    def _skin_distance(self, first: int, last: int) -> F32:
        return distance_layers(self._chosen(), self._world, first, last, max(self._world.spacing) + self._skin_mm)

    def _signed_distance(self, first: int, last: int) -> F32:
        spacing = self._world.spacing
        reach = max(spacing) + (self._skin_mm if self._skin_faces is None else 0.0)
        distance = distance_layers(self._corners(), self._world, first, last, reach)
        # the border of a hole is felt across blocks
        halo = 0 if self._method == "scanline" else math.ceil(reach / spacing[2])
        low, high = max(0, first - halo), min(self._world.shape[2], last + halo)
        around = self.inside(low, high)
        if halo:
            reach_bare_borders(distance, around, first - low, spacing)
        inside = around[first - low : last - low].view(bool)
        np.negative(distance, out=distance, where=inside)
        # Nodes on the surface itself, as those of a box often are, are void whatever way their distance is rounded: a
        # face of the part is then flat.
        distance[np.abs(distance) < ROUNDING * min(spacing)] = 0.0
        return distance

    def crossings(self, start: int, stop: int) -> Crossings:
        """Points where grid edges that begin in the layers start <= k < stop pierce the triangles of the domain."""
        from sppm_pipeline.method.part.crossings import grid_crossings, unit_normals

        if self._normals is None:
            outer = self._domain.outer_surface
            self._normals = unit_normals(self._domain.vertices[self._domain.faces])
            if outer is not None:  # pieces may be too small for a normal of their own
                self._normals = np.ascontiguousarray(self._normals[outer.owners])
        return grid_crossings(self._corners(), self._normals, self._world, start, stop)

    def _chosen(self) -> F64:
        if self._skin_corners is None:
            outer, chosen = self._domain.outer_surface, self._skin_faces
            if outer is not None and chosen is not None:
                chosen = np.flatnonzero(np.isin(outer.owners, chosen)).astype(np.int32)
            self._skin_corners = np.ascontiguousarray(self._corners()[chosen])
        return self._skin_corners

    def _corners(self) -> F64:
        """Corners of the triangles, or of the pieces of them that are surface where shells overlap."""
        if self._triangles is None:
            outer = self._domain.outer_surface
            self._triangles = self._domain.vertices[self._domain.faces] if outer is None else outer.triangles
        return self._triangles
