"""A field bent to another shape: its value at a point is that of the field at the place from which the point came."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sppm_pipeline.features.grading.curved_cells import CurvedCells
from sppm_pipeline.method.fields.formula import CellCache
from sppm_pipeline.method.fields.scalar_field import Placed, RepeatedField, ScalarField
from sppm_pipeline.services.arrays import F32, F64, I64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.threads import ordered_map

BEFORE = 1
"""Samples that a brick holds before its first one; cubics need one there and two behind the last."""


@jit
def _weights(t: float, out: F64) -> None:
    out[0] = 0.5 * t * (-1.0 + t * (2.0 - t))
    out[1] = 1.0 + 0.5 * t * t * (-5.0 + 3.0 * t)
    out[2] = 0.5 * t * (1.0 + t * (4.0 - 3.0 * t))
    out[3] = 0.5 * t * t * (t - 1.0)


@jit
def interpolate(brick: F32, places: F64, chosen: I64, out: F32) -> None:
    """Values at places in a cell, by the four samples along each axis of Catmull and Rom (1974).

    `brick` (n + 4, n + 4, n + 4) are samples indexed x, y, z, n to an edge of the cell, the second one in its low
    corner; `places` (m, 3) are 0 to 1 in the cell, of which those `chosen` (k,) are written to `out` (m,).
    """
    n = brick.shape[0] - 4
    wx, wy, wz = np.empty(4), np.empty(4), np.empty(4)
    for m in chosen:
        x, y, z = places[m, 0] * n, places[m, 1] * n, places[m, 2] * n
        i, j, k = min(int(x), n), min(int(y), n), min(int(z), n)
        _weights(x - i, wx)
        _weights(y - j, wy)
        _weights(z - k, wz)
        total = 0.0
        for a in range(4):
            plane = 0.0
            for b in range(4):
                row = brick[i + a, j + b]
                plane += wy[b] * (wz[0] * row[k] + wz[1] * row[k + 1] + wz[2] * row[k + 2] + wz[3] * row[k + 3])
            total += wx[a] * plane
        out[m] = total


@jit
def cubic_in_layers(values: F32, places: F64) -> F32:
    """Values (n,) at places (n, 3), x, y, z counted in samples from the first one, of layers indexed z, y, x; a place
    needs one sample before it and two behind it along each axis.
    """
    out = np.empty(len(places), np.float32)
    wx, wy, wz = np.empty(4), np.empty(4), np.empty(4)
    for m in range(len(places)):
        x, y, z = places[m, 0], places[m, 1], places[m, 2]
        i, j, k = int(np.floor(x)) - 1, int(np.floor(y)) - 1, int(np.floor(z)) - 1
        _weights(x - i - 1, wx)
        _weights(y - j - 1, wy)
        _weights(z - k - 1, wz)
        total = 0.0
        for c in range(4):
            plane = 0.0
            for b in range(4):
                row = values[k + c, j + b]
                plane += wy[b] * (wx[0] * row[i] + wx[1] * row[i + 1] + wx[2] * row[i + 2] + wx[3] * row[i + 3])
            total += wz[c] * plane
        out[m] = total
    return out


@jit
def linear_in_layers(values: F32, places: F64) -> F32:
    """As `cubic_in_layers`, linear between samples."""
    out = np.empty(len(places), np.float32)
    for m in range(len(places)):
        x, y, z = places[m, 0], places[m, 1], places[m, 2]
        i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        x, y, z = x - i, y - j, z - k
        low = (1 - y) * ((1 - x) * values[k, j, i] + x * values[k, j, i + 1])
        low += y * ((1 - x) * values[k, j + 1, i] + x * values[k, j + 1, i + 1])
        high = (1 - y) * ((1 - x) * values[k + 1, j, i] + x * values[k + 1, j, i + 1])
        high += y * ((1 - x) * values[k + 1, j + 1, i] + x * values[k + 1, j + 1, i + 1])
        out[m] = (1 - z) * low + z * high
    return out


KEPT_BYTES = 512 * 2**20
"""Maximum number of bytes of the samples of cells."""

VOID = 1.0
"""Value outside of all cells."""

BOUND = 4.0
"""Values are cut off at this multiple of the largest difference of two samples with the surface between them."""

POINTS = 1 << 16
"""Points of a layer that are evaluated together: 2 MB."""


@dataclass(frozen=True, eq=False)
class WarpedField(Placed, ScalarField):
    """Another field whose cells are bent; void farther than half a cell outside of them.

    The field is sampled once in each cell that it has, or in the only one if it repeats, and interpolated by cubics.
    """

    base: ScalarField
    curved: CurvedCells
    extent: tuple[int, int, int]  # blocks of the box around the bent cells
    edge: float  # size of a block, mm
    origin: tuple[float, float, float]  # low corner of the box, mm
    samples: int  # along an edge of a cell of `base`
    stretch: tuple[float, float]  # least and largest length in a bent cell over that in `base`, in blocks per cell
    kept: CellCache = field(default_factory=CellCache, compare=False, repr=False)

    def __post_init__(self) -> None:
        bytes_of_a_brick = 4 * (self.samples + 4) ** 3
        object.__setattr__(self, "kept", CellCache(max(8, KEPT_BYTES // bytes_of_a_brick)))

    def check(self) -> None:
        """The bent field is in order."""
        self.base.check()

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.extent

    @property
    def periodic(self) -> bool:
        return False

    @property
    def finest_radius(self) -> float | None:
        radius = self.base.finest_radius
        return None if radius is None else radius * self.stretch[0]

    @property
    def thinnest_wall(self) -> float | None:
        wall = self.base.thinnest_wall
        return None if wall is None else wall * self.stretch[0]

    def exactly(self) -> WarpedField:
        return replace(self, base=self.base.exactly())

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        nx, ny, _ = grid.shape
        values = np.empty((stop - start, ny, nx), np.float32)
        x, y, z = (self.origin[axis] + self.edge * grid.axis(axis) for axis in range(3))
        # blocks of rows, so that threads share even a single layer
        rows = max(1, POINTS // max(1, nx))

        def fill(at: tuple[int, int]) -> None:
            k, j = at
            own = values[k, j : j + rows]
            points = np.empty((*own.shape, 3))
            points[..., 0], points[..., 1], points[..., 2] = x, y[j : j + rows, None], z[start + k]
            own[...] = self._at(points.reshape(-1, 3)).reshape(own.shape)

        blocks = [(k, j) for k in range(stop - start) for j in range(0, ny, rows)]
        deque(ordered_map(fill, blocks, threads), maxlen=0)
        return values.T

    def _at(self, points: F64) -> F32:
        """Values at points (n, 3) mm."""
        cell, places = self.curved.continued(points)
        values = np.full(len(points), VOID, np.float32)
        repeats, size = self.base.periodic, np.array(_own_cells(self.base))
        if not repeats:
            places = np.clip(places, 0.0, size)
        site = np.floor(places)
        if not repeats:
            site = np.minimum(site, size - 1)
        places = places - site
        number = np.ravel_multi_index(tuple((site.astype(np.int64) % size).T), tuple(size))
        number[cell < 0] = -1
        order = np.argsort(number, kind="stable")
        ordered = number[order]
        # grouped by cell, so that the samples of each are used together
        for one in np.unique(ordered[ordered >= 0]):
            chosen = order[np.searchsorted(ordered, one) : np.searchsorted(ordered, one, side="right")]
            interpolate(self._brick(tuple(int(k) for k in np.unravel_index(one, size))), places, chosen, values)
        return values

    def _brick(self, site: tuple[int, ...]) -> F32:
        """Samples of a cell, and a few around it, (n + 4,) * 3."""

        def make() -> F32:
            h = 1.0 / self.samples
            x, y, z = (k - BEFORE * h for k in site)
            grid = Grid((x, y, z), (h,) * 3, (self.samples + 4,) * 3)
            # of what repeats, the cell alone is sampled
            inner = self.base.base if isinstance(self.base, RepeatedField) else self.base
            return bounded(np.ascontiguousarray(inner.sample_zyx(grid, 0, self.samples + 4).T))

        made: F32 = self.kept.get(site, make)
        return made

    def summary(self) -> dict[str, Any]:
        """The summary of the field that was bent, and the number of cells."""
        return {**self.base.summary(), "curved_cells": self.curved.count}


def bounded(brick: F32) -> F32:
    """Samples cut off a few spacings from the surface, in place, so that cubics swing over nothing far from it.

    Distances estimated from a slope are very large where it vanishes. What lies within two samples of the surface is
    left as it is.
    """
    steepest = 0.0
    for axis in range(3):
        ahead, behind = np.moveaxis(brick, axis, 0)[1:], np.moveaxis(brick, axis, 0)[:-1]
        crossing = (ahead < 0) != (behind < 0)
        steepest = max(steepest, float(np.abs(ahead - behind).max(where=crossing, initial=0.0)))
    if steepest > 0:
        np.clip(brick, -BOUND * steepest, BOUND * steepest, out=brick)
    return brick


def _own_cells(base: ScalarField) -> tuple[int, int, int]:
    """Cells after which a field repeats, or those it has."""
    return base.base.cells if isinstance(base, RepeatedField) and base.periodic else base.cells


def cells_sampled(base: ScalarField) -> int:
    """Number of cells of a field that are sampled when it is bent."""
    nx, ny, nz = _own_cells(base)
    return nx * ny * nz


def least_and_largest_stretch(curved: CurvedCells, per_axis: int = 3) -> tuple[float, float]:
    """Least and largest length, mm, of what was one cell size long, over all directions at places in all cells."""
    t = (np.arange(per_axis) + 0.5) / per_axis
    # middles of `per_axis`^3 parts of a cell, not its corners: a hexahedron may be nearly flat at one, and every voxel
    # of the part would have to be as small
    within = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
    cell = np.repeat(np.arange(curved.count), len(within))
    # singular values of the derivative are the stretches along its principal directions
    sizes = np.linalg.svd(curved.derivatives(cell, np.tile(within, (curved.count, 1))), compute_uv=False)
    return float(sizes.min()), float(sizes.max())


def warped_field(base: ScalarField, curved: CurvedCells, samples: int) -> WarpedField:
    """A field with its cells bent, in a box of blocks as large as its mean cell."""
    low, high = curved.box
    edge = float(curved.volumes.mean() ** (1 / 3))
    count = np.maximum(np.ceil((high - low) / edge - 1e-9), 1).astype(int)
    x, y, z = ((low + high - count * edge) / 2).tolist()
    least, most = least_and_largest_stretch(curved)
    extent = (int(count[0]), int(count[1]), int(count[2]))
    return WarpedField(base, curved, extent, edge, (x, y, z), samples, (least / edge, most / edge))


def has_cubic_symmetry(base: ScalarField, n: int = 24) -> bool:
    """Test whether a periodic cell has the symmetry of a cube, so that it fits its neighbors in a mesh of any shape."""
    values = base.sample(n).astype(np.float64)
    values = values[:n, :n, :n]
    # a third of a turn, a mirror at a diagonal plane and one at x generate all 48 symmetries of the cube
    slack = 1e-3 * float(np.abs(values).max())
    turned = (values.transpose(1, 2, 0), values.transpose(1, 0, 2), values[::-1])
    return all(float(np.abs(values - other).max()) <= slack for other in turned)
