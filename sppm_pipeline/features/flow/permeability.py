"""The permeability of a cell and further results of its slow flow."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Report, frozen, number, reports
from sppm_pipeline.nouns import TEXT, Box, is_number
from sppm_pipeline.pictures import NOTEBOOK_SIZE

if TYPE_CHECKING:
    from sppm_pipeline.numerics import Solved


MAX_CORRECTION = 0.5
"""Correction over a tensor above which nothing is extrapolated, as walls or throats are lost on the coarser grid. At 32
voxels, cells of the paper have up to 0.15."""


def worst_direction(correction: NDArray[np.float64], k: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The direction in which a correction of a tensor is largest, if it is too large to be trusted; else None."""
    worst = min((np.linalg.eigh(MAX_CORRECTION * k + sign * correction) for sign in (1, -1)), key=lambda one: one[0][0])
    return None if worst[0][0] >= -1e-6 * np.abs(k).max() else worst[1][:, 0]


@dataclass(frozen=True, eq=False)
class TransportReport(Report):
    """A tensor of transport through a periodic cell, and how it was computed.

    Attributes
    ----------
    k : (3, 3) float64
    error : (3, 3) float64 or None
        Error bar of `k` by refinement of the grid.
    porosity : float
        Fraction of void.
    grid : (nx, ny, nz)
    precision : str
    iterations : tuple of 3 int
    residuals, errors : tuple of 3 float
        As in `StiffnessReport`; 0 along axes without a way through.
    converged : bool
    wraps : (3,) bool
        Whether what is passed percolates along x, y, z, across faces of voxels.
    warnings : tuple of str
    """

    tensor: ClassVar[str]
    """Its name in messages."""

    k: NDArray[np.float64] = field(metadata=number("#3.#3", error="error"), kw_only=True)
    error: NDArray[np.float64] | None = field(default=None, metadata=number("#3.#3", optional=True), kw_only=True)
    porosity: float = field(metadata=number(), kw_only=True)
    grid: tuple[int, int, int] = field(metadata=number("#3"), kw_only=True)
    precision: str = field(metadata=TEXT, kw_only=True)
    iterations: tuple[int, ...] = field(metadata=number("#3"), kw_only=True)
    residuals: tuple[float, ...] = field(metadata=number("#3"), kw_only=True)
    errors: tuple[float, ...] = field(metadata=number("#3"), kw_only=True)
    converged: bool = field(metadata=number(), kw_only=True)
    wraps: tuple[bool, bool, bool] = field(metadata=number("#3"), kw_only=True)
    warnings: tuple[str, ...] = field(default=(), metadata=TEXT, kw_only=True)

    def __post_init__(self) -> None:
        for name in ("k", "error") if self.error is not None else ("k",):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), np.float64)))

    @staticmethod
    def solver(solved: Sequence[Solved], precision: str) -> dict[str, Any]:
        """The entries that say how the load cases were solved."""
        return {
            "precision": precision, "iterations": tuple(case.iterations for case in solved),
            "residuals": tuple(float(case.residual) for case in solved),
            "errors": tuple(min(float(case.error), 1.0) for case in solved),
            "converged": all(case.converged for case in solved),
        }  # fmt: skip

    def slack(self) -> float:
        """Part of the largest entry by which eigenvalues may lie below zero."""
        return 1e-4

    def check(self) -> None:
        """A finite, symmetric matrix that is not negative, and a porosity between 0 and 1."""
        if self.k.shape != (3, 3) or not np.isfinite(self.k).all():
            raise ValueError(f"the {self.tensor} must be a finite 3 x 3 matrix, got shape {self.k.shape}")
        largest = float(np.abs(self.k).max())
        # effective tensors are symmetric by reciprocity; what is left of that is rounding
        if np.abs(self.k - self.k.T).max() > 1e-6 * largest:
            raise ValueError(f"the {self.tensor} is not symmetric")
        if np.linalg.eigvalsh(self.k)[0] < -self.slack() * largest:
            raise ValueError(f"the {self.tensor} has a negative eigenvalue")
        if not 0 <= self.porosity <= 1:
            raise ValueError(f"the porosity must lie between 0 and 1, got {self.porosity}")


@dataclass(frozen=True, eq=False)
class ConductivityReport(TransportReport):
    """Effective conductivity, or diffusivity, of a periodic cell.

    Attributes
    ----------
    k : (3, 3) float64
        Mean flow over mean gradient, the unit of `bulk`; of two grids of a field, their limit.
    of : str
        The conducting phase, "solid" or "void", the other one insulating; or "both".
    bulk : tuple of float
        Conductivity of the phase, or of each phase of the solid.
    fluid : float or None
        Conductivity of what fills the void, if both conduct.
    tortuosity : tuple of 3 floats or None
        Fraction times bulk over effective conductivity along x, y, z; None where nothing flows. With several conductors
        the sum of fractions times bulk.
    fractions : bool
        Whether voxels at the surface count by the fraction of them that conducts.
    """

    tensor: ClassVar[str] = "conductivity"
    headline: ClassVar[tuple[str, ...]] = ("k.1.1", "k.2.2", "k.3.3", "tortuosity", "porosity")

    tortuosity: tuple[float | None, ...] = field(metadata=number("#3"))
    of: str = field(metadata=TEXT)
    bulk: tuple[float, ...] = field(metadata=number("#6"))
    fluid: float | None = field(default=None, metadata=number(optional=True), kw_only=True)
    fractions: bool = field(metadata=number())


DARCY = 9.869233e-13
"""Square meters."""


@dataclass(frozen=True, eq=False)
class PermeabilityReport(TransportReport):
    """Permeability of the pores of a periodic cell.

    Attributes
    ----------
    k : (3, 3) float64
        Flux times viscosity over the pressure gradient (Darcy's law), cell edges squared; of grids of a field, their
        limit.
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
    """

    tensor: ClassVar[str] = "permeability"
    headline: ClassVar[tuple[str, ...]] = ("k.1.1", "k.2.2", "k.3.3", "darcy_mean", "porosity")

    k: NDArray[np.float64] = field(metadata=number("#3.#3", unit="cell^2", error="error"), kw_only=True)

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

    @property
    @reports(optional=True)
    def error_relative(self) -> float | None:
        """Largest error bar over the largest entry of `k`; None without error bars."""
        largest = float(np.abs(self.k).max())
        if self.error is None:
            return None
        return float(np.abs(self.error).max()) / largest if largest > 0 else 0.0

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

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "slices", tuple(frozen(np.asarray(part, np.float32)) for part in self.slices))

    def slack(self) -> float:
        """Any, if the solver did not get far enough."""
        return 1e-3 if self.converged else math.inf

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
