"""``homogenize.voxel``: the effective stiffness of a periodic cell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, Homogenizer, ScalarField, Voxels, option, options
from sppm_pipeline.method.families.homogenizer import LOCKING, SidedHomogenizer, VoxelCell, per_phase, refined
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.method.porosity.fractions import power_share, solid_fractions, stiff_share
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.elastic.refinement import (
    POWERS,
    Limit,
    doubt,
    limit_of_grids,
    limit_of_powers,
    mean_thickness,
    power_weights,
    second_order,
)  # fmt: skip
from sppm_pipeline.services.multigrid.transfer import coarsened

if TYPE_CHECKING:
    from sppm_pipeline.features.stiffness.numerics.elasticity import ElasticBody, Homogenized

_INCOMPRESSIBLE = 0.4999
"""Poisson's ratio above which voxels are refused: a solution takes 300 iterations here, and beyond 0.499999 single
precision loses the shear modulus beside the bulk modulus."""

_COARSEST = 4
"""Voxels along an edge from which on a coarser grid makes sense at all (heuristic; error bars tell the rest)."""


@dataclass(frozen=True, kw_only=True)
class ElasticCell(Homogenizer):
    """Base of stages that solve the elasticity of a cell of voxels: materials, and the body that is solved."""

    young: float | tuple[float, ...] = options.young(1.0, note=f"{options.EACH_PHASE}; 1: results are relative to it")
    poisson: float | tuple[float, ...] = options.poisson(0.3, note=options.EACH_PHASE)
    filling_young: float | None = option(
        None, help="Young's modulus of what fills the void; nothing does if omitted", above=0, maximum=1e15
    )
    filling_poisson: float = option(0.3, help="Poisson's ratio of what fills the void", above=-1, below=0.5)
    stress_unit: str = options.stress_unit("relative", formerly="unit")
    ersatz: float = option(
        0.0, help="stiffness of the void relative to phase 1, for comparison with other codes", minimum=0, maximum=1,
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

    def _constants(self) -> list[tuple[float, float]]:
        """Lamé constants of the void and of each phase."""
        from sppm_pipeline.services.elastic.voigt import lame

        return [lame(e, v) for e, v in (self._void(), *zip(*self._materials(), strict=True))]

    def _expansion(self, cell: VoxelCell, expansion: tuple[float, ...], bulk: NDArray[Any]) -> NDArray[Any]:
        """Coefficients of all voxels, (nz, ny, nx), of which `bulk` has the bulk moduli."""
        # stresses that hold an expansion back are mixed by volume: so Levin's relation holds for mixtures, too
        moduli = [lam + 2 / 3 * mu for lam, mu in self._constants()]
        stress = cell.of_voxels(tuple(k * alpha for k, alpha in zip(moduli, expansion, strict=True)), np.float64)
        return np.asarray(np.divide(stress, bulk, out=np.zeros_like(stress), where=bulk > 0))

    def _loaded(self, cell: VoxelCell, power: float | None) -> VoxelCell:
        """The cell with shares of the stiffness in place of solid fractions: by this power of them, or by the ramp."""
        if cell.fraction is None:
            return cell
        ratio = self._void()[0] / self._materials()[0][0]
        share = stiff_share(cell.fraction) if power is None else power_share(cell.fraction, power, ratio)
        return cell._replace(fraction=share)

    def _body(
        self, cell: VoxelCell, expansion: tuple[float, ...], power: float | None = None
    ) -> tuple[ElasticBody, NDArray[Any] | None]:
        """The cell as it is solved, and the coefficients of expansion of its voxels, if there are any."""
        from sppm_pipeline.features.stiffness.numerics.elasticity import ElasticBody

        cell = self._loaded(cell, power)
        lam, mu = zip(*self._constants(), strict=True)
        dtype = np.float32 if self.precision == "single" else np.float64
        firsts, seconds = cell.of_voxels(lam, dtype), cell.of_voxels(mu, dtype)
        expanding = self._expansion(cell, expansion, firsts + 2 / 3 * seconds) if expansion else None
        return ElasticBody.of(firsts, seconds, cell.edges, dtype), expanding


@dataclass(frozen=True, kw_only=True)
class ElasticHomogenizer(ElasticCell):
    """Base of stages that compute effective stiffnesses on voxels: grids, and the stiffness report of a cell."""

    grids: int | None = option(
        None, help="grids solved, for an error bar; by one rule for voxels at the surface, the limit of which is "
        "extrapolated; if omitted 2 by several rules where voxels count by solid fractions, else 1",
        minimum=1, maximum=3,
    )  # fmt: skip

    def _counts(self) -> list[int]:
        """Voxels along the edge of a cell of a field on each grid, the finest first."""
        grids = self.grids or (2 if self.fractions == "auto" and self.resolution >= _COARSEST else 1)
        # half as fine, and in between: the finest costs most, and on coarser ones most cells fall to pieces
        counts = [self.resolution, *(max(2, round(self.resolution * part)) for part in (0.5, 0.75)[: grids - 1])]
        if len(set(counts)) < grids:
            raise ConfigError(
                f"a resolution of {self.resolution} has no coarser grids", hint="raise it, or write `grids: 1`"
            )
        return counts

    @property
    def effort(self) -> float:
        """Voxels of all solutions of a cell over those of the finest."""
        counts = self._counts()
        counts += counts[1:] * 2 if len(counts) == 2 and self.grids is None else []  # by three powers of the fraction
        return float(sum((count / self.resolution) ** 3 for count in counts))

    def stiffness_of(
        self, context: Context, source: ScalarField | Voxels, expansion: tuple[float, ...] = ()
    ) -> StiffnessReport:
        """Homogenize on all grids; `expansion` has coefficients of the void and of the phases from 1 on, or nothing."""
        cell = self.cell_of(context, source)
        cell.check_materials(context, len(self._materials()[0]), "`young` and `poisson`")
        thickness = float("inf") if cell.fraction is None else mean_thickness(cell.fraction)
        phases, image = self._phases(cell), self._coarser_image(source, cell)
        spacings = [self.resolution / n for n in self._counts()] if isinstance(source, ScalarField) else [1.0]
        spacings += [2.0] if image else []
        powers: tuple[float | None, ...] = (None,) * len(spacings)
        if len(spacings) == 2 and self.grids is None:
            powers, spacings = POWERS, [1.0, *spacings[1:] * (len(POWERS) - 1)]
        report = self._solved(context, cell, expansion, phases, powers[0])
        del cell  # the solver needs the memory
        if len(spacings) == 1:
            return report
        values, heat = [report.stiffness], [_held_stress(report.stiffness, report.expansion)]
        for number, (spacing, power) in enumerate(zip(spacings[1:], powers[1:], strict=True), 2):
            if image is None and (number == 2 or spacing != spacings[1]):
                assert isinstance(source, ScalarField)
                coarse = replace(self, resolution=round(self.resolution / spacing)).sampled(source, context.threads)
            found = self._found(context, coarse if image is None else image, expansion, power)
            values.append(found.stiffness)
            heat.append(_held_stress(found.stiffness, found.expansion))
            context.progress(number, len(spacings), "grids")
        moduli = sorted(young for share, young, _ in phases if share > 0)
        contrast = 1 - moduli[0] / moduli[-1] if moduli[-1] else 0.0
        if powers[0] is None:
            limit, held = limit_of_grids(spacings, values, thickness, contrast), second_order(spacings, heat)
        else:
            limit = limit_of_powers(spacings[1], values, thickness, contrast)
            held = power_weights(spacings[1])[0] @ heat
        result = replace(
            report, stiffness=limit.value, error=limit.error, expansion=self._free_strain(report, limit, held),
            solver=report.solver | {
                "grids": [round(n) for n in report.solver["grid"][0] / np.array(spacings)],
                "C11": [float(value[0, 0]) for value in values], "extrapolated": limit.extrapolated,
            },
        )  # fmt: skip
        self._warn_of_error(context, result, thickness, 0 if image else self.resolution)
        return result

    @staticmethod
    def _free_strain(report: StiffnessReport, limit: Limit, held: F64) -> F64 | None:
        """Thermal expansion from extrapolated stresses, in which Levin's relation to the stiffness is linear."""
        if report.expansion is None or not limit.extrapolated:
            return report.expansion
        free, loaded = np.full(6, np.nan), np.isfinite(report.expansion)
        free[loaded] = np.linalg.lstsq(limit.value[np.ix_(loaded, loaded)], held[loaded], rcond=1e-9)[0]
        return free

    @staticmethod
    def _warn_of_error(context: Context, report: StiffnessReport, thickness: float, resolution: int) -> None:
        """Warn of error bars too long to rely on."""
        error = report.summary()["error_relative"]
        if not report.solver["extrapolated"]:
            context.warn(
                "these grids are too coarse to extrapolate; the stiffness is that of the finest, with an error bar of "
                f"{error:.0%}: raise `resolution`"
            )
        elif warning := doubt(error, "stiffness", thickness, resolution):
            context.warn(warning)

    def _coarser_image(self, source: ScalarField | Voxels, cell: VoxelCell) -> VoxelCell | None:
        """The image of half as many voxels, where solid fractions can be averaged."""
        if self.grids == 1 or not isinstance(source, Voxels) or cell.fraction is None or not _has_fractions(source):
            return None
        x, y, z = (2 * h for h in cell.edges)
        return VoxelCell(None, np.asfortranarray(coarsened(cell.fraction), np.float32), (x, y, z))

    def _found(
        self, context: Context, cell: VoxelCell, expansion: tuple[float, ...], power: float | None
    ) -> Homogenized:
        """The stiffness of a cell on its grid, by a power of the solid fraction or by the ramp."""
        options = self.solver_options(context.threads)
        del options["precision"]  # which the body has
        body, expanding = self._body(cell, expansion, power)
        return body.stiffness(expansion=expanding, **options)

    def _solved(
        self, context: Context, cell: VoxelCell, expansion: tuple[float, ...],
        phases: tuple[tuple[float, float, float], ...], power: float | None,
    ) -> StiffnessReport:  # fmt: skip
        """The report of one grid, with what there is to warn of."""
        from sppm_pipeline.method.connectivity.components import phase_report

        # of what carries load: voxels that are hardly solid join nothing
        connected = phase_report(self._loaded(cell, None).occupied().T, self.wraps)
        found = self._found(context, cell, expansion, power)
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
            found.stiffness, phases,
            f"{' x '.join(map(str, cell.shape))} voxels, {'whole' if cell.fraction is None else 'solid fractions'}",
            unit=None if self.stress_unit == "relative" else self.stress_unit, expansion=found.expansion,
            solver={
                "grid": list(cell.shape), "precision": found.precision,
                "iterations": [case.iterations for case in found.solved],
                "residuals": [float(case.residual) for case in found.solved],
                "errors": [min(float(case.error), 1.0) for case in found.solved],
                "converged": all(case.converged for case in found.solved), "wraps": list(connected.wraps),
                "components": connected.components,
            },
        )  # fmt: skip

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


_STRAINS = ("xx", "yy", "zz", "yz", "xz", "xy")


def _has_fractions(image: Voxels) -> bool:
    """True if an image has voxels that are partly solid, and even numbers of voxels, to be halved."""
    values = image.values
    partly = image.fractions and bool(np.any((values > 0) & (values < 1)))
    return partly and all(n % 2 == 0 and n >= _COARSEST for n in image.shape)


def _held_stress(stiffness: F64, expansion: F64 | None) -> F64:
    """Stress of a clamped cell per kelvin, 0 where nothing carries load."""
    return np.zeros(6) if expansion is None else stiffness @ np.nan_to_num(expansion)


@dataclass(frozen=True, kw_only=True)
class HomogenizeVoxel(SidedHomogenizer, ElasticHomogenizer):
    """Compute the effective stiffness of a periodic cell on voxels (paper, section 3.2).

    Trilinear bricks, six unit strains, periodic displacements, no stiffness at all in the void. A field is sampled;
    voxels at its surface have a power of their solid fraction as their stiffness. Three powers on a grid half as fine
    tell what they do to walls; the limit of fine grids is extrapolated from that, and has an error bar. `grids: 1` with
    `fractions: binary` is the paper's way. Images may hold several phases, each with
    a material of its own; `extract.phases` makes them of fields. What fills the void has a stiffness by
    `filling_young`; voxels at the surface then have a mean of both.

    A cell that does not repeat, such as a scan, is loaded with its mirror images (`sides: mirror`): its sides stay
    plane under tension and take no shear, the mixed conditions of Pahr and Zysset (2008). Without thermal expansion
    the scan alone is solved. The result is then orthotropic whatever the scan is, and has no coupling of shear to
    tension.

    Given the coefficients of thermal expansion of the phases, it finds that of the cell as well.
    """

    name: ClassVar[str] = "homogenize.voxel"
    version: ClassVar[int] = 4
    reported: ClassVar[tuple[str, ...]] = ()

    expansion: float | tuple[float, ...] | None = option(
        None, help=f"coefficient of thermal expansion of the solid, {options.EACH_PHASE}", unit="1/K",
        minimum=-1, maximum=1,
    )  # fmt: skip
    filling_expansion: float | None = option(
        None, help="coefficient of thermal expansion of what fills the void", unit="1/K", minimum=-1, maximum=1
    )
    stretch: tuple[float, float, float] | None = option(
        None, help="how many times longer; a field, along x, y and z, before it is solved", minimum=0.05, maximum=20,
    )  # fmt: skip

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

    def sampled(self, field: ScalarField, threads: int) -> VoxelCell:
        """As many voxels of a stretched cell as of the plain one, nearly cubes in the stretched one."""
        if self.stretch is None:
            return super().sampled(field, threads)
        from sppm_pipeline.services.grid import Grid

        scale = float(np.prod(self.stretch)) ** (1 / 3)
        per_cell = [max(2, round(self.resolution * s / scale)) for s in self.stretch]
        nx, ny, nz = (n * cells for n, cells in zip(per_cell, field.cells, strict=True))
        ex, ey, ez = (s / scale * self.resolution / n for n, s in zip(per_cell, self.stretch, strict=True))
        kx, ky, kz = (float(n) for n in per_cell)
        if self.fractions == "binary":
            grid = Grid((0.5 / kx, 0.5 / ky, 0.5 / kz), (1 / kx, 1 / ky, 1 / kz), (nx, ny, nz))
            return VoxelCell(field.solid(grid, threads), None, (ex, ey, ez))
        fraction = solid_fractions(
            lambda grid, start, stop: field.sample_zyx(grid, start, stop, threads), (nx, ny, nz), (kx, ky, kz)
        )
        return VoxelCell(None, fraction.T, (ex, ey, ez))

    @property
    def mirrored(self) -> bool:
        return super().mirrored and self.expansion is None

    def _found(
        self, context: Context, cell: VoxelCell, expansion: tuple[float, ...], power: float | None
    ) -> Homogenized:
        """The stiffness of a cell on its grid."""
        if not self.mirrored:
            return super()._found(context, cell, expansion, power)
        from sppm_pipeline.features.stiffness.numerics.mirrored import mirrored_stiffness

        cell = self._loaded(cell, power)
        options = self.solver_options(context.threads)
        del options["threads"]
        lam, mu = (cell.of_voxels(values, options["precision"]) for values in zip(*self._constants(), strict=True))
        return mirrored_stiffness(lam, mu, cell.edges, **options)

    def bytes_of_a_voxel(self, threads: int) -> int:
        """Between mirrors one case is solved at a time."""
        return super().bytes_of_a_voxel(1 if self.mirrored else threads)

    def _expansions(self) -> tuple[float, ...]:
        """Of the void and of each phase; the void, if it has a stiffness of its own accord, expands as phase 1 does."""
        given = per_phase(self.expansion)
        return (given[0] if self.filling_expansion is None else self.filling_expansion, *given) if given else ()

    def run(self, context: Context, source: ScalarField | Voxels) -> StiffnessReport:
        """Homogenize."""
        source = self.sided(context, source)
        self.check_image(context, source)
        if self.stretch is not None and not isinstance(source, ScalarField):
            raise ConfigError("an image is not stretched", hint="leave out `stretch`, or state its `spacing`")
        expansions = self._expansions()
        if isinstance(source, ScalarField) or (self.grids or 1) == 1 or _has_fractions(source):
            return self.stiffness_of(context, source, expansions)
        # steps of whole voxels make errors of first order, too irregular to extrapolate
        counts, reports, limit = refined(
            context, source, [0] * (self.grids or 1),
            lambda on, count, given: replace(self, grids=1).stiffness_of(on, given, expansions),
            lambda report: report.stiffness,
        )  # fmt: skip
        solver = {"grids": counts, "C11": [float(report.stiffness[0, 0]) for report in reports], "extrapolated": False}
        return replace(reports[-1], error=limit.error, solver=reports[-1].solver | solver)
