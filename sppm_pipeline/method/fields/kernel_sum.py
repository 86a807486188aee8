"""Fields that are a sum of kernels less a level: how they are sampled on any grid."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.assembly.occupancy import spans_in_any
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.nouns.size import PAYING_SHARE, PAYING_SHARE_OF_PATCHES
from sppm_pipeline.services.arrays import F32, I32, U8, U64
from sppm_pipeline.services.bit_rows import empty_bits, unpack
from sppm_pipeline.services.grid import Grid, sample_one_period

if TYPE_CHECKING:
    from sppm_pipeline.method.assembly.contents import TilingArrays
    from sppm_pipeline.method.assembly.patches import PatchBank
    from sppm_pipeline.method.fields.fine_sampler import FineSampler

WIDE = 2**24
"""Samples of a sheet from which some rows are interpolated at a time: coarse planes of whole sheets would take 1 GB."""

BAND = 2**21
"""Samples of such rows: their coarse planes take 130 MB."""


class Patches(NamedTuple):
    """Sampled pieces, and which of them stand where."""

    bank: PatchBank
    arrays: TilingArrays


class _Placed(NamedTuple):
    """Patches, and the indices of those of their samples along x, y and z that a grid stands for."""

    patches: Patches
    x: tuple[int, int]
    y: tuple[int, int]
    z: tuple[int, int]

    def sums(self, start: int, stop: int, threads: int, wanted: I32 | None = None) -> F32:
        """G in the layers start <= k < stop of the grid; `wanted` as for `solid_layers`."""
        from sppm_pipeline.method.assembly.overlap_add import assemble

        rows = None if wanted is None else spans_in_any(wanted)
        return assemble(*self.patches, *self._box(start, stop), threads=threads, wanted=rows)

    def bits(self, level: float, start: int, stop: int, threads: int, wanted: I32 | None = None) -> U64:
        """Bits of the samples where G lies below the level."""
        from sppm_pipeline.method.assembly.overlap_add import assemble_bits

        rows = None if wanted is None else spans_in_any(wanted)
        return assemble_bits(*self.patches, level, *self._box(start, stop), threads=threads, wanted=rows)

    def _box(self, start: int, stop: int) -> tuple[int, int, int, int, int, int]:
        return (self.z[0] + start, self.z[0] + stop, *self.x, *self.y)


class KernelSum(ScalarField):
    """Base of fields that are a sum G of kernels less a level C: solid where G < C (paper, eq. 3-5).

    A subclass gives the level, the sum itself (`kernel_sums`), and sampled pieces if it has such (`patches`). A grid
    finer than `coarse_pitch`, if there is one, is interpolated from a coarse one (`FineSampler`). Otherwise patches are
    added up where they pay and the grid fits the cells, or the kernels are summed; both agree within the stated
    cut-off. The choice belongs to the field and the spacings of the grid.

    `kernel_sums` and `own_values` are what kernels make, (stop - start, ny, nx), and are transposed here.
    """

    @property
    @abstractmethod
    def solid_below(self) -> float:
        """The level C."""

    @abstractmethod
    def kernel_sums(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> F32:
        """G in the layers start <= k < stop of any grid (cell sizes), kernel by kernel; not less than zero.

        A layer's values depend neither on start and stop nor on the number of threads; `wanted` as for `solid_layers`.
        """

    @property
    def additive(self) -> bool:
        """True if G is the sum of those of its parts, and continuous; else `own_values` is what is sampled."""
        return True

    @property
    def sum_level(self) -> float | None:
        return self.solid_below if self.additive else None

    def own_values(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        """A continuous field with the sign of G - C in the layers start <= k < stop of any grid."""
        values = self.kernel_sums(grid, start, stop, threads)
        values -= np.float32(self.solid_below)
        return values

    @property
    def coarse_pitch(self) -> float | None:
        """Spacing of samples, cell sizes, from which finer ones may be interpolated; None to sum them all."""
        return None

    def has_patches(self, n: int, offset: float) -> bool:
        """True if sampled pieces, n samples a cell edge, sample i at (i + offset) / n, pay.

        The answer belongs to the field: it is the same for every part that is sampled.
        """
        return False

    def has_patches_on(self, grid: Grid) -> bool:
        """True if the samples of a grid come from patches that pay; none are sampled to know."""
        lattice = _lattice_of(grid)
        return lattice is not None and self.has_patches(*lattice[:2])

    def patches(self, n: int, offset: float, threads: int = 1, solid: bool = False) -> Patches | None:
        """The sampled pieces; None if they do not pay. Those for `solid` need only serve `assemble_bits`."""
        return None

    @property
    def patches_last(self) -> bool:
        """True if patches are used so often that sampling them finely costs less than to interpolate everywhere."""
        return False

    def sums(self, grid: Grid, threads: int = 1, wanted: I32 | None = None) -> F32:
        """G at the points of a grid, (nx, ny, nz) float32; `sample` is this less the level, but may be interpolated.

        `wanted` as for `solid_layers`.
        """

        def sums(grid: Grid, start: int, stop: int) -> F32:
            return self._summed(grid, start, stop, threads, None if self.periodic else wanted)

        return self._each_once(grid, 0, grid.shape[2], sums).T

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        return self.sample_wanted(grid, start, stop, threads, None).T

    def sample_wanted(self, grid: Grid, start: int, stop: int, threads: int, wanted: I32 | None) -> F32:
        def values(grid: Grid, start: int, stop: int) -> F32:
            if not self.additive:
                return self.own_values(grid, start, stop, threads)
            rows = None if self.periodic else wanted
            if (fine := self._fine(grid, threads)) is not None:
                shape = (stop - start, *grid.shape[1::-1])
                out = np.empty(shape, np.float32) if rows is None else np.zeros(shape, np.float32)
                fine.sample(self, start, stop, threads, rows, out, None)
                return out
            sums = self._summed(grid, start, stop, threads, rows)
            sums -= np.float32(self.solid_below)
            return sums

        return self._each_once(grid, start, stop, values)

    def solid_layers(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> U8:
        def solid(grid: Grid, start: int, stop: int) -> U8:
            if not self.additive:
                return (self.own_values(grid, start, stop, threads) < 0).view(np.uint8)
            rows = None if self.periodic else wanted
            if (fine := self._fine(grid, threads)) is not None:
                shape = (stop - start, *grid.shape[1::-1])
                out = np.empty(shape, np.uint8) if rows is None else np.zeros(shape, np.uint8)
                fine.sample(self, start, stop, threads, rows, None, out)
                return out
            if (placed := self._placed(grid, threads, solid=True)) is not None:
                return unpack(placed.bits(self.solid_below, start, stop, threads, rows), grid.shape[0])
            return (self._summed(grid, start, stop, threads, rows) < np.float32(self.solid_below)).view(np.uint8)

        return self._each_once(grid, start, stop, solid).T

    def samples_by_rows(self, grid: Grid) -> bool:
        wide = grid.shape[0] * grid.shape[1] > WIDE and self.additive and not self.periodic
        return wide and self._fine(grid, 1) is not None

    def solid_bits(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> U64:
        if self.samples_by_rows(grid):
            (x, y, z), (nx, ny, nz) = grid.origin, grid.shape
            bits, rows = empty_bits(stop - start, ny, nx), max(1, BAND // nx)
            for row in range(0, ny, rows):
                own = slice(row, min(row + rows, ny))
                band = Grid((x, y + row * grid.spacing[1], z), grid.spacing, (nx, own.stop - row, nz))
                asked = None if wanted is None else np.ascontiguousarray(wanted[:, own])
                bits[:, own] = super().solid_bits(band, start, stop, threads, asked)
            return bits
        # the only way that makes bits without bytes in between
        summed = not self.periodic and self.additive and self._fine(grid, threads) is None
        if summed and (placed := self._placed(grid, threads, solid=True)) is not None:
            return placed.bits(self.solid_below, start, stop, threads, wanted)
        return super().solid_bits(grid, start, stop, threads, wanted)

    def _each_once(
        self, grid: Grid, start: int, stop: int, sample: Callable[[Grid, int, int], NDArray[Any]]
    ) -> NDArray[Any]:
        return sample_one_period(grid, self.cells, start, stop, sample) if self.periodic else sample(grid, start, stop)

    def _summed(self, grid: Grid, start: int, stop: int, threads: int, wanted: I32 | None) -> F32:
        placed = self._placed(grid, threads)
        if placed is None:
            return self.kernel_sums(grid, start, stop, threads, wanted)
        return placed.sums(start, stop, threads, wanted)

    def _fine(self, grid: Grid, threads: int) -> FineSampler | None:
        """The sampler that interpolates on this grid, if that pays; the last one is kept for the next layers."""
        pitch = self.coarse_pitch
        if pitch is None or 0 in grid.shape:
            return None
        from sppm_pipeline.method.fields.fine_sampler import FineSampler
        from sppm_pipeline.services.interpolation import TAPS

        # a whole number of samples a cell, so that patches may serve them
        n = max(2, math.ceil(1.0 / pitch - 1e-9))
        # coarse samples for each fine one: the taps overlap where the grid is coarse
        share = math.prod(min(TAPS, spacing * n) for spacing in grid.spacing)
        if share > PAYING_SHARE and (share > PAYING_SHARE_OF_PATCHES or not self.has_patches(n, 0.0)):
            return None
        if self.patches_last and self.has_patches_on(grid):
            return None
        sampler = _SAMPLERS.get(self)
        if sampler is None or sampler.of != (grid, n):
            sampler = _SAMPLERS[self] = FineSampler(self, grid, n)
        return sampler

    def _placed(self, grid: Grid, threads: int, solid: bool = False) -> _Placed | None:
        """The patches and those of their samples that a grid stands for; None if there are none."""
        lattice = _lattice_of(grid)
        patches = self.patches(*lattice[:2], threads, solid) if lattice is not None else None
        return _Placed(patches, *lattice[2]) if lattice is not None and patches is not None else None


def _lattice_of(grid: Grid) -> tuple[int, float, list[tuple[int, int]]] | None:
    """Samples a cell edge, their offset and, for x, y, z, the range of their indices; None if the grid fits no cell."""
    found, ranges = set(), []
    for origin, spacing, samples in zip(*grid, strict=True):
        n = round(1 / spacing)
        if n < 2 or abs(n * spacing - 1) > 1e-9:
            return None
        place = origin * n
        shift = place - np.floor(place + 1e-6)
        # only centers and corners of voxels: a bank for every offset would not be used again
        if abs(shift) > 1e-6 and abs(shift - 0.5) > 1e-6:
            return None
        half = 0.5 if shift > 0.25 else 0.0
        first = round(place - half)
        ranges.append((first, first + samples))
        found.add((n, half))
    return (*found.pop(), ranges) if len(found) == 1 else None


_SAMPLERS: WeakKeyDictionary[KernelSum, FineSampler] = WeakKeyDictionary()
