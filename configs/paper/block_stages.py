"""A stage that a table needs: stresses of a crushed block as means over half a percent of strain."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from sppm_crushing import CompressionCurve

from sppm_pipeline import Context, Stage


@dataclass(frozen=True, kw_only=True)
class MeasureBlock(Stage):
    """Measure the highest stress up to 20 % strain, stresses beyond it, and work per volume."""

    name: ClassVar[str] = "measure.block"
    reported: ClassVar[tuple[str, ...]] = ("highest", "at", "mean", "stress_*", "low", "high", "work_*")

    def run(self, context: Context, curve: CompressionCurve) -> None:
        # single spikes are waves of the march
        grid = np.arange(0.0, 0.4001, 0.001)
        around = np.interp(grid[:, None] + np.linspace(-0.0025, 0.0025, 6), curve.strain, curve.stress)
        stress = around.mean(axis=1)
        early, later = grid <= 0.2, stress[grid >= 0.05]
        work = np.concatenate([[0.0], np.cumsum(np.diff(curve.strain) * (curve.stress[1:] + curve.stress[:-1]) / 2)])
        context.report(
            highest=float(stress[early].max()), at=float(grid[early][np.argmax(stress[early])]),
            mean=float(later.mean()), low=float(later.min() / later.mean()), high=float(later.max() / later.mean()),
            **{f"stress_{n}": float(np.interp(n / 100, grid, stress)) for n in (5, 10, 20, 30, 40)},
            **{f"work_{n}": float(np.interp(n / 100, curve.strain, work)) for n in (5, 6, 9, 12, 15, 25, 40, 45)},
        )  # fmt: skip
