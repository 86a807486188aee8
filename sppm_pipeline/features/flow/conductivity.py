"""The effective conductivity of a cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.nouns.artifact import Artifact, frozen


def check_transport(k: NDArray[np.float64], porosity: float, name: str, slack: float) -> None:
    """Raise `ValueError` unless a tensor is finite, (3, 3), symmetric and not negative, and a porosity within 0 and 1.

    Eigenvalues may be below zero by `slack` times the largest entry.
    """
    if k.shape != (3, 3) or not np.isfinite(k).all():
        raise ValueError(f"the {name} must be a finite 3 x 3 matrix, got shape {k.shape}")
    largest = float(np.abs(k).max())
    if np.abs(k - k.T).max() > 1e-6 * largest:
        raise ValueError(f"the {name} is not symmetric")
    if np.linalg.eigvalsh(k)[0] < -slack * largest:
        raise ValueError(f"the {name} has a negative eigenvalue")
    if not 0 <= porosity <= 1:
        raise ValueError(f"the porosity must lie between 0 and 1, got {porosity}")


@dataclass(frozen=True, eq=False)
class ConductivityReport(Artifact):
    """Effective conductivity, or diffusivity, of a periodic cell, and how it was computed.

    Attributes
    ----------
    k : (3, 3) float64
        Mean flow over mean gradient, the unit of `bulk`.
    of : str
        The conducting phase, "solid" or "void", the other one insulating; or "both".
    bulk : tuple of float
        Conductivity of the phase, or of each phase of the solid.
    fluid : float or None
        Conductivity of what fills the void, if both conduct.
    porosity : float
        Fraction of void.
    tortuosity : tuple of 3 floats or None
        Fraction times bulk over effective conductivity along x, y, z; None where nothing flows. With several conductors
        the sum of fractions times bulk.
    grid : (nx, ny, nz)
    fractions : bool
        Whether voxels at the surface count by the fraction of them that conducts.
    precision : str
    iterations : tuple of 3 int
    residuals, errors : tuple of 3 float
        As in `StiffnessReport`.
    converged : bool
    wraps : (3,) bool
        Whether the conductor percolates along x, y, z, across faces of voxels.
    warnings : tuple of str
    """

    reported: ClassVar[tuple[str, ...]] = (
        "k.#3.#3", "tortuosity.#3", "bulk.#6", "fluid", "porosity", "grid.#3", "fractions", "iterations.#3",
        "residuals.#3", "errors.#3", "converged", "wraps.#3",
    )  # fmt: skip

    k: NDArray[np.float64]
    of: str
    bulk: tuple[float, ...]
    porosity: float
    tortuosity: tuple[float | None, ...]
    grid: tuple[int, int, int]
    fractions: bool
    precision: str
    iterations: tuple[int, ...]
    residuals: tuple[float, ...]
    errors: tuple[float, ...]
    converged: bool
    wraps: tuple[bool, bool, bool]
    warnings: tuple[str, ...] = ()
    fluid: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "k", frozen(np.asarray(self.k, np.float64)))

    def check(self) -> None:
        """A finite, symmetric matrix that is not negative, and a porosity between 0 and 1."""
        check_transport(self.k, self.porosity, "conductivity", 1e-4)

    def summary(self) -> dict[str, Any]:
        """The tensor, tortuosity, porosity, and how the solver did."""
        return {
            "k": [[float(value) for value in row] for row in self.k],
            "tortuosity": list(self.tortuosity),
            "of": self.of,
            "bulk": list(self.bulk),
            **({} if self.fluid is None else {"fluid": self.fluid}),
            "porosity": self.porosity,
            "grid": list(self.grid),
            "fractions": self.fractions,
            "precision": self.precision,
            "iterations": list(self.iterations),
            "residuals": list(self.residuals),
            "errors": list(self.errors),
            "converged": self.converged,
            "wraps": list(self.wraps),
            "warnings": list(self.warnings),
        }
