"""The porosity of bent cells: measured on voxels of the part, and tuned by a level that varies from cell to cell."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.curved_cells import CurvedCells
from sppm_pipeline.data.grading import Grading
from sppm_pipeline.fields.kernel_sum import KernelSum
from sppm_pipeline.fields.level_field import LevelField
from sppm_pipeline.fields.part import Part
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.fields.warped import WarpedTiling
from sppm_pipeline.fields.warped_field import WarpedField
from sppm_pipeline.fields.wrapped import WrappedField
from sppm_pipeline.numerics.grading.cell_level import (
    CellLevelFit,
    ControlLattice,
    LocatedSamples,
    blending,
    fit_cells,
    means_over_cells,
    porosities_and_slopes,
)
from sppm_pipeline.numerics.grading.level_spline import LayerSpline
from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.threads import ordered_map

POINTS = 4
"""Points along each axis of a cell at which a map is asked for its mean."""

PER_CELL = 3.0
"""Control points of a level along the shortest edge of any cell: a choice."""

MOST_CONTROL = 2**24
"""Control points at most; cells that differ more in size get fewer each."""

SLAB = 1 << 22
"""Samples that are taken together."""

BYTES_OF_A_SAMPLE = 12


def curved_cells_of(field: ScalarField) -> CurvedCells | None:
    """The bent cells of a field, of a part filled with it, or of a field made from it; None of others."""
    while isinstance(field, WrappedField) and not isinstance(field, (WarpedTiling, WarpedField)):
        field = field.base
    return field.curved if isinstance(field, (WarpedTiling, WarpedField)) else None


def curved_targets(grading: Grading, name: str, curved: CurvedCells) -> NDArray[np.float64]:
    """Means of a map over bent cells, by volume, (m,)."""
    points, volume = curved.inner(POINTS)
    values = grading[name].at(points.reshape(-1, 3)).reshape(volume.shape)
    return np.asarray((values * volume).sum(axis=1) / volume.sum(axis=1))


class CellCounts(NamedTuple):
    """Voxels of each bent cell, all (m,): how many there are, how many lie in the part, and the void among these."""

    number: NDArray[np.int64]
    inside: NDArray[np.int64]
    void: NDArray[np.int64]

    @property
    def porosity(self) -> NDArray[np.float64]:
        """Share of void in what lies in the part."""
        return self.void / np.maximum(self.inside, 1)

    @property
    def share(self) -> NDArray[np.float64]:
        """Share that lies in the part."""
        return self.inside / np.maximum(self.number, 1)


def voxels_for(field: ScalarField, curved: CurvedCells, n: int) -> Grid:
    """Voxels over the box of a field, so fine that a bent cell of mean size has n along an edge, a small one n / 2."""
    sizes = np.cbrt(curved.volumes)
    size = min(float(np.cbrt(curved.volumes.mean())), 2 * float(sizes.min()))
    edge = field.physical_edge()
    low, high = (curved.box - np.array(field.origin_mm)) / edge
    h = size / n / edge
    first = np.floor(low / h).astype(int)
    nx, ny, nz = (np.ceil(high / h).astype(int) - first).tolist()
    x, y, z = ((first + 0.5) * h).tolist()
    return Grid((x, y, z), (h, h, h), (nx, ny, nz))


class CurvedVoxels:
    """Voxels of a field and the bent cells in which they lie, layer after layer.

    Parameters
    ----------
    field : ScalarField
    curved : CurvedCells
    n : int
        See `voxels_for`.
    threads : int
    """

    def __init__(self, field: ScalarField, curved: CurvedCells, n: int, threads: int = 1) -> None:
        self.field, self.curved, self._threads = field, curved, threads
        self.grid = voxels_for(field, curved, n)
        edge, origin = field.physical_edge(), field.origin_mm
        self._axes = [origin[axis] + edge * self.grid.axis(axis) for axis in range(3)]
        nx, ny, _ = self.grid.shape
        self._at_once = max(1, SLAB // (nx * ny))

    def cells_of_layer(self, k: int) -> NDArray[np.int32]:
        """The cell of each voxel of a layer, (ny nx,); -1 for none."""
        x, y, z = self._axes
        points = np.empty((len(y), len(x), 3))
        points[..., 0], points[..., 1], points[..., 2] = x, y[:, None], z[k]
        return self.curved.places(points.reshape(-1, 3)).cell

    def slabs(self) -> list[tuple[int, int]]:
        """First layers and those after the last of what is sampled together."""
        nz = self.grid.shape[2]
        return [(k, min(k + self._at_once, nz)) for k in range(0, nz, self._at_once)]

    def counts(self, progress: Callable[[int, int], None] = lambda done, of: None) -> CellCounts:
        """Voxels of each cell."""
        field, m, slabs = self.field, self.curved.count, self.slabs()
        totals = np.zeros((3, m), np.int64)
        for done, (start, stop) in enumerate(slabs):
            void = (field.solid_zyx(self.grid, start, stop, self._threads) == 0).reshape(stop - start, -1)
            inside = field.inside_zyx(self.grid, start, stop) if isinstance(field, Part) else None
            cells = ordered_map(self.cells_of_layer, list(range(start, stop)), self._threads)
            for k, cell in enumerate(cells):
                there = cell >= 0
                totals[0] += np.bincount(cell[there], minlength=m)
                if inside is not None:
                    there &= inside[k].reshape(-1).view(np.bool_)
                totals[1] += np.bincount(cell[there], minlength=m)
                totals[2] += np.bincount(cell[there & void[k]], minlength=m)
            progress(done + 1, len(slabs))
        return CellCounts(totals[0], totals[1], totals[2])

    def located(self, progress: Callable[[int, int], None] = lambda done, of: None) -> list[LocatedSamples]:
        """Samples in cells, and in the part, of each layer; values are ln G of a sum G of kernels, or the field's."""
        inner = self.field.base if isinstance(self.field, Part) else self.field
        level = inner.solid_below if isinstance(inner, KernelSum) and inner.additive else None
        found, slabs = [], self.slabs()
        for done, (start, stop) in enumerate(slabs):
            values = inner.sample_zyx(self.grid, start, stop, self._threads).reshape(stop - start, -1)
            if level is not None:
                values = np.log(np.maximum(values + np.float32(level), np.float32(1e-9)))
            part = self.field
            inside = part.inside_zyx(self.grid, start, stop) if isinstance(part, Part) else None
            cells = ordered_map(self.cells_of_layer, list(range(start, stop)), self._threads)
            for k, cell in enumerate(cells):
                there = cell >= 0
                if inside is not None:
                    there &= inside[k].reshape(-1).view(np.bool_)
                place = np.flatnonzero(there).astype(np.int32)
                found.append(LocatedSamples(place, cell[place], values[k][place]))
            progress(done + 1, len(slabs))
        return found


def control_lattice(field: ScalarField, curved: CurvedCells) -> tuple[ControlLattice, int]:
    """The lattice of a level over the cells of a field, and its control points along an edge of these."""
    edge = field.physical_edge()
    smallest = float(np.linalg.svd(curved.frames, compute_uv=False).min())
    most = math.floor((MOST_CONTROL / math.prod(field.cells)) ** (1 / 3))
    parts = max(1, min(math.ceil(PER_CELL * edge / smallest), most))
    nx, ny, nz = (parts * n for n in field.cells)
    return ControlLattice((nx, ny, nz), edge / parts, np.array(field.origin_mm)), parts


class CurvedFit(NamedTuple):
    """A field with a level of its own in each bent cell, and how well it does."""

    field: LevelField
    fit: CellLevelFit


def fit_curved_level(
    voxels: CurvedVoxels,
    bare: ScalarField,
    targets: NDArray[np.float64],
    known: NDArray[np.bool_],
    start: float,
    bounds: tuple[float, float],
    near: float,
    tolerance: float,
    evaluations: int,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> CurvedFit:
    """Choose values at the cells so that each has its porosity; see `numerics.grading.cell_level`."""
    curved = voxels.curved
    lattice, parts = control_lattice(bare, curved)
    blend = blending(lattice, curved.centers, curved.frames)
    points, volumes = curved.inner(POINTS)
    means = means_over_cells(lattice, blend, lambda first, stop: (points[first:stop], volumes[first:stop]))
    samples = voxels.located()
    x, y, z = (voxels.grid.axis(axis) * parts for axis in range(3))
    done = 0

    def control(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((blend @ values).reshape(lattice.shape))

    def measure(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        nonlocal done
        spline = LayerSpline(control(values), x, y, z)
        void, slope, _ = porosities_and_slopes(iter(enumerate(samples)), spline, (len(y), len(x)), curved.count, near)
        done += 1
        progress(done, evaluations)
        return void, slope

    fit = fit_cells(measure, means, known, targets, np.full(curved.count, start), bounds, tolerance, evaluations)
    return CurvedFit(LevelField(bare, control(fit.values), parts), fit)
