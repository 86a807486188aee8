"""Voxel images."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.nouns.artifact import Artifact, optional_module
from sppm_pipeline.nouns.length import parse_length
from sppm_pipeline.services.arrays import F32, U8, Bools

THIN = 3
"""Voxels across a strut or wall below which its stiffness and conductivity are not resolved."""

MAX_THIN_SHARE = 0.1
"""Fraction of the solid that may be thinner before a warning: a heuristic. Random blobs with 30 % of solid, smoothed by
a Gaussian of 5, 3, 2, 1.5 and 1 voxels, have 1, 3, 11, 28 and 69 %, so a factor of two moves the warning by a fifth of
the voxels along an edge."""

MAX_FACE_MISMATCH = 1.5
"""Mismatch of opposite faces over the largest of neighboring layers before a warning. On 50 images of such blobs from
16 to 100 voxels wide, periodic ones had 0.1 to 1.5, and cropped ones 1.5 to 10 along nearly every axis."""


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

    values: U8 | F32
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
        spacing: float | str | tuple[float | str, float | str, float | str] | None = None,
        periodic: bool | tuple[bool, bool, bool] = False,
        axes: str = "xyz",
    ) -> Voxels:
        """An image from an array.

        Parameters
        ----------
        array : (nx, ny, nz) array_like
            Truth values (True is solid), phases as integers from 0 (void) to 255, or solid fractions as floats.
        spacing : float or str or (sx, sy, sz), optional
            Edges of a voxel, mm, or with their unit: "50 um". Without it the image is a cell without a physical size,
            whose longest side is 1.
        periodic : bool or 3 bools
            Whether opposite sides are neighbors: True for a periodic cell, False for a scan.
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
        # before the conversion to 8 bits, in which 256 would be 0
        if values.dtype.kind in "iu" and values.size and not 0 <= values.min() <= values.max() <= 255:
            raise ValueError("phases are integers from 0 to 255")
        if values.ndim != 3 or not values.size or values.dtype.kind not in "biuf":
            raise ValueError(f"voxels need three axes of numbers, got shape {values.shape} of {values.dtype}")
        # without a size the longest side is one cell
        edges = 1.0 / max(values.shape) if spacing is None else spacing
        x, y, z = (
            parse_length(edge).mm() if isinstance(edge, str) else float(edge)
            for edge in (edges if isinstance(edges, tuple) else (edges,) * 3)
        )
        voxels = cls(
            values.T if axes == "zyx" else values,
            (x, y, z),
            spacing is not None,
            periodic if isinstance(periodic, tuple) else (periodic,) * 3,
        )
        voxels.check()
        return voxels

    def to_numpy(self, axes: str = "xyz") -> U8 | F32:
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
        """True if the values are solid fractions, not phases."""
        return self.values.dtype.kind == "f"

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along x, y, z."""
        nx, ny, nz = self.values.shape
        return nx, ny, nz

    def solid(self) -> Bools:
        """Which voxels are solid: a phase other than void, or at least half full."""
        return self.values >= 0.5 if self.fractions else self.values > 0

    def mirrored(self) -> Voxels:
        """A periodic image, twice as long along each axis, that any image makes with its mirror images."""
        values: NDArray[Any] = self.values
        for axis in range(3):
            values = np.concatenate((values, np.flip(values, axis)), axis)
        return Voxels(values, self.spacing, self.physical, (True,) * 3)

    def coarsened(self) -> Voxels:
        """Blocks of 2 x 2 x 2 voxels as one: their mean, or their most frequent phase, the lowest of equals.

        Raises
        ------
        ValueError
            If an axis has an odd number of voxels.
        """
        if any(n % 2 for n in self.shape):
            counts = " x ".join(map(str, self.shape))
            raise ValueError(f"an image of {counts} voxels has no coarser one of half as many")
        nx, ny, nz = (n // 2 for n in self.shape)
        blocks = self.values.reshape(nx, 2, ny, 2, nz, 2)
        values: NDArray[Any]
        if self.fractions:
            values = blocks.mean((1, 3, 5), dtype=np.float64).astype(np.float32)
        else:
            votes = [np.count_nonzero(blocks == phase, axis=(1, 3, 5)) for phase in range(int(self.values.max()) + 1)]
            values = np.argmax(votes, axis=0).astype(np.uint8)
        x, y, z = self.spacing
        return Voxels(values, (2 * x, 2 * y, 2 * z), self.physical, self.periodic)

    def face_mismatch(self) -> tuple[float, float, float]:
        """Mean difference of opposite faces over the largest of neighboring layers, along x, y, z.

        At most about 1 where the image repeats.
        """

        def difference(a: NDArray[Any], b: NDArray[Any]) -> float:
            return float(np.abs(a - b).mean(dtype=np.float64) if self.fractions else np.mean(a != b))

        ratios = []
        for axis in range(3):
            layers = np.moveaxis(self.values, axis, 0)
            inside = max((difference(a, b) for a, b in pairwise(layers)), default=0.0)
            across = difference(layers[0], layers[-1])
            ratios.append(across / inside if inside else 0.0)
        return ratios[0], ratios[1], ratios[2]

    def thin_share(self, *, void: bool = False) -> float:
        """Fraction of the solid, or of the void, in struts, walls or channels thinner than three voxels.

        That is what opening by a voxel and its 18 neighbors across faces and edges removes, a ball of three voxels.
        """
        solid = ~self.solid() if void else self.solid()
        if not solid.any():
            return 0.0
        mode = {"mode": "wrap"} if all(self.periodic) else {"mode": "edge"}
        inside = np.pad(solid, 2, **mode)  # type: ignore[call-overload]
        steps = [step for step in np.ndindex(3, 3, 3) if step != (1, 1, 1) and 1 in step]

        def shifted(image: Bools, step: tuple[int, ...]) -> Bools:
            return image[tuple(slice(s, n - 2 + s) for s, n in zip(step, image.shape, strict=True))]

        core = shifted(inside, (1, 1, 1)).copy()
        for step in steps:
            core &= shifted(inside, step)
        opened = shifted(core, (1, 1, 1)).copy()
        for step in steps:
            opened |= shifted(core, step)
        return 1 - float(np.count_nonzero(opened)) / np.count_nonzero(solid)

    def doubts(self, *, void: bool = False, repeats: bool = True) -> list[str]:
        """Warnings for homogenizing the solid, or the void, as a cell: faces that do not fit, too few voxels across."""
        warnings = []
        if repeats and (bad := [f"{axis} ({ratio:.2g})" for axis, ratio in zip("xyz", self.face_mismatch(), strict=True)
                   if ratio > MAX_FACE_MISMATCH]):  # fmt: skip
            warnings.append(
                f"opposite faces of the image do not fit along {', '.join(bad)} times the mismatch of neighboring "
                "layers: it is not a periodic cell, and the result is wrong near its faces; take `sides: mirror`"
            )
        if (thin := self.thin_share(void=void)) > MAX_THIN_SHARE:
            warnings.append(
                f"{100 * thin:.0f} % of the {'void' if void else 'solid'} is thinner than {THIN} voxels, so the result "
                "depends on the voxels; use an image of finer voxels, and `grids: 2` for an error bar"
            )
        return warnings

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
