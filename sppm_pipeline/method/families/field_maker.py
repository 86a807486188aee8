"""Base classes of stages that make a field from a formula: one method evaluates it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.families import options
from sppm_pipeline.method.families.tiler import lattice_for
from sppm_pipeline.method.fields.formula import FormulaField
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.stage import Context, Stage


@dataclass(frozen=True, kw_only=True)
class Formula(Stage):
    """Common base of `FieldMaker` and `PartFieldMaker`: the formula, and the size of a cell.

    Implement `cut_at` where an option says what tuning the porosity should change, and `finest_radius` where it is
    known what a grid must show.
    """

    edge: Length | None = options.edge(None)

    def evaluate(self, x: F64, y: F64, z: F64) -> NDArray[np.floating]:
        """Values, negative in the solid, at the points of three axes: x (nx, 1, 1), y (ny, 1), z (nz,).

        Positions are in cell sizes: 0 <= x, y, z < 1 in a periodic cell, else from the low corner of the part. The
        values are (nx, ny, nz), or broadcast to it, in any order in memory. That at a point may not depend on which
        others are asked for.
        """
        raise NotImplementedError(f"{type(self).__name__} needs the method `evaluate`")

    def cut_at(self, value: float) -> Self | None:
        """The stage whose solid is where this one's values are smaller than `value`; None to subtract the value."""
        return None

    @property
    def finest_radius(self) -> float | None:
        """Radius of the thinnest channel, cell sizes, which coarse grids are warned about; None if unknown."""
        return None

    @property
    def edge_mm(self) -> float | None:
        """Cell size, mm; None if it has no physical size."""
        return self.edge.mm() if self.edge is not None else None

    def in_cells(self, length: Length, edge_mm: float | None = None) -> float:
        """A length in cell sizes; `edge_mm` replaces that of the stage. ConfigError for a physical unit without any."""
        return length.in_cells(edge_mm or self.edge_mm)


@dataclass(frozen=True, kw_only=True)
class FieldMaker(Formula):
    """Base of formulas of a periodic cell: implement `evaluate`.

    The stage itself is what is evaluated, so its options are the parameters of the formula. A stage whose formula
    needs more than options, such as something drawn at random, replaces `run` and makes a `FormulaField` of its own.
    """

    def run(self, context: Context) -> ScalarField:
        """Make the field; nothing is computed before it is sampled."""
        return MadeField(maker=self, edge=self.edge_mm)


@dataclass(frozen=True, kw_only=True)
class PartFieldMaker(Formula):
    """Base of formulas that do not repeat but fill a part, or a box of cells, of any size: implement `evaluate`.

    A stage whose formula needs more than options replaces `run` and makes a `FormulaField` or, with a content of its
    own in every cell, a `CellwiseField`.
    """

    cells: tuple[int, int, int] | None = options.cells(None)

    def region(
        self, cover: SurfaceMesh | None, edge_mm: float | None = None
    ) -> tuple[tuple[int, int, int], tuple[float, float, float]]:
        """Cells that the part takes, or those of `cells`, and the world position of the first one's low corner.

        Raises ConfigError if there is neither a part nor a number of cells, or the size of a cell is missing.
        """
        if self.cells is not None:
            return self.cells, (0.0, 0.0, 0.0)
        lattice = lattice_for(None, None, cover, edge_mm or self.edge_mm)
        nx, ny, nz = lattice.mask.shape
        return (nx, ny, nz), lattice.origin

    def run(self, context: Context, cover: SurfaceMesh | None) -> ScalarField:
        """Make the field of the part; nothing is computed before it is sampled."""
        region, origin = self.region(cover)
        return MadeField(maker=self, edge=self.edge_mm, region=region, origin=origin)


@dataclass(frozen=True, eq=False, kw_only=True)
class MadeField(FormulaField):
    """The field that a stage evaluates."""

    maker: Formula
    offset: float = 0.0  # subtracted from the values

    def evaluate(self, x: F64, y: F64, z: F64) -> NDArray[np.floating]:
        values = self.maker.evaluate(x, y, z)
        # a float64 scalar promotes float32 values, so that the difference keeps its digits
        return values - np.float64(self.offset) if self.offset else values

    def cut_at(self, value: float) -> MadeField:
        maker = self.maker.cut_at(value)
        return replace(self, offset=self.offset + value) if maker is None else replace(self, maker=maker)

    @property
    def finest_radius(self) -> float | None:
        return self.maker.finest_radius

    def summary(self) -> dict[str, Any]:
        """The size."""
        return {"cells": list(self.cells), "cell_mm": self.edge}
