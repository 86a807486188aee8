"""``tune.local_porosity``: a level that varies from place to place, so that every cell has its porosity."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sppm_pipeline import Palette, Part, ScalarField, Size, Tiling, options
from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.grading.curved_cells import CurvedCells
from sppm_pipeline.features.grading.curved_porosity import (
    CurvedSamples,
    curved_cells_of,
    curved_targets,
    fit_curved_level,
)
from sppm_pipeline.features.grading.laid_graph import WarpedTiling
from sppm_pipeline.features.grading.local_porosity import HALF_RANGE, RAMP, LatticeCells, cell_means, error_summary
from sppm_pipeline.features.grading.numerics.cell_level import BYTES_OF_A_SAMPLE
from sppm_pipeline.features.grading.numerics.local_level import CellCodes, LevelFit, fit_level
from sppm_pipeline.method.fields.kernel_sum import KernelSum
from sppm_pipeline.method.fields.level_field import LevelField
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.stage import Context, Headline, Stage, option

LOWEST = 0.05
"""Lower bound of the level C, where pores are 1.5 times as wide as at the usual 0.25. Not sensitive: levels of graded
bars stay between 0.22 and 0.27 once the numbers of pores are right."""

CHECKED = 16
"""Cells, spread over the part, that are measured again on a finer grid."""


class _Fitted(NamedTuple):
    """A field with its level, and the cells that had an equation: names, numbers among all cells, targets and fit."""

    field: LevelField
    names: list[Any]
    numbers: I64
    targets: F64
    fit: LevelFit
    resolution: int


@dataclass(frozen=True, kw_only=True)
class TuneLocalPorosity(Stage):
    """Choose a smooth level so that every cell has the porosity that a map gives as its mean.

    Of fields that are sums of kernels ln C becomes a quadratic spline with one control point in the middle of each
    cell, found by Newton steps. Other fields are cut at a spline of values. The level stays between bounds, so that
    tunnels keep most of their radius; cells that would need more are named, with the number of pores they are off by.
    Between cells porosity keeps the noise of the structure.

    Of what was bent by a `warp` stage, or laid by `tile.hexahedra`, the cells are those of the structure: each has a
    value of its own, and values are blended by smooth weights around the middles of the cells.
    """

    name: ClassVar[str] = "tune.local_porosity"
    version: ClassVar[int] = 2
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("error_rms", "error of the cells, rms"), Headline("error_max", "largest"), Headline("cells_at_bound"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = (
        "cells_tuned", "cells_at_bound", "steps", "level_min", "level_max", "error_mean", "error_rms", "error_p95",
        "error_max", "checked_at",
    )  # fmt: skip

    resolution: int = options.resolution(40, note="for measuring the porosity", minimum=8, maximum=256)
    tolerance: float = options.tolerance(0.001)
    narrowest: float = option(
        0.8, help="least radius of a tunnel over that at the field's own level", above=0, maximum=1
    )
    evaluations: int = options.evaluations(12, note="of all cells, one for each Newton step")

    def estimate(self, palette: Palette, field: Size, grading: Size) -> Size:
        n = self.resolution
        samples = field.body.volume * float(n**3) + min(field.body.volume, CHECKED) * (n + n // 2 + 1) ** 3
        return Size(
            design=field.design, geometry=field.body, samples=samples, sums=samples * field.body.kernels,
            resident=field.body.volume * float(n**3) / 2,
        )  # fmt: skip

    def run(self, context: Context, field: ScalarField, grading: Grading) -> ScalarField:
        """Measure, correct, and check on a finer grid."""
        inner = field.base if isinstance(field, Part) else field
        earlier = inner if isinstance(inner, LevelField) else None
        bare = earlier.base if earlier is not None else inner
        if not isinstance(bare, KernelSum) and bare.periodic:
            raise DesignError("a level varies over the cells of a part", hint="lay the cell by `tile.periodic` first")
        part = replace(field, base=bare) if isinstance(field, Part) else bare
        curved = curved_cells_of(bare)
        if curved is None:
            fitted = self._in_lattice(context, part, bare, earlier, grading)
        else:
            fitted = self._in_curved(context, part, bare, curved, grading)
        tuned = replace(field, base=fitted.field) if isinstance(field, Part) else fitted.field
        self._warn_of_bounds(context, fitted, bare)
        finer = fitted.resolution + fitted.resolution // 2 + 1  # no grid of whole multiples, whose errors would agree
        if curved is None:
            # some cells, spread over the part, show whether the first grid was fine enough
            some = fitted.names[:: -(-len(fitted.names) // CHECKED)]
            measured = LatticeCells(tuned, finer, context.threads, only=some)
            number = {cell: m for m, cell in enumerate(fitted.names)}
            which = np.array([number[cell] for cell in measured.cells])
            found = measured.counted()
        else:
            which = np.arange(len(fitted.names))
            found = CurvedSamples(tuned, curved, finer, context.threads).shares().porosity[fitted.numbers]
        self._warn_of_errors(context, fitted, which, found - fitted.targets[which], finer)
        context.report(
            cells_tuned=len(fitted.targets), cells_at_bound=int(fitted.fit.at_bound.sum()), steps=fitted.fit.steps,
            **{name: value for name, value in fitted.field.summary().items() if name in ("level_min", "level_max")},
        )  # fmt: skip
        return tuned

    def _in_lattice(
        self, context: Context, part: ScalarField, bare: ScalarField, earlier: LevelField | None, grading: Grading
    ) -> _Fitted:
        cells = LatticeCells(part, self.resolution, context.threads)
        if not cells.cells:
            raise DesignError("no cell lies in the part", hint="give smaller cells")
        targets = cell_means(grading, "porosity", bare.physical_edge(), bare.origin_mm, np.array(cells.cells))
        scale = 1.0
        if bare.sum_level is None:
            scale = float(cells.values([cells.cells[len(cells.cells) // 2]]).std())
        start, half, ramp, bounds = self._range(bare.sum_level, scale)
        control = np.full(bare.cells, start) if earlier is None else np.array(earlier.control)
        codes = CellCodes(cells.sampled, start, half, memory=context.memory / 2)
        fit = fit_level(
            codes, cells.cells, targets, control, bounds, ramp, self.tolerance / 4, self.evaluations, cells.across,
            lambda done, of: context.progress(done, of, "cells compared"),
        )  # fmt: skip
        numbers = np.arange(len(targets))
        return _Fitted(LevelField(bare, fit.values), cells.cells, numbers, targets, fit, self.resolution)

    def _in_curved(
        self, context: Context, part: ScalarField, bare: ScalarField, curved: CurvedCells, grading: Grading
    ) -> _Fitted:
        n = self._fitting(context, curved)
        samples = CurvedSamples(part, curved, n, context.threads)
        targets = curved_targets(grading, "porosity", curved)
        scale = 1.0
        if bare.sum_level is None:
            scale = float(next(samples.found()).value.std())
        start, half, _, bounds = self._range(bare.sum_level, scale)
        made, fit, known = fit_curved_level(
            samples, bare, targets, start, bounds, half / 80, self.tolerance / 4, self.evaluations,
            lambda done, of: context.progress(done, of, "comparisons of all cells"),
        )  # fmt: skip
        numbers = np.flatnonzero(known)
        names = [dict(zip(curved.columns, name, strict=True)) for name in curved.names[numbers].tolist()]
        fit = fit._replace(errors=fit.errors[known], at_bound=fit.at_bound[known])
        return _Fitted(made, names, numbers, targets[known], fit, n)

    def _range(self, level: float | None, deviation: float) -> tuple[float, float, float, tuple[float, float]]:
        """The level to start from, half the range of values that are resolved, the width of the ramp, and the bounds:
        of the `level` of a sum of kernels, or by the standard `deviation` of the values of any other field.
        """
        if level is None:
            half = 4 * deviation
            return 0.0, half, half / 40, (-half, half)  # a tenth of the deviation: the field may bend sharply
        start, bounds = math.log(level), (math.log(LOWEST), self.narrowest * math.log(level))
        if not bounds[0] < start < bounds[1]:
            raise DesignError(f"the level of {level:g} must lie above {LOWEST:g} and below 1")
        return start, HALF_RANGE, RAMP, bounds

    def _fitting(self, context: Context, curved: CurvedCells) -> int:
        """The resolution, or a lower one whose samples fit into memory."""
        n = self.resolution
        while n > 8 and BYTES_OF_A_SAMPLE * float(n) ** 3 * curved.count > context.memory / 2:
            n -= max(1, n // 16)
        if n < self.resolution:
            context.warn(f"samples of all cells would not fit into memory; `resolution: {n}` is taken")
        return n

    def _warn_of_bounds(self, context: Context, fitted: _Fitted, field: ScalarField) -> None:
        """Name the cell that stays farthest from its target because the level would leave its bounds."""
        errors, targets, at_bound = fitted.fit.errors, fitted.targets, fitted.fit.at_bound
        if not at_bound.any():
            return
        worst = int(np.argmax(np.where(at_bound, np.abs(errors), -1)))
        error = float(errors[worst])
        advice = f"{'fewer' if error > 0 else 'more'} pores"
        if isinstance(field, Tiling) and not isinstance(field, WarpedTiling):
            # a pore takes the same share of what is solid anywhere, as in the Boolean model
            mean, count = float(targets.mean()), field.tileset.micro.graph.pores.per_cell
            of_a_pore = (1 - targets[worst]) * -math.log1p(-mean) / count
            advice = f"about {max(1, round(abs(error) / of_a_pore))} {advice}"
        elif not isinstance(field, KernelSum):
            advice = "a wider range of levels"
        context.warn(
            f"the level reaches its bound in {int(at_bound.sum())} of {len(targets)} cells; cell {fitted.names[worst]} "
            f"has a porosity of {targets[worst] + error:.4f} instead of {targets[worst]:.4f} and needs {advice}"
        )

    def _warn_of_errors(self, context: Context, fitted: _Fitted, which: I64, errors: F64, finer: int) -> None:
        """Report the errors of some cells on an independent grid, and name the worst if it is beyond the tolerance."""
        context.report(checked_at=finer, **error_summary(errors))
        free = np.where(fitted.fit.at_bound[which], 0.0, np.abs(errors))
        if free.max() > self.tolerance:
            worst = int(free.argmax())
            context.warn(
                f"on a grid of {finer} voxels along an edge {int((free > self.tolerance).sum())} of {len(which)} cells "
                f"are off by more than {self.tolerance:g}; cell {fitted.names[which[worst]]} by {errors[worst]:+.4f}; "
                f"a larger `resolution`, such as {2 * fitted.resolution}, comes nearer"
            )
