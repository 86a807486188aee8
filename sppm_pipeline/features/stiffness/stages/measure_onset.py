"""``measure.onset``: the stress at which a share of the solid begins to yield."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import (
    ConfigError,
    Context,
    DesignError,
    Headline,
    ScalarField,
    Table,
    Voxels,
    option,
    options,
)
from sppm_pipeline.features.stiffness.numerics.onset import onsets, stress_ratios, uniaxial_strain
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import ElasticCell
from sppm_pipeline.method.families.homogenizer import per_phase

AXES = "xyz"


@dataclass(frozen=True, kw_only=True)
class MeasureOnset(ElasticCell):
    """Compute the stress at which a share of the solid of a periodic cell reaches its yield stress.

    The quick estimate of a strength: linear elasticity, so nothing is redistributed and nothing is fitted. The cell is
    loaded by a mean stress along x, y and z, one after the other, its sides free in the mean. Von Mises stress over
    yield stress is taken at the eight Gauss points of each solid voxel; the onset is the mean stress at which the
    largest of these, over a share of the solid's volume, are 1 or more. One point alone would be that of the sharpest
    corner of the staircase, and depend on the grid.

    An ideally plastic solid bears more than this; a brittle one fails near it. The solid of a partial voxel has the
    voxel's strain, and counts by its volume. What fills the void never yields. The table has a row for each axis and
    share. The spread over draws is that of a sweep over seeds.
    """

    name: ClassVar[str] = "measure.onset"
    reported: ClassVar[tuple[str, ...]] = (
        "onset", "deviation", "x", "y", "z", "share", "unit", "relative_density", "iterations.*",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("onset", "onset of yield", "{unit}"), Headline("deviation", "its deviation over axes", "{unit}"),
    )  # fmt: skip

    yield_stress: float | tuple[float, ...] = option(
        1.0, help=f"yield stress, {options.EACH_PHASE}; 1: results are relative to it", above=0, maximum=1e15
    )
    yielded: float = option(0.01, help="share of the solid that yields, of the numbers reported", above=0, maximum=1)
    shares: tuple[float, ...] = option((0.001, 0.01, 0.05), help="shares of the table", above=0, maximum=1)

    def check_options(self) -> None:
        """As many yield stresses as materials, or one."""
        super().check_options()
        phases, given = len(self._materials()[0]), len(per_phase(self.yield_stress))
        if given not in (1, phases):
            raise ConfigError(
                f"`yield_stress` has {given} values, and `young` {phases}", hint="give one, or one for every phase"
            )

    def bytes_of_a_voxel(self, threads: int) -> int:
        """As for stiffness; all six fields are kept, and then superposed."""
        return super().bytes_of_a_voxel(threads) + 6

    def run(self, context: Context, source: ScalarField | Voxels) -> Table:
        """Solve, superpose, and sort the stresses."""
        from sppm_pipeline.services.elastic.voigt import lame

        self.check_image(context, source)
        cell = self.cell_of(context, source)
        young, poisson = self._materials()
        cell.check_materials(context, len(young), "`young`, `poisson` and `yield_stress`")
        if not cell.occupied().any():
            raise DesignError("the cell is empty: there is nothing to yield", hint="lower the porosity")
        options = self.solver_options(context.threads)
        del options["precision"]  # which the body has
        found = self._body(cell, ())[0].stiffness(fields=True, **options)
        for warning in self.solver_warnings(found.solved, found.precision):
            context.warn(warning)
        strengths = per_phase(self.yield_stress) * (len(young) if len(per_phase(self.yield_stress)) == 1 else 1)
        ratios = tuple(lame(e, v)[1] / y for e, v, y in zip(young, poisson, strengths, strict=True))
        if cell.fraction is None:
            modulus = cell.of_voxels((0.0, *ratios), np.float64)
            weights = np.ones(np.count_nonzero(modulus))
        else:
            share = cell.fraction.T
            modulus, weights = ratios[0] * (share > 0), share[share > 0].astype(np.float64)
        wanted = (self.yielded, *self.shares)
        rows: list[tuple[str, float, float | None]] = []
        means: list[float | None] = []
        for axis, name in enumerate(AXES):
            strain = uniaxial_strain(found.stiffness, axis)
            values: tuple[float | None, ...] = (None,) * len(wanted)
            if strain is None:
                context.warn(f"the solid has no load path along {name}")
            else:
                values = onsets(stress_ratios(found, strain, modulus, cell.edges), weights, wanted)
            means.append(values[0])
            rows += [(name, share, value) for share, value in zip(self.shares, values[1:], strict=True)]
        borne = [value for value in means if value is not None]
        context.report(
            onset=float(np.mean(borne)) if borne else None, deviation=float(np.std(borne)) if borne else None,
            **dict(zip(AXES, means, strict=True)), share=self.yielded, unit=self.stress_unit,
            relative_density=1 - cell.porosity, iterations=[case.iterations for case in found.solved],
        )  # fmt: skip
        axes, shares, stresses = zip(*rows, strict=True) if rows else ((), (), ())
        return Table({"axis": axes, "share": shares, "onset": stresses})
