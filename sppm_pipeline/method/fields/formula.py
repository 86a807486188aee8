"""Fields given by a formula of the position: one periodic cell, or a part of any size.

Samples are evaluated in blocks by several threads, and positions are taken to 2^-40 of a cell, so that neither the
number of threads, nor the cut of the grid into slabs, nor the period changes a bit of the result.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.fields.scalar_field import Placed, ScalarField
from sppm_pipeline.services.arrays import F32, F64, I32, U8
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.threads import ordered_map

BLOCK = 1 << 18
"""Samples evaluated together by one thread: few enough that intermediate results stay in the processor's cache."""

MAX_KEPT = 512
"""Cells whose tables are kept, some 200 KB each: a slab of a part of 22 x 22 cells."""

CellIndex = tuple[int, int, int]
"""A cell of the lattice by its indices; they may be negative."""

Span = tuple[int, int, int]
"""Index of a cell along an axis, its first position in a grid and the one after its last."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PlacedField(Placed, ScalarField):
    """Base of fields with a size and a place of their own.

    Attributes
    ----------
    edge : float or None
        Cell size, mm.
    region : tuple of 3 ints or None
        Cells of a part that does not repeat; None for one cell that does.
    origin : tuple of 3 floats
        World position of the low corner of cell (0, 0, 0), mm.
    """

    edge: float | None = None
    region: tuple[int, int, int] | None = None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def cells(self) -> tuple[int, int, int]:
        return (1, 1, 1) if self.region is None else self.region

    @property
    def periodic(self) -> bool:
        return self.region is None


@dataclass(frozen=True, eq=False, kw_only=True)
class FormulaField(PlacedField):
    """Base of fields that are a function of the position alone: implement `evaluate`."""

    @abstractmethod
    def evaluate(self, x: F64, y: F64, z: F64) -> NDArray[np.floating]:
        """Values, negative in the solid, at the points of three axes: x (nx, 1, 1), y (ny, 1), z (nz,).

        Positions are in cell sizes: 0 <= x, y, z < 1 in a periodic cell, else from the low corner of the part. The
        values are (nx, ny, nz), or broadcast to it, in any order in memory. That at a point may not depend on which
        others are asked for.
        """

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        x, y, z = (_rounded(grid.axis(axis), self.periodic) for axis in range(3))
        values = np.empty((stop - start, len(y), len(x)), np.float32)
        rows = max(1, BLOCK // max(1, len(x)))  # of one layer, or of several whole ones
        layers = max(1, rows // len(y))

        def fill(at: tuple[int, int]) -> None:
            k, j = at
            own = values[k : k + layers, j : j + rows].T
            made: Any = self.evaluate(x[:, None, None], y[j : j + rows, None], z[start + k : start + k + own.shape[2]])
            own[...] = _checked(made, own.shape)

        blocks = [(k, j) for k in range(0, stop - start, layers) for j in range(0, len(y), rows)]
        deque(ordered_map(fill, blocks, threads), maxlen=0)
        return values.T


def _checked(made: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """Checked result of `evaluate`, which may be as small as what it depends on: (nz,) for a function of z."""
    array = np.asarray(made)
    fits = array.ndim <= len(shape) and all(a in (1, b) for a, b in zip(array.shape[::-1], shape[::-1], strict=False))
    if array.dtype.kind not in "if" or not fits:
        raise ValueError(
            f"`evaluate` must return numbers of the shape (x, y, z) = {shape}, or one that broadcasts to it; got "
            f"{array.dtype} {array.shape}"
        )
    return array


class CellCache:
    """Cache of the contents of the cells that were asked for last."""

    def __init__(self, most: int = MAX_KEPT) -> None:
        self._most = most
        self._made: OrderedDict[Any, Any] = OrderedDict()
        self._lock = Lock()

    def known(self) -> list[Any]:
        """Keys of what is kept, the last one asked for at the end."""
        with self._lock:
            return list(self._made)

    def get(self, key: Any, make: Callable[[], Any]) -> Any:
        """Cached value of `key`, or `make()`; two threads may make the same at once, which does no harm."""
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
class CellwiseField(PlacedField):
    """Base of fields with a content of its own in every cell of a part: implement `prepare` and `evaluate`."""

    kept: CellCache = field(default_factory=CellCache, compare=False, repr=False)

    @abstractmethod
    def prepare(self, cell: CellIndex) -> Any:
        """Content of a cell for `evaluate`, a function of the cell's place alone."""

    @abstractmethod
    def evaluate(self, prepared: Any, x: F64, y: F64, z: F64) -> F32:
        """Values at the points of three axes (nx,), (ny,), (nz,), 0 <= x, y, z < 1 within the cell: (nx, ny, nz)."""

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        return self._sampled(grid, start, stop, threads, None)

    def solid_layers(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> U8:
        return (self._sampled(grid, start, stop, threads, wanted) < 0).view(np.uint8)

    def _sampled(self, grid: Grid, start: int, stop: int, threads: int, wanted: I32 | None) -> F32:
        """Values of some layers; 0 in cells of which no row that matters has a sample."""
        axes = [_rounded(grid.axis(axis), False) for axis in range(3)]
        axes[2] = axes[2][start:stop]
        values = np.zeros((len(axes[2]), len(axes[1]), len(axes[0])), np.float32).T
        spans = [_spans(axis) for axis in axes]

        def fill(block: tuple[Span, Span, Span]) -> None:
            cell = (0, 0, 0) if self.periodic else (block[0][0], block[1][0], block[2][0])
            prepared = self.kept.get(("prepared", cell), lambda: self.prepare(cell))
            x, y, z = (axis[low:high] - at for axis, (at, low, high) in zip(axes, block, strict=True))
            (_, i, i_end), (_, j, j_end), (_, k, k_end) = block
            values[i:i_end, j:j_end, k:k_end] = self.evaluate(prepared, x, y, z)

        blocks = [
            (in_x, in_y, (at, layer, min(layer + layers, high)))
            for at, low, high in spans[2]
            for in_y in spans[1]
            for in_x in spans[0]
            for layers in [max(1, BLOCK // ((in_x[2] - in_x[1]) * (in_y[2] - in_y[1])))]
            for layer in range(low, high, layers)
            if wanted is None or _any_wanted(wanted[layer : min(layer + layers, high), in_y[1] : in_y[2]], in_x)
        ]
        deque(ordered_map(fill, blocks, threads), maxlen=0)
        return values


def _rounded(positions: F64, periodic: bool) -> F64:
    """Positions to 2^-40 of a cell, of a periodic cell between 0 and 1.

    A position that should be the same in the next cell is off by some rounding, and must give the same value.
    """
    if not periodic:
        return np.round(positions * 2.0**40) / 2.0**40
    inside = np.round((positions - np.floor(positions)) * 2.0**40) / 2.0**40
    # what is rounded up to 1 lies in the next cell
    inside[inside >= 1.0] = 0.0
    return inside


def _any_wanted(rows: I32, span: Span) -> bool:
    """True if a row's samples that matter, from the first to before the last, meet those of a span."""
    first, last = np.maximum(rows[..., 0], span[1]), np.minimum(rows[..., 1], span[2])
    return bool((first < last).any())


def _spans(positions: F64) -> list[Span]:
    """Runs of rising positions in one cell."""
    cells = np.floor(positions).astype(np.int64)
    ends = [0, *(np.flatnonzero(np.diff(cells)) + 1).tolist(), len(cells)]
    return [(int(cells[a]), a, b) for a, b in pairwise(ends) if a < b]
