"""Fields of images: a smooth function through the values of all voxels, which is zero on a surface between them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, DesignError, Stage, Voxels, frozen, option
from sppm_pipeline.engine.process.budget import require_memory
from sppm_pipeline.method.nouns.voxels import MAX_FACE_MISMATCH, MAX_THIN_SHARE, THIN
from sppm_pipeline.method.porosity.level import cut_for_porosity
from sppm_pipeline.nouns import PlacedField
from sppm_pipeline.numerics import Grid, find_components, ordered_map, paint_runs
from sppm_pipeline.services.arrays import F32, F64, I64, Bools

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

    coefficients: F32
    per_cell: tuple[float, float, float]
    repeats: bool = False
    shift: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", frozen(np.asfortranarray(self.coefficients, np.float32)))

    @classmethod
    def through(
        cls, values: F32, spacing: tuple[float, float, float], *, physical: bool, periodic: bool,
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

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
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

    def _taps(self, positions: F64, axis: int) -> tuple[I64, F32]:
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


def _matrix(taps: I64, weights: F32, n: int) -> Any:
    """The sparse matrix (m, n) that makes samples of a row of coefficients."""
    from scipy.sparse import csr_array

    m = len(taps)
    return csr_array((weights.ravel(), taps.ravel(), np.arange(0, 4 * m + 1, 4)), (m, n))


def _cells(lengths: F64) -> tuple[float, tuple[int, int, int]]:
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


SMOOTHING = 1.0
"""Standard deviation, in voxels, by which the steps of a binary image are smoothed: the surface of a ball of 10 voxels
is then 0.06 voxels off (root mean square), against 0.09 with 0.7, and that of a gyroid of 32 voxels 0.05 and 0.08."""

MAX_ASPECT = 1.5
"""Longest over shortest edge of a voxel before a warning, a heuristic."""


@dataclass(frozen=True, kw_only=True)
class ImageStage(Stage):
    """Base of stages that make a field of an image: implement `run` by `made`."""

    crop: tuple[int, int, int, int, int, int] | None = option(
        None, help="voxels that are kept: from and to along x, then y, then z; the last of each is left out",
        minimum=0, maximum=2**20,
    )  # fmt: skip
    downsample: int = option(1, help="blocks of so many voxels along each axis become one, their mean",
                             minimum=1, maximum=64)  # fmt: skip
    blur: float | None = option(
        None, help="standard deviation of a Gaussian by which the image is smoothed; if omitted 1 of binary images and "
        "0 of others", unit="voxels", minimum=0, maximum=20,
    )  # fmt: skip
    keep_largest: bool = option(False, help="keep only the largest connected part of the solid")

    def cropped(self, values: NDArray[Any], name: str) -> NDArray[Any]:
        """The part of an image that is kept; `DesignError` if it does not reach so far."""
        if self.crop is None:
            return values
        ends = [(self.crop[2 * axis], self.crop[2 * axis + 1]) for axis in range(3)]
        if any(not a < b <= n for (a, b), n in zip(ends, values.shape, strict=True)):
            raise DesignError(
                f"`crop: {list(self.crop)}` does not lie in the {' x '.join(map(str, values.shape))} voxels of {name}",
                hint="give from and to of each axis, counted from 0",
            )
        return values[tuple(slice(a, b) for a, b in ends)]

    def made(
        self, context: Context, values: NDArray[Any], level: float | None, name: str, *,
        spacing: tuple[float, float, float], physical: bool, periodic: bool, invert: bool = False,
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> ImageField:  # fmt: skip
        """The field whose solid is where `values`, cropped already, reach the level; None if they are truth values."""
        from scipy.ndimage import gaussian_filter

        check_layers(values.shape)
        require_memory(
            float(values.size) / self.downsample**3 * BYTES_OF_A_VOXEL + 5.0 * values.size * (self.downsample > 1),
            f"a field of {' x '.join(map(str, values.shape))} voxels", "`crop` the image, or `downsample: 2`",
            limit=context.memory_limit,
        )  # fmt: skip
        if level is None:
            field = np.where(values, np.float32(-1), np.float32(1))
        else:
            field = np.asfortranarray(values, np.float32)
            field = np.subtract(np.float32(level), field, out=field if field is not values else None)
        if invert:
            np.negative(field, out=field)
        if self.downsample > 1:
            x, y, z = spacing
            field, spacing = _means(field, k := self.downsample), (k * x, k * y, k * z)
        mode = "wrap" if periodic else "nearest"
        sigma = (SMOOTHING if level is None else 0.0) if self.blur is None else self.blur
        share = float(np.count_nonzero(field < 0)) / field.size
        if not 0 < share < 1:
            ends = f": its values are {values.min():g} to {values.max():g}, and the level is "
            raise DesignError(
                f"{name} is all {'solid' if share else 'void'}" + ("" if level is None else f"{ends}{level:g}"),
                hint="check the level and `invert`; a field needs a surface",
            )
        if sigma > 0:
            gaussian_filter(field, sigma, output=field, mode=mode)
            # convex surfaces shrink when they are smoothed; as much solid as before is kept
            field -= np.float32(cut_for_porosity(field, 1 - share).level)
        if self.keep_largest:
            self._keep_largest(context, field, periodic)
        self._describe(context, field < 0, spacing, periodic)
        made = ImageField.through(field, spacing, physical=physical, periodic=periodic, origin=origin)
        if made.lost > 0.001:
            context.warn(
                f"{made.lost:.1%} of {name} lies beyond the last whole cell and is left out; crop it to "
                f"{' x '.join(f'{n * v:g}' for n, v in zip(made.cells, made.per_cell, strict=True))} voxels"
            )
        return made

    @staticmethod
    def _keep_largest(context: Context, field: F32, periodic: bool) -> None:
        found = find_components((field < 0).T, (periodic,) * 3)
        if len(found.sizes) > 1:
            painted = np.zeros(field.T.shape, np.int32)
            paint_runs(found.runs.rows, found.runs.bounds, (found.of_run > 0).astype(np.int32), painted)
            # the sign is inverted, which keeps the surface of what stays
            np.negative(field, out=field, where=painted.T != 0)
            context.report(removed_share=1 - float(found.sizes[0]) / float(found.sizes.sum()))

    @staticmethod
    def _describe(context: Context, solid: Bools, spacing: tuple[float, float, float], periodic: bool) -> None:
        image = Voxels(solid.view(np.uint8), spacing, False, (periodic,) * 3)
        thin = image.thin_share()
        mismatch = image.face_mismatch()
        context.report(porosity=1 - float(solid.mean()), thin_share=thin, face_mismatch=list(mismatch))
        if periodic and max(mismatch) > MAX_FACE_MISMATCH:
            context.warn(
                f"opposite faces of the image differ {max(mismatch):.2g} times as much as neighboring layers: it is no "
                "periodic cell; read it without `periodic`, and homogenize it with `sides: mirror`"
            )
        if thin > MAX_THIN_SHARE:
            context.warn(
                f"{thin:.0%} of the solid is thinner than {THIN} voxels, so that sizes and stiffness depend on the "
                "voxels; compare `grids: 3` with one grid, or scan it finer"
            )
        if max(spacing) > MAX_ASPECT * min(spacing):
            context.warn(
                f"voxels are {max(spacing) / min(spacing):.3g} times as long along one axis as along another; the "
                "surface is known no better than along that axis"
            )


def _means(values: F32, k: int) -> F32:
    """Means of blocks of k voxels along each axis; what fills no block at the far sides is left out."""
    nx, ny, nz = (n // k for n in values.shape)
    check_layers((nx, ny, nz))
    blocks = values[: nx * k, : ny * k, : nz * k].T.reshape(nz, k, ny, k, nx, k)
    return np.asarray(blocks.mean((1, 3, 5), dtype=np.float64), np.float32).T
