"""Fields of images: a smooth function through the values of all voxels, which is zero on a surface between them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import DesignError, frozen
from sppm_pipeline.nouns import PlacedField
from sppm_pipeline.numerics import Grid, ordered_map

MIN_LAYERS = 4
"""Voxels along each axis that a cubic spline needs."""

MAX_DIVISION = 8
"""The shortest side of an image is at most so many cells long."""

MAX_LOST = 0.01
"""Share of the image that may lie beyond the last whole cell without a finer division."""

_GRAIN = 2.0**-20
"""Positions are rounded to this part of a voxel, so that those of the next period are the same."""

BYTES_OF_A_VOXEL = 15
"""Measured at 256^3: 10.1 of a gray image of 8 bits, 14.1 of a binary one, whose level is found in a sorted copy."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ImageField(PlacedField):
    """The cubic spline through the values of the voxels of an image, twice continuously differentiable.

    Along each axis the spline passes through the values at the middles of the voxels (Unser 1999, "Splines: a perfect
    fit for signal and image processing"). Beyond the sides the image goes on mirrored, or repeats.

    Attributes
    ----------
    coefficients : (nx, ny, nz) float32
        Of the B-splines, x contiguous.
    per_cell : (x, y, z)
        Voxels along the edge of a cell, on each axis.
    repeats : bool
    shift : float
        What is taken off the spline.
    """

    reported: ClassVar[tuple[str, ...]] = ("per_cell.#3", "lattice.#3")

    coefficients: NDArray[np.float32]
    per_cell: tuple[float, float, float]
    repeats: bool = False
    shift: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", frozen(np.asfortranarray(self.coefficients, np.float32)))

    @classmethod
    def through(
        cls, values: NDArray[np.float32], spacing: tuple[float, float, float], *, physical: bool, periodic: bool,
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> ImageField:  # fmt: skip
        """The field through values (nx, ny, nz), negative in the solid, which are overwritten.

        A cell is the shortest side of the image, or a whole part of it, so that the cells leave little of the image
        out, beyond the last ones; of an image that repeats, nothing.

        Raises
        ------
        DesignError
            If an axis has too few voxels, or no cells cover an image that repeats.
        """
        from scipy.ndimage import spline_filter1d

        check_layers(values.shape)
        lengths = np.array(values.shape) * np.array(spacing)
        edge, cells = _cells(lengths)
        lost = 1 - math.prod(cells) * edge**3 / float(lengths.prod())
        if periodic and lost > 1e-9:
            raise DesignError(
                f"no cube fits {' x '.join(f'{length:g}' for length in lengths)} a whole number of times along each "
                "axis, so that the image can't repeat as a lattice of cells",
                hint="crop it, or read it without `periodic`",
            )
        for axis in range(3):
            spline_filter1d(values, 3, axis, output=values, mode="grid-wrap" if periodic else "reflect")
        x, y, z = (edge / h for h in spacing)
        return cls(
            edge=edge if physical else None, region=cells, origin=origin, coefficients=values, repeats=periodic,
            per_cell=(x, y, z),
        )  # fmt: skip

    @property
    def periodic(self) -> bool:
        return self.repeats

    @property
    def lost(self) -> float:
        """Share of the image beyond the last cells."""
        return 1 - math.prod(self.cells) * math.prod(self.per_cell) / self.coefficients.size

    def check(self) -> None:
        """Finite coefficients."""
        super().check()
        if not np.isfinite(self.coefficients[:, :, :: max(1, self.coefficients.shape[2] // 8)]).all():
            raise ValueError("an image with values that are not finite is no field")

    def cut_at(self, value: float) -> ImageField:
        return replace(self, shift=self.shift + value)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        out = np.empty((stop - start, grid.shape[1], grid.shape[0]), np.float32)
        (ix, wx), (iy, wy), (iz, wz) = (self._taps(grid.axis(axis), axis) for axis in range(3))
        along_x, along_y = _matrix(ix, wx, self.coefficients.shape[0]), _matrix(iy, wy, self.coefficients.shape[1])

        def fill(k: int) -> None:
            plane = sum(w * self.coefficients[:, :, i] for w, i in zip(wz[k], iz[k], strict=True))
            layer = along_y @ (along_x @ plane).T
            np.subtract(layer, np.float32(self.shift), out=out[k - start])

        for _ in ordered_map(fill, range(start, stop), threads):
            pass
        return out.T

    def _taps(self, positions: NDArray[np.float64], axis: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Coefficients (m, 4) that samples along an axis are made of, and their weights."""
        n = self.coefficients.shape[axis]
        at = np.rint((positions * self.per_cell[axis] - 0.5) / _GRAIN) * _GRAIN
        first = np.floor(at)
        f = (at - first)[:, None]
        weights = np.hstack([(1 - f) ** 3, (3 * f - 6) * f**2 + 4, ((3 - 3 * f) * f + 3) * f + 1, f**3]) / 6
        taps = first.astype(np.int64)[:, None] + np.arange(-1, 3)
        if self.repeats:
            return taps % n, weights.astype(np.float32)
        taps %= 2 * n
        return np.where(taps < n, taps, 2 * n - 1 - taps), weights.astype(np.float32)

    def summary(self) -> dict[str, Any]:
        """Voxels along the edge of a cell, and the cells."""
        return {"per_cell": list(self.per_cell), "lattice": list(self.cells), "cell_mm": self.edge}


def check_layers(shape: tuple[int, ...]) -> None:
    """Raise `DesignError` if an image has too few voxels along an axis for a field."""
    if min(shape) < MIN_LAYERS:
        raise DesignError(
            f"an image of {' x '.join(map(str, shape))} voxels is too thin for a field, which needs {MIN_LAYERS} or "
            "more along each axis"
        )


def _matrix(taps: NDArray[np.int64], weights: NDArray[np.float32], n: int) -> Any:
    """The sparse matrix (m, n) that makes samples of a row of coefficients."""
    from scipy.sparse import csr_array

    m = len(taps)
    return csr_array((weights.ravel(), taps.ravel(), np.arange(0, 4 * m + 1, 4)), (m, n))


def _cells(lengths: NDArray[np.float64]) -> tuple[float, tuple[int, int, int]]:
    """Edge of a cell and whole cells along each axis: the largest cells that leave out little, else the least."""
    found = []
    for parts in range(1, MAX_DIVISION + 1):
        edge = float(lengths.min()) / parts
        x, y, z = np.floor(lengths / edge + 1e-9).astype(int).tolist()
        found.append((1 - x * y * z * edge**3 / float(lengths.prod()), edge, (x, y, z)))
        if found[-1][0] <= MAX_LOST:
            break
    # of equal ones that of the largest cells
    _, edge, cells = min(found, key=lambda one: round(one[0], 9))
    return edge, cells
