"""The porosity of bent cells: sampled in their own coordinates, and tuned by a level that varies between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.grading.curved_cells import CurvedCells
from sppm_pipeline.features.grading.laid_graph import WarpedTiling
from sppm_pipeline.features.grading.local_porosity import MIN_SHARE
from sppm_pipeline.features.grading.numerics.cell_level import (
    CellSamples,
    ControlLattice,
    blending,
    fit_cells,
    means_over_cells,
    porosities_and_slopes,
)
from sppm_pipeline.features.grading.numerics.local_level import LevelFit
from sppm_pipeline.features.grading.warped_field import WarpedField, cubic_in_layers, linear_in_layers
from sppm_pipeline.method.fields.kernel_sum import KernelSum
from sppm_pipeline.method.fields.level_field import LevelField
from sppm_pipeline.method.fields.scalar_field import ScalarField, WrappedField
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.services.arrays import F32, F64, I32, I64, Bools
from sppm_pipeline.services.grid import Grid

POINTS = 4
"""Points along each axis of a cell whose mean is that of a map over the cell."""

FINER, FINEST = 0.75, 1.5
"""Spacing of the samples between which values are interpolated, over that from which the field may be; and the most of
them along the smallest cell, over the number of points there: kernels outside of the cells may be finer by far."""

PER_CELL = 3.0
"""Control points of a level along the shortest edge of any cell. A heuristic: with half as many the
spline blurs what differs from cell to cell; twice as many take eight times the memory."""

MAX_CONTROL = 2**24
"""Control points at most; cells that differ more in size get fewer each."""

SLAB, AT_ONCE, MIN_LAYERS = 1 << 23, 1 << 21, 4
"""Samples of the field, and points in cells, that are processed together (32 and 50 MB); and the minimum of layers."""

MORE_LAYERS = 3
"""Layers beyond those of a slab that cubic interpolation needs."""


def curved_cells_of(field: ScalarField) -> CurvedCells | None:
    """The bent cells of a field, of a part filled with it, or of a field made from it; None of others."""
    while isinstance(field, WrappedField):
        field = field.base
    return field.curved if isinstance(field, (WarpedTiling, WarpedField)) else None


def curved_targets(grading: Grading, name: str, curved: CurvedCells) -> F64:
    """Means of a map over bent cells, by volume, (m,)."""
    points, volume = curved.inner(POINTS)
    values = grading[name].at(points.reshape(-1, 3)).reshape(volume.shape)
    return np.asarray((values * volume).sum(axis=1) / volume.sum(axis=1))


class CellShares(NamedTuple):
    """Shares of each bent cell, all (m,): of what lies in the part, and of void in that."""

    share: F64
    porosity: F64


class Found(NamedTuple):
    """Points (k, 3) in cells, mm: cells, volumes that they stand for, values of the field, whether the part holds
    them.
    """

    points: F64
    cell: I32
    volume: F64
    value: F32
    inside: Bools


def _layers_of_a_slab(layer: float) -> int:
    """Layers of so many samples that are taken together."""
    return max(MIN_LAYERS, int(SLAB // max(layer, 1.0)))


def most_samples(nx: float, ny: float, nz: float) -> float:
    """Samples of a grid that are held at a time."""
    return min(nz, _layers_of_a_slab(nx * ny) + MORE_LAYERS) * nx * ny


class CurvedSamples:
    """A field at n x n x n points in each of its bent cells, evenly in the cell's own coordinates.

    Cells end where they end, not at voxels. The field is sampled on a fine grid, a slab after the other, and
    interpolated by cubics; the distance from the domain of a part, linearly.
    """

    def __init__(self, field: ScalarField, curved: CurvedCells, n: int, threads: int = 1) -> None:
        self.field, self.curved, self.n, self._threads = field, curved, n, threads
        self._edge, self._origin = field.physical_edge(), np.array(field.origin_mm)
        inner = field.base if isinstance(field, Part) else field
        # one grid for all cells: fine enough for the smallest one, and not finer than kernels are smooth
        h = float(np.cbrt(curved.volumes.min())) / (FINEST * n) / self._edge
        pitch = inner.coarse_pitch if isinstance(inner, KernelSum) and inner.additive else None
        if pitch is not None:
            h = max(h, FINER * pitch)  # no finer than it is smooth
        low, high = (curved.box - self._origin) / self._edge
        # a few more, as curved faces bulge between the points by which the box was found
        first = np.floor(low / h).astype(int) - 3 - n // 8
        nx, ny, nz = (np.ceil(high / h).astype(int) - first + 4 + n // 8).tolist()
        x, y, z = ((first + 0.5) * h).tolist()
        self.grid = Grid((x, y, z), (h, h, h), (nx, ny, nz))

    def _slabs(self) -> Iterator[tuple[int, int, I64]]:
        """First layer and the one after the last between which points lie, and the cells that reach there."""
        corner = np.stack(np.meshgrid(*(np.linspace(0, 1, 9),) * 3, indexing="ij"), -1).reshape(-1, 3)
        low, high = np.empty(self.curved.count), np.empty(self.curved.count)
        for first in range(0, self.curved.count, 1000):
            cells = np.arange(first, min(first + 1000, self.curved.count))
            z = self.curved.points(np.repeat(cells, len(corner)), np.tile(corner, (len(cells), 1)))[:, 2]
            z = self._place(z.reshape(len(cells), -1), 2)
            low[cells], high[cells] = z.min(axis=1), z.max(axis=1)
        slack = 0.05 * (high - low) + 1e-6
        nx, ny, nz = self.grid.shape
        layers = _layers_of_a_slab(nx * ny)
        for start in range(1, nz - 2, layers):
            stop = min(start + layers, nz - 2)
            yield start, stop, np.flatnonzero((low - slack < stop) & (high + slack >= start))

    def _place(self, positions: F64, axis: int) -> F64:
        """Positions along an axis, mm, counted in samples from the first one."""
        in_cells = (positions - self._origin[axis]) / self._edge
        return np.asarray((in_cells - self.grid.origin[axis]) / self.grid.spacing[axis])

    def found(self, progress: Callable[[int, int], None] = lambda done, of: None) -> Iterator[Found]:
        """All points, slab after slab."""
        for start, stop, cells in self._slabs():
            if len(cells):
                yield from self._in_slab(start, stop, cells)
            progress(stop, self.grid.shape[2])

    def _in_slab(self, start: int, stop: int, cells: I64) -> Iterator[Found]:
        first, last = start - 1, stop + 2
        # one layer before and two behind a slab, for cubics at its border
        distance = None
        if isinstance(self.field, Part):
            values, distance = self.field.apart_zyx(self.grid, self._threads, first, last)
        else:
            values = self.field.sample_zyx(self.grid, first, last, self._threads)
        size = self.n**3
        for begin in range(0, len(cells), max(1, AT_ONCE // size)):
            some = cells[begin : begin + max(1, AT_ONCE // size)]
            points, volume = self.curved.inner(self.n, some)
            points = points.reshape(-1, 3)
            layer = self._place(points[:, 2], 2)
            own = np.flatnonzero((layer >= start) & (layer < stop))
            points, place = points[own], np.empty((len(own), 3))
            place[:, 0], place[:, 1] = self._place(points[:, 0], 0), self._place(points[:, 1], 1)
            place[:, 2] = layer[own] - first
            inside = np.ones(len(own), bool) if distance is None else linear_in_layers(distance, place) < 0
            yield Found(
                points, some[own // size].astype(np.int32), volume.reshape(-1)[own],
                cubic_in_layers(values, place), inside,
            )  # fmt: skip

    def shares(self, progress: Callable[[int, int], None] = lambda done, of: None) -> CellShares:
        """Share of each cell in the part, and its porosity."""
        whole, inside, void = np.zeros((3, self.curved.count))
        for some in self.found(progress):
            whole += np.bincount(some.cell, some.volume, self.curved.count)
            there = some.volume * some.inside
            inside += np.bincount(some.cell, there, self.curved.count)
            void += np.bincount(some.cell, there * (some.value >= 0), self.curved.count)
        return CellShares(inside / whole, void / np.maximum(inside, 1e-300))

    def for_level(self, lattice: ControlLattice) -> tuple[list[CellSamples], F64]:
        """Samples in the part, of ln G for a sum G of kernels or of the field, and the share of each cell in it."""
        inner = self.field.base if isinstance(self.field, Part) else self.field
        level = inner.solid_below if isinstance(inner, KernelSum) and inner.additive else None
        made, totals = [], np.zeros((2, self.curved.count))
        for some in self.found():
            totals[0] += np.bincount(some.cell, some.volume, self.curved.count)
            totals[1] += np.bincount(some.cell, some.volume * some.inside, self.curved.count)
            value = some.value
            if level is not None:
                # ln G is nearly linear in the distance near the surface, so that cubics and Newton steps do well
                value = np.log(np.maximum(value + np.float32(level), np.float32(1e-9)))
            place = (some.points - lattice.origin) / lattice.edge
            parts = (place.astype(np.float32), some.cell, value, some.volume.astype(np.float32))
            kept = slice(None) if some.inside.all() else some.inside
            made.append(CellSamples(parts[0][kept], parts[1][kept], parts[2][kept], parts[3][kept]))
        return made, totals[1] / totals[0]


def control_lattice(field: ScalarField, curved: CurvedCells) -> tuple[ControlLattice, int]:
    """The lattice of a level over the cells of a field, and its control points along an edge of these."""
    edge = field.physical_edge()
    # the least stretch of any cell in any direction
    smallest = float(np.linalg.svd(curved.frames, compute_uv=False).min())
    most = math.floor((MAX_CONTROL / math.prod(field.cells)) ** (1 / 3))
    parts = max(1, min(math.ceil(PER_CELL * edge / smallest), most))
    nx, ny, nz = (parts * n for n in field.cells)
    return ControlLattice((nx, ny, nz), edge / parts, np.array(field.origin_mm)), parts


def fit_curved_level(
    samples: CurvedSamples,
    bare: ScalarField,
    targets: F64,
    start: float,
    bounds: tuple[float, float],
    near: float,
    tolerance: float,
    evaluations: int,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> tuple[LevelField, LevelFit, Bools]:
    """The field with a level that gives each cell its porosity, the fit, and which cells had an equation."""
    curved = samples.curved
    lattice, parts = control_lattice(bare, curved)
    blend = blending(lattice, curved.centers, curved.frames)
    means = means_over_cells(lattice, blend, lambda first, stop: curved.inner(POINTS, np.arange(first, stop)))
    found, share = samples.for_level(lattice)
    known = share >= MIN_SHARE
    if not known.any():
        raise DesignError("no cell lies in the part", hint="give smaller cells")
    done = 0

    def control(values: F64) -> F64:
        return np.asarray((blend @ values).reshape(lattice.shape))

    def measure(values: F64) -> tuple[F64, F64]:
        nonlocal done
        done += 1
        progress(done, evaluations)
        return porosities_and_slopes(found, control(values), curved.count, near)

    fit = fit_cells(measure, means, known, targets, np.full(curved.count, start), bounds, tolerance, evaluations)
    return LevelField(bare, control(fit.values), parts), fit, known
