"""Voxel images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.nouns.artifact import Artifact, optional_module


@dataclass(frozen=True, eq=False)
class Voxels(Artifact):
    """An image of a structure: a phase for each voxel, or how much of each voxel is solid.

    Attributes
    ----------
    values : (nx, ny, nz) uint8 or float32
        Indexed x, y, z; x is contiguous in memory. As integers the phase, 0 for void; as floats the fraction of the
        voxel that is solid, from 0 to 1.
    spacing : (sx, sy, sz)
        Edges of a voxel, mm, or cell sizes if `physical` is False.
    physical : bool
    periodic : tuple of 3 bools
        Whether opposite sides are neighbors.
    """

    reported: ClassVar[tuple[str, ...]] = ("shape.#3", "spacing.#3", "porosity", "phases.#6")

    values: NDArray[np.uint8] | NDArray[np.float32]
    spacing: tuple[float, float, float]
    physical: bool
    periodic: tuple[bool, bool, bool]

    def __post_init__(self) -> None:
        values = np.asarray(self.values)
        values = np.asfortranarray(values, np.float32 if values.dtype.kind == "f" else np.uint8)
        if values.flags.writeable:
            values = values.copy(order="F")
            values.setflags(write=False)
        object.__setattr__(self, "values", values)

    @classmethod
    def from_array(
        cls,
        array: ArrayLike,
        *,
        spacing: float | tuple[float, float, float] | None = None,
        periodic: bool | tuple[bool, bool, bool] = True,
        axes: str = "xyz",
    ) -> Voxels:
        """An image from an array.

        Parameters
        ----------
        array : (nx, ny, nz) array_like
            Truth values (True is solid), phases as integers from 0 (void) to 255, or solid fractions as floats.
        spacing : float or (sx, sy, sz), optional
            Edges of a voxel, mm. Without it the image is a cell without a physical size, whose longest side is 1.
        periodic : bool or 3 bools
            Whether opposite sides are neighbors.
        axes : {"xyz", "zyx"}
            Order of the array's axes; "zyx" is that of stacks of pictures, as of TIFF pages.

        Raises
        ------
        ValueError
            If a value is out of range or the array has not three axes.
        """
        values = np.asarray(array)
        if axes not in ("xyz", "zyx"):
            raise ValueError(f"the axes are 'xyz' or 'zyx', got {axes!r}")
        if values.dtype.kind in "iu" and values.size and not 0 <= values.min() <= values.max() <= 255:
            raise ValueError("phases are integers from 0 to 255")
        if values.ndim != 3 or not values.size or values.dtype.kind not in "biuf":
            raise ValueError(f"voxels need three axes of numbers, got shape {values.shape} of {values.dtype}")
        edges = (1.0 / max(values.shape),) * 3 if spacing is None else spacing
        voxels = cls(
            values.T if axes == "zyx" else values,
            edges if isinstance(edges, tuple) else (float(edges),) * 3,
            spacing is not None,
            periodic if isinstance(periodic, tuple) else (periodic,) * 3,
        )
        voxels.check()
        return voxels

    def to_array(self, axes: str = "xyz") -> NDArray[np.uint8] | NDArray[np.float32]:
        """`values`, read-only, or with ``axes="zyx"`` the same indexed z, y, x."""
        return self.values.T if axes == "zyx" else self.values

    def to_pyvista(self) -> Any:
        """A `pyvista.ImageData` whose cells are the voxels.

        Raises
        ------
        ResourceError
            If pyvista is not installed.
        """
        image = optional_module("pyvista").ImageData(
            dimensions=tuple(n + 1 for n in self.shape), spacing=self.spacing, origin=(0.0, 0.0, 0.0)
        )
        image.cell_data["solid" if self.fractions else "phase"] = self.values.reshape(-1, order="F")
        return image

    def check(self) -> None:
        """Three axes, at least one voxel, a positive spacing, fractions between 0 and 1."""
        if self.values.ndim != 3 or not self.values.size:
            raise ValueError(f"voxels need three axes, got shape {self.values.shape}")
        if not min(self.spacing) > 0:
            raise ValueError(f"the voxel edges must be positive, got {self.spacing}")
        if self.fractions and not (self.values.min() >= 0 and self.values.max() <= 1):
            raise ValueError("solid fractions must lie between 0 and 1")

    @property
    def fractions(self) -> bool:
        """Whether the values are solid fractions, not phases."""
        return self.values.dtype.kind == "f"

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along x, y, z."""
        nx, ny, nz = self.values.shape
        return nx, ny, nz

    def solid(self) -> NDArray[np.bool_]:
        """Which voxels are solid: a phase other than void, or at least half full."""
        return self.values >= 0.5 if self.fractions else self.values > 0

    def summary(self) -> dict[str, Any]:
        """Shape, porosity, and the fraction of each phase."""
        size = self.values.size
        summary: dict[str, Any] = {
            "shape": list(self.shape),
            "spacing": list(self.spacing),
            "unit": "mm" if self.physical else "cell size",
        }
        if self.fractions:
            return {**summary, "porosity": 1 - float(self.values.sum(dtype=np.float64)) / size}
        fractions = np.bincount(self.values.reshape(-1, order="F"), minlength=2) / size
        return {**summary, "porosity": float(fractions[0]), "phases": [float(fraction) for fraction in fractions[1:]]}
