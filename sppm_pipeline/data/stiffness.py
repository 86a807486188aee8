"""The effective stiffness of a cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.noun import Noun, frozen

__all__ = ["StiffnessReport"]


@dataclass(frozen=True, eq=False)
class StiffnessReport(Noun):
    """Effective stiffness C^H of a periodic cell, and how it was computed (paper, section 3.2).

    Attributes
    ----------
    C : (6, 6) float64
        Mean stress over mean strain; Voigt order xx, yy, zz, yz, xz, xy, engineering shear strains.
    unit : str
        Of `C` and `young`; "relative" if they are parts of Young's modulus of the base material.
    young, poisson : tuple of float
        Of the base materials, one for each phase.
    porosity : float
        Share of void.
    method : str
        How C was found.
    grid : (nx, ny, nz)
        Voxels of the cell.
    fractions : bool
        Whether voxels at the surface count by the share of them that is solid.
    precision : str
        Of the solver.
    iterations : tuple of 6 int
    residuals : tuple of 6 float
        2-norm over that of the right-hand side, for each load case.
    errors : tuple of 6 float
        Estimated relative error of the diagonal of C by the solver (not by the grid).
    converged : bool
    wraps : (3,) bool
        Whether the solid runs through along x, y, z.
    components : int
        Pieces of the solid, across faces of voxels, opposite sides of the cell joined.
    warnings : tuple of str
    """

    C: NDArray[np.float64]
    unit: str
    young: tuple[float, ...]
    poisson: tuple[float, ...]
    porosity: float
    method: str
    grid: tuple[int, int, int]
    fractions: bool
    precision: str
    iterations: tuple[int, ...]
    residuals: tuple[float, ...]
    errors: tuple[float, ...]
    converged: bool
    wraps: tuple[bool, bool, bool]
    components: int
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "C", frozen(np.asarray(self.C, np.float64)))

    def check(self) -> None:
        """A finite, symmetric matrix without negative energies, and a porosity between 0 and 1."""
        if self.C.shape != (6, 6) or not np.isfinite(self.C).all():
            raise ValueError(f"the stiffness must be a finite 6 x 6 matrix, got shape {self.C.shape}")
        largest = float(np.abs(self.C).max())
        if np.abs(self.C - self.C.T).max() > 1e-6 * largest:
            raise ValueError("the stiffness is not symmetric")
        if np.linalg.eigvalsh(self.C)[0] < -1e-4 * largest:
            raise ValueError("the stiffness has a negative energy")
        if not 0 <= self.porosity <= 1:
            raise ValueError(f"the porosity must lie between 0 and 1, got {self.porosity}")

    def compliance(self) -> NDArray[np.float64]:
        """Strain over stress, (6, 6); the pseudo-inverse where some strains meet no stiffness."""
        return np.asarray(np.linalg.pinv(self.C, rcond=1e-9, hermitian=True), np.float64)

    def engineering(self) -> dict[str, Any]:
        """Young's moduli along x, y, z, shear moduli yz, xz, xy, and Poisson's ratios.

        Returns
        -------
        dict
            ``E`` and ``G`` are 0 where the load meets no stiffness. ``nu`` maps ``"xy"`` to the contraction along y
            over the extension along x when pulled along x, and so on; None where nothing can be pulled.
        """
        s = self.compliance()
        # loads that strains without stiffness can't balance
        carried = np.diag(self.C @ s) > 1 - 1e-6
        moduli = [float(1 / s[i, i]) if carried[i] and s[i, i] > 0 else 0.0 for i in range(6)]
        ratios = {
            f"{'xyz'[i]}{'xyz'[j]}": float(-s[j, i] * moduli[i]) if moduli[i] else None
            for i in range(3)
            for j in range(3)
            if i != j
        }
        return {"E": moduli[:3], "G": moduli[3:], "nu": ratios}

    def summary(self) -> dict[str, Any]:
        """C, the engineering constants, porosity, and how the solver did."""
        return {
            "C": [[float(value) for value in row] for row in self.C],
            **self.engineering(),
            "unit": self.unit,
            "porosity": self.porosity,
            "method": self.method,
            "grid": list(self.grid),
            "fractions": self.fractions,
            "young": list(self.young),
            "poisson": list(self.poisson),
            "precision": self.precision,
            "iterations": list(self.iterations),
            "residuals": list(self.residuals),
            "errors": list(self.errors),
            "converged": self.converged,
            "solid_wraps": list(self.wraps),
            "solid_components": self.components,
            "warnings": list(self.warnings),
        }
