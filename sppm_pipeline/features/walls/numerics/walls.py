"""Walls of a tiling pierced by tunnels: distance from Voronoi faces, depth in capsules, and both as one field.

Voronoi cells are computed lattice site by lattice site, where samples need them.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

import numpy as np

from sppm_pipeline.features.walls.numerics.cells import VoronoiCells, voronoi_cells
from sppm_pipeline.features.walls.numerics.distance import UNCLAIMED, raise_to_distance
from sppm_pipeline.method.assembly.contents import Pieces, TilingArrays
from sppm_pipeline.method.assembly.gather import Catalog, kernels_in_box, make_catalog
from sppm_pipeline.services.arrays import F32, F64, I64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.threads import in_bands

RADIUS_LEVEL = math.exp(-1)
"""Value of a tunnel's kernel ``exp(-mu d)`` at its radius 1 / mu."""

#: `opening` inside of tunnels, cell sizes: larger than half the thickness of any wall.
OPEN = np.float32(16.0)

# Bytes of Voronoi cells that are cached for the next layers; with less room, sites are computed again. Not measured.
_KEPT_BYTES = 96 * 2**20
# Points along the edge of a cell at which the distance to the nearest pore is measured. Twice as many cost eight times
# the time and lower the bound of the empty radius by 0.05 cell sizes.
_PROBES = 8
# No point of a cell with a pore lies farther from it than its diagonal.
_DIAGONAL = math.sqrt(3)


class WallSampler:
    """Distances from walls and depths in tunnels of one tiling, on any grid.

    Pores of the pieces are points; tunnels are capsules of radius ``1 / mu``. `rounding` is the radius of the fillets
    where walls meet, cell sizes; samples farther than `margin` from a tunnel have the depth ``-margin``.
    """

    def __init__(self, pieces: Pieces, tiling: TilingArrays, rounding: float, margin: float) -> None:
        self._catalog: Catalog = make_catalog(pieces, RADIUS_LEVEL)
        self._tiling = tiling
        self._rounding, self._margin = rounding, margin
        self.empty = largest_empty_radius(pieces)
        self._sites: OrderedDict[tuple[int, int, int], VoronoiCells] = OrderedDict()
        self._bytes, self._lock = 0, Lock()

    def sample(self, grid: Grid, start: int, stop: int, threads: int = 1) -> tuple[F32, F32]:
        """Distance from the middle of the nearest wall, and depth in tunnels (negative outside), both (stop - start,
        ny, nx), in cell sizes, for the layers start <= k < stop. Outside of all cells there are no walls; the distance
        is then the largest empty radius.
        """
        nx, ny = grid.shape[:2]
        distance = np.full((stop - start, ny, nx), UNCLAIMED, np.float32)
        depth = np.full((stop - start, ny, nx), -self._margin, np.float32)
        if distance.size == 0:
            return distance, depth
        span = grid.layers(start, stop)
        lower = np.array(span.origin)
        upper = lower + np.array(span.spacing) * (np.array(span.shape) - 1)
        for cells in self._cells_near(lower, upper, threads):
            raise_to_distance(distance, grid, cells, self._rounding, threads, start)
        distance[distance == UNCLAIMED] = np.float32(self.empty)
        tunnels = kernels_in_box(self._catalog, self._tiling, lower - self._margin, upper + self._margin)
        raise_to_depth(depth, grid, tunnels.starts, tunnels.ends, 1 / tunnels.mu, self._margin, threads, start)
        return distance, depth

    def _cells_near(self, lower: F64, upper: F64, threads: int) -> list[VoronoiCells]:
        """Voronoi cells that may meet a box, in the order of their sites; one set for each image of a site."""
        first = np.floor(lower - self.empty).astype(np.int64)
        last = np.floor(upper + self.empty).astype(np.int64)
        if not self._tiling.periodic:  # pores of the last faces belong to sites without a cell
            halo = self._tiling.halo
            first, last = np.maximum(first, -halo), np.minimum(last, np.add(self._tiling.shape, halo))
        shape = self._tiling.shape
        places = [
            (x, y, z)
            for z in range(first[2], last[2] + 1)
            for y in range(first[1], last[1] + 1)
            for x in range(first[0], last[0] + 1)
        ]
        sites = [tuple(p % n for p, n in zip(place, shape, strict=True)) if self._tiling.periodic else place
                 for place in places]  # fmt: skip
        wanted = sorted(set(sites), key=lambda site: site[::-1])
        with ThreadPoolExecutor(threads) as pool:
            made = dict(zip(wanted, pool.map(self._site, wanted), strict=True))
        moved = []
        for place, site in zip(places, sites, strict=True):
            cells = made[site]
            shift = np.subtract(place, site).astype(np.float64)
            low, high = cells.lower + shift, cells.upper + shift
            near = ((low <= upper) & (high >= lower)).all(1)
            if near.any():
                moved.append(cells._replace(centers=cells.centers + shift, lower=low, upper=high))
        return moved

    def _site(self, site: tuple[int, int, int]) -> VoronoiCells:
        """Return the cells of the pores in the unit cube at a site, from the cache if possible."""
        with self._lock:
            found = self._sites.get(site)
            if found is not None:
                self._sites.move_to_end(site)
                return found
        corner = np.array(site, np.float64)
        reach = 2 * self.empty  # pores farther apart than this share no face
        points = kernels_in_box(self._catalog, self._tiling, corner - reach, corner + 1 + reach).centers
        owners = np.flatnonzero((np.floor(points) == corner).all(1))
        found = voronoi_cells(points, owners, self.empty)
        with self._lock:
            self._sites[site] = found
            self._bytes += found.planes.nbytes
            # the site that was not used for longest goes first; the last one always stays
            while self._bytes > _KEPT_BYTES and len(self._sites) > 1:
                self._bytes -= self._sites.popitem(last=False)[1].planes.nbytes
        return found


def largest_empty_radius(pieces: Pieces) -> float:
    """Upper bound of the distance of any point of a tiling's cells from the nearest pore, from each interior alone."""
    # no point is farther from a probe than half the diagonal of its part of the cell
    found = _farthest_probe(pieces.kernels.centers, pieces.first_pore[: pieces.interiors + 1], _PROBES)
    return min(found + _DIAGONAL / (2 * _PROBES), _DIAGONAL)


@jit
def _farthest_probe(centers: F64, first: I64, probes: int) -> float:
    """Largest distance of the centers of probes^3 parts of a cell from the nearest pore of its interior."""
    largest = 0.0
    for t in range(len(first) - 1):
        for i in range(probes**3):
            x, y, z = i % probes, i // probes % probes, i // probes**2
            nearest = np.inf
            for p in range(first[t], first[t + 1]):
                dx, dy = (x + 0.5) / probes - centers[p, 0], (y + 0.5) / probes - centers[p, 1]
                dz = (z + 0.5) / probes - centers[p, 2]
                nearest = min(nearest, dx * dx + dy * dy + dz * dz)
            largest = max(largest, nearest)
    return math.sqrt(largest)


def raise_to_depth(
    out: F32, grid: Grid, starts: F64, ends: F64, radii: F64, margin: float, threads: int = 1, first_layer: int = 0
) -> None:
    """Raise samples to their depth in the nearest tunnel: its radius less the distance from its axis, whatever the
    number of threads.

    `out` (nz, ny, nx) are the layers ``first_layer <= k < first_layer + nz`` of the grid, initially ``-margin``, which
    stays farther than `margin` from a tunnel; axes go from `starts` to `ends` (m, 3), in the unit of the grid, and may
    have length zero, with `radii` (m,).
    """
    layers = len(out)
    if layers == 0 or len(starts) == 0:
        return
    origin, spacing = np.array(grid.origin), np.array(grid.spacing)

    def fill(start: int, stop: int) -> None:
        block = out[start:stop]
        arguments = block.reshape(-1), block.shape, first_layer + start, origin, spacing
        _raise_tunnels(*arguments, starts, ends, radii, margin)

    in_bands(fill, layers, threads)


@inline_jit
def _raise_row(
    out: F32, at: int, count: int, x: np.float32, step: np.float32, y: np.float32, z: np.float32, ux: np.float32,
    uy: np.float32, uz: np.float32, length: np.float32, radius: np.float32,
) -> None:  # fmt: skip
    """Raise ``out[at + i]`` to the radius less the distance of ``(x + i step, y, z)`` from a segment at the origin."""
    first = np.uint64(at)
    aside = y * uy + z * uz
    for i in range(np.uint64(count)):
        dx = x + step * np.float32(np.int32(i))
        foot = min(max(dx * ux + aside, np.float32(0.0)), length)
        px, py, pz = dx - foot * ux, y - foot * uy, z - foot * uz
        out[first + i] = max(out[first + i], radius - np.float32(math.sqrt(px * px + py * py + pz * pz)))


@jit
def _raise_tunnels(
    out: F32, shape: tuple[int, int, int], first_layer: int, origin: F64, spacing: F64, starts: F64, ends: F64,
    radii: F64, margin: float,
) -> None:  # fmt: skip
    """Visit the rows of the box around every tunnel, each over the samples that its capsule can reach."""
    nz, ny, nx = shape
    hx, hy, hz = spacing[0], spacing[1], spacing[2]
    for t in range(len(starts)):
        ax, ay, az = starts[t, 0], starts[t, 1], starts[t, 2]
        ux, uy, uz = ends[t, 0] - ax, ends[t, 1] - ay, ends[t, 2] - az
        length = math.sqrt(ux * ux + uy * uy + uz * uz)
        if length > 0.0:  # else a ball: any direction will do
            ux, uy, uz = ux / length, uy / length, uz / length
        reach = radii[t] + margin
        bz, by = az + uz * length, ay + uy * length
        z0 = max(math.ceil((min(az, bz) - reach - origin[2]) / hz), first_layer)
        z1 = min(math.floor((max(az, bz) + reach - origin[2]) / hz), first_layer + nz - 1)
        y0 = max(math.ceil((min(ay, by) - reach - origin[1]) / hy), 0)
        y1 = min(math.floor((max(ay, by) + reach - origin[1]) / hy), ny - 1)
        # rows count from the sample next to the start, so that a sample's rounding depends on its position alone
        column = math.floor((ax - origin[0]) / hx)
        rest = origin[0] + column * hx - ax
        for z in range(z0, z1 + 1):
            dz = origin[2] + z * hz - az
            for y in range(y0, y1 + 1):
                dy = origin[1] + y * hy - ay
                # the part of the axis within reach of the row
                aside = dy * uy + dz * uz
                slant = 1.0 - ux * ux
                aside2 = dy * dy + dz * dz
                low, high = 0.0, length
                if slant > 1e-9:
                    square = aside * aside - slant * (aside2 - reach * reach)
                    if square < 0.0:
                        continue
                    root = math.sqrt(square)
                    low, high = max(low, (aside - root) / slant), min(high, (aside + root) / slant)
                elif aside2 > reach * reach:
                    continue
                if low > high:
                    continue
                left, right = min(low * ux, high * ux) - reach, max(low * ux, high * ux) + reach
                start = max(math.ceil((left - rest) / hx), -column)
                stop = min(math.floor((right - rest) / hx), nx - 1 - column) + 1
                if start >= stop:
                    continue
                _raise_row(
                    out, ((z - first_layer) * ny + y) * nx + column + start, stop - start,
                    np.float32(rest + start * hx), np.float32(hx), np.float32(dy), np.float32(dz),
                    np.float32(ux), np.float32(uy), np.float32(uz), np.float32(length), np.float32(radii[t]),
                )  # fmt: skip


@inline_jit
def _wall_field(distance: F32, depth: F32, half: np.float32, radius: np.float32) -> None:
    for i in range(np.uint64(len(distance))):
        a, b = distance[i] - half, depth[i]
        top, gap = max(a, b), abs(a - b)
        # the larger of both, and above it where they are within `radius` of each other (soft minimum of two)
        rest = max(radius - gap, np.float32(0.0))
        other, less = radius + rest, radius - rest
        lift = np.float32(0.5) * (other - np.sqrt(max(np.float32(2.0) * radius * radius - less * less, 0.0)))
        distance[i] = top + (lift if rest > np.float32(0.0) else np.float32(0.0))


@inline_jit
def _opening(distance: F32, depth: F32, radius: np.float32, top: np.float32) -> None:
    for i in range(np.uint64(len(distance))):
        b = max(radius + depth[i], np.float32(0.0))
        # raise the threshold near a tunnel, so that the rim of the opening is rounded
        rise = radius - np.sqrt(max(radius * radius - b * b, np.float32(0.0)))
        distance[i] = distance[i] + rise if depth[i] < np.float32(0.0) else top


def wall_field(distance: F32, depth: F32, half_thickness: float, rounding: float) -> F32:
    """Combine distance from the middle of the nearest wall and depth in tunnels, of the same shape, to a field that is
    negative in walls; `distance` is overwritten by it.

    It is the larger of ``distance - half_thickness`` and `depth`, smooth where they meet: `rounding` is the radius of
    the rims of the openings, 0 for sharp ones.
    """
    _wall_field(distance.reshape(-1), depth.reshape(-1), np.float32(half_thickness), np.float32(rounding))
    return distance


def opening(distance: F32, depth: F32, rounding: float) -> F32:
    """Half thickness above which a point is solid, so that a porosity is a quantile of it; see `wall_field`. `OPEN` in
    tunnels, which no wall closes. Overwrites `distance`.
    """
    _opening(distance.reshape(-1), depth.reshape(-1), np.float32(rounding), OPEN)
    return distance
