"""``homogenize.conductivity``: the effective conductivity of solid or void of a periodic cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.conductivity import ConductivityReport
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.data.voxels import Voxels
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.families.homogenizer import Cell, Homogenizer
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.stage import Context, Headline, option


@dataclass(frozen=True, kw_only=True)
class HomogenizeConductivity(Homogenizer):
    """Compute the effective conductivity of a periodic cell on voxels: of heat, charge, or what diffuses.

    One phase conducts, the other insulates: the solid, or the void with ``of: void`` (diffusion in the pores). The
    result is a tensor, and the tortuosity along each axis. Voxels that touch at an edge or corner only conduct a
    little there; if most of the flow passes there, raise the resolution.
    """

    name: ClassVar[str] = "homogenize.conductivity"
    reported: ClassVar[tuple[str, ...]] = ()
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("k.1.1", "k11"), Headline("k.2.2", "k22"), Headline("k.3.3", "k33"),
        Headline("tortuosity"), Headline("porosity"),
    )  # fmt: skip
    of: str = option("solid", help="which phase conducts", choices=("solid", "void"))
    bulk: float | tuple[float, ...] = option(
        1.0, help="conductivity of that phase, or of each phase of the solid from 1 on", above=0, maximum=1e15
    )

    def check_options(self) -> None:
        """At least one conductivity, and one only for the void."""
        if not self._bulk() or (self.of == "void" and len(self._bulk()) > 1):
            raise ConfigError(
                f"`bulk` has {len(self._bulk())} conductivities for the {self.of}", hint="give one number"
            )

    def _bulk(self) -> tuple[float, ...]:
        return self.bulk if isinstance(self.bulk, tuple) else (self.bulk,)

    def estimate(self, palette: Palette, source: Size) -> Size:
        return self.solving(source, self.resolution)

    def bytes_of_a_voxel(self, threads: int) -> int:
        """Three potentials, their work space for each load case in progress, conductivities."""
        return 4 * (3 + 6 * min(threads, 3) + 6)

    def run(self, context: Context, source: ScalarField | Voxels) -> ConductivityReport:
        """Solve three load cases."""
        from sppm_pipeline.numerics.connectivity.components import phase_report
        from sppm_pipeline.numerics.homogenization.conduction import conductivity, tortuosity

        cell = self.cell_of(context, source)
        k = self._conductivities(cell)
        found = conductivity(k, cell.edges, **self.solver_options(context.threads))
        connected = phase_report((k > 0).view(np.uint8))
        warnings = self.solver_warnings(found.solved, found.precision)
        without = [axis for axis, value in zip("xyz", np.diag(found.conductivity), strict=True) if value == 0]
        if without:
            warnings.append(f"no flow along {', '.join(without)}: the {self.of} does not percolate")
        for warning in warnings:
            context.warn(warning)
        return ConductivityReport(
            k=found.conductivity,
            of=self.of,
            bulk=self._bulk(),
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

    def _conductivities(self, cell: Cell) -> NDArray[Any]:
        """Of all voxels, (nz, ny, nx)."""
        bulk = self._bulk()
        dtype = np.dtype(np.float32 if self.precision == "single" else np.float64)
        if cell.phase is not None:
            if self.of == "void":
                return np.asarray((cell.phase.T == 0) * dtype.type(bulk[0]))
            phases = int(cell.phase.max())
            if phases > len(bulk):
                raise DesignError(
                    f"the image has phases up to {phases}, and conductivities are given for {len(bulk)}",
                    hint="give `bulk` a value for every phase from 1 on",
                )
            table: NDArray[Any] = np.array([0.0, *bulk], dtype)
            return np.asarray(table[cell.phase.T])
        if len(bulk) > 1:
            raise DesignError(
                f"conductivities are given for {len(bulk)} phases, and a field or an image of fractions has one",
                hint="give one number",
            )
        assert cell.fraction is not None
        fraction: NDArray[Any] = cell.fraction.T if self.of == "solid" else 1 - cell.fraction.T
        return fraction.astype(dtype) * dtype.type(bulk[0])
