"""Base of stages that make a field of an image: what is done before a surface is laid between the voxels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, DesignError, Stage, Voxels, option
from sppm_pipeline.engine.process.budget import require_memory
from sppm_pipeline.features.scans.image_field import BYTES_OF_A_VOXEL, ImageField, check_layers
from sppm_pipeline.method.nouns.voxels import MAX_FACE_MISMATCH, MAX_THIN_SHARE, THIN
from sppm_pipeline.numerics import find_components, paint_runs

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
        """The part of an image that is kept.

        Raises
        ------
        DesignError
            If the image does not reach so far.
        """
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
            raise DesignError(
                f"{name} is all {'solid' if share else 'void'}"
                + ("" if level is None else f": its values are {_ends(values)}, and the level is {level:g}"),
                hint="check the level and `invert`; a field needs a surface",
            )
        if sigma > 0:
            gaussian_filter(field, sigma, output=field, mode=mode)
            # convex surfaces shrink when they are smoothed; as much solid as before is kept
            field -= _quantile(field, share)
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
    def _keep_largest(context: Context, field: NDArray[np.float32], periodic: bool) -> None:
        found = find_components((field < 0).T, (periodic,) * 3)
        if len(found.sizes) > 1:
            painted = np.zeros(field.T.shape, np.int32)
            paint_runs(found.runs.rows, found.runs.bounds, (found.of_run > 0).astype(np.int32), painted)
            # the sign is inverted, which keeps the surface of what stays
            np.negative(field, out=field, where=painted.T != 0)
            context.report(removed_share=1 - float(found.sizes[0]) / float(found.sizes.sum()))

    @staticmethod
    def _describe(
        context: Context, solid: NDArray[np.bool_], spacing: tuple[float, float, float], periodic: bool
    ) -> None:
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


def _means(values: NDArray[np.float32], k: int) -> NDArray[np.float32]:
    """Means of blocks of k voxels along each axis; what fills no block at the far sides is left out."""
    nx, ny, nz = (n // k for n in values.shape)
    check_layers((nx, ny, nz))
    blocks = values[: nx * k, : ny * k, : nz * k].T.reshape(nz, k, ny, k, nx, k)
    return np.asarray(blocks.mean((1, 3, 5), dtype=np.float64), np.float32).T


def _quantile(values: NDArray[np.float32], share: float) -> np.float32:
    """The middle between the two values that a share of all lies below."""
    rank = min(max(round(share * values.size), 1), values.size - 1)
    sorted_to = np.partition(values.ravel(order="K"), (rank - 1, rank))
    return np.float32((sorted_to[rank - 1] + sorted_to[rank]) / 2)


def _ends(values: NDArray[Any]) -> str:
    return f"{values.min():g} to {values.max():g}"
