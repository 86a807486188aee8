"""``homogenize.permeability``: slow flow through the pores of a periodic cell."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, DesignError, Homogenizer, Length, ScalarField, Voxels, option, options
from sppm_pipeline.features.flow.numerics.faces import (
    Faces,
    Percolation,
    faces_of_field,
    faces_of_fractions,
    faces_of_voxels,
    percolating,
)
from sppm_pipeline.features.flow.permeability import PermeabilityReport, worst_direction
from sppm_pipeline.nouns import SidedHomogenizer
from sppm_pipeline.numerics import cell_centers, grids_below, refined

MIN_THROAT = 5
"""Voxels across a throat below which whole voxels trigger a warning."""

ORDER = 2.25
"""Order of convergence that is taken for two grids of a field: 1.9 to 2.3 are measured on cells of the presets `paper`,
2.7 to 2.9 on those of `stiff`."""

MAX_ERROR = 0.1
"""Error bar over the permeability above which throats are said to be too narrow for the grid (heuristic)."""


@dataclass(frozen=True, kw_only=True)
class FlowHomogenizer(Homogenizer):
    """Base of stages that solve for the slow flow of a fluid through the pores."""

    solver_tolerance: float = option(
        1e-3, help="relative error of the result left by the solver, estimated", minimum=1e-12, maximum=0.1,
    )  # fmt: skip
    cell: Length | None = options.cell(None, note="if the cell has none yet, or another one is wanted")

    def bytes_of_a_voxel(self, threads: int) -> int:
        """Grids of components and pressure, graphs, weights, torsion fields, flows, work space of each in progress."""
        return 4 * (4 * 6 + 14 + 7 + 6 + 9 + 28 * min(threads, 3))

    def edge_of(self, source: ScalarField | Voxels) -> float | None:
        """Edge of the cell in millimeters; of an image, its longest side."""
        if self.cell is not None:
            return self.cell.mm()
        if isinstance(source, Voxels):
            return self._longest(source) if source.physical else None
        return source.edge_mm

    def _longest(self, image: Voxels) -> float:
        return max(n * h for n, h in zip(image.shape, image.spacing, strict=True)) if image.physical else 1.0

    def faces_of(self, context: Context, source: ScalarField | Voxels) -> tuple[Faces, float]:
        """Faces of voxels that the fluid passes, and how many units of their edges make a cell edge."""
        shape, edges = self.grid_of(context, source)
        if isinstance(source, Voxels):
            if source.fractions and self.fractions == "auto":
                return faces_of_fractions(source.values.T, edges, self.mirrored), self._longest(source)
            solid = source.values >= 0.5 if source.fractions else source.values > 0
            return faces_of_voxels(~solid.T, edges, self.mirrored), self._longest(source)
        if self.fractions == "binary":
            inside = source.solid(cell_centers(self.resolution, source.cells), context.threads)
            return faces_of_voxels(inside.T == 0, edges, self.mirrored), float(self.resolution)
        faces = faces_of_field(
            lambda grid: source.sample_zyx(grid, 0, grid.shape[2], context.threads), shape, 1 / self.resolution,
            self.mirrored,
        )  # fmt: skip
        return faces, float(self.resolution)

    def flow_of(self, context: Context, source: ScalarField | Voxels) -> PermeabilityReport:
        """The flow along each axis; `DesignError` if no walls are across one, or they are too thin to be seen."""
        from sppm_pipeline.features.flow.numerics.stokes import stokes_flow

        faces, edge = self.faces_of(context, source)
        # velocities along an axis that no wall stops may all be the same, whatever there is between them
        if free := [axis for axis, active in zip("xyz", faces.active, strict=True) if active.all()]:
            missed = f"the grid misses all solid along {', '.join(free)}"
            where = "the cell has no solid" if len(free) == 3 else missed
            raise DesignError(
                f"{where}, so nothing holds the fluid back: the permeability is infinite",
                hint="check which side of the field or image is solid, and the `resolution` if the solid is thin",
            )
        open_void = percolating(faces)
        # pockets hold no flow: only open void counts as porosity of the flow
        porosity = faces.porosity * (1 - open_void.pocket_share)
        found = stokes_flow(open_void.faces, porosity, open_void.wraps, **self.solver_options(context.threads))
        warnings = self.solver_warnings(found.solved, found.precision)
        if open_void.pocket_share > 0:
            warnings.append(
                f"{open_void.pocket_share:.2g} of the void lies in {open_void.pockets} closed pockets, left out"
            )
        if faces.surface is None and (narrow := _narrow(open_void)):
            warnings.append(
                f"the widest way through along {', '.join(narrow)} has throats of less than {MIN_THROAT} voxels, which "
                "whole voxels make too narrow: the permeability is too low by a tenth or more; use finer voxels, or a "
                "field or image with solid fractions"
            )
        without = [axis for axis, way in zip("xyz", open_void.wraps, strict=True) if not way]
        if without:
            warnings.append(f"nothing flows along {', '.join(without)}: the void does not percolate")
        for warning in warnings:
            context.warn(warning)
        return PermeabilityReport(
            k=found.permeability / edge**2, edge_mm=self.edge_of(source), porosity=porosity,
            pocket_share=open_void.pocket_share, thermal=found.thermal_permeability / edge**2,
            viscous_tortuosity=_finite(found.viscous_tortuosity),
            thermal_tortuosity=_finite((found.thermal_tortuosity,))[0],
            hydraulic_tortuosity=_finite(found.hydraulic_tortuosity),
            surface=None if faces.surface is None else faces.surface * edge, slices=found.slices,
            grid=faces.voxels().shape[::-1], wraps=open_void.wraps, warnings=tuple(warnings),
            **PermeabilityReport.solver(found.solved, found.precision),
        )  # fmt: skip


def _narrow(void: Percolation) -> list[str]:
    """Axes along which no ball of `MIN_THROAT` voxels gets through the void."""
    from sppm_pipeline.numerics import phase_report

    mirrored, reach = void.faces.mirrored, MIN_THROAT // 2
    voxels = np.pad(void.faces.voxels(), reach, mode="symmetric" if mirrored else "wrap")
    # erosion by a ball: what is left is where its center may lie
    centers = voxels.copy()
    for x, y, z in np.ndindex((MIN_THROAT,) * 3):
        step = (x - reach, y - reach, z - reach)
        if 0 < np.dot(step, step) <= reach * reach:
            centers &= np.roll(voxels, step, (0, 1, 2))
    centers = centers[(slice(reach, -reach),) * 3]
    passed = phase_report(np.ascontiguousarray(centers).view(np.uint8), (not mirrored,) * 3).wraps
    return [axis for axis, way, wide in zip("xyz", void.wraps, passed, strict=True) if way and not wide]


def _finite(values: tuple[float, ...]) -> tuple[float | None, ...]:
    return tuple(float(value) if math.isfinite(value) else None for value in values)


@dataclass(frozen=True, kw_only=True)
class HomogenizePermeability(FlowHomogenizer, SidedHomogenizer):
    """Compute the permeability of the pores of a periodic cell: Stokes flow on a staggered grid.

    Walls lie where the field is zero, between the points of the grid, which converges much faster than whole voxels;
    images may hold solid fractions or phases, of which every one but 0 is solid. The tensor is in squared cell edges,
    and in square meters and darcy where the cell has a physical size. Pockets of the void that no flow reaches are
    left out with a warning. The report holds as well the thermal permeability, tortuosities, and the constant of
    Kozeny and Carman; `write.flow` draws the flow.

    With `sides: mirror` the flow of a scan passes no mirror beside it, as between smooth plates; flows along each axis
    are solved by themselves, on the scan and one mirror image, and the tensor is diagonal.

    On the grid of a field throats come out too wide, by an error of about second order. So a second grid, coarser by a
    third, is solved as well; the limit of fine grids is the result, and the correction its error bar; all else is that
    of the finer grid. Images, and fields as whole voxels, have one grid; with more than one their result is that of the
    finest, and the difference from the limit its error bar. Where the coarser grid of a field misses
    all walls across an axis, the finer one is the result, with a warning and without an error bar.
    """

    name: ClassVar[str] = "homogenize.permeability"
    version: ClassVar[int] = 7
    reported: ClassVar[tuple[str, ...]] = ("convergence.*",)

    grids: int | None = option(
        None, help="grids solved, for an error bar; if omitted 2 for fields and 1 for images, whose coarser grids are "
        "blocks of their voxels", minimum=1, maximum=3,
    )  # fmt: skip

    @property
    def effort(self) -> float:
        """Each coarser grid has a third fewer voxels along an edge."""
        return sum((2 / 3) ** (3 * step) for step in range(self.grids or 2))

    def run(self, context: Context, source: ScalarField | Voxels) -> PermeabilityReport:
        """Solve for three flows, on coarser grids first for the limit and the error bar."""
        source = self.sided(context, source)
        self.check_image(context, source, void=True)
        whole = isinstance(source, Voxels) or self.fractions == "binary"
        counts = grids_below(self.resolution, self.grids or (1 if whole else 2))
        if len(counts) == 1:
            return self.flow_of(context, source)
        try:
            counts, reports, limit = refined(
                context, source, counts,
                lambda context, count, given: replace(self, resolution=count).flow_of(context, given),
                lambda report: report.k, 1.0 if whole else ORDER,
            )  # fmt: skip
        except DesignError:  # a coarser grid sees no walls at all
            if self.grids is not None:
                raise
            fine = self.flow_of(context, source)
            return self._doubted(
                context, fine, f"there is no error bar, as {counts[0]} voxels along an edge miss all walls across an "
                f"axis: the solid is too thin for these grids; compare with `resolution: {2 * self.resolution}`",
            )  # fmt: skip
        fine = reports[-1]
        context.report(
            convergence={
                "resolutions": counts, "k11": [float(report.k[0, 0]) for report in reports],
                "limit": np.asarray(limit.value).tolist(), "order": limit.order, "order_observed": limit.observed,
            }
        )  # fmt: skip
        if whole:
            return replace(fine, error=limit.error)
        closed = np.diag(fine.k) == 0
        correction = np.asarray(limit.value) - fine.k
        correction[closed | closed[:, None]] = 0  # what only coarser grids let through
        if worst_direction(correction, fine.k) is not None:
            made = replace(fine, error=limit.error)
        else:
            made = replace(fine, k=fine.k + correction, error=np.abs(correction) if len(counts) == 2 else limit.error)
        share = made.error_relative or 0.0
        if share <= MAX_ERROR:
            return made
        finer = math.ceil(self.resolution * (share / (0.3 * MAX_ERROR)) ** (1 / ORDER))
        return self._doubted(
            context, made, f"the error bar is {share:.0%} of the permeability, as throats or walls are few voxels "
            f"thick: raise `resolution` to about {finer} for {0.3 * MAX_ERROR:.0%}",
        )  # fmt: skip

    @staticmethod
    def _doubted(context: Context, report: PermeabilityReport, why: str) -> PermeabilityReport:
        context.warn(why)
        return replace(report, warnings=(*report.warnings, why))
