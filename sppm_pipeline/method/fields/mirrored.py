"""A field of a box with its mirror images."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from sppm_pipeline.method.fields.scalar_field import WrappedField
from sppm_pipeline.services.arrays import F32, F64
from sppm_pipeline.services.grid import Grid


@dataclass(frozen=True, eq=False)
class MirroredField(WrappedField):
    """A field of a box and its seven mirror images at the high sides, which repeat: twice as many cells each way.

    Attributes
    ----------
    base : ScalarField
    whole : bool
        Whether the images belong to the region, which then repeats, or lie beyond it.
    """

    whole: bool = True

    @property
    def cells(self) -> tuple[int, int, int]:
        x, y, z = self.base.cells
        return (2 * x, 2 * y, 2 * z) if self.whole else (x, y, z)

    @property
    def periodic(self) -> bool:
        return self.whole

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        part = grid.layers(start, stop)
        values = np.empty(part.shape, np.float32, order="F")
        runs = [_mirrored_runs(part.axis(axis), self.base.cells[axis]) for axis in range(3)]
        for (x, fx, bx), (y, fy, by), (z, fz, bz) in product(*runs):
            shape = (x.stop - x.start, y.stop - y.start, z.stop - z.start)
            found = self.base.sample(Grid((fx, fy, fz), part.spacing, shape), threads)
            values[x, y, z] = found[tuple(slice(None, None, -1 if back else 1) for back in (bx, by, bz))]
        return values


def _mirrored_runs(positions: F64, period: int) -> list[tuple[slice, float, bool]]:
    """Samples of an axis between mirrors: which they are, where the lowest of them is read, and whether backwards."""
    image = np.floor(positions / period + 1e-12).astype(np.int64)
    ends = [0, *(np.flatnonzero(np.diff(image)) + 1).tolist(), len(positions)]
    runs = []
    for a, b in pairwise(ends):
        number = int(image[a])
        back = bool(number % 2)
        lowest = (number + 1) * period - positions[b - 1] if back else positions[a] - number * period
        runs.append((slice(a, b), float(lowest), back))
    return runs
