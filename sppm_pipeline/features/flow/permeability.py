"""The permeability of a cell and further results of its slow flow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Report, frozen, number, reports
from sppm_pipeline.nouns import TEXT, Box, is_number
from sppm_pipeline.pictures import NOTEBOOK_SIZE


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


DARCY = 9.869233e-13
"""Square meters."""


@dataclass(frozen=True, eq=False)
class PermeabilityReport(Report):
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

    headline: ClassVar[tuple[str, ...]] = ("k.1.1", "k.2.2", "k.3.3", "darcy_mean", "porosity")

    k: NDArray[np.float64] = field(metadata=number("#3.#3", unit="cell^2", error="error"))

    @property
    @reports("k_m2.#3.#3", optional=True)
    def m2(self) -> NDArray[np.float64] | None:
        """The tensor in square meters; None if the cell has no physical size."""
        return None if self.edge_mm is None else np.asarray(self.k * (1e-3 * self.edge_mm) ** 2)

    @property
    @reports("#3.#3", optional=True)
    def darcy(self) -> NDArray[np.float64] | None:
        """The tensor in darcy; None if the cell has no physical size."""
        return None if self.m2 is None else self.m2 / DARCY

    @property
    @reports()
    def k_mean(self) -> float:
        """Mean along x, y, z, cell edges squared."""
        return float(np.trace(self.k)) / 3

    @property
    @reports(label="k", unit="darcy", optional=True)
    def darcy_mean(self) -> float | None:
        """Mean along x, y, z in darcy; None if the cell has no physical size."""
        return None if self.m2 is None else float(np.trace(self.m2)) / 3 / DARCY

    edge_mm: float | None = field(metadata=number(optional=True))
    error: NDArray[np.float64] | None = field(default=None, metadata=number("#3.#3", optional=True), kw_only=True)

    @property
    @reports(optional=True)
    def error_relative(self) -> float | None:
        """Largest error bar over the largest entry of `k`; None without error bars."""
        largest = float(np.abs(self.k).max())
        if self.error is None:
            return None
        return float(np.abs(self.error).max()) / largest if largest > 0 else 0.0

    porosity: float = field(metadata=number())
    pocket_share: float = field(metadata=number())
    thermal: float = field(metadata=number())
    viscous_tortuosity: tuple[float | None, ...] = field(metadata=number("#3"))
    thermal_tortuosity: float | None = field(metadata=number())
    hydraulic_tortuosity: tuple[float | None, ...] = field(metadata=number("#3"))
    surface: float | None = field(metadata=number())

    @property
    @reports()
    def kozeny(self) -> float | None:
        """The constant c of Kozeny and Carman, ``k = porosity^3 / (c surface^2)`` with the mean k along x, y, z."""
        mean, surface = self.k_mean, self.surface
        # with the area over the volume of the solid, (1 - porosity)^2 would stand in the denominator
        return self.porosity**3 / (mean * surface**2) if surface and mean > 0 else None

    slices: tuple[NDArray[np.float32], ...]
    grid: tuple[int, int, int] = field(metadata=number("#3"))
    precision: str = field(metadata=TEXT)
    iterations: tuple[int, ...] = field(metadata=number("#3"))
    residuals: tuple[float, ...] = field(metadata=number("#3"))
    errors: tuple[float, ...] = field(metadata=number("#3"))
    converged: bool = field(metadata=number())
    wraps: tuple[bool, bool, bool] = field(metadata=number("#3"))
    warnings: tuple[str, ...] = field(default=(), metadata=TEXT)

    def __post_init__(self) -> None:
        object.__setattr__(self, "k", frozen(np.asarray(self.k, np.float64)))
        object.__setattr__(self, "slices", tuple(frozen(np.asarray(part, np.float32)) for part in self.slices))
        if self.error is not None:
            object.__setattr__(self, "error", frozen(np.asarray(self.error, np.float64)))

    def check(self) -> None:
        """A finite, symmetric tensor that is not negative, if the solver got so far, and a porosity between 0 and 1."""
        check_transport(self.k, self.porosity, "permeability", 1e-3 if self.converged else math.inf)

    @classmethod
    def report_boxes(cls, summary: Mapping[str, Any], stage: str) -> list[Box]:
        """The mean, in darcy where the cell has a size, with its relative error."""
        share = summary.get("error_relative")
        note = f"± {100 * share:.2g} %, {stage}" if is_number(share) else stage
        for name, unit in (("darcy_mean", "darcy"), ("k_mean", "cell²")):
            if is_number(summary.get(name)):
                return [Box("permeability", f"{summary[name]:.3g} {unit}", note)]
        return []

    def picture(
        self, axis: int = 0, size: tuple[int, int] = (NOTEBOOK_SIZE[0] + 140, NOTEBOOK_SIZE[1])
    ) -> NDArray[np.uint8]:
        """The speed of the flow along an axis in a middle plane, (height, width, 3); the flow goes to the right."""
        from PIL import Image

        from sppm_pipeline.pictures import colors_of, with_scale

        # rows of pictures count downwards, the next axis points up
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
