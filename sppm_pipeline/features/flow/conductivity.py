"""The effective conductivity of a cell."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Report, frozen, number
from sppm_pipeline.nouns import TEXT


def check_transport(k: NDArray[np.float64], porosity: float, name: str, slack: float) -> None:
    """Raise `ValueError` unless a tensor is finite, (3, 3), symmetric and not negative, and a porosity within 0 and 1;
    eigenvalues may be below zero by `slack` times the largest entry.
    """
    if k.shape != (3, 3) or not np.isfinite(k).all():
        raise ValueError(f"the {name} must be a finite 3 x 3 matrix, got shape {k.shape}")
    largest = float(np.abs(k).max())
    # effective tensors are symmetric by reciprocity; what is left of that is rounding
    if np.abs(k - k.T).max() > 1e-6 * largest:
        raise ValueError(f"the {name} is not symmetric")
    if np.linalg.eigvalsh(k)[0] < -slack * largest:
        raise ValueError(f"the {name} has a negative eigenvalue")
    if not 0 <= porosity <= 1:
        raise ValueError(f"the porosity must lie between 0 and 1, got {porosity}")


@dataclass(frozen=True, eq=False)
class ConductivityReport(Report):
    """Effective conductivity, or diffusivity, of a periodic cell, and how it was computed.

    Attributes
    ----------
    k : (3, 3) float64
        Mean flow over mean gradient, the unit of `bulk`; of two grids of a field, their limit.
    error : (3, 3) float64 or None
        Error bar of `k`, from two grids.
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

    headline: ClassVar[tuple[str, ...]] = ("k.1.1", "k.2.2", "k.3.3", "tortuosity", "porosity")

    k: NDArray[np.float64] = field(metadata=number("#3.#3", error="error"))
    error: NDArray[np.float64] | None = field(default=None, metadata=number("#3.#3", optional=True), kw_only=True)
    tortuosity: tuple[float | None, ...] = field(metadata=number("#3"))
    of: str = field(metadata=TEXT)
    bulk: tuple[float, ...] = field(metadata=number("#6"))
    fluid: float | None = field(default=None, metadata=number(optional=True), kw_only=True)
    porosity: float = field(metadata=number())
    grid: tuple[int, int, int] = field(metadata=number("#3"))
    fractions: bool = field(metadata=number())
    precision: str = field(metadata=TEXT)
    iterations: tuple[int, ...] = field(metadata=number("#3"))
    residuals: tuple[float, ...] = field(metadata=number("#3"))
    errors: tuple[float, ...] = field(metadata=number("#3"))
    converged: bool = field(metadata=number())
    wraps: tuple[bool, bool, bool] = field(metadata=number("#3"))
    warnings: tuple[str, ...] = field(default=(), metadata=TEXT)

    def __post_init__(self) -> None:
        object.__setattr__(self, "k", frozen(np.asarray(self.k, np.float64)))
        if self.error is not None:
            object.__setattr__(self, "error", frozen(np.asarray(self.error, np.float64)))

    def check(self) -> None:
        """A finite, symmetric matrix that is not negative, and a porosity between 0 and 1."""
        check_transport(self.k, self.porosity, "conductivity", 1e-4)
