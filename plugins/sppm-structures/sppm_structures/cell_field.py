"""Fields of one periodic cell that are given by a formula."""

from __future__ import annotations

from abc import abstractmethod
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.length import Length
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.numerics.grid import Grid

BLOCK = 1 << 18
"""Samples evaluated together: few enough that the intermediate results stay in the processor's cache."""


def in_cell_edges(length: Length, edge_mm: float | None) -> float:
    """A length in cell edges.

    Raises
    ------
    ConfigError
        If it has a unit and the cell has no physical size.
    """
    if length.unit is None:
        return length.value
    if edge_mm is None:
        raise ConfigError(
            f"the length {length} has a physical unit, but the cell has no physical size",
            hint="give the stage the size of the cell, for example `edge: 7.5 mm`, or write the length in cell edges",
        )
    return length.mm() / edge_mm


@dataclass(frozen=True, eq=False, kw_only=True)
class CellField(ScalarField):
    """Base of formulas: implement `evaluate`.

    Attributes
    ----------
    edge : float or None
        Edge of the cell, mm.
    """

    edge: float | None = None

    @abstractmethod
    def evaluate(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.floating]:
        """Values at the points of three axes, cell edges; x (nx,), y (ny, 1), z (nz, 1, 1), 0 <= x, y, z < 1.

        Negative in the solid. The value at a point may not depend on which others are asked for.
        """

    @property
    def cells(self) -> tuple[int, int, int]:
        return (1, 1, 1)

    @property
    def periodic(self) -> bool:
        return True

    @property
    def edge_mm(self) -> float | None:
        return self.edge

    def sample(self, grid: Grid, threads: int = 1) -> NDArray[np.float32]:
        return self.sample_layers(grid, 0, grid.shape[2], threads)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        x, y, z = (_into_cell(grid.axis(axis)) for axis in range(3))
        values = np.empty((stop - start, len(y), len(x)), np.float32)
        rows = max(1, BLOCK // max(1, len(x)))  # of one layer, or of several whole ones
        layers = max(1, rows // len(y))

        def fill(at: tuple[int, int]) -> None:
            k, j = at
            own = values[k : k + layers, j : j + rows]
            own[...] = self.evaluate(x, y[j : j + rows, None], z[start + k : start + k + own.shape[0], None, None])

        blocks = [(k, j) for k in range(0, stop - start, layers) for j in range(0, len(y), rows)]
        if threads > 1 and len(blocks) > 1:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(fill, blocks))
        else:
            for block in blocks:
                fill(block)
        return values


def _into_cell(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions of the periodic cell, so that a repeated one gives the same value to the last bit.

    A position that should be the same in the next cell is off by some rounding; 2^-40 of a cell is taken for none.
    """
    inside = np.round((positions - np.floor(positions)) * 2.0**40) / 2.0**40
    inside[inside >= 1.0] = 0.0
    return inside
