"""Fields that are made brick by brick from random numbers of their place: one periodic cell, or a part of any size."""

from __future__ import annotations

from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.families import lattice_for
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.numerics.grid import Grid

Brick = tuple[int, int, int]
"""A cell of the lattice by its indices; they may be negative."""

BLOCK = 1 << 18
"""Samples that one thread evaluates at a time."""

MOST_KEPT = 512
"""Bricks whose tables are kept, some 200 KB each: a slab of a part of 22 x 22 cells."""


class Kept:
    """What was made for the bricks that were asked for last."""

    def __init__(self, most: int = MOST_KEPT) -> None:
        self._most = most
        self._made: OrderedDict[Any, Any] = OrderedDict()
        self._lock = Lock()

    def known(self) -> list[Any]:
        """Keys of what is kept, the last one asked for at the end."""
        with self._lock:
            return list(self._made)

    def get(self, key: Any, make: Callable[[], Any]) -> Any:
        """What was made for `key`, or `make()`; two threads may make the same at once, which does no harm."""
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
                return self._made[key]
        made = make()
        with self._lock:
            self._made[key] = made
            while len(self._made) > self._most:
                self._made.popitem(last=False)
        return made


@dataclass(frozen=True, eq=False, kw_only=True)
class BrickField(ScalarField):
    """Base of fields with a content of its own in every cell: implement `prepare` and `evaluate`.

    Attributes
    ----------
    edge : float or None
        Edge of a cell, mm.
    region : tuple of 3 ints or None
        Cells of the part, none of which is like another; None for one cell that repeats.
    origin : tuple of 3 floats
        World position of the low corner of cell (0, 0, 0), mm.
    """

    edge: float | None = None
    region: tuple[int, int, int] | None = None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    kept: Kept = field(default_factory=Kept, compare=False, repr=False)

    @abstractmethod
    def prepare(self, brick: Brick) -> Any:
        """What `evaluate` needs for a brick; a function of the brick's place alone."""

    @abstractmethod
    def evaluate(
        self, prepared: Any, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Values at the points of three axes (nx,), (ny,), (nz,), 0 <= x, y, z < 1 within the brick, (nz, ny, nx)."""

    @property
    def cells(self) -> tuple[int, int, int]:
        return (1, 1, 1) if self.region is None else self.region

    @property
    def periodic(self) -> bool:
        return self.region is None

    @property
    def edge_mm(self) -> float | None:
        return self.edge

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.origin

    def sample(self, grid: Grid, threads: int = 1) -> NDArray[np.float32]:
        return self.sample_layers(grid, 0, grid.shape[2], threads)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        return self._sampled(grid, start, stop, threads, None)

    def solid_layers(
        self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: NDArray[np.int32] | None = None
    ) -> NDArray[np.uint8]:
        return (self._sampled(grid, start, stop, threads, wanted) < 0).view(np.uint8)

    def _sampled(
        self, grid: Grid, start: int, stop: int, threads: int, wanted: NDArray[np.int32] | None
    ) -> NDArray[np.float32]:
        """Values of some layers; 0 in bricks of which no row that matters has a sample."""
        axes = [_exact(grid.axis(axis)) for axis in range(3)]
        axes[2] = axes[2][start:stop]
        values = np.zeros((len(axes[2]), len(axes[1]), len(axes[0])), np.float32)
        spans = [_spans(axis) for axis in axes]

        def fill(job: tuple[tuple[int, int, int], tuple[int, int, int], tuple[int, int, int]]) -> None:
            brick = (0, 0, 0) if self.periodic else (job[0][0], job[1][0], job[2][0])
            prepared = self.kept.get(("prepared", brick), lambda: self.prepare(brick))
            x, y, z = (axis[low:high] - at for axis, (at, low, high) in zip(axes, job, strict=True))
            (_, i, i_end), (_, j, j_end), (_, k, k_end) = job
            values[k:k_end, j:j_end, i:i_end] = self.evaluate(prepared, x, y, z)

        jobs = [
            (in_x, in_y, (at, layer, min(layer + layers, high)))
            for at, low, high in spans[2]
            for in_y in spans[1]
            for in_x in spans[0]
            for layers in [max(1, BLOCK // ((in_x[2] - in_x[1]) * (in_y[2] - in_y[1])))]
            for layer in range(low, high, layers)
            if wanted is None or _any_wanted(wanted[layer : min(layer + layers, high), in_y[1] : in_y[2]], in_x)
        ]
        if threads > 1 and len(jobs) > 1:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(fill, jobs))
        else:
            for job in jobs:
                fill(job)
        return values


def _exact(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions to 2^-40 of a cell, so that what should be the same place in the next cell is."""
    return np.round(positions * 2.0**40) / 2.0**40


def _any_wanted(rows: NDArray[np.int32], span: tuple[int, int, int]) -> bool:
    """Whether a row's samples that matter, from the first to before the last, meet those of a span."""
    first, last = np.maximum(rows[..., 0], span[1]), np.minimum(rows[..., 1], span[2])
    return bool((first < last).any())


def _spans(positions: NDArray[np.float64]) -> list[tuple[int, int, int]]:
    """Runs of rising positions in one cell: its index, the first position, the one after the last."""
    cells = np.floor(positions).astype(np.int64)
    ends = [0, *(np.flatnonzero(np.diff(cells)) + 1).tolist(), len(cells)]
    return [(int(cells[a]), a, b) for a, b in pairwise(ends) if a < b]


def region_of(
    edge: float | None, cells: tuple[int, int, int] | None, cover: SurfaceMesh | None
) -> tuple[tuple[int, int, int], tuple[float, float, float]]:
    """Cells that a part takes, or those asked for, and the world position of the first one's low corner.

    Raises
    ------
    ConfigError
        If neither a part nor a number of cells is given, or the size of a cell is missing.
    """
    if cells is not None:
        return cells, (0.0, 0.0, 0.0)
    lattice = lattice_for(None, None, cover, edge)
    nx, ny, nz = lattice.mask.shape
    return (nx, ny, nz), lattice.origin
