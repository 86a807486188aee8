"""The result of a simulated part: numbers of each case, and its surface with displacements and stresses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Report, Viewable, frozen, number
from sppm_pipeline.nouns import TEXT
from sppm_pipeline.nouns.artifact import NOTEBOOK_SIZE, Surface
from sppm_pipeline.nouns.report import Chart, Curve
from sppm_pipeline.services.arrays import F32, I32

SHOWN = 0.08
"""Largest displacement in pictures, over the diagonal of the part, if it is smaller."""

TOP = 99.9
"""Percentile over the solid that counts as the largest: stress has no limit at notches between voxels, nor has the
displacement of what hangs by an edge of a voxel."""


@dataclass(frozen=True, eq=False)
class PartResult(Report, Viewable):
    """Displacements and stresses of a part under its load cases.

    Attributes
    ----------
    way : {"resolved", "homogenized"}
    mass : float or None
        Of the solid, g; None if its density was not given.
    compliance : float
        Twice the energy that loads and given displacements store, N mm, weighted over the cases; of a resolved part on
        two grids, its limit on fine ones, as is the deflection.
    deflection : float
        Largest displacement of all cases, mm: 99.9 % of the nodes move less.
    stress : float
        99.9 % of the solid bear less, in every case: von Mises, MPa. Of a homogenized part the mean over its walls.
    safety : float or None
        Yield stress over that; of a homogenized part over an estimate of the peaks in its walls.
    loose : float
        Share of the solid that nothing holds, which is left out.
    error : float or None
        Error bar of compliance and deflection by refinement of the grid, relative; None on one grid.
    cases : mapping of case to numbers
        Compliance, deflection, stress, the force at what is held (x, y, z) and the iterations of each case.
    elements : int
    points : (n, 3) float32
        Nodes of the surface, mm.
    triangles : (m, 3) int32
    moved : (cases, n, 3) float32
        Displacements, mm.
    stresses : (cases, m) float32
        At the triangles, MPa.
    """

    headline: ClassVar[tuple[str, ...]] = ("compliance", "deflection", "safety", "mass")

    way: str = field(metadata=TEXT)
    compliance: float = field(metadata=number(unit="N mm", box="compliance"))
    deflection: float = field(metadata=number(unit="mm", box="deflection"))
    stress: float = field(metadata=number(unit="MPa"))
    safety: float | None = field(default=None, metadata=number(box="safety factor", optional=True))
    mass: float | None = field(default=None, metadata=number(unit="g", box="mass", optional=True))
    loose: float = field(default=0.0, metadata=number())
    error: float | None = field(default=None, metadata=number(optional=True))
    elements: int = field(default=0, metadata=number())
    cases: Mapping[str, Any] = field(default_factory=dict, metadata=number("*"))
    points: F32 = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    triangles: I32 = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    moved: F32 = field(default_factory=lambda: np.zeros((0, 0, 3), np.float32))
    stresses: F32 = field(default_factory=lambda: np.zeros((0, 0), np.float32))

    def __post_init__(self) -> None:
        for name in ("points", "triangles", "moved", "stresses"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def check(self) -> None:
        """Finite numbers, and arrays that fit each other."""
        count = len(self.cases)
        if self.moved.shape != (count, len(self.points), 3) or self.stresses.shape != (count, len(self.triangles)):
            raise ValueError("displacements and stresses do not fit the surface")
        if not (np.isfinite(self.moved).all() and np.isfinite([self.compliance, self.deflection, self.stress]).all()):
            raise ValueError("displacements and stresses must be finite")

    @property
    def magnification(self) -> float:
        """Factor of displacements in pictures."""
        size = float(np.linalg.norm(np.ptp(self.points, axis=0)))
        return max(1.0, float(f"{SHOWN * size / max(self.deflection, 1e-300):.1g}"))

    def shown(self, number: int) -> F32:
        """The surface of a case as it is drawn: displacements magnified, the few beyond `deflection` cut there."""
        moved = self.moved[number]
        size = np.linalg.norm(moved, axis=1, keepdims=True)
        held = np.minimum(1, self.deflection / np.maximum(size, np.float32(1e-30)))
        return np.asarray(self.points + np.float32(self.magnification) * held * moved, np.float32)

    def live_view(self) -> Surface:
        """The deformed surface in its first case, and the surface as it was."""
        shown = self.shown(0)
        title = f"{next(iter(self.cases))}, displacements {self.magnification:g} times"
        return Surface(shown, self.triangles, title, "mm", self.points, self.magnification)

    def picture(self) -> NDArray[np.uint8]:
        """The deformed part in its first case, in colors of the stress."""
        from sppm_pipeline.features.parts.pictures import deformed_picture

        return deformed_picture(self, 0, NOTEBOOK_SIZE)

    @classmethod
    def report_charts(cls, summary: Mapping[str, Any]) -> list[Chart]:
        """The compliance of each case, if there are several."""
        cases = summary.get("cases") or {}
        if len(cases) < 2:
            return []
        values = [one["compliance"] for one in cases.values()]
        return [Chart([Curve(list(range(1, len(values) + 1)), values, points=True)], "case", "compliance, N mm")]
