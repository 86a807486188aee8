"""A physics of its own in one folder: the permittivity of a laminate of two phases, exactly, and all that shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

import sppm_pipeline as sppm


@dataclass(frozen=True, eq=False)
class PermittivityReport(sppm.Report, sppm.Viewable):
    """Relative permittivity of a laminate, along x and y in its planes and along z across them.

    Attributes
    ----------
    relative : (3,) float64
    share : float
        Fraction of the first phase.
    spread : float
        Half the difference of the two phases, as an error bar that is easy to check.
    """

    headline: ClassVar[tuple[str, ...]] = ("relative", "relative.3", "anisotropy")

    relative: NDArray[np.float64] = field(metadata=sppm.number("#3", box="permittivity x, y, z", error="spread"))
    share: float = field(metadata=sppm.number())
    spread: float = field(metadata=sppm.number())

    @property
    @sppm.reports(label="in plane over across")
    def anisotropy(self) -> float:
        """Permittivity in the planes over that across."""
        return float(self.relative[0] / self.relative[2])

    def live_view(self) -> sppm.nouns.Surface:
        """An octahedron with the permittivities as half axes."""
        ends = np.concatenate([np.diag(self.relative), -np.diag(self.relative)])
        faces = [(a, b, c) for c in (2, 5) for a, b in ((0, 1), (1, 3), (3, 4), (4, 0))]
        outward = [f if np.linalg.det(ends[list(f)]) > 0 else (f[1], f[0], f[2]) for f in faces]
        return sppm.nouns.Surface(ends, np.array(outward), "permittivity", "of vacuum's")

    def picture(self) -> NDArray[np.uint8]:
        """The laminate: a row of light pixels for the first phase, of dark ones for the second."""
        rows = np.where(np.arange(32) % 8 < 8 * self.share, 230, 60).astype(np.uint8)
        return np.broadcast_to(rows[:, None, None], (32, 32, 3)).copy()

    @classmethod
    def report_charts(cls, summary: Mapping[str, Any]) -> list[sppm.nouns.Chart]:
        """Permittivity over the directions of the plane zx."""
        turn = np.linspace(0, 2 * np.pi, 73)
        across, along = summary["relative"][2], summary["relative"][0]
        curve = sppm.nouns.Curve(turn, across * np.cos(turn) ** 2 + along * np.sin(turn) ** 2, "zx plane")
        return [sppm.nouns.Chart([curve], "permittivity over direction", polar=True)]


@dataclass(frozen=True, kw_only=True)
class HomogenizeLaminate(sppm.Stage):
    """Compute the permittivity of a laminate: the mean of its phases in the planes, the harmonic mean across them."""

    name: ClassVar[str] = "homogenize.laminate"
    reported: ClassVar[tuple[str, ...]] = ()

    permittivity: tuple[float, float] = sppm.option((4.0, 1.0), help="of the two phases, relative", minimum=1)
    share: float = sppm.option(0.5, help="fraction of the first phase", minimum=0, maximum=1)

    def run(self, context: sppm.Context) -> PermittivityReport:
        """Mix."""
        fractions, own = np.array([self.share, 1 - self.share]), np.array(self.permittivity)
        mean, harmonic = float(fractions @ own), 1 / float(fractions @ (1 / own))
        return PermittivityReport(np.array([mean, mean, harmonic]), self.share, float(np.ptp(own)) / 2)


@sppm.hookimpl
def sppm_report_sections(record: Mapping[str, Any]) -> Sequence[sppm.nouns.ReportSection]:
    """A section of all laminates of the run."""
    found = [s["summary"] for s in record["stages"] if s["stage"] == HomogenizeLaminate.name and s["summary"]]
    rows = [(f"laminate {n}", one["relative"]) for n, one in enumerate(found, 1)]
    curve = sppm.nouns.Curve([one["share"] for one in found], [one["anisotropy"] for one in found], points=True)
    chart = sppm.nouns.Chart([curve], "share", "anisotropy")
    return [sppm.nouns.ReportSection("Laminates <of> the run", "Mixed exactly.", rows, [chart])] if found else []
