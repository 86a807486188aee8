"""``read.scan``: a gray or binary image of a file as a field."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, Headline, Length, Palette, ScalarField, Size, option, options
from sppm_pipeline.engine.process.budget import require_memory
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.scans.image_field import ImageStage
from sppm_pipeline.nouns import Geometry
from sppm_pipeline.services.segmentation import labels_of, otsu


@dataclass(frozen=True, kw_only=True)
class ReadScan(ImageStage):
    """Read a scan (micro-CT, tomography, a stack of pictures) as a field whose surface lies between the voxels.

    The files are those of `read.voxels`. Gray values are kept: the surface is where the cubic spline through them
    reaches the threshold, Otsu's if none is given, so that meshes, layers, sizes, porosity, connectivity and error bars
    work as for any field, and are finer than a voxel. An image of two values is binary and smoothed, see
    `field.voxels`. A cell of the field is the shortest side of the image, or a whole part of it.

    A scan does not repeat: homogenize it with `sides: mirror`.
    """

    name: ClassVar[str] = "read.scan"
    libraries: ClassVar[tuple[str, ...]] = ("imagecodecs", "pynrrd", "tifffile")
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("porosity"), Headline("threshold"), Headline("thin_share", "thinner than 3 voxels"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = ("threshold", "porosity", "thin_share", "face_mismatch.#3", "removed_share")

    path: Path = options.read_path(note="an image, or a folder of pictures")
    threshold: float | None = options.threshold(None, note="the surface is where it is reached; Otsu's if omitted")
    invert: bool = option(False, help="solid is where the values are low")
    axes: str = option("xyz", help="what the axes of a .npy array are, in order", choices=("xyz", "zyx"))
    voxel: Length | tuple[Length, Length, Length] | None = options.voxel(
        None, note="or along x, y and z; what the file says if omitted, in mm, else the shortest side is one cell"
    )
    periodic: bool = options.periodic(False, note="those of the image, which is a cell")
    mask: Path | None = options.read_path(None, note="an image of the same voxels, 0 where there is void in any case")

    def check_options(self) -> None:
        """A part of a periodic image is none."""
        if self.periodic and self.crop is not None:
            raise ConfigError("an image that is cropped does not repeat", hint="leave out `crop` or `periodic`")

    def estimate(self, palette: Palette) -> Size:
        """From the length of the file, as if each voxel took one byte."""
        voxels = float(self.path.stat().st_size) if self.path.is_file() else 0.0
        return Size(voxels=voxels, resident=voxels / self.downsample**3, geometry=Geometry())

    def run(self, context: Context) -> ScalarField:
        """Read the image and lay a spline through it."""
        from sppm_pipeline.services.formats.voxel_files import read_image

        name = self.path.name
        if self.path.is_file():  # before anything of its length is reserved; a voxel has 8 bytes at most
            length = float(self.path.stat().st_size)
            require_memory(
                length if self.crop or self.downsample > 1 else 2 * length, f"reading {name}",
                "cut out a smaller piece", limit=context.memory_limit,
            )  # fmt: skip
        image = read_image(self.path)
        values = self.cropped(self._turned(self.path, image.values), name)
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            bad = int(np.count_nonzero(~np.isfinite(values)))
            raise InputError(
                f"{name} holds {bad} values that are not finite", hint="replace them, or crop to where there are none"
            )
        level, values = self._level(context, values)
        if self.mask is not None:
            values = self._masked(values, level, name)
        spacing, physical = self._spacing(image.spacing, values.shape)
        corner = self.crop[::2] if self.crop else (0, 0, 0)
        start = (image.origin or (0.0, 0.0, 0.0)) if physical else (0.0, 0.0, 0.0)
        x, y, z = (a + i * h * physical for a, i, h in zip(start, corner, spacing, strict=True))
        return self.made(
            context, values, level, name, spacing=spacing, physical=physical, periodic=self.periodic,
            invert=self.invert, origin=(x, y, z),
        )  # fmt: skip

    def _turned(self, path: Path, values: NDArray[Any]) -> NDArray[Any]:
        return values.transpose(2, 1, 0) if self.axes == "zyx" and path.suffix == ".npy" else values

    def _level(self, context: Context, values: NDArray[Any]) -> tuple[float | None, NDArray[Any]]:
        """The gray value at the surface and the values; None and truth values of an image of two values."""
        if self.threshold is not None:
            context.report(threshold=self.threshold)
            return self.threshold, values
        labels = labels_of(values)
        if labels is not None and len(labels) <= 2:
            return None, values == labels[-1] if len(labels) == 2 or labels[0] > 0 else np.zeros(values.shape, bool)
        level = otsu(values)
        context.report(threshold=level)
        return level, values

    def _masked(self, values: NDArray[Any], level: float | None, name: str) -> NDArray[Any]:
        """The image with void outside of the mask."""
        from sppm_pipeline.services.formats.voxel_files import read_image

        assert self.mask is not None
        mask = self.cropped(self._turned(self.mask, read_image(self.mask).values), self.mask.name) != 0
        if mask.shape != values.shape:
            raise InputError(f"the mask {self.mask.name} has the shape {mask.shape}, and {name} has {values.shape}")
        if level is None:
            return np.asarray(np.where(mask, values, self.invert))
        void = values.max() if self.invert else values.min()
        return np.asarray(np.where(mask, values, void))

    def _spacing(
        self, given: tuple[float, float, float] | None, shape: tuple[int, ...]
    ) -> tuple[tuple[float, float, float], bool]:
        if isinstance(self.voxel, tuple):
            x, y, z = (edge.mm() for edge in self.voxel)
            return (x, y, z), True
        if self.voxel is not None:
            return (self.voxel.mm(),) * 3, True
        return (given, True) if given is not None else ((1.0 / min(shape),) * 3, False)
