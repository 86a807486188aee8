"""Stages that a table needs: the void around spheres on a lattice, and their drag."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, FieldMaker, Stage, option
from sppm_pipeline.features.flow.permeability import PermeabilityReport

CENTERS = {
    "SC": ((0.5, 0.5, 0.5),),
    "BCC": ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5)),
    "FCC": ((0.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, 0.0, 0.5), (0.0, 0.5, 0.5)),
}


def radius_of(lattice, share):
    return float((3 * share / 4 / np.pi / len(CENTERS[lattice])) ** (1 / 3))


@dataclass(frozen=True, kw_only=True)
class Spheres(FieldMaker):
    """Spheres of a solid on a cubic lattice."""

    name: ClassVar[str] = "field.spheres"

    lattice: str = option("SC", help="lattice", choices=tuple(CENTERS))
    share: float = option(0.2, help="share of the solid, spheres counted apart", minimum=0.001, maximum=0.8)

    def evaluate(self, x, y, z):
        squares = [
            sum(((v - c + 0.5) % 1 - 0.5) ** 2 for v, c in zip((x, y, z), center, strict=True))
            for center in CENTERS[self.lattice]
        ]
        return np.sqrt(np.min(np.broadcast_arrays(*squares), axis=0)) - radius_of(self.lattice, self.share)


@dataclass(frozen=True, kw_only=True)
class Drag(Stage):
    """Measure the drag of a sphere over that of a single one, by Stokes, and its difference from a known one."""

    name: ClassVar[str] = "measure.drag"
    reported: ClassVar[tuple[str, ...]] = ("drag", "known", "error_percent")

    lattice: str = option("SC", help="lattice", choices=tuple(CENTERS))
    share: float = option(0.2, help="share of the solid", minimum=0.001, maximum=0.8)
    known: float = option(help="known drag", minimum=1, maximum=1000)

    def run(self, context: Context, report: PermeabilityReport) -> None:
        drag = 1 / (6 * np.pi * radius_of(self.lattice, self.share) * len(CENTERS[self.lattice]) * report.k[0, 0])
        context.report(drag=float(drag), known=self.known, error_percent=100 * (float(drag) / self.known - 1))
