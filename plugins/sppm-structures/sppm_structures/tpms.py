"""``field.tpms``: triply periodic minimal surfaces, as networks or sheets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, FieldMaker, Length, Palette, ScalarField, Size, option
from sppm_pipeline.nouns import FormulaField
from sppm_structures.nodal import SURFACES
from sppm_structures.sizes import field_size

SHALLOW = 1e-3
"""Least slope that a value is divided by, where the distance from the surface is estimated: the slope vanishes only
far from the surface."""

SAMPLED, SLOPED = 8.0, 42.0
"""Nanoseconds of a sample without and with the slope."""

COARSE = 24
"""Samples along a period from which the expected solid and surface are counted."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TpmsField(FormulaField):
    """The solid on one side of a nodal surface, or around it, with `repeat` periods along an edge of the cell.

    A "network" is ``f < level`` (or ``>``, if turned); a "sheet" ``|f - level| < width``; a "wall" the same with the
    distance ``|f - level| / |f'|`` in place of the difference, and half its thickness, cell sizes, in place of the
    width.
    """

    surface: str
    repeat: int
    form: str
    turned: bool
    level: float
    width: float

    def evaluate(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.floating]:
        nodal, turn = SURFACES[self.surface], 2 * np.pi * self.repeat
        phases = (turn * x, turn * y, turn * z)
        f = nodal.value(*phases)
        f -= self.level
        if self.form == "network":
            return np.negative(f, out=f) if self.turned else f
        np.abs(f, out=f)
        if self.form == "wall":
            f /= np.maximum(nodal.slope(*phases), SHALLOW) * turn
        f -= self.width
        return f

    def cut_at(self, value: float) -> TpmsField:
        if self.form == "network":
            return replace(self, level=self.level - value if self.turned else self.level + value)
        return replace(self, width=self.width + value)

    def summary(self) -> dict[str, Any]:
        """Surface, form and what tuning changes."""
        summary: dict[str, Any] = {"surface": self.surface, "form": self.form, "level": self.level}
        if self.form == "sheet":
            summary["half_width"] = self.width
        if self.form == "wall":
            summary["thickness"] = 2 * self.width
            if self.edge is not None:
                summary["thickness_mm"] = 2 * self.width * self.edge
        return summary


@dataclass(frozen=True, kw_only=True)
class Tpms(FieldMaker):
    """A triply periodic minimal surface by its nodal approximation f, as a solid network or a sheet.

    A network is the solid on one side of ``f = isovalue``. A sheet is either all points with ``|f - isovalue|`` below a
    half width, whose thickness varies over the surface, or those nearer than half a thickness, by the distance
    ``|f - isovalue| / |grad f|``, which is right to first order: thick walls get uneven.

    ``tune.porosity`` changes the isovalue of a network, the half width or thickness of a sheet.

    Sources of the formulas are in the plugin's README; what the paper calls TPMS-L is taken for the Lidinoid.
    """

    name: ClassVar[str] = "field.tpms"

    surface: str = option("gyroid", help="which surface", choices=tuple(SURFACES))
    form: str = option(
        "network",
        help="form of the solid; on one side of the surface, or around it",
        choices=("network", "sheet"),
    )
    isovalue: float = option(0.0, help="value of f at the surface", formerly="level")
    side: str = option("low", help="side of a network that is solid: where f is low, or high", choices=("low", "high"))
    thickness: Length | None = option(
        None,
        help="thickness of the walls; those of a sheet, 0.1 if neither this nor `half_width` is given",
        unit="cell size",
        above=0,
    )
    half_width: float | None = option(None, help="half the width of a sheet in values of f", above=0)
    repeat: int = option(1, help="periods along an edge of the cell", minimum=1, maximum=64)

    def check_options(self) -> None:
        if self.thickness is not None and self.half_width is not None:
            raise ConfigError("`thickness` and `half_width` exclude each other")
        if self.form == "network" and (self.thickness is not None or self.half_width is not None):
            raise ConfigError("a network has no thickness", hint="give `form: sheet`, or an `isovalue`")

    def estimate(self, palette: Palette) -> Size:
        made = self._field()
        # of one period, whose walls are thicker by as much as it is larger
        made = replace(made, repeat=1, width=made.width * (self.repeat if made.form == "wall" else 1))
        axis = (np.arange(COARSE) + 0.5) / COARSE
        values = np.asarray(made.evaluate(axis[:, None, None], axis[:, None], axis))
        solid = np.broadcast_to(values, (COARSE,) * 3) < 0
        crossed = sum(np.count_nonzero(solid != np.roll(solid, 1, along)) for along in range(3))
        # a plane of any direction crosses 3/2 grid lines per squared spacing in the mean
        surface = self.repeat * crossed / 1.5 / COARSE**2
        work = SLOPED if made.form == "wall" else SAMPLED
        return field_size(self.edge_mm, float(solid.mean()), surface, work)

    def run(self, context: Context) -> ScalarField:
        """Name the surface; it is evaluated where it is sampled."""
        return self._field()

    def _field(self) -> TpmsField:
        form, width = self.form, 0.0
        if form == "sheet":
            if self.half_width is not None:
                width = self.half_width
            else:
                form, width = "wall", self.in_cells(self.thickness or Length(0.1)) / 2
        return TpmsField(
            surface=self.surface,
            repeat=self.repeat,
            form=form,
            turned=self.side == "high",
            level=self.isovalue,
            width=width,
            edge=self.edge_mm,
        )
