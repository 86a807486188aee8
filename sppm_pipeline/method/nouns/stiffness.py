"""Effective stiffness of a periodic structure, and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.nouns.artifact import Artifact, frozen

if TYPE_CHECKING:
    from sppm_pipeline.services.elastic.bounds import Bounds

ROUNDING = 1e-8
"""What is nothing beside the modulus of the stiffest phase."""


@dataclass(frozen=True, eq=False)
class StiffnessReport(Artifact):
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

    reported: ClassVar[tuple[str, ...]] = (
        "porosity", "C.#6.#6", "E.#3", "G.#3", "nu.xy", "nu.xz", "nu.yx", "nu.yz", "nu.zx", "nu.zy", "E_relative",
        "isotropic.E", "isotropic.nu", "xi", "xi_relative", "deviation_invariant", "bulk.voigt", "bulk.reuss",
        "shear.voigt", "shear.reuss", "zener", "distance_from_cubic", "universal_anisotropy",
        "log_euclidean_anisotropy", "E_min.value", "E_min.direction.#3", "E_max.value", "E_max.direction.#3",
        "bounds.within_voigt_and_reuss", "bounds.hashin_shtrikman_bulk.#2", "bounds.hashin_shtrikman_shear.#2",
        "bounds.hashin_shtrikman_young.#2", "bounds.bulk_within", "bounds.shear_within", "compliance.#6.#6", "solver.*",
        "error.#6.#6", "error_relative", "E_error.#3", "G_error.#3", "expansion.#6",
    )  # fmt: skip

    stiffness: NDArray[np.float64]
    phases: tuple[tuple[float, float, float], ...]
    method: str
    unit: str | None = None
    error: NDArray[np.float64] | None = None
    expansion: NDArray[np.float64] | None = None
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
    def C(self) -> NDArray[np.float64]:
        """`stiffness`, (6, 6) float64."""
        return self.stiffness

    @property
    def porosity(self) -> float:
        """Fraction of the void."""
        return sum(fraction for fraction, young, _ in self.phases if young == 0)

    @property
    def base(self) -> float:
        """Young's modulus of the stiffest phase: what relative moduli are relative to."""
        return max(young for _, young, _ in self.phases)

    @cached_property
    def bounds(self) -> Bounds:
        """Voigt, Reuss and Hashin-Shtrikman, and whether the stiffness keeps to them."""
        from sppm_pipeline.services.elastic.bounds import bounds

        return bounds(self.stiffness, list(self.phases))

    def summary(self) -> dict[str, Any]:
        """Engineering constants, isotropy, bounds; what is not defined is None."""
        from sppm_pipeline.services.elastic import isotropy
        from sppm_pipeline.services.elastic.directional import extremes
        from sppm_pipeline.services.elastic.voigt import compliance, engineering_constants

        c = self.stiffness
        constants, mean = engineering_constants(c), isotropy.averages(c)
        fit, invariant = isotropy.nearest_isotropic(c), isotropy.nearest_isotropic(c, "tensor")
        ratio, from_cubic = isotropy.zener(c)
        ends, bound = extremes(c), self.bounds
        summary: dict[str, Any] = {
            "method": self.method,
            "unit": self.unit,
            "porosity": self.porosity,
            "phases": [{"share": f, "young": e, "poisson": nu} for f, e, nu in self.phases],
            "C": c,
            "E": constants["E"],
            "G": constants["G"],
            "nu": {
                name: constants["nu"]["xyz".index(name[0]), "xyz".index(name[1])]
                for name in ("xy", "xz", "yx", "yz", "zx", "zy")
            },
            "E_relative": constants["E"][0] / self.base if self.base else None,
            "isotropic": {"E": fit.young, "nu": fit.poisson},
            "xi": fit.deviation,
            "xi_relative": fit.relative,
            "deviation_invariant": invariant.relative,
            "bulk": {"voigt": mean.bulk_voigt, "reuss": mean.bulk_reuss},
            "shear": {"voigt": mean.shear_voigt, "reuss": mean.shear_reuss},
            "zener": ratio,
            "distance_from_cubic": from_cubic,
            "universal_anisotropy": isotropy.universal_anisotropy(c),
            "log_euclidean_anisotropy": isotropy.log_euclidean(c),
            "E_min": {"value": ends["min"][0], "direction": ends["min"][1]},
            "E_max": {"value": ends["max"][0], "direction": ends["max"][1]},
            "bounds": {
                "within_voigt_and_reuss": bound.within,
                "hashin_shtrikman_bulk": list(bound.bulk),
                "hashin_shtrikman_shear": list(bound.shear),
                "hashin_shtrikman_young": list(bound.young),
                "bulk_within": bound.bulk_holds,
                "shear_within": bound.shear_holds,
            },
            "compliance": compliance(c),
            "solver": self.solver,
        }
        if self.expansion is not None:
            summary["expansion"] = [float(value) if np.isfinite(value) else None for value in self.expansion]
        if self.error is not None:
            summary["error"] = self.error
            size = float(np.linalg.norm(c))
            summary["error_relative"] = float(np.linalg.norm(self.error)) / size if size else 0.0
            # as if all entries erred to one side, as those of voxels do: too stiff
            softer = engineering_constants(c - self.error)
            for name in ("E", "G"):
                summary[f"{name}_error"] = np.abs(constants[name] - softer[name])
        return summary
