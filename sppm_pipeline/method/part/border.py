"""The solid of a part without what is too thin to print: a union of balls of one size, on a grid of its own.

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

from sppm_pipeline.method.assembly.occupancy import row_spans
from sppm_pipeline.method.part.opening import (
    AROUND,
    MAX_REACH,
    UNIT,
    across_planes,
    core_field,
    crossed,
    grown_field,
    in_planes,
    place_crossings,
    widened,
)
from sppm_pipeline.services.arrays import F32, F64, I16, I32
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.threads import in_bands

if TYPE_CHECKING:
    from sppm_pipeline.method.part.part import Part

PER_DIAMETER = 3.5
"""Spacings of the grid in the diameter of the ball. Edges are round to within half of a spacing, a seventh of the
diameter. At 4 as much of a knot is thin, for 1.4 times the time; at 6 the solid differs by a hundredth."""

ROOM = 0.42
"""Radius of the ball beyond half of `thinnest`, as a share of that. Voxels of a sixth of `thinnest` show solid up to
one and a half of them thinner than it is; with this room 0.5 % of a knot's solid look thinner, without it
5 %."""

LEAST = 0.86
"""Radius, in halves of `thinnest`, of the largest ball in solid that is just kept, and thickened: what is gained there
makes up for what goes, so that the porosity stays. At 0.67 struts gain a twentieth of the solid, at 1 a tenth is
lost."""

KEPT_NODES = 2**25
"""Grids of so many nodes are kept, in 64 MB, so that layers, meshes and pictures of a part make them once."""

BLOCK_SAMPLES = 2**22
"""Nodes of the grid that are made at a time: some bytes of memory for each. Only speed."""


@dataclass(frozen=True)
class Border:
    """How the solid of a part ends at its surface.

    Parameters
    ----------
    thinnest_mm : float
        Thinnest solid, as local thickness on voxels of a sixth of it shows it.
    """

    thinnest_mm: float


class _Planes:
    """Planes of some arrays, made in blocks from the bottom up; those asked for last are kept, and some below."""

    def __init__(self, make: Callable[[int, int, int], tuple[Any, ...]], below: int = 0) -> None:
        self._make, self._below = make, below
        self._start = self._stop = 0
        self._kept: tuple[Any, ...] = ()

    def clear(self) -> None:
        """Let go of all planes."""
        self._kept = ()

    def get(self, start: int, stop: int, threads: int) -> tuple[Any, ...]:
        """The planes start <= k < stop."""
        if not self._kept or not self._start <= start <= self._stop:
            self._kept, self._start, self._stop = self._make(start, stop, threads), start, stop
        if (first := start - self._below) > self._start:
            self._kept = tuple(array[first - self._start :] for array in self._kept)
            self._start = first
        if stop > self._stop:
            more = self._make(self._stop, stop, threads)
            self._kept = tuple(np.concatenate(pair) for pair in zip(self._kept, more, strict=True))
            self._stop = stop
        return tuple(array[start - self._start : stop - self._start] for array in self._kept)


class BorderSampler:
    """The solid with a border of a part that is cut at its surface."""

    def __init__(self, part: Part, border: Border) -> None:
        self._part = part
        self._edge = part.physical_edge()
        self._h = border.thinnest_mm / PER_DIAMETER
        self._radius = PER_DIAMETER / 2 * (1 + ROOM)
        self._least = PER_DIAMETER / 2 * LEAST
        self._eroded_within = math.ceil(self._radius) + 1
        self._grown_within = min(MAX_REACH, self._eroded_within + 2)
        lower, extent = np.asarray(part.domain.lower), np.asarray(part.domain.upper - part.domain.lower)
        # nodes of void around the part, as far as the field is known
        margin = self._grown_within - int(self._radius)
        nx, ny, nz = (int(n) + 2 * margin + 2 for n in np.floor(extent / self._h))
        x, y, z = ((lower - margin * self._h - part.origin_mm) / self._edge).tolist()
        self._void = np.float32((self._grown_within - self._radius) * self._h / self._edge)
        self._grid = Grid((x, y, z), (self._h / self._edge,) * 3, (nx, ny, nz))
        self._spans = _Planes(self._make_spans, below=4 * MAX_REACH)
        self._crossed, self._core, self._field = (
            _Planes(make) for make in (self._make_crossed, self._make_core, self._make_field)
        )
        self._whole: I16 | None = None
        if nx * ny * nz <= KEPT_NODES:  # no memory is used before it is written
            self._whole, self._made = np.empty((nz, ny, nx), np.int16), np.zeros(nz, np.bool_)
        self._lock = Lock()

    def sample(self, grid: Grid, start: int, stop: int, threads: int = 1, spans: I32 | None = None) -> F32:
        """The field in cell sizes at layers of a grid, (stop - start, ny, nx); only within `spans` if given.

        Beyond the grid of the part, and beside the spans, it is void.
        """
        nx, ny, nz = self._grid.shape
        places = [(grid.axis(axis) - self._grid.origin[axis]) / self._grid.spacing[axis] for axis in range(3)]
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
                planes = self._planes(low, int(z[some - 1]) + 2, threads)

                def work(a: int, b: int, first: int = first, low: int = low, planes: I16 = planes) -> None:
                    a, b = a + first, b + first
                    unit = np.float32(self._h / self._edge / UNIT)
                    _interpolate(planes, z[a:b] - low, places[1], places[0], spans[a:b], unit, out[a:b])

                in_bands(work, some - first, threads)
                first = some
        return out

    def _planes(self, low: int, high: int, threads: int) -> I16:
        """The field at planes low <= k < high of the part's own grid, in spacings times `UNIT`."""
        if self._whole is None:
            return np.asarray(self._field.get(low, high, threads)[0])
        missing = np.flatnonzero(~self._made[low:high]) + low
        if len(missing):
            first, last = int(missing[0]), int(missing[-1]) + 1
            self._whole[first:last] = self._field.get(first, last, threads)[0]
            self._made[first:last] = True
        if self._made.all():  # what others are made from has no use any more
            for planes in (self._spans, self._crossed, self._core, self._field):
                planes.clear()
        return self._whole[low:high]

    def _make_spans(self, start: int, stop: int, threads: int) -> tuple[Any, ...]:
        """Span of each row that lies in the domain; none beyond the grid."""
        low, high = max(0, start), min(self._grid.shape[2], stop)
        spans = np.zeros((stop - start, self._grid.shape[1], 2), np.int32)
        if low < high:
            inside = self._part.inside_zyx(self._grid, low, high)
            spans[low - start : high - start] = row_spans(inside)
        return (spans,)

    def _spans_around(self, start: int, stop: int, above: int, beside: int, threads: int) -> I32:
        spans = self._spans.get(start - above, stop + above, threads)[0]
        return widened(spans, above, beside, self._grid.shape[0])

    def _make_crossed(self, start: int, stop: int, threads: int) -> tuple[Any, ...]:
        """Crossings of the solid and of the domain, and the squared distances from them in each plane."""
        nz = self._grid.shape[2]
        # beyond the grid things go on as at its end, which is void
        low, high = min(max(0, start), nz - 1), max(min(nz, stop + 1), 1)
        more = self._eroded_within + AROUND
        wanted = self._spans_around(low, high, more + 1, more + 1, threads)
        inner, skin, outer, found = self._part.cut_zyx(self._grid, threads, low, high, wanted)
        rows = np.clip(np.arange(start, stop + 1), low, high - 1) - low
        if len(rows) != high - low:
            inner, outer = inner[rows], outer[rows]
            skin = None if skin is None else skin[rows]
        spans = self._spans_around(start, stop, more, more, threads)
        solid = crossed(inner, skin, spans, threads, self._part.base.sum_level or 0.0)
        domain = crossed(outer, None, spans, threads)
        place_crossings(domain, found, start)
        flat, domain_flat = (in_planes(made, spans, self._eroded_within, threads) for made in (solid, domain))
        return solid.solid, solid.z, flat, domain.solid, domain.z, domain_flat

    def _make_core(self, start: int, stop: int, threads: int) -> tuple[Any, ...]:
        reach, above = self._eroded_within, self._grown_within
        first, last = start - AROUND, stop + 1 + AROUND
        solid, z, flat, domain, domain_z, domain_flat = self._crossed.get(first - reach, last + reach, threads)
        spans = self._spans_around(first, last, AROUND, AROUND, threads)
        depth = across_planes(z, flat, spans, reach, reach, threads)
        within = across_planes(domain_z, domain_flat, spans, reach, reach, threads)
        own = slice(reach, reach + last - first)
        within *= domain[own]
        spans = self._spans_around(start, stop + 1, 0, 0, threads)
        field = core_field(solid[own], depth, within, spans, self._radius, self._least, threads)
        spans = self._spans_around(start, stop, above, above - int(self._radius), threads)
        core = crossed(field, None, spans, threads)
        return core.solid, core.z, in_planes(core, spans, above, threads)

    def _make_field(self, start: int, stop: int, threads: int) -> tuple[Any, ...]:
        reach = self._grown_within
        core, z, flat = self._core.get(start - reach, stop + reach, threads)
        more = reach - int(self._radius)
        spans = self._spans_around(start, stop, more, more, threads)
        squares = across_planes(z, flat, spans, reach, reach, threads)
        return (grown_field(core[reach : reach + stop - start], squares, self._radius, reach, threads),)


@jit
def _interpolate(planes: I16, z: F64, y: F64, x: F64, spans: I32, unit: np.float32, out: F32) -> None:
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
            p, q = planes[below, front], planes[below, front + 1]
            r, s = planes[below + 1, front], planes[below + 1, front + 1]
            for i in range(a, b):
                low = (np.float32(1) - wy) * np.float32(p[i]) + wy * np.float32(q[i])
                high = (np.float32(1) - wy) * np.float32(r[i]) + wy * np.float32(s[i])
                row[i] = unit * ((np.float32(1) - wz) * low + wz * high)
            for i in range(first, last):
                if x[i] < 0 or x[i] >= nx - 1:
                    continue
                at = int(x[i])
                out[k, j, i] = row[at] + np.float32(x[i] - at) * (row[at + 1] - row[at])
