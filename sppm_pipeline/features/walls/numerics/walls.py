"""Walls of a tiling: Voronoi cells of its pores, made lattice site by lattice site where samples need them."""

from __future__ import annotations

import math
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.walls.numerics.cells import VoronoiCells, voronoi_cells
from sppm_pipeline.features.walls.numerics.distance import UNCLAIMED, raise_to_distance
from sppm_pipeline.features.walls.numerics.windows import raise_to_depth
from sppm_pipeline.method.assembly.contents import Pieces, TilingArrays
from sppm_pipeline.method.assembly.gather import Catalog, kernels_in_box, make_catalog
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit

RADIUS_LEVEL = math.exp(-1)
"""Value of a tunnel's kernel ``exp(-mu d)`` at its radius 1 / mu."""

# Bytes of Voronoi cells that are kept for the next layers.
_KEPT_BYTES = 96 * 2**20
# Points along the edge of a cell at which the distance to the nearest pore is measured.
_PROBES = 8
# No point of a cell with a pore lies farther from it than its diagonal.
_DIAGONAL = math.sqrt(3)


class WallSampler:
    """Distances from walls and depths in tunnels of one tiling, on any grid.

    Parameters
    ----------
    pieces : Pieces
        Pores are points; tunnels are capsules of radius ``1 / mu``.
    tiling : TilingArrays
    rounding : float
        Radius of the fillets where walls meet, cell sizes.
    margin : float
        Samples farther than this from a tunnel have the depth ``-margin``.
    """

    def __init__(self, pieces: Pieces, tiling: TilingArrays, rounding: float, margin: float) -> None:
        self._catalog: Catalog = make_catalog(pieces, RADIUS_LEVEL)
        self._tiling = tiling
        self._rounding, self._margin = rounding, margin
        self.empty = largest_empty_radius(pieces)
        self._sites: OrderedDict[tuple[int, int, int], VoronoiCells] = OrderedDict()
        self._bytes, self._lock = 0, Lock()

    def sample(
        self, grid: Grid, start: int, stop: int, threads: int = 1
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Distance from the middle of the nearest wall, and depth in tunnels (negative outside), cell sizes.

        Both (stop - start, ny, nx), for the layers start <= k < stop. Where there are no cells, there are no walls:
        points beyond the largest empty radius have that as their distance.
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

    def _cells_near(self, lower: NDArray[np.float64], upper: NDArray[np.float64], threads: int) -> list[VoronoiCells]:
        """The Voronoi cells that may meet a box, in the order of their sites; one set for each image of a site."""
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
        """The cells of the pores in the unit cube at a site."""
        with self._lock:
            found = self._sites.get(site)
            if found is not None:
                self._sites.move_to_end(site)
                return found
        corner = np.array(site, np.float64)
        reach = 2 * self.empty
        points = kernels_in_box(self._catalog, self._tiling, corner - reach, corner + 1 + reach).centers
        owners = np.flatnonzero((np.floor(points) == corner).all(1))
        found = voronoi_cells(points, owners, self.empty)
        with self._lock:
            self._sites[site] = found
            self._bytes += found.planes.nbytes
            while self._bytes > _KEPT_BYTES and len(self._sites) > 1:
                self._bytes -= self._sites.popitem(last=False)[1].planes.nbytes
        return found


def largest_empty_radius(pieces: Pieces) -> float:
    """Bound on the distance of any point of a tiling's cells from the nearest pore, from each interior alone."""
    found = _farthest_probe(pieces.kernels.centers, pieces.first_pore[: pieces.interiors + 1], _PROBES)
    return min(found + _DIAGONAL / (2 * _PROBES), _DIAGONAL)


@jit
def _farthest_probe(centers: NDArray[np.float64], first: NDArray[np.int64], probes: int) -> float:
    """Largest distance of the centers of probes^3 parts of a cell from the nearest pore of its interior."""
    most = 0.0
    for t in range(len(first) - 1):
        for i in range(probes**3):
            x, y, z = i % probes, i // probes % probes, i // probes**2
            least = np.inf
            for p in range(first[t], first[t + 1]):
                dx, dy = (x + 0.5) / probes - centers[p, 0], (y + 0.5) / probes - centers[p, 1]
                dz = (z + 0.5) / probes - centers[p, 2]
                least = min(least, dx * dx + dy * dy + dz * dz)
            most = max(most, least)
    return math.sqrt(most)
