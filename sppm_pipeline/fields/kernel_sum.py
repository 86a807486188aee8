"""Fields that are a sum of kernels less a level: how they are sampled on any grid."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.numerics.grid import Grid, sample_one_period

if TYPE_CHECKING:
    from sppm_pipeline.numerics.assembly.contents import TilingArrays
    from sppm_pipeline.numerics.assembly.patches import PatchBank


class Patches(NamedTuple):
    """Sampled pieces, and which of them stand where."""

    bank: PatchBank
    arrays: TilingArrays


class KernelSum(ScalarField):
    """Base of fields that are a sum G of kernels less a level C: solid where G < C (paper, eq. 3-5).

    A subclass gives the level, the sum itself (`kernel_sums`), and sampled pieces if it has such (`patches`). On a grid
    whose spacing divides the cell edge patches are added up where they pay; on any other the kernels are summed. Both
    agree within the stated cut-off.
    """

    @property
    @abstractmethod
    def solid_below(self) -> float:
        """The level C."""

    @abstractmethod
    def kernel_sums(
        self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: NDArray[np.int32] | None = None
    ) -> NDArray[np.float32]:
        """G in the layers start <= k < stop of any grid (cell sizes), kernel by kernel; not less than zero.

        A layer's values depend neither on start and stop nor on the number of threads; `wanted` as for `solid_layers`.
        """

    @property
    def additive(self) -> bool:
        """Whether G is the sum of those of its parts and continuous; else `own_values` is what is sampled."""
        return True

    def own_values(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        """A continuous field with the sign of G - C in the layers start <= k < stop of any grid."""
        values = self.kernel_sums(grid, start, stop, threads)
        values -= np.float32(self.solid_below)
        return values

    def patches(self, n: int, offset: float, threads: int = 1) -> Patches | None:
        """Sampled pieces, n samples a cell edge, sample i at (i + offset) / n; None if they do not pay.

        The answer belongs to the field: it is the same for every part that is sampled.
        """
        return None

    def sums(self, grid: Grid, threads: int = 1) -> NDArray[np.float32]:
        """G at the points of a grid, (nz, ny, nx) float32; `sample` is this less the level."""
        return self._sums(grid, 0, grid.shape[2], threads)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        if not self.additive:

            def own(grid: Grid, start: int, stop: int) -> NDArray[np.float32]:
                return self.own_values(grid, start, stop, threads)

            return sample_one_period(grid, self.cells, start, stop, own) if self.periodic else own(grid, start, stop)
        values = self._sums(grid, start, stop, threads)
        values -= np.float32(self.solid_below)
        return values

    def solid_layers(
        self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: NDArray[np.int32] | None = None
    ) -> NDArray[np.uint8]:
        if not self.additive:
            return (self.sample_layers(grid, start, stop, threads) < 0).view(np.uint8)

        def solid(grid: Grid, start: int, stop: int) -> NDArray[np.uint8]:
            if (placed := self._placed(grid, threads)) is not None:
                from sppm_pipeline.numerics.assembly.overlap_add import assemble_solid

                (bank, arrays), (x, y, z) = placed
                box = (z[0] + start, z[0] + stop, *x, *y)
                return assemble_solid(bank, arrays, self.solid_below, *box, threads=threads)
            rows = None if self.periodic else wanted
            return (self.kernel_sums(grid, start, stop, threads, rows) < np.float32(self.solid_below)).view(np.uint8)

        return sample_one_period(grid, self.cells, start, stop, solid) if self.periodic else solid(grid, start, stop)

    def _sums(self, grid: Grid, start: int, stop: int, threads: int) -> NDArray[np.float32]:
        def sums(grid: Grid, start: int, stop: int) -> NDArray[np.float32]:
            if (placed := self._placed(grid, threads)) is not None:
                from sppm_pipeline.numerics.assembly.overlap_add import assemble

                (bank, arrays), (x, y, z) = placed
                return assemble(bank, arrays, z[0] + start, z[0] + stop, *x, *y, threads=threads)
            return self.kernel_sums(grid, start, stop, threads)

        return sample_one_period(grid, self.cells, start, stop, sums) if self.periodic else sums(grid, start, stop)

    def _placed(self, grid: Grid, threads: int) -> tuple[Patches, list[tuple[int, int]]] | None:
        """The patches and, for x, y, z, the range of their samples that a grid stands for; None if there are none."""
        lattice = _lattice_of(grid)
        patches = self.patches(*lattice[:2], threads) if lattice is not None else None
        return (patches, lattice[2]) if lattice is not None and patches is not None else None


def _lattice_of(grid: Grid) -> tuple[int, float, list[tuple[int, int]]] | None:
    """Samples a cell edge, their offset and, for x, y, z, the range of their indices; None if the grid fits no cell."""
    found, ranges = set(), []
    for origin, spacing, samples in zip(*grid, strict=True):
        n = round(1 / spacing)
        if n < 2 or abs(n * spacing - 1) > 1e-9:
            return None
        place = origin * n
        shift = place - np.floor(place + 1e-6)
        if abs(shift) > 1e-6 and abs(shift - 0.5) > 1e-6:
            return None
        half = 0.5 if shift > 0.25 else 0.0
        first = round(place - half)
        ranges.append((first, first + samples))
        found.add((n, half))
    return (*found.pop(), ranges) if len(found) == 1 else None
