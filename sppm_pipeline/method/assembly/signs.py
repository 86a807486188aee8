"""Solid samples of a tiling, slab by slab of a grid: bounds decide most samples, kernels the rest."""

from __future__ import annotations

import math
from collections.abc import Callable
from threading import Lock, local
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.assembly.gather import Catalog, kernels_in_box
from sppm_pipeline.method.kernels.kernels import Kernels, kernel_reaches, steepest
from sppm_pipeline.method.kernels.level_spline import LayerSpline
from sppm_pipeline.method.kernels.open_samples import resolver
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES
from sppm_pipeline.method.kernels.signs import (
    Bounds,
    Levels,
    coarse_grid,
    coarse_layers,
    coarse_rows,
    crowd_of,
    decide_rows,
    find_bounds,
)
from sppm_pipeline.method.kernels.splat import Prepared, add_prepared, prepared
from sppm_pipeline.method.kernels.stretched import packed_capsules
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.threads import share_out

# Cells whose kernels are listed together, and kernels of such lists that are kept: 12 MB.
_SITES, _KEPT = 600, 60_000


class _Near(NamedTuple):
    """The kernels near a box of the grid, for rows of coarse samples and for single ones, and the bounds there."""

    coarse: Prepared
    pores: NDArray[np.float64]
    tunnels: NDArray[np.float64]
    bounds: Bounds


class SignSampler:
    """A tiling on one grid, solid where its sum of kernels lies below a level; lists of kernels are kept for a while.

    The grid is in cell sizes; there are bounds, with these `steps`, for it and the levels. `spline` of a grid, start,
    stop is ln C in some layers of it, where the level is a function of place. Threads may ask for different layers at
    once.
    """

    def __init__(
        self,
        catalog: Catalog,
        tiling: TilingArrays,
        grid: Grid,
        levels: Levels,
        steps: tuple[int, int, int],
        spline: Callable[[Grid, int, int], LayerSpline] | None = None,
    ) -> None:
        self._catalog, self._tiling, self._grid, self._levels, self._steps = catalog, tiling, grid, levels, steps
        self._spline = spline
        self._steepest = steepest(catalog.kernels)
        kinds = PORE_PROFILE, TUNNEL_PROFILES[catalog.kernels.profile]
        self._reaches = tuple(kind.scaled_reach(catalog.cutoff) for kind in kinds)
        self._coarse = coarse_grid(grid, steps)
        # boxes that belong to the grid, so that the next slab finds their kernels listed
        self._height = max(8, int(0.5 / grid.spacing[2]))
        cells_a_row = 2.0 + grid.shape[0] * grid.spacing[0]
        rows = max(16, int(_SITES / (3.0 * cells_a_row) / grid.spacing[1]))
        unit = 8 * steps[1]
        self._rows = min(-(-rows // unit) * unit, grid.shape[1])
        self._lists: dict[tuple[int, int], _Near] = {}
        self._lock, self._scratch = Lock(), local()

    def sample(self, start: int, stop: int, threads: int, wanted: NDArray[np.int32] | None) -> NDArray[np.uint8]:
        """1 where solid, 0 where not or not wanted, in the layers start <= k < stop, (stop - start, ny, nx) uint8."""
        nx, ny, _ = self._grid.shape
        if wanted is None:
            wanted = np.tile(np.array([0, nx], np.int32), (stop - start, ny, 1))
        out = np.zeros((stop - start, ny, nx), np.uint8)
        for first in range(start - start % self._height, stop, self._height):
            low, high = max(start, first), min(stop, first + self._height)
            own = slice(low - start, high - start)
            for row in range(0, ny, self._rows):
                rows = row, min(row + self._rows, ny)
                if (wanted[own, slice(*rows), 0] < wanted[own, slice(*rows), 1]).any():
                    self._decide(first // self._height, low, rows, threads, wanted[own], out[own])
        return out

    def _decide(
        self,
        number: int,
        start: int,
        rows: tuple[int, int],
        threads: int,
        wanted: NDArray[np.int32],
        out: NDArray[np.uint8],
    ) -> None:
        """Decide some rows of the layers from `start` on, which lie in one box."""
        _, sy, sz = self._steps
        near = self._listed(number, rows)
        first, stop = coarse_layers(start, start + len(out), sz)
        # coarse rows of these rows alone: wanted parts of others count for nothing
        own = np.zeros_like(wanted)
        own[:, slice(*rows)] = wanted[:, slice(*rows)]
        low, high = rows[0] // sy, -(-(rows[1] - 1) // sy) + 1
        box = self._box(low, high)
        asked = np.ascontiguousarray(coarse_rows(own, self._steps, start, self._coarse)[:, low:high])
        sums = self._zeros((stop - first, high - low, self._coarse.shape[0]))
        add_prepared(sums, box, near.coarse, threads, first, asked)
        if self._spline is not None:
            self._over_level(sums, first, low, self._spline)
        kernels = near.pores, self._reaches[0], near.tunnels, self._reaches[1]
        origin, spacing = np.array(self._grid.origin), np.array(self._grid.spacing)
        bounds, resolve = near.bounds, resolver(near.coarse.profile)

        def decide(begin: int) -> None:
            part = begin, min(begin + step, rows[1])
            asked = own[:, slice(*part)]
            count = int(np.maximum(asked[..., 1] - asked[..., 0], 0).sum())
            # room for all; what is not used is never given by the system
            still_open = np.empty(asked.shape[0] * asked.shape[1] + 1, np.int64), np.empty(count + 8, np.int32)
            limits = bounds.solid, bounds.void
            decide_rows(sums, first, low, bounds.steps, *limits, start, *part, own, out, *still_open)
            levels = self._levels_at(start, *part, *still_open)
            resolve(out, start, *part, *still_open, origin, spacing, *kernels, levels)

        step = max(8, -(-(rows[1] - rows[0]) // (4 * threads) // 8) * 8) if threads > 1 else rows[1] - rows[0]
        share_out(decide, range(*rows, step), threads)

    def _over_level(
        self, sums: NDArray[np.float32], first: int, low: int, spline: Callable[[Grid, int, int], LayerSpline]
    ) -> None:
        """Coarse sums G in layers and rows from the first ones on become G / C times the mean level."""
        made = spline(self._coarse, first, first + len(sums))
        rows, columns = slice(low, low + sums.shape[1]), slice(0, sums.shape[2])
        for k in range(len(sums)):
            factor = made.less(math.log(self._levels.mean), k, rows, columns)
            sums[k] *= np.exp(factor, out=factor)

    def _levels_at(
        self, start: int, row: int, stop: int, open_from: NDArray[np.int64], open_x: NDArray[np.int32]
    ) -> NDArray[np.float32]:
        """The level, or that at each open sample of some rows of layers from `start` on."""
        if self._spline is None:
            return np.array([self._levels.mean], np.float32)
        levels = np.empty(max(2, int(open_from[-1])), np.float32)
        height = stop - row
        layers = (len(open_from) - 1) // height
        made = self._spline(self._grid, start, start + layers)
        for k in range(layers):
            made.at(k, range(row, stop), open_from[k * height : (k + 1) * height + 1], open_x, levels)
        return np.asarray(np.exp(levels, out=levels))

    def _zeros(self, shape: tuple[int, int, int]) -> NDArray[np.float32]:
        """Zeros in memory that this thread uses again: to be given it afresh takes as long as to decide."""
        size = math.prod(shape)
        kept: NDArray[np.float32] | None = getattr(self._scratch, "sums", None)
        if kept is None or len(kept) < size:
            kept = self._scratch.sums = np.empty(size, np.float32)
        zeros = kept[:size].reshape(shape)
        zeros[:] = 0
        return zeros

    def _box(self, low: int, high: int) -> Grid:
        """Some rows of the coarse grid, all layers."""
        (x, y, z), spacing, (nx, _, nz) = self._coarse
        return Grid((x, y + low * spacing[1], z), spacing, (nx, high - low, nz))

    def _listed(self, number: int, rows: tuple[int, int]) -> _Near:
        """The kernels near a box, which is listed unless that has been done lately."""
        key = number, rows[0]
        with self._lock:
            if key not in self._lists:
                _, sy, sz = self._steps
                start, end = number * self._height, min((number + 1) * self._height, self._grid.shape[2])
                first, stop = coarse_layers(start, end, sz)
                box = self._box(rows[0] // sy, -(-(rows[1] - 1) // sy) + 1).layers(first, stop)
                lower = np.array(box.origin)
                upper = lower + np.array(box.spacing) * (np.array(box.shape) - 1)
                kernels = kernels_in_box(self._catalog, self._tiling, lower, upper)
                cutoff = self._catalog.cutoff
                pores, tunnels = packed_capsules(kernels, box, cutoff)
                near = _Near(prepared(kernels, box, cutoff), pores, tunnels, self._bounds(kernels))
                kept = len(near.pores) + len(near.tunnels)
                for other in reversed(list(self._lists)):
                    kept += len(self._lists[other].pores) + len(self._lists[other].tunnels)
                    if kept > _KEPT:
                        del self._lists[other]
                self._lists[key] = near
            return self._lists[key]

    def _bounds(self, kernels: Kernels) -> Bounds:
        """The bounds where these kernels, and no others, are within reach."""
        cutoff, spacing = self._catalog.cutoff, self._grid.spacing
        reach = float(kernel_reaches(kernels, cutoff)[0].max(initial=0)) + max(self._coarse.spacing)
        crowd = crowd_of(kernels.centers, reach)
        bounds = find_bounds(*self._steepest, kernels.profile, self._levels, spacing, cutoff, crowd)
        assert bounds is not None
        return bounds
