"""Effective stiffness of a periodic structure, and what follows from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sppm_pipeline.nouns.artifact import Surface, Viewable, frozen
from sppm_pipeline.nouns.report import TEXT, Chart, Curve, Number, Report, reports
from sppm_pipeline.services.arrays import F64

if TYPE_CHECKING:
    from sppm_pipeline.services.elastic.bounds import Bounds

ROUNDING = 1e-8
"""Fraction of the modulus of the stiffest phase that counts as zero."""

_PAIRS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
"""Axes of Poisson's ratios: along which a bar is pulled, and along which it contracts."""


@dataclass(frozen=True, eq=False)
class StiffnessReport(Report, Viewable):
    """The stiffness C^H of a cell that repeats for ever, in Voigt order xx, yy, zz, yz, xz, xy, engineering shear.

    Attributes
    ----------
    stiffness : (6, 6) float64
        In `unit`.
    phases : tuple of (fraction, Young's modulus, Poisson's ratio)
        What the cell is made of, void (modulus 0) included; fractions sum to 1.
    method : str
        How it was found, for people.
    unit : str or None
        Unit of stress; None if the moduli are relative to nothing in particular.
    error : (6, 6) float64 or None
        Error bar of each entry by refinement of the grid.
    expansion : (6,) float64 or None
        Thermal expansion, the strain of a free body for each kelvin, xx, yy, zz, yz, xz, xy, engineering shear; NaN
        where nothing carries load. None if that of the materials was not given.
    solver : dict
        Residuals, iterations and what else the method has to say, JSON-ready.
    """

    headline: ClassVar[tuple[str, ...]] = (
        "E_relative", "E_ratio", "E", "G", "nu", "C.1.1", "C.1.2", "C.4.4", "porosity",
    )  # fmt: skip

    stiffness: F64
    phases: tuple[tuple[float, float, float], ...]
    method: str = field(metadata=TEXT)
    unit: str | None = field(default=None, metadata=TEXT)
    error: F64 | None = None
    expansion: F64 | None = None
    solver: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "stiffness", frozen(np.asarray(self.stiffness, np.float64)))
        object.__setattr__(self, "phases", tuple((float(f), float(e), float(nu)) for f, e, nu in self.phases))
        if self.error is not None:
            object.__setattr__(self, "error", frozen(np.asarray(self.error, np.float64)))
        if self.expansion is not None:
            object.__setattr__(self, "expansion", frozen(np.asarray(self.expansion, np.float64)))

    def check(self) -> None:
        """Six by six, finite, symmetric, without negative energies; shares that sum to 1."""
        c = self.stiffness
        if c.shape != (6, 6) or not np.isfinite(c).all():
            raise ValueError("a stiffness is a finite 6 x 6 matrix")
        # of a solid that carries nothing the solver's rounding is left, which has no symmetry and no sign
        largest, rounding = float(np.abs(c).max()), ROUNDING * max((young for _, young, _ in self.phases), default=0.0)
        if np.abs(c - c.T).max() > max(1e-6 * largest, rounding):
            raise ValueError("a stiffness is symmetric")
        if np.linalg.eigvalsh(c)[0] < -max(1e-4 * largest, rounding):
            raise ValueError("a stiffness has no negative energy")
        if self.expansion is not None and self.expansion.shape != (6,):
            raise ValueError(f"an expansion has six components, got the shape {self.expansion.shape}")
        if abs(sum(fraction for fraction, _, _ in self.phases) - 1) > 1e-6:
            raise ValueError(f"the fractions of the phases sum to 1, got {self.phases}")

    @property
    @reports()
    def porosity(self) -> float:
        """Fraction of the void."""
        return sum(fraction for fraction, young, _ in self.phases if young == 0)

    @reports("phases", column=False)
    def _materials(self) -> list[dict[str, float]]:
        return [{"share": f, "young": e, "poisson": nu} for f, e, nu in self.phases]

    @property
    @reports("#6.#6", unit="{unit}", error="error")
    def C(self) -> F64:
        """`stiffness`, (6, 6) float64."""
        return self.stiffness

    @property
    def E(self) -> F64:
        """Young's moduli along x, y, z, (3,) float64, in `unit`; the number in tables is ``E.1`` to ``E.3``."""
        return self._constants("E")

    @property
    def G(self) -> F64:
        """Shear moduli yz, xz, xy, (3,) float64, in `unit`."""
        return self._constants("G")

    def _constants(self, name: str) -> F64:
        from sppm_pipeline.services.elastic.voigt import engineering_constants

        return np.asarray(engineering_constants(self.stiffness)[name], np.float64)

    @property
    def base(self) -> float:
        """Young's modulus of the stiffest phase: what relative moduli are relative to."""
        return max(young for _, young, _ in self.phases)

    @cached_property
    def bounds(self) -> Bounds:
        """Voigt, Reuss and Hashin-Shtrikman, and whether the stiffness keeps to them."""
        from sppm_pipeline.services.elastic.bounds import bounds

        return bounds(self.stiffness, list(self.phases))

    @reports(
        Number("E.#3", unit="{unit}", error="E_error", box="Young's modulus x, y, z"),
        Number("G.#3", unit="{unit}", error="G_error"),
        *(Number(f"nu.{'xyz'[i]}{'xyz'[j]}") for i, j in _PAIRS),
        Number("E_x_relative"),
    )
    def _engineering_constants(self) -> tuple[Any, ...]:
        from sppm_pipeline.services.elastic.voigt import engineering_constants

        found = engineering_constants(self.stiffness)
        return found["E"], found["G"], *(found["nu"][pair] for pair in _PAIRS), self._relative(found["E"][0])

    def _relative(self, modulus: float) -> float | None:
        """A modulus over that of the stiffest phase; None of a cell without any."""
        return modulus / self.base if self.base else None

    @reports(
        Number("E_relative", error="E_relative_error", box="E / E of the solid"),
        Number("E_ratio", box="largest over smallest E"),
        "isotropic.E", "isotropic.nu", "xi", "xi_relative", "deviation_invariant", "bulk.voigt", "bulk.reuss",
        "shear.voigt", "shear.reuss", "zener", "distance_from_cubic", "universal_anisotropy",
        "log_euclidean_anisotropy", "E_min.value", "E_min.direction.#3", "E_max.value", "E_max.direction.#3",
    )  # fmt: skip
    def _isotropy(self) -> tuple[Any, ...]:
        from sppm_pipeline.services.elastic import isotropy
        from sppm_pipeline.services.elastic.directional import extremes

        c, fit = self.stiffness, isotropy.nearest_isotropic(self.stiffness)
        anisotropies = isotropy.universal_anisotropy(c), isotropy.log_euclidean(c)
        invariant, ends = isotropy.nearest_isotropic(c, "tensor").relative, extremes(c)
        low, high = ends["min"][0], ends["max"][0]
        return (
            self._relative(fit.young), high / low if low > 0 else float("inf"), *fit, invariant, *isotropy.averages(c),
            *isotropy.zener(c), *anisotropies, *ends["min"], *ends["max"],
        )  # fmt: skip

    @reports(
        "bounds.within_voigt_and_reuss", "bounds.hashin_shtrikman_bulk.#2", "bounds.hashin_shtrikman_shear.#2",
        "bounds.hashin_shtrikman_young.#2", "bounds.bulk_within", "bounds.shear_within",
    )  # fmt: skip
    def _kept_bounds(self) -> tuple[Any, ...]:
        found = self.bounds
        return found.within, found.bulk, found.shear, found.young, found.bulk_holds, found.shear_holds

    @reports("compliance.#6.#6", "solver.*")
    def _compliance(self) -> tuple[Any, ...]:
        from sppm_pipeline.services.elastic.voigt import compliance

        return compliance(self.stiffness), self.solver

    @reports("expansion.#6", optional=True)
    def _expansion(self) -> list[float | None] | None:
        if self.expansion is None:
            return None
        return [float(value) if np.isfinite(value) else None for value in self.expansion]

    @reports("error.#6.#6", "error_relative", "E_error.#3", "G_error.#3", "E_relative_error", optional=True)
    def _error_bars(self) -> tuple[Any, ...] | None:
        """Those of the moduli as if all entries erred to one side, as those of voxels do: too stiff."""
        from sppm_pipeline.services.elastic.isotropy import nearest_isotropic
        from sppm_pipeline.services.elastic.voigt import engineering_constants

        if self.error is None:
            return None
        fits = [nearest_isotropic(c).young for c in (self.stiffness, self.stiffness - self.error)]
        size = float(np.linalg.norm(self.stiffness))
        found, softer = engineering_constants(self.stiffness), engineering_constants(self.stiffness - self.error)
        bars = (np.abs(found[name] - softer[name]) for name in ("E", "G"))
        return (
            self.error,
            float(np.linalg.norm(self.error)) / size if size else 0.0,
            *bars,
            self._relative(abs(fits[0] - fits[1])),
        )

    def live_view(self) -> Surface:
        """The surface whose distance from the middle is Young's modulus in that direction."""
        from sppm_pipeline.services.elastic.directional import sphere_mesh, young_along

        sphere, faces = sphere_mesh(5)
        vertices = sphere * young_along(self.stiffness, sphere)[:, None]
        return Surface(vertices, faces, "Young's modulus by direction", self.unit or "of the solid's")

    @classmethod
    def report_charts(cls, summary: Mapping[str, Any]) -> list[Chart]:
        """Young's modulus over the directions of the planes xy, yz and zx; nothing of a singular stiffness."""
        c = np.asarray(summary.get("C"), np.float64)
        if c.shape != (6, 6) or not np.isfinite(c).all() or np.linalg.cond(c) > 1e12:
            return []
        s = np.linalg.inv(c)
        turn = np.linspace(0, 2 * np.pi, 181)
        curves = []
        for label, (a, b) in (("xy plane", (0, 1)), ("yz plane", (1, 2)), ("zx plane", (2, 0))):
            n = np.zeros((3, len(turn)))
            n[a], n[b] = np.cos(turn), np.sin(turn)
            # E(n) = 1 / (v S v) with the compliance S and v = n n in Voigt order
            v = np.stack([n[0] ** 2, n[1] ** 2, n[2] ** 2, n[1] * n[2], n[0] * n[2], n[0] * n[1]])
            curves.append(Curve(turn, 1 / np.einsum("ik,ij,jk->k", v, s, v), label))
        unit = str(summary.get("unit") or "")
        return [Chart(curves, "Young's modulus over direction" + (f", {unit}" if unit else ""), polar=True)]
