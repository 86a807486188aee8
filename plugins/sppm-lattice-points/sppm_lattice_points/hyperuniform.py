"""``sample.hyperuniform``: disordered pores without density fluctuations at long waves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_lattice_points.measured import MeasuredSampler
from sppm_lattice_points.structure_factor import stealthy, structure_factor, wave_vectors
from sppm_pipeline import Context, DesignError, InteriorBox, PoreSet, option, options

TOLERANCE = 1e-8
"""Structure factor that counts as none."""


@dataclass(frozen=True, kw_only=True)
class Hyperuniform(MeasuredSampler):
    """Stealthy hyperuniform pores: independent pores, moved until the structure factor vanishes for all long waves.

    Such pores are as evenly spread as those of a lattice over long distances, and as disordered as thrown ones over
    short distances (Torquato 2018, "Hyperuniform states of matter"). Where pores lie on the faces, the interior box
    is taken as the periodic cell, and the property holds for that box only.
    """

    name: ClassVar[str] = "sample.hyperuniform"

    count: int = options.count(note="in one interior", minimum=4, maximum=2000)
    stealth: float = option(
        0.4,
        help="degrees of freedom bound by the waves, as a share of all; above 0.5 pores would crystallize",
        minimum=0.05,
        maximum=0.5,
    )

    def _waves(self) -> NDArray[np.float64]:
        waves = wave_vectors(self.count, self.stealth)
        if not len(waves):
            raise DesignError(
                f"{self.count} pores with `stealth: {self.stealth:g}` bind no wave at all",
                hint=f"give at least {int(np.ceil(1 / self.stealth)) + 1} pores",
            )
        return waves

    def run(self, context: Context, pores: PoreSet | None) -> PoreSet:
        """Throw the pores of all interiors; report the waves that were silenced."""
        thrown = super().run(context, pores)
        if thrown.has_faces:
            context.warn("with pores on the faces, only the box of the interior pores is hyperuniform")
            return thrown
        waves = self._waves()
        loudest = max(float(structure_factor(thrown.of_piece(t), waves).max()) for t in range(thrown.interiors))
        context.report(
            waves=2 * len(waves),
            shortest_wave=float(1 / np.sqrt((waves[-1] ** 2).sum())),
            largest_structure_factor=loudest,
        )
        return thrown

    def throw(self, rng: np.random.Generator, box: InteriorBox) -> NDArray[np.float64]:
        """Pores of one interior, (count, 3), cell sizes."""
        start = rng.random((self.count, 3))
        points = stealthy(start, self._waves(), tolerance=TOLERANCE, steps=20_000)
        return box.lower + points * (box.upper - box.lower)
