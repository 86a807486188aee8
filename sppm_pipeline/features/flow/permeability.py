"""The permeability of a cell, and what else its slow flow tells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.flow.conductivity import check_transport
from sppm_pipeline.nouns.artifact import NOTEBOOK_SIZE, Artifact, frozen, png_of

DARCY = 9.869233e-13
"""Square meters."""


@dataclass(frozen=True, eq=False)
class PermeabilityReport(Artifact):
    """Permeability of the pores of a periodic cell, and how it was computed.

    Attributes
    ----------
    k : (3, 3) float64
        Flux times viscosity over the pressure gradient (Darcy's law), cell edges squared.
    edge_mm : float or None
        Edge of the cell; None if it has no physical size.
    porosity : float
        Fraction of void that is open: without pockets.
    pocket_share : float
        Share of the void in pockets, which are closed off.
    thermal : float
        Thermal (static) permeability, cell edges squared: mean of the torsion field, never less than `k`.
    viscous_tortuosity : tuple of 3 floats or None
        Static viscous tortuosity of the flow along x, y, z; None where nothing flows.
    thermal_tortuosity : float or None
        Static thermal tortuosity.
    hydraulic_tortuosity : tuple of 3 floats or None
        Mean speed over mean velocity along x, y, z: how much longer than the cell the ways of the fluid are.
    surface : float or None
        Area of the walls over the volume of the cell, in 1 / cell edge; None for images of whole voxels.
    slices : tuple of 3 arrays float32
        Speed in a middle plane along each axis (columns) and the next (rows), over the mean velocity; NaN in the solid.
    grid : (nx, ny, nz)
    precision : str
    iterations : tuple of 3 int
    residuals, errors : tuple of 3 float
        As in `StiffnessReport`; 0 along axes without a way through.
    converged : bool
    wraps : (3,) bool
        Whether the void percolates along x, y, z.
    error : (3, 3) float64 or None
        Error bar of `k` by refinement of the grid.
    warnings : tuple of str
    """

    reported: ClassVar[tuple[str, ...]] = (
        "k.#3.#3", "k_m2.#3.#3", "darcy.#3.#3", "error.#3.#3", "k_mean", "darcy_mean", "error_relative", "edge_mm",
        "porosity", "pocket_share", "thermal", "viscous_tortuosity.#3", "thermal_tortuosity", "hydraulic_tortuosity.#3",
        "surface", "kozeny", "grid.#3", "iterations.#3", "residuals.#3", "errors.#3", "converged", "wraps.#3",
    )  # fmt: skip

    k: NDArray[np.float64]
    edge_mm: float | None
    porosity: float
    pocket_share: float
    thermal: float
    viscous_tortuosity: tuple[float | None, ...]
    thermal_tortuosity: float | None
    hydraulic_tortuosity: tuple[float | None, ...]
    surface: float | None
    slices: tuple[NDArray[np.float32], ...]
    grid: tuple[int, int, int]
    precision: str
    iterations: tuple[int, ...]
    residuals: tuple[float, ...]
    errors: tuple[float, ...]
    converged: bool
    wraps: tuple[bool, bool, bool]
    error: NDArray[np.float64] | None = None
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "k", frozen(np.asarray(self.k, np.float64)))
        object.__setattr__(self, "slices", tuple(frozen(np.asarray(part, np.float32)) for part in self.slices))
        if self.error is not None:
            object.__setattr__(self, "error", frozen(np.asarray(self.error, np.float64)))

    def check(self) -> None:
        """A finite, symmetric tensor that is not negative, if the solver got so far, and a porosity between 0 and 1."""
        check_transport(self.k, self.porosity, "permeability", 1e-3 if self.converged else math.inf)

    @property
    def m2(self) -> NDArray[np.float64] | None:
        """The tensor in square meters; None if the cell has no physical size."""
        return None if self.edge_mm is None else self.k * (1e-3 * self.edge_mm) ** 2

    @property
    def kozeny(self) -> float | None:
        """The constant c of Kozeny and Carman, ``k = porosity^3 / (c surface^2)`` with the mean k along x, y, z."""
        mean = float(np.trace(self.k)) / 3
        return self.porosity**3 / (mean * self.surface**2) if self.surface and mean > 0 else None

    def summary(self) -> dict[str, Any]:
        """The tensor in all units, what follows from it, and how the solver did."""
        mean, m2 = float(np.trace(self.k)) / 3, self.m2
        largest = float(np.abs(self.k).max())
        return {
            "k": self.k.tolist(),
            **({} if m2 is None else {"k_m2": m2.tolist(), "darcy": (m2 / DARCY).tolist()}),
            "k_mean": mean,
            **({} if m2 is None else {"darcy_mean": float(np.trace(m2)) / 3 / DARCY, "edge_mm": self.edge_mm}),
            **self._error_bar(largest),
            "porosity": self.porosity,
            "pocket_share": self.pocket_share,
            "thermal": self.thermal,
            "viscous_tortuosity": list(self.viscous_tortuosity),
            "thermal_tortuosity": self.thermal_tortuosity,
            "hydraulic_tortuosity": list(self.hydraulic_tortuosity),
            "surface": self.surface,
            "kozeny": self.kozeny,
            "grid": list(self.grid),
            "precision": self.precision,
            "iterations": list(self.iterations),
            "residuals": list(self.residuals),
            "errors": list(self.errors),
            "converged": self.converged,
            "wraps": list(self.wraps),
            "warnings": list(self.warnings),
        }

    def _error_bar(self, largest: float) -> dict[str, Any]:
        if self.error is None:
            return {}
        relative = float(np.abs(self.error).max()) / largest if largest > 0 else 0.0
        return {"error": self.error.tolist(), "error_relative": relative}

    def picture(self, axis: int, size: tuple[int, int]) -> NDArray[np.uint8]:
        """The speed of the flow along an axis in a middle plane, (height, width, 3); the flow goes to the right."""
        from PIL import Image

        from sppm_pipeline.services.pictures.sheets import colors_of, with_scale

        speed = self.slices[axis][::-1]
        solid = np.isnan(speed)
        # a few fast places in throats would leave all others dark
        high = float(np.quantile(speed[~solid], 0.995)) if not solid.all() else 1.0
        high = high if high > 0 else 1.0
        shown = colors_of(np.where(solid, 0, speed).astype(np.float64).ravel(), 0, high).reshape(*speed.shape, 3)
        shown[solid] = 255
        bar = 140
        width, height = size[0] - bar, size[1]
        factor = min(width / speed.shape[1], height / speed.shape[0])
        scaled = (max(1, math.floor(factor * speed.shape[1])), max(1, math.floor(factor * speed.shape[0])))
        picture = np.asarray(Image.fromarray(shown).resize(scaled, Image.Resampling.NEAREST))
        canvas = np.full((height, width, 3), 255, np.uint8)
        top, left = (height - scaled[1]) // 2, (width - scaled[0]) // 2
        canvas[top : top + scaled[1], left : left + scaled[0]] = picture
        return with_scale(canvas, 0, high, "speed / mean", bar)

    def _repr_png_(self) -> bytes:
        return png_of(self.picture(0, (NOTEBOOK_SIZE[0] + 140, NOTEBOOK_SIZE[1])))
