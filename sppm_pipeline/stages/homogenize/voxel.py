"""``homogenize.voxel``: the effective stiffness of a periodic cell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.data.stiffness import StiffnessReport
from sppm_pipeline.data.voxels import Voxels
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.families import options
from sppm_pipeline.families.homogenizer import ELASTIC_HEADLINE, Cell, Homogenizer, grids_below, refined
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.stage import Context, Headline, option


@dataclass(frozen=True, kw_only=True)
class ElasticHomogenizer(Homogenizer):
    """Base of stages that compute effective stiffnesses on voxels: materials, and the stiffness report of a cell."""

    young: float | tuple[float, ...] = options.young(
        1.0, note="or of each phase from 1 on; 1: results are relative to it"
    )
    poisson: float | tuple[float, ...] = options.poisson(0.3, note="or of each phase from 1 on")
    stress_unit: str = options.stress_unit("relative", formerly="unit")
    ersatz: float = option(
        0.0, help="stiffness of the void relative to phase 1, for comparison with other codes",
        minimum=0, maximum=1,
    )  # fmt: skip

    def check_options(self) -> None:
        """As many Poisson's ratios as Young's moduli."""
        young, poisson = self._materials()
        if not young or len(young) != len(poisson):
            raise ConfigError(
                f"`young` has {len(young)} Young's moduli and `poisson` {len(poisson)} Poisson's ratios",
                hint="give one of each, or one of each for every phase",
            )

    def _materials(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        young = self.young if isinstance(self.young, tuple) else (self.young,)
        poisson = self.poisson if isinstance(self.poisson, tuple) else (self.poisson,)
        return young, poisson * len(young) if len(poisson) == 1 else poisson

    def bytes_of_a_voxel(self, threads: int) -> int:
        """Six fields, their work space for each load case in progress, Lamé constants."""
        return 4 * (3 * 6 + 16 * min(threads, 6) + 12)

    def stiffness_of(
        self, context: Context, source: ScalarField | Voxels, expansion: tuple[float, ...] = ()
    ) -> StiffnessReport:
        """Solve six load cases; `expansion` has coefficients of the phases from 1 on, or nothing."""
        from sppm_pipeline.numerics.connectivity.components import phase_report
        from sppm_pipeline.numerics.homogenization.elasticity import stiffness

        cell = self.cell_of(context, source)
        expanding = self._expansion(cell, expansion) if expansion else None
        found = stiffness(*self._lame(cell), cell.edges, expansion=expanding, **self.solver_options(context.threads))
        connected = phase_report(cell.occupied().T)
        warnings = self.solver_warnings(found.solved, found.precision)
        without = [word for word, value in zip(_STRAINS, np.diag(found.stiffness), strict=True) if value == 0]
        if without:
            warnings.append(f"the solid has no load path along {', '.join(without)}")
        if self.ersatz == 0 and connected.removed_share > 0:
            warnings.append(
                f"{connected.removed_share:.2g} of the solid is disconnected from the rest across faces of voxels "
                "and has no load path"
            )
        for warning in warnings:
            context.warn(warning)
        return StiffnessReport(
            found.stiffness,
            self._phases(cell),
            f"{' x '.join(map(str, cell.shape))} voxels, {'whole' if cell.fraction is None else 'solid fractions'}",
            unit=None if self.stress_unit == "relative" else self.stress_unit,
            expansion=found.expansion,
            solver={
                "grid": list(cell.shape),
                "precision": found.precision,
                "iterations": [case.iterations for case in found.solved],
                "residuals": [float(case.residual) for case in found.solved],
                "errors": [min(float(case.error), 1.0) for case in found.solved],
                "converged": all(case.converged for case in found.solved),
                "wraps": list(connected.wraps),
                "components": connected.components,
            },
        )

    def _phases(self, cell: Cell) -> tuple[tuple[float, float, float], ...]:
        """Volume fraction, Young's modulus and Poisson's ratio of each phase, void last."""
        young, poisson = self._materials()
        void = (self.ersatz * young[0], poisson[0]) if self.ersatz else (0.0, 0.0)
        if cell.phase is None:
            return ((1 - cell.porosity, young[0], poisson[0]), (cell.porosity, *void))
        fractions = np.bincount(cell.phase.ravel("K"), minlength=2) / cell.phase.size
        solid = tuple(
            (float(fractions[phase]), young[phase - 1], poisson[phase - 1]) for phase in range(1, len(fractions))
        )
        return (*solid, (float(fractions[0]), *void))

    def _expansion(self, cell: Cell, expansion: tuple[float, ...]) -> NDArray[Any]:
        """Coefficients of all voxels, (nz, ny, nx); the void, if it has a stiffness, expands as phase 1 does."""
        if cell.phase is None:
            return np.full(cell.shape[::-1], expansion[0], np.float32)
        return np.array([expansion[0], *expansion])[cell.phase.T]

    def _lame(self, cell: Cell) -> tuple[NDArray[Any], NDArray[Any]]:
        """Lamé constants of all voxels, (nz, ny, nx)."""
        from sppm_pipeline.numerics.homogenization.stiffness.voigt import lame

        young, poisson = self._materials()
        constants = np.array([(0.0, 0.0), *(lame(e, v) for e, v in zip(young, poisson, strict=True))])
        constants[0] = self.ersatz * constants[1]
        dtype = np.dtype(np.float32 if self.precision == "single" else np.float64)
        if cell.phase is not None:
            phases = int(cell.phase.max())
            if phases > len(young):
                raise DesignError(
                    f"the image has phases up to {phases}, and materials are given for {len(young)}",
                    hint="give `young` and `poisson` a value for every phase from 1 on",
                )
            table = constants.astype(dtype)
            return table[cell.phase.T, 0], table[cell.phase.T, 1]
        if len(young) > 1:
            raise DesignError(
                f"materials are given for {len(young)} phases, and a field or an image of solid fractions has one",
                hint="give one Young's modulus and one Poisson's ratio",
            )
        assert cell.fraction is not None
        fraction: NDArray[Any] = cell.fraction.T.astype(dtype)
        if self.ersatz:
            fraction = self.ersatz + (1 - self.ersatz) * fraction
        return fraction * dtype.type(constants[1, 0]), fraction * dtype.type(constants[1, 1])


_STRAINS = ("xx", "yy", "zz", "yz", "xz", "xy")


@dataclass(frozen=True, kw_only=True)
class HomogenizeVoxel(ElasticHomogenizer):
    """Compute the effective stiffness of a periodic cell on voxels (paper, section 3.2).

    Trilinear bricks, six unit strains, periodic displacements, no stiffness at all in the void. A field is sampled;
    voxels at its surface get the stiffness of the solid times their solid fraction, which converges much
    faster than the binary voxels of the paper. Images may hold several phases, each with a material of its own.

    With more than one grid, each coarser by a third than the next, the limit of fine grids is extrapolated
    (Richardson), and the difference becomes the error bar of the result, which stays that of the finest grid.

    Given the coefficients of thermal expansion of the phases, it finds that of the cell as well.
    """

    name: ClassVar[str] = "homogenize.voxel"
    reported: ClassVar[tuple[str, ...]] = ("convergence.*",)
    headline: ClassVar[tuple[Headline, ...]] = ELASTIC_HEADLINE

    grids: int = option(
        1, help="grids over which the error is estimated, for fields; 1 for no estimate", minimum=1, maximum=3
    )

    expansion: float | tuple[float, ...] | None = option(
        None, help="coefficient of thermal expansion of the solid, or of each phase from 1 on", unit="1/K",
        minimum=-1, maximum=1,
    )  # fmt: skip

    def check_options(self) -> None:
        """As many expansions as materials, or none."""
        super().check_options()
        phases = len(self._materials()[0])
        if self.expansion is not None and len(self._expansions()) != phases:
            raise ConfigError(
                f"`expansion` has {len(self._expansions())} coefficients, and `young` {phases} Young's moduli",
                hint="give one for each phase, or none",
            )

    def _expansions(self) -> tuple[float, ...]:
        if self.expansion is None:
            return ()
        return self.expansion if isinstance(self.expansion, tuple) else (self.expansion,)

    def estimate(self, palette: Palette, source: Size) -> Size:
        """All grids; the finest needs most memory."""
        found = [self.solving(source, n) for n in self._resolutions()]
        return replace(found[-1], samples=sum(s.samples for s in found), sums=sum(s.sums for s in found),
                       voxels=sum(s.voxels for s in found))  # fmt: skip

    def _resolutions(self) -> list[int]:
        return grids_below(self.resolution, self.grids)

    def run(self, context: Context, source: ScalarField | Voxels) -> StiffnessReport:
        """Homogenize, on coarser grids first if an error bar is requested."""
        if self.grids == 1:
            return self.stiffness_of(context, source, self._expansions())
        counts = self._resolutions()
        reports, limit = refined(
            context,
            source,
            counts,
            lambda count: replace(self, resolution=count).stiffness_of(context, source, self._expansions()),
            lambda report: report.stiffness,
        )
        context.report(
            convergence={
                "resolutions": counts,
                "C11": [float(report.stiffness[0, 0]) for report in reports],
                "limit": limit.value,
                "order": limit.order,
                "order_observed": limit.observed,
            }
        )
        return replace(reports[-1], error=limit.error)
