"""``homogenize.conductivity``: the effective conductivity of solid or void of a periodic cell."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, ScalarField, Voxels, option, options
from sppm_pipeline.features.flow.permeability import ConductivityReport, worst_direction
from sppm_pipeline.nouns import SidedHomogenizer, VoxelCell
from sppm_pipeline.numerics import grids_below, per_phase, refined

MIN_WALL = 3
"""Voxels across a wall from which on no partly filled voxel lets anything through, as measured on flat walls along
100, 110, 120, 111 and 133: at two voxels up to 0.48 of the bulk passes, at two and a half up to 0.09, and below 1e-4 at
three."""

MAX_LEAK = 0.01
"""Fraction of the bulk conductivity above which a leak is reported: a heuristic, between the 1e-4 of closed walls and
the 0.09 of the thinnest leaky ones, so that a factor of two changes little."""

SERIES = 0.02
"""Ratio r of the conductivities at which voxels at the surface count half as much of the harmonic mean as between
similar conductors, where it is a third. With an insulator all flow follows the surface, for which the arithmetic mean
is right. Three cells of the paper want 0.7 to 1 of that third at r = 0.13, and 0.3 to 0.5 of it at 0.01."""

SERIES_ERROR = 0.5
"""Error that is left of it, in voxels over the edge of the cell: what 0.15 of the third are worth at r = 0.01."""


@dataclass(frozen=True, kw_only=True)
class HomogenizeConductivity(SidedHomogenizer):
    """Compute the effective conductivity of a periodic cell on voxels: of heat, charge, or what diffuses.

    One phase conducts, the other insulates: the solid, or the void with ``of: void`` (diffusion in the pores). With
    ``of: both`` what fills the void conducts as well, as a gas does beside a poor conductor. The result is a tensor,
    and the tortuosity along each axis. Voxels that touch at an edge or corner only conduct a little there; if most of
    the flow passes there, raise the resolution.

    Voxels at the surface of a field conduct by the fraction of them that is filled, which is too much by an error that
    falls with the square of their edge. So a second grid, coarser by a third, is solved as well; the limit of fine
    grids is the result, and the correction its error bar. Images, `fractions: binary` and `grids: 1` are not corrected.

    Permittivity and magnetic permeability obey the same equations, as long as waves are much longer than the cell.
    """

    name: ClassVar[str] = "homogenize.conductivity"
    version: ClassVar[int] = 3
    reported: ClassVar[tuple[str, ...]] = ()
    of: str = option("solid", help="which phase conducts", choices=("solid", "void", "both"))
    bulk: float | tuple[float, ...] = option(
        1.0, help=f"conductivity of the solid, {options.EACH_PHASE}; with `of: void` that of the void", above=0,
        maximum=1e15,
    )  # fmt: skip
    fluid: float | None = option(
        None, help="conductivity of what fills the void, if both conduct; 0.026 W/(m K) for air", above=0, maximum=1e15
    )

    grids: int | None = option(
        None, help="grids solved, for an error bar; if omitted 2 for fields and 1 for images, whose coarser grids are "
        "blocks of their voxels", minimum=1, maximum=2,
    )  # fmt: skip

    def check_options(self) -> None:
        """At least one conductivity, and one only for the void."""
        if (self.of == "both") != (self.fluid is not None):
            given = "is not given" if self.fluid is None else f"is {self.fluid:g}"
            raise ConfigError(
                f"with `of: {self.of}` the conductivity `fluid` {given}",
                hint="give `fluid` with `of: both`, and only then",
            )
        if not self._bulk() or (self.of == "void" and len(self._bulk()) > 1):
            raise ConfigError(
                f"`bulk` has {len(self._bulk())} conductivities for the {self.of}", hint="give one number"
            )

    def _bulk(self) -> tuple[float, ...]:
        return per_phase(self.bulk)

    def bytes_of_a_voxel(self, threads: int) -> int:
        """Three potentials, their work space for each load case in progress, conductivities."""
        return 4 * (3 + 6 * min(threads, 3) + 6)

    def run(self, context: Context, source: ScalarField | Voxels) -> ConductivityReport:
        """Solve three load cases, on the coarser grid first."""
        source = self.sided(context, source)
        self.check_image(context, source, void=self.of == "void")
        counts = grids_below(self.resolution, self.grids or (1 if isinstance(source, Voxels) else 2))
        if len(counts) == 1:
            return self.conductivity_of(context, source)
        counts, reports, limit = refined(
            context, source, counts,
            lambda context, count, given: replace(self, resolution=count).conductivity_of(context, given),
            lambda report: report.k, 1.0 if self.fractions == "binary" else 2.0,
        )  # fmt: skip
        coarse, fine = reports
        if isinstance(source, Voxels) or self.fractions == "binary":
            return replace(fine, error=limit.error)
        correction = (fine.k - coarse.k) / ((counts[1] / counts[0]) ** 2 - 1)
        direction = worst_direction(correction, fine.k)
        if direction is not None:
            # a wall that only the coarser grid leaks through is closed on the finer one, whose result is right
            unresolved = [
                f"from {counts[0]} to {counts[1]} voxels along an edge the conductivity changes from "
                f"{np.trace(coarse.k) / 3:.3g} to {np.trace(fine.k) / 3:.3g}, so that walls or throats are not "
                "resolved; raise `resolution`"
            ] if direction @ fine.k @ direction > MAX_LEAK * self._bulk()[0] else []  # fmt: skip
            for warning in unresolved:
                context.warn(warning)
            return replace(fine, error=limit.error, warnings=(*fine.warnings, *unresolved))
        k = fine.k + correction
        ratios = np.divide(np.diag(fine.k), np.diag(k), out=np.ones(3), where=np.diag(k) > 0).tolist()
        turns = (None if one is None else one * ratio for one, ratio in zip(fine.tortuosity, ratios, strict=True))
        error = np.abs(correction) + (0 if self.fluid is None else SERIES_ERROR / counts[1] * np.diag(np.diag(k)))
        return replace(fine, k=k, error=error, tortuosity=tuple(turns))

    def conductivity_of(self, context: Context, source: ScalarField | Voxels) -> ConductivityReport:
        """The conductivity on one grid."""
        from sppm_pipeline.features.flow.numerics.conduction import conductivity, tortuosity
        from sppm_pipeline.features.flow.numerics.mirrored import mirrored_conductivity
        from sppm_pipeline.numerics import phase_report

        cell = self.cell_of(context, source)
        if self.of != "void":
            cell.check_materials(context, len(self._bulk()), "`bulk`")
        k = self._conductivities(cell)
        solve = mirrored_conductivity if self.mirrored else conductivity
        found = solve(k, cell.edges, **self.solver_options(context.threads))
        connected = phase_report((k > 0).view(np.uint8), self.wraps)
        warnings = self.solver_warnings(found.solved, found.precision)
        without = [axis for axis, value in zip("xyz", np.diag(found.conductivity), strict=True) if value == 0]
        if without:
            warnings.append(f"no flow along {', '.join(without)}: the {self.of} does not percolate")
        warnings += self._leaks(source, cell, np.diag(found.conductivity))
        for warning in warnings:
            context.warn(warning)
        return ConductivityReport(
            k=found.conductivity, of=self.of, bulk=self._bulk(), fluid=self.fluid, porosity=cell.porosity,
            tortuosity=tuple(tortuosity(found.conductivity, float(k.mean(dtype=np.float64)))), grid=cell.shape,
            fractions=cell.fraction is not None, wraps=connected.wraps, warnings=tuple(warnings),
            **ConductivityReport.solver(found.solved, found.precision),
        )  # fmt: skip

    def _leaks(self, source: ScalarField | Voxels, cell: VoxelCell, k: NDArray[Any]) -> list[str]:
        """Warnings for flow through walls that are too thin for the voxels."""
        from sppm_pipeline.numerics import phase_report

        flows = k > MAX_LEAK * self._bulk()[0]
        if self.of != "void" or cell.fraction is None or not flows.any():
            return []
        wall = None if isinstance(source, Voxels) else source.thinnest_wall
        if wall is not None and self.resolution * wall < MIN_WALL:
            return [
                f"the void may conduct through walls, which are {self.resolution * wall:.2g} voxels thick; "
                f"`resolution: {math.ceil(MIN_WALL / wall)}` or more ({MIN_WALL} voxels) closes them"
            ]
        # a way through voxels that are more than half open is no leak
        closed = ~np.array(phase_report((cell.fraction.T < 0.5).view(np.uint8), self.wraps).wraps)
        leaking = [axis for axis, leak in zip("xyz", closed & flows, strict=True) if leak]
        if not leaking:
            return []
        finer = "an image of finer voxels" if isinstance(source, Voxels) else f"`resolution: {2 * self.resolution}`"
        return [
            f"the flow along {', '.join(leaking)} passes only through voxels that are half solid or more, thin walls "
            f"or throats: compare with {finer}"
        ]

    def _conductivities(self, cell: VoxelCell) -> NDArray[Any]:
        """Of all voxels, (nz, ny, nx)."""
        dtype = np.float32 if self.precision == "single" else np.float64
        if self.fluid is not None and cell.fraction is not None:
            # in series where the flow crosses the surface, beside each other where it follows it
            solid, fraction = self._bulk()[0], np.asarray(cell.fraction.T, np.float64)
            ratio = min(solid, self.fluid) / max(solid, self.fluid)
            beside = self.fluid + fraction * (solid - self.fluid)
            series = 1 / (fraction / solid + (1 - fraction) / self.fluid)
            return np.asarray(beside + (series - beside) * (ratio / (ratio + SERIES) / 3), dtype)
        if self.of != "void":
            return cell.of_voxels((self.fluid or 0.0, *self._bulk()), dtype)
        phases = 1 if cell.phase is None else int(cell.phase.max())
        return cell.of_voxels((self._bulk()[0], *(0.0,) * phases), dtype)
