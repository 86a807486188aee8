"""``homogenize.voxel``: the effective stiffness of a periodic cell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, Homogenizer, Palette, ScalarField, Size, Voxels, option, options
from sppm_pipeline.method.families.homogenizer import LOCKING, VoxelCell, grids_below, per_phase, refined
from sppm_pipeline.method.nouns.stiffness import StiffnessReport

if TYPE_CHECKING:
    from sppm_pipeline.features.stiffness.numerics.elasticity import ElasticBody

_INCOMPRESSIBLE = 0.4999
"""Poisson's ratio above which voxels are refused: here a solution takes 300 iterations, and beyond .499999 single
precision loses the shear modulus beside the bulk modulus."""


@dataclass(frozen=True, kw_only=True)
class ElasticHomogenizer(Homogenizer):
    """Base of stages that compute effective stiffnesses on voxels: materials, and the stiffness report of a cell."""

    young: float | tuple[float, ...] = options.young(1.0, note=f"{options.EACH_PHASE}; 1: results are relative to it")
    poisson: float | tuple[float, ...] = options.poisson(0.3, note=options.EACH_PHASE)
    filling_young: float | None = option(
        None, help="Young's modulus of what fills the void; nothing does if omitted", above=0, maximum=1e15
    )
    filling_poisson: float = option(0.3, help="Poisson's ratio of what fills the void", above=-1, below=0.5)
    stress_unit: str = options.stress_unit("relative", formerly="unit")
    ersatz: float = option(
        0.0, help="stiffness of the void relative to phase 1, for comparison with other codes",
        minimum=0, maximum=1,
    )  # fmt: skip

    def check_options(self) -> None:
        """As many Poisson's ratios as Young's moduli, and one stiffness of the void."""
        young, poisson = self._materials()
        if not young or len(young) != len(poisson):
            raise ConfigError(
                f"`young` has {len(young)} Young's moduli and `poisson` {len(poisson)} Poisson's ratios",
                hint="give one of each, or one of each for every phase",
            )
        if self.ersatz and self.filling_young is not None:
            raise ConfigError(
                f"the void can't have the stiffness `ersatz: {self.ersatz:g}` and that of `filling_young` at once",
                hint="leave out `ersatz`",
            )
        if (largest := self._least_compressible()) > _INCOMPRESSIBLE:
            raise ConfigError(
                f"Poisson's ratio {largest:.10g} is so near to 0.5 that voxels lock and are many times too stiff",
                hint=f"take {LOCKING:g}; up to {_INCOMPRESSIBLE:g} there is a warning",
            )

    def _least_compressible(self) -> float:
        """The largest of Poisson's ratios."""
        filling = (self.filling_poisson,) if self.filling_young is not None else ()
        return max(*self._materials()[1], *filling, -1.0)

    def _materials(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        young, poisson = per_phase(self.young), per_phase(self.poisson)
        return young, poisson * len(young) if len(poisson) == 1 else poisson

    def _void(self) -> tuple[float, float]:
        """Young's modulus and Poisson's ratio of what is in the void."""
        if self.filling_young is not None:
            return self.filling_young, self.filling_poisson
        young, poisson = self._materials()
        return (self.ersatz * young[0], poisson[0]) if self.ersatz else (0.0, 0.0)

    def bytes_of_a_voxel(self, threads: int) -> int:
        """Five fields of 16 bits, four whole ones for each case in progress, coarser grids, Lamé constants, weights."""
        return 30 + 54 * min(threads, 6) + 16

    def stiffness_of(
        self, context: Context, source: ScalarField | Voxels, expansion: tuple[float, ...] = ()
    ) -> StiffnessReport:
        """Solve six load cases; `expansion` has coefficients of the void and of the phases from 1 on, or nothing."""
        from sppm_pipeline.method.connectivity.components import phase_report

        cell = self.cell_of(context, source)
        cell.check_materials(context, len(self._materials()[0]), "`young` and `poisson`")
        connected, phases, shape = phase_report(cell.occupied().T), self._phases(cell), cell.shape
        whole = cell.fraction is None
        body, expanding = self._body(cell, expansion)
        del cell  # the solver needs the memory
        options = self.solver_options(context.threads)
        del options["precision"]  # which the body has
        found = body.stiffness(expansion=expanding, **options)
        warnings = self.solver_warnings(found.solved, found.precision)
        # of what is there: materials of phases that the image lacks do no harm
        if (largest := max((nu for share, e, nu in phases if share > 0 and e > 0), default=-1.0)) > LOCKING:
            warnings.append(
                f"with Poisson's ratio {largest:g} voxels lock: the stiffness comes out too large, and falls slowly on "
                "finer grids"
            )
        without = [word for word, value in zip(_STRAINS, np.diag(found.stiffness), strict=True) if value == 0]
        if without:
            warnings.append(f"the solid has no load path along {', '.join(without)}")
        if self._void()[0] == 0 and connected.removed_share > 0:
            warnings.append(
                f"{connected.removed_share:.2g} of the solid is disconnected from the rest across faces of voxels "
                "and has no load path"
            )
        for warning in warnings:
            context.warn(warning)
        return StiffnessReport(
            found.stiffness,
            phases,
            f"{' x '.join(map(str, shape))} voxels, {'whole' if whole else 'solid fractions'}",
            unit=None if self.stress_unit == "relative" else self.stress_unit,
            expansion=found.expansion,
            solver={
                "grid": list(shape),
                "precision": found.precision,
                "iterations": [case.iterations for case in found.solved],
                "residuals": [float(case.residual) for case in found.solved],
                "errors": [min(float(case.error), 1.0) for case in found.solved],
                "converged": all(case.converged for case in found.solved),
                "wraps": list(connected.wraps),
                "components": connected.components,
            },
        )

    def _phases(self, cell: VoxelCell) -> tuple[tuple[float, float, float], ...]:
        """Volume fraction, Young's modulus and Poisson's ratio of each phase, that of the void last."""
        young, poisson = self._materials()
        if cell.phase is None:
            return ((1 - cell.porosity, young[0], poisson[0]), (cell.porosity, *self._void()))
        fractions = np.bincount(cell.phase.ravel("K"), minlength=2) / cell.phase.size
        solid = tuple(
            (float(fractions[phase]), young[phase - 1], poisson[phase - 1]) for phase in range(1, len(fractions))
        )
        return (*solid, (float(fractions[0]), *self._void()))

    def _constants(self) -> list[tuple[float, float]]:
        """Lamé constants of the void and of each phase."""
        from sppm_pipeline.services.elastic.voigt import lame

        return [lame(e, v) for e, v in (self._void(), *zip(*self._materials(), strict=True))]

    def _expansion(self, cell: VoxelCell, expansion: tuple[float, ...], bulk: NDArray[Any]) -> NDArray[Any]:
        """Coefficients of all voxels, (nz, ny, nx), of which `bulk` has the bulk moduli.

        What is mixed in a voxel by volume is the stress that holds an expansion back, so that Levin's relation between
        expansion and stiffness holds for mixtures, too.
        """
        moduli = [lam + 2 / 3 * mu for lam, mu in self._constants()]
        stress = cell.of_voxels(tuple(k * alpha for k, alpha in zip(moduli, expansion, strict=True)), np.float64)
        return np.asarray(np.divide(stress, bulk, out=np.zeros_like(stress), where=bulk > 0))

    def _body(self, cell: VoxelCell, expansion: tuple[float, ...]) -> tuple[ElasticBody, NDArray[Any] | None]:
        """The cell as it is solved, and the coefficients of expansion of its voxels, if there are any."""
        from sppm_pipeline.features.stiffness.numerics.elasticity import ElasticBody

        lam, mu = zip(*self._constants(), strict=True)
        dtype = np.float32 if self.precision == "single" else np.float64
        firsts, seconds = cell.of_voxels(lam, dtype), cell.of_voxels(mu, dtype)
        expanding = self._expansion(cell, expansion, firsts + 2 / 3 * seconds) if expansion else None
        return ElasticBody.of(firsts, seconds, cell.edges, dtype), expanding


_STRAINS = ("xx", "yy", "zz", "yz", "xz", "xy")


@dataclass(frozen=True, kw_only=True)
class HomogenizeVoxel(ElasticHomogenizer):
    """Compute the effective stiffness of a periodic cell on voxels (paper, section 3.2).

    Trilinear bricks, six unit strains, periodic displacements, no stiffness at all in the void. A field is sampled;
    voxels at its surface get the stiffness of the solid times their solid fraction, which converges much
    faster than the binary voxels of the paper. Images may hold several phases, each with a material of its own;
    `extract.phases` makes them of fields. What fills the void has a stiffness by `filling_young`; voxels at the surface
    then have the mean of both, weighted by volume.

    With more than one grid, each coarser by a third than the next, the limit of fine grids is extrapolated
    (Richardson), and the difference becomes the error bar of the result, which stays that of the finest grid.

    Given the coefficients of thermal expansion of the phases, it finds that of the cell as well.
    """

    name: ClassVar[str] = "homogenize.voxel"
    version: ClassVar[int] = 2
    reported: ClassVar[tuple[str, ...]] = ("convergence.*",)

    grids: int = option(
        1, help="grids for an error bar, of an image made of blocks of its voxels; 1 for none", minimum=1, maximum=3
    )

    expansion: float | tuple[float, ...] | None = option(
        None, help=f"coefficient of thermal expansion of the solid, {options.EACH_PHASE}", unit="1/K",
        minimum=-1, maximum=1,
    )  # fmt: skip
    filling_expansion: float | None = option(
        None, help="coefficient of thermal expansion of what fills the void", unit="1/K", minimum=-1, maximum=1
    )

    def check_options(self) -> None:
        """As many expansions as materials, or none."""
        super().check_options()
        phases, given = len(self._materials()[0]), len(per_phase(self.expansion))
        if self.expansion is not None and given != phases:
            raise ConfigError(
                f"`expansion` has {given} coefficients, and `young` {phases} Young's moduli",
                hint="give one for each phase, or none",
            )
        wanted = self.expansion is not None and self.filling_young is not None
        if wanted != (self.filling_expansion is not None):
            raise ConfigError(
                f"`filling_expansion` is {'missing' if wanted else 'of no use'}",
                hint="give it with `expansion` and `filling_young`, and only then",
            )

    def _expansions(self) -> tuple[float, ...]:
        """Of the void and of each phase; the void, if it has a stiffness of its own accord, expands as phase 1 does."""
        given = per_phase(self.expansion)
        return (given[0] if self.filling_expansion is None else self.filling_expansion, *given) if given else ()

    def estimate(self, palette: Palette, source: Size) -> Size:
        """All grids; the finest needs most memory."""
        found = [self.solving(source, n) for n in self._resolutions()]
        return replace(found[-1], samples=sum(s.samples for s in found), sums=sum(s.sums for s in found),
                       voxels=sum(s.voxels for s in found))  # fmt: skip

    def _resolutions(self) -> list[int]:
        return grids_below(self.resolution, self.grids)

    def run(self, context: Context, source: ScalarField | Voxels) -> StiffnessReport:
        """Homogenize, on coarser grids first if an error bar is requested."""
        self.check_image(context, source)
        if self.grids == 1:
            return self.stiffness_of(context, source, self._expansions())
        counts, reports, limit = refined(
            context,
            source,
            self._resolutions(),
            lambda on, count, given: replace(self, resolution=count).stiffness_of(on, given, self._expansions()),
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
