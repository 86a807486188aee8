"""A structure designed for a stiffness tensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.nouns.report import TEXT, Number, Report, number, reports
from sppm_pipeline.services.arrays import F64


@dataclass(frozen=True, eq=False)
class StiffnessDesign(Report):
    """The options of a recipe, a stretch and a rotation that give a stiffness tensor, and what they give.

    Tensors are in Voigt order xx, yy, zz, yz, xz, xy, engineering shear, along the axes of the part.

    Attributes
    ----------
    recipe : str
        Its name.
    options : tuple of (stage.option, value)
        Options of the recipe that were found.
    porosity : float
    stretch : (3,) float64
        How many times longer the cell is made along x, y and z of the recipe; their product is 1.
    rotation : (3, 3) float64
        Takes vectors of the stretched cell to where they point in the part.
    stiffness, target : (6, 6) float64
        Obtained, as the mean over draws, and asked for.
    mean_error : (6, 6) float64
        Half width of the 95 % interval of the mean, by Student's t.
    draw_error : (6, 6) float64
        Half width of the interval in which one more cell lies in 95 % of all cases, by Student's t.
    distance : float
        Norm of the difference to the target over that of the target (Frobenius, in Mandel's basis).
    floor : float
        What of it no structure with three planes of symmetry could reach.
    grid_error : float
        Relative error bar of the grid.
    draws : int
    edge_mm : float or None
        Size of the cell at which struts have at least the mean thickness asked for; None if none was.
    young, poisson : float
        Young's modulus of the solid, in the unit of the stiffness, and its Poisson's ratio.
    """

    headline: ClassVar[tuple[str, ...]] = ("distance", "stretch", "porosity", "draws")

    recipe: str = field(metadata=TEXT)
    options: tuple[tuple[str, float], ...]
    porosity: float = field(metadata=number(box="porosity"))
    stretch: F64 = field(metadata=number("#3", box="stretch x, y, z"))
    rotation: F64 = field(metadata=number("#3.#3"))
    stiffness: F64 = field(metadata=number("#6.#6"))
    target: F64 = field(metadata=number("#6.#6"))
    mean_error: F64 = field(metadata=number("#6.#6"))
    draw_error: F64 = field(metadata=number("#6.#6"))
    distance: float = field(metadata=number(box="distance to the target"))
    floor: float = field(metadata=number())
    grid_error: float = field(metadata=number())
    draws: int = field(metadata=number())
    edge_mm: float | None = field(default=None, metadata=number(label="cell", unit="mm"))
    young: float = field(default=1.0, metadata=number())
    poisson: float = field(default=0.3, metadata=number())

    def __post_init__(self) -> None:
        for name in ("stretch", "rotation", "stiffness", "target", "mean_error", "draw_error"):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), np.float64)))

    @reports(Number("dials.*"))
    def _dials(self) -> dict[str, Any]:
        return {name.replace(".", "_"): value for name, value in self.options}

    def check(self) -> None:
        """Matrices of their shapes, a rotation, stretches of the product 1, and a solid that is stiff."""
        shapes = {"stretch": (3,), "rotation": (3, 3), **dict.fromkeys(("stiffness", "target", "draw_error"), (6, 6))}
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values.shape != shape or not np.isfinite(values).all():
                raise ValueError(f"{name} is finite and of the shape {shape}, got {values.shape}")
        if np.abs(self.rotation @ self.rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(self.rotation) < 0:
            raise ValueError("the rotation is not orthogonal, or mirrors")
        if not self.young > 0:
            raise ValueError(f"Young's modulus of the solid is above 0, got {self.young}")
        if not (self.stretch > 0).all() or abs(float(np.prod(self.stretch)) - 1) > 1e-9:
            raise ValueError(f"stretches are positive and of the product 1, got {self.stretch}")
