"""The size and porosity of a cell that give struts and pores of the sizes asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

from sppm_pipeline.nouns.report import TEXT, Report, number


@dataclass(frozen=True, eq=False)
class CellSizes(Report):
    """A cell designed by its sizes, of which `tile` stages take the cell size and the porosity.

    Sizes are mean local thicknesses in mm, in the limit of fine grids.

    Attributes
    ----------
    edge_mm : float
        Cell size.
    porosity : float
    strut, pore : float
        Obtained mean size of the solid (struts or walls) and of the void.
    strut_deviation, pore_deviation : float
        Standard deviations over the volume.
    strut_low, strut_high, pore_low, pore_high : float
        Sizes at 5 and 95 % of the volume.
    strut_thinnest, pore_thinnest : float
        Sizes below which 1 % of the volume is.
    strut_asked : float
    pore_asked : float or None
        None if a throat was asked for.
    draws : int
        Cells over which sizes are averaged.
    lay : {"scattered", "cells"}
        Rules that the design holds for: scattered pores are joined across cells and make other struts than cells do.
    throat : float or None
        Diameter of the largest ball that passes through the void, if it was asked for.
    """

    headline: ClassVar[tuple[str, ...]] = (
        "strut", "strut_low", "strut_high", "strut_thinnest", "pore", "edge_mm", "porosity",
    )  # fmt: skip

    edge_mm: float = field(metadata=number(label="cell", unit="mm", box="cell, mm"))
    porosity: float = field(metadata=number(box="porosity"))
    strut: float = field(metadata=number(label="struts", unit="mm", error="strut_deviation", box="struts, mm"))
    strut_deviation: float = field(metadata=number())
    strut_low: float = field(metadata=number(label="5 % below"))
    strut_high: float = field(metadata=number(label="95 % below"))
    strut_thinnest: float = field(metadata=number(label="1 % below"))
    pore: float = field(metadata=number(label="pores", unit="mm", error="pore_deviation", box="pores, mm"))
    pore_deviation: float = field(metadata=number())
    pore_low: float = field(metadata=number())
    pore_high: float = field(metadata=number())
    pore_thinnest: float = field(metadata=number())
    strut_asked: float = field(metadata=number())
    pore_asked: float | None = field(metadata=number())
    draws: int = field(metadata=number())
    lay: str = field(default="scattered", metadata=TEXT)
    throat: float | None = field(default=None, metadata=number(label="throat", unit="mm"))

    def check(self) -> None:
        """A length above 0 and a share between 0 and 1."""
        if not (math.isfinite(self.edge_mm) and self.edge_mm > 0 and 0 < self.porosity < 1):
            raise ValueError(f"no cell has the size {self.edge_mm} mm and the porosity {self.porosity}")
