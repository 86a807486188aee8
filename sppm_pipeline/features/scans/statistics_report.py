"""Statistics of the two phases of a field or image, with error bars and curves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline import Report, Table, number, reports
from sppm_pipeline.features.scans.numerics.stretching import stretch_of
from sppm_pipeline.nouns import TEXT, Chart, Curve
from sppm_pipeline.services.arrays import F64

CURVES = {
    "S2": "two-point probability", "cluster": "two-point cluster function", "path": "lineal path",
    "chords": "chord lengths, density", "thickness": "local thickness, share of the volume",
}  # fmt: skip
"""Names of curves, and what they are."""


@dataclass(frozen=True, eq=False)
class StatisticsReport(Report):
    """Statistics of solid and void. Lengths are in `unit`; error bars are standard errors over equal blocks.

    Attributes
    ----------
    grid : (nx, ny, nz)
    voxel : (x, y, z)
    unit : {"mm", "cell size"}
    sides : {"periodic", "open"}
        Whether opposite sides are neighbors.
    porosity, surface, curvature, euler : float
        Share of void; of the solid area, integral of the mean curvature and Euler number, each per volume.
    porosity_error, surface_error, curvature_error, euler_error : float
    solid, void : dict
        Of each phase: `chords`, the mean along x, y, z; `thickness`, the mean local thickness in the limit of fine
        grids, and `deviation` over the volume; `connected`, the share of its largest part.
    entry : (3,)
        Diameters of a ball that get into 90, 50 and 10 % of the void from the sides; 0 where none does.
    fabric : (3,)
        Mean intercept lengths of the solid along its principal axes, longest first.
    axes : (3, 3)
        These axes, one a row.
    curves : mapping of name to (m, 3)
        ``solid.S2``, ``void.path``, ...: distance or length, value, error bar; NaN where there is none. See `CURVES`.
    """

    headline: ClassVar[tuple[str, ...]] = ("porosity", "surface", "euler", "anisotropy")

    grid: tuple[int, int, int] = field(metadata=number("#3"))
    voxel: tuple[float, float, float] = field(metadata=number("#3"))
    unit: str = field(metadata=TEXT)
    sides: str = field(metadata=TEXT)
    porosity: float = field(metadata=number(error="porosity_error", box="porosity"))
    porosity_error: float = field(metadata=number())
    surface: float = field(metadata=number(unit="1/{unit}", error="surface_error"))
    surface_error: float = field(metadata=number())
    curvature: float = field(metadata=number(unit="1/{unit}^2", error="curvature_error"))
    curvature_error: float = field(metadata=number())
    euler: float = field(metadata=number(unit="1/{unit}^3", error="euler_error"))
    euler_error: float = field(metadata=number())
    solid: Mapping[str, Any] = field(metadata=number("*"))
    void: Mapping[str, Any] = field(metadata=number("*"))
    entry: tuple[float, ...] = field(metadata=number("#3", unit="{unit}"))
    fabric: F64 = field(metadata=number("#3", unit="{unit}"))
    axes: F64 = field(metadata=number("#3.#3"))
    curves: Mapping[str, F64] = field(metadata=TEXT)

    def check(self) -> None:
        """A share, and a table of three columns for each curve."""
        if not 0 <= self.porosity <= 1:
            raise ValueError(f"the porosity must lie between 0 and 1, got {self.porosity}")
        for name, curve in self.curves.items():
            if curve.ndim != 2 or curve.shape[1] != 3:
                raise ValueError(f"the curve {name!r} has the shape {curve.shape}, not (m, 3)")

    @property
    @reports()
    def anisotropy(self) -> float:
        """Longest over shortest mean intercept length."""
        return float(self.fabric[0] / self.fabric[2]) if self.fabric[2] > 0 else float("nan")

    @cached_property
    def _mapping(self) -> tuple[F64, F64]:
        return stretch_of(self.fabric, self.axes)

    @property
    @reports("#3")
    def stretch(self) -> F64:
        """How an isotropic structure is stretched along x, y, z to have this fabric; the product is 1, or NaN."""
        return self._mapping[0]

    @property
    @reports("#3", unit="degrees")
    def turn(self) -> F64:
        """Angles about x, then y, then z by which `warp.affine` turns it then."""
        return self._mapping[1]

    def table(self, curve: str = "solid.S2") -> Table:
        """A curve as a table of the columns distance, value and error; `KeyError` if there is no such curve."""
        found = self.curves[curve]
        return Table.from_arrays({"distance": found[:, 0], "value": found[:, 1], "error": found[:, 2]})

    def plot(self, kind: str = "S2", ax: Any = None) -> Any:
        """Draw the curves of a kind of `CURVES`, of both phases, with matplotlib; returns the axes."""
        from sppm_pipeline.nouns.artifact import optional_module

        axes = optional_module("matplotlib.pyplot").subplots()[1] if ax is None else ax
        for phase in ("solid", "void"):
            curve = self.curves[f"{phase}.{kind}"]
            axes.errorbar(curve[:, 0], curve[:, 1], curve[:, 2], label=phase, errorevery=4)
        axes.set(xlabel=f"length ({self.unit})", ylabel=CURVES[kind])
        axes.legend()
        return axes

    @classmethod
    def report_charts(cls, summary: Mapping[str, Any]) -> list[Chart]:
        """Both phases, a chart for each kind of curve."""
        found = summary.get("curves") or {}
        charts = []
        for kind, words in CURVES.items():
            arrays = {phase: np.asarray(found.get(f"{phase}.{kind}", ()), np.float64) for phase in ("solid", "void")}
            curves = [Curve(one[:, 0], one[:, 1], phase) for phase, one in arrays.items() if one.ndim == 2]
            if curves:
                charts.append(Chart(curves, f"length, {summary.get('unit')}", words))
        return charts
