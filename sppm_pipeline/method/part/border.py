"""The solid of a part without what is too thin to print: opened by a ball, on a grid of its own.

The grid belongs to the part, so the result at a place is the same in layers, meshes and pictures, whatever grid they
are sampled on, and on any slab; between its nodes the field, about a distance, is interpolated linearly. Planes are
made from the bottom up, and those that the next ones need are kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from sppm_pipeline.method.part.opening import (
    AROUND,
    MAX_REACH,
    across_planes,
    core_field,
    crossed,
    in_planes,
    opened_field,
)
from sppm_pipeline.services.arrays import F32, F64, I32, I64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.threads import in_bands

if TYPE_CHECKING:
    from sppm_pipeline.method.part.part import Part

PER_DIAMETER = 6
"""Spacings of the grid in the diameter of the ball. Solid that is thicker than the diameter by less than half a spacing
may still be lost, as its middle lies between nodes: a twelfth of the diameter. Twice as many take eight times as long."""

ROOM = 1.0
LEAST = 2.0

BLOCK_SAMPLES = 2**22
"""Nodes of the grid that are made at a time: some bytes of memory for each. Only speed."""


@dataclass(frozen=True)
class Border:
    """How the solid of a part ends at its surface."""

    thinnest_mm: float  # diameter of the ball by which the solid is opened


class _Planes:
    """Planes of some arrays, made in blocks from the bottom up; those asked for last, and above, are kept."""

    def __init__(self, make: Callable[[int, int, int], tuple[Any, ...]]) -> None:
        self._make = make
        self._start = self._stop = 0
        self._kept: tuple[Any, ...] = ()

    def get(self, start: int, stop: int, threads: int) -> tuple[Any, ...]:
        """The planes start <= k < stop."""
        if not self._start <= start <= self._stop or not self._kept:
            self._kept, self._start, self._stop = self._make(start, stop, threads), start, stop
        if start > self._start:
            self._kept = tuple(array[start - self._start :] for array in self._kept)
            self._start = start
        if stop > self._stop:
            more = self._make(self._stop, stop, threads)
            self._kept = tuple(np.concatenate(pair) for pair in zip(self._kept, more, strict=True))
            self._stop = stop
        return tuple(array[: stop - start] for array in self._kept)


class BorderSampler:
    """The opened solid of a part that ends at its surface as cut, for grids of one spacing or less.

    `spacing` is the largest of the grids that will be sampled, mm: so far from its surface the field is a distance.
    """

    def __init__(self, part: Part, border: Border, spacing: float) -> None:
        self._part = part
        self._edge = part.physical_edge()
        self._h = border.thinnest_mm / PER_DIAMETER
        self._radius = PER_DIAMETER / 2 + ROOM
        self._least = LEAST
        self._eroded_within = math.ceil(self._radius) + 1
        self._grown_within = min(MAX_REACH, math.ceil(self._radius + max(1.0, spacing / self._h)))
        self.spacing = spacing
        lower, extent = np.asarray(part.domain.lower), np.asarray(part.domain.upper - part.domain.lower)
        # nodes of void around the part, as far as the field is known
        margin = self._grown_within - math.floor(self._radius)
        nx, ny, nz = (int(n) + 2 * margin + 2 for n in np.floor(extent / self._h))
        x, y, z = ((lower - margin * self._h - part.origin_mm) / self._edge).tolist()
        self._void = np.float32((self._grown_within - self._radius) * self._h / self._edge)
        self._grid = Grid((x, y, z), (self._h / self._edge,) * 3, (nx, ny, nz))
        self._crossed, self._core, self._field = (
            _Planes(make) for make in (self._make_crossed, self._make_core, self._make_field)
        )
        self._lock = Lock()

    def sample(self, grid: Grid, start: int, stop: int, threads: int = 1, spans: I32 | None = None) -> F32:
        """The field in cell sizes at layers of a grid, (stop - start, ny, nx); only within `spans` if given.

        Beyond the grid of the part, and beside the spans, it is void.
        """
        nx, ny, nz = self._grid.shape
        places = [
            (grid.axis(axis) - self._grid.origin[axis]) / self._grid.spacing[axis] for axis in range(3)
        ]
        out = np.full((stop - start, *grid.shape[1::-1]), self._void)
        z = places[2][start:stop]
        inside = np.flatnonzero((z >= 0) & (z < nz - 1))
        if not len(inside):
            return out
        if spans is None:
            spans = np.tile(np.array([0, grid.shape[0]], np.int32), (stop - start, grid.shape[1], 1))
        first, last = int(inside[0]), int(inside[-1]) + 1
        most = max(2, BLOCK_SAMPLES // (nx * ny))
        with self._lock:  # planes are kept from call to call
            while first < last:
                low = int(z[first])
                some = first + int(np.searchsorted(z[first:last], low + most - 1))
                some = min(last, max(some, first + 1))
                planes = self._field.get(low, int(z[some - 1]) + 2, threads)[0]

                def work(a: int, b: int, first: int = first, low: int = low, planes: F32 = planes) -> None:
                    a, b = a + first, b + first
                    _interpolate(
                        planes, z[a:b] - low, places[1], places[0], spans[a:b], out[a:b]
                    )

                in_bands(work, some - first, threads)
                first = some
        return out

    def _make_crossed(self, start: int, stop: int, threads: int) -> tuple[Any, ...]:
        """Crossings of the solid and of the domain, and the squared distances from them in each plane."""
        from sppm_pipeline.method.kernels.profiles import log_of_sums

        nz = self._grid.shape[2]
        # beyond the grid things go on as at its end, which is void
        low, high = min(max(0, start), nz - 1), max(min(nz, stop + 1), 1)
        inner, skin, outer = self._part.fields_zyx(self._grid, threads, low, high)
        if (level := self._part.base.sum_level) is not None:
            inner = log_of_sums(inner, level)
        rows = np.clip(np.arange(start, stop + 1), low, high - 1) - low
        if len(rows) != high - low:
            inner, outer = inner[rows], outer[rows]
            skin = None if skin is None else skin[rows]
        solid, domain = crossed(inner, skin, threads), crossed(outer, None, threads)
        reach = self._eroded_within
        return *solid, in_planes(solid, reach, threads), domain.solid, domain.z, in_planes(domain, reach, threads)

    def _make_core(self, start: int, stop: int, threads: int) -> tuple[Any, ...]:
        reach = self._eroded_within
        first, last = start - AROUND, stop + 1 + AROUND
        solid, _, _, z, flat, domain, domain_z, domain_flat = self._crossed.get(first - reach, last + reach, threads)
        depth = across_planes(z, flat, reach, last - first, reach, threads)
        within = across_planes(domain_z, domain_flat, reach, last - first, reach, threads)
        within *= domain[reach : reach + last - first]
        own = solid[reach : reach + last - first]
        field = core_field(own, depth, within, AROUND, stop + 1 - start, self._radius, self._least, threads)
        core = crossed(field, None, threads)
        return core.solid, core.z, in_planes(core, self._grown_within, threads)

    def _make_field(self, start: int, stop: int, threads: int) -> tuple[Any, ...]:
        reach = self._grown_within
        core, z, flat = self._core.get(start - reach, stop + reach, threads)
        squares = across_planes(z, flat, reach, stop - start, reach, threads)
        field = opened_field(core[reach : reach + stop - start], squares, self._radius, reach, threads)
        field *= np.float32(self._h / self._edge)
        return (field,)


@jit
def _interpolate(planes: F32, z: F64, y: F64, x: F64, spans: I32, out: F32) -> None:
    """Linear interpolation in planes at the places z, y, x, counted in nodes, in spans of rows."""
    _, ny, nx = planes.shape
    row = np.empty(nx, np.float32)
    for k in range(z.size):
        below = int(z[k])
        wz = np.float32(z[k] - below)
        for j in range(y.size):
            first, last = spans[k, j, 0], spans[k, j, 1]
            front = int(np.floor(y[j]))
            if front < 0 or front >= ny - 1 or first >= last:
                continue
            wy = np.float32(y[j] - front)
            a, b = max(0, int(x[first])), min(nx, int(x[last - 1]) + 2)
            p, q, r, s = planes[below, front], planes[below, front + 1], planes[below + 1, front], planes[below + 1, front + 1]
            for i in range(a, b):
                low = p[i] + wy * (q[i] - p[i])
                high = r[i] + wy * (s[i] - r[i])
                row[i] = low + wz * (high - low)
            for i in range(first, last):
                if x[i] < 0 or x[i] >= nx - 1:
                    continue
                at = int(x[i])
                out[k, j, i] = row[at] + np.float32(x[i] - at) * (row[at + 1] - row[at])
