"""A field that is cut at a level of its own in every place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sppm_pipeline.method.fields.kernel_sum import KernelSum
from sppm_pipeline.method.fields.scalar_field import WrappedField
from sppm_pipeline.method.kernels.level_spline import LayerSpline
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.services.arrays import F32, F64, I32
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.threads import in_bands

NARROWED = 0.8
"""Tunnels this much narrower than at the field's own level are still interpolated from the same samples: 2 of 100 000
change sides where all tunnels are, 1 where none is."""


@dataclass(frozen=True, eq=False)
class LevelField(WrappedField, KernelSum):
    """Another field cut at a level that is a smooth function of place, a quadratic spline over the lattice.

    Of a sum G of kernels the spline is ln C, and solid is where G < C. What is sampled is ``(G / C - 1)`` times the
    mean level, which has the same sign and is as smooth. Of any other field the spline is the value at which it is cut,
    and is taken off. `base` is not itself a field with a level of its own.
    """

    control: F64  # (nx, ny, nz) in the middles of the cells: ln C, or values of the field
    per_cell: int = 1  # control points along a cell edge where cells of the structure are not those of the lattice

    def __post_init__(self) -> None:
        object.__setattr__(self, "control", frozen(np.asarray(self.control, np.float64)))

    def check(self) -> None:
        """One finite control point for each cell, or part of one."""
        self.base.check()
        wanted = tuple(self.per_cell * n for n in self.cells)
        if self.control.shape != wanted or not np.isfinite(self.control).all():
            raise ValueError(
                f"the level has one finite control point for each cell of {list(wanted)}, not those of an array "
                f"{self.control.shape}"
            )

    @property
    def additive(self) -> bool:
        return isinstance(self.base, KernelSum) and self.base.additive

    @property
    def periodic(self) -> bool:
        return False

    @property
    def solid_below(self) -> float:
        return math.exp(float(self.control.mean())) if self.additive else 0.0

    @property
    def sum_level(self) -> float | None:
        return self.solid_below if self.additive else None

    @property
    def _narrowing(self) -> float:
        """The least radius of a tunnel over that at the field's own level; tunnels are taken as linear kernels."""
        level = self.base.sum_level
        if not self.additive or level is None or not 0 < level < 1:
            return 1.0
        return max(0.0, min(1.0, float(self.control.max()) / math.log(level)))

    @property
    def finest_radius(self) -> float | None:
        radius = self.base.finest_radius
        return None if radius is None else radius * self._narrowing

    @property
    def coarse_pitch(self) -> float | None:
        pitch = self.base.coarse_pitch if isinstance(self.base, KernelSum) else None
        return None if pitch is None or not self._narrowing else pitch * min(1.0, self._narrowing / NARROWED)

    def kernel_sums(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> F32:
        assert isinstance(self.base, KernelSum)
        return self._over_level(self.base.kernel_sums(grid, start, stop, threads, wanted), grid, start, threads, wanted)

    def _summed(self, grid: Grid, start: int, stop: int, threads: int, wanted: I32 | None) -> F32:
        # by patches of the field that repeats, where it has such
        assert isinstance(self.base, KernelSum)
        return self._over_level(self.base._summed(grid, start, stop, threads, wanted), grid, start, threads, wanted)

    def _over_level(self, sums: F32, grid: Grid, start: int, threads: int, wanted: I32 | None) -> F32:
        """G in some layers becomes G / C times the mean level, where it is wanted."""
        mean, spline = float(np.float32(self.control.mean())), self._spline(grid, start, start + len(sums))

        def divide(first: int, last: int) -> None:
            for k in range(first, last):
                rows, columns = _window(None if wanted is None else wanted[k], sums.shape[1:])
                factor = spline.less(mean, k, rows, columns)
                sums[k, rows, columns] *= np.exp(factor, out=factor)

        in_bands(divide, len(sums), threads)
        return sums

    def own_values(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        # a copy: what a field hands out may be its own
        values, spline = self.base.sample_zyx(grid, start, stop, threads).copy(), self._spline(grid, start, stop)

        def take_off(first: int, last: int) -> None:
            for k in range(first, last):
                values[k] += spline.less(0.0, k, *_window(None, values.shape[1:]))

        in_bands(take_off, len(values), threads)
        return values

    def _spline(self, grid: Grid, start: int, stop: int) -> LayerSpline:
        x, y, z = (self.per_cell * grid.axis(axis) for axis in range(3))
        return LayerSpline(self.control, x, y, z[start:stop])

    def summary(self) -> dict[str, Any]:
        """The summary of the field, and the range of its level."""
        least, most = float(self.control.min()), float(self.control.max())
        if self.additive:
            least, most = math.exp(least), math.exp(most)
        return {**self.base.summary(), "level_min": least, "level_max": most}


def _window(wanted: I32 | None, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The rows and columns of a layer in which all lies that is wanted."""
    if wanted is None:
        return slice(0, shape[0]), slice(0, shape[1])
    rows = np.flatnonzero(wanted[:, 0] < wanted[:, 1])
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    asked = wanted[rows]
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(asked[:, 0].min()), int(asked[:, 1].max()))
