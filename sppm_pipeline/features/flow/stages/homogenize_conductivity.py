"""``homogenize.conductivity``: the effective conductivity of solid or void of a periodic cell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, Homogenizer, Palette, ScalarField, Size, Voxels, option, options
from sppm_pipeline.features.flow.conductivity import ConductivityReport
from sppm_pipeline.nouns import VoxelCell
from sppm_pipeline.numerics import per_phase

WALL = 3
"""Voxels across a wall from which on no partly filled voxel lets anything through, as measured on flat walls along
100, 110, 120, 111 and 133: at two voxels up to .48 of the bulk passes, at two and a half up to .09, and below 1e-4 at
three."""

LEAK = 0.01
"""Share of the bulk conductivity from which on a leak is told; a choice."""


@dataclass(frozen=True, kw_only=True)
class HomogenizeConductivity(Homogenizer):
    """Compute the effective conductivity of a periodic cell on voxels: of heat, charge, or what diffuses.

    One phase conducts, the other insulates: the solid, or the void with ``of: void`` (diffusion in the pores). With
    ``of: both`` what fills the void conducts as well, as a gas does beside a poor conductor; voxels at the surface then
    have the mean of both, weighted by volume. The result is a tensor, and the tortuosity along each axis. Voxels that
    touch at an edge or corner only conduct a little there; if most of the flow passes there, raise the resolution.
    Permittivity and magnetic permeability obey the same equations, as long as waves are much longer than the cell.
    """

    name: ClassVar[str] = "homogenize.conductivity"
    version: ClassVar[int] = 2
    reported: ClassVar[tuple[str, ...]] = ()
    of: str = option("solid", help="which phase conducts", choices=("solid", "void", "both"))
    bulk: float | tuple[float, ...] = option(
        1.0, help=f"conductivity of the solid, {options.EACH_PHASE}; with `of: void` that of the void", above=0,
        maximum=1e15,
    )  # fmt: skip
    fluid: float | None = option(
        None, help="conductivity of what fills the void, if both conduct; 0.026 W/(m K) for air", above=0, maximum=1e15
    )

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

    def estimate(self, palette: Palette, source: Size) -> Size:
        return self.solving(source, self.resolution)

    def bytes_of_a_voxel(self, threads: int) -> int:
        """Three potentials, their work space for each load case in progress, conductivities."""
        return 4 * (3 + 6 * min(threads, 3) + 6)

    def run(self, context: Context, source: ScalarField | Voxels) -> ConductivityReport:
        """Solve three load cases."""
        self.check_image(context, source, void=self.of == "void")
        from sppm_pipeline.features.flow.numerics.conduction import conductivity, tortuosity
        from sppm_pipeline.numerics import phase_report

        cell = self.cell_of(context, source)
        if self.of != "void":
            cell.check_materials(context, len(self._bulk()), "`bulk`")
        k = self._conductivities(cell)
        found = conductivity(k, cell.edges, **self.solver_options(context.threads))
        connected = phase_report((k > 0).view(np.uint8))
        warnings = self.solver_warnings(found.solved, found.precision)
        without = [axis for axis, value in zip("xyz", np.diag(found.conductivity), strict=True) if value == 0]
        if without:
            warnings.append(f"no flow along {', '.join(without)}: the {self.of} does not percolate")
        warnings += self._leaks(source, cell, np.diag(found.conductivity))
        for warning in warnings:
            context.warn(warning)
        return ConductivityReport(
            k=found.conductivity,
            of=self.of,
            bulk=self._bulk(),
            fluid=self.fluid,
            porosity=cell.porosity,
            tortuosity=tuple(tortuosity(found.conductivity, float(k.mean(dtype=np.float64)))),
            grid=cell.shape,
            fractions=cell.fraction is not None,
            precision=found.precision,
            iterations=tuple(case.iterations for case in found.solved),
            residuals=tuple(float(case.residual) for case in found.solved),
            errors=tuple(min(float(case.error), 1.0) for case in found.solved),
            converged=all(case.converged for case in found.solved),
            wraps=connected.wraps,
            warnings=tuple(warnings),
        )

    def _leaks(self, source: ScalarField | Voxels, cell: VoxelCell, k: NDArray[Any]) -> list[str]:
        """Warnings for flow through walls that are too thin for the voxels."""
        from sppm_pipeline.numerics import phase_report

        flows = k > LEAK * self._bulk()[0]
        if self.of != "void" or cell.fraction is None or not flows.any():
            return []
        wall = None if isinstance(source, Voxels) else source.thinnest_wall
        if wall is not None and self.resolution * wall < WALL:
            return [
                f"the void may conduct through walls, which are {self.resolution * wall:.2g} voxels thick; "
                f"`resolution: {math.ceil(WALL / wall)}` or more ({WALL} voxels) closes them"
            ]
        closed = ~np.array(phase_report((cell.fraction.T < 0.5).view(np.uint8)).wraps)
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
        if self.of != "void":
            return cell.of_voxels((self.fluid or 0.0, *self._bulk()), dtype)
        phases = 1 if cell.phase is None else int(cell.phase.max())
        return cell.of_voxels((self._bulk()[0], *(0.0,) * phases), dtype)
