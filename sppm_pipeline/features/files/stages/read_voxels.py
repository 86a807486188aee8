"""``read.voxels``: a cell or a scan, from an image of voxels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, InputError, Length, Stage, Voxels, option, options
from sppm_pipeline.services.segmentation import labels_of, otsu


@dataclass(frozen=True, kw_only=True)
class ReadVoxels(Stage):
    """Read a voxel image: .npy, .nrrd, a TIFF file of many pages, a folder of PNG or TIFF files, or .vti of one array.

    The image becomes phases (0 is void) or solid fractions. An image of two values is void and solid; one with the
    values 0, 1, 2 ... holds phases; a gray one needs a threshold, or the statement that its values are fractions.
    The size of a voxel is read from .nrrd and .vti, and from a TIFF file that states pixels per unit and, as ImageJ
    does, the distance of layers.
    """

    name: ClassVar[str] = "read.voxels"
    libraries: ClassVar[tuple[str, ...]] = ("imagecodecs", "pynrrd", "tifffile")

    path: Path = options.read_path(note="an image, or a folder of pictures")
    values: str = option(
        "auto",
        help="what the values are: auto detects images of two values and of phases; threshold and otsu cut gray ones; "
        "fractions are solid fractions, 0 to 1 or over the full range of an integer type",
        choices=("auto", "phases", "fractions", "threshold", "otsu"),
    )
    threshold: float | None = options.threshold(None)
    invert: bool = option(False, help="solid is where the values are low")
    axes: str = option("xyz", help="what the axes of a .npy array are, in order", choices=("xyz", "zyx"))
    voxel: Length | None = options.voxel(
        None, note="what the file says if omitted, in mm, else the whole image is one cell", formerly="spacing"
    )
    periodic: bool = options.periodic(False, note="those of the image, which is a cell")
    mirror: bool = option(
        False,
        help="append mirror images along x, y and z, which makes a periodic cell of a scan, of eight times as many "
        "voxels; flow and load across the faces of the scan then are as between lubricated plates",
    )

    def check_options(self) -> None:
        if self.mirror and self.periodic:
            raise ConfigError(
                "`mirror` makes a periodic cell of an image that is none, and `periodic: true` says that it is one",
                hint="leave out one of them",
            )
        if (self.threshold is not None) != (self.values == "threshold"):
            raise ConfigError("`values: threshold` and a `threshold` belong together")

    def run(self, context: Context) -> Voxels:
        """Read the image and make phases or fractions of it."""
        from sppm_pipeline.services.formats.voxel_files import read_image

        image = read_image(self.path)
        values = image.values if self.axes == "xyz" or self.path.suffix != ".npy" else image.values.transpose(2, 1, 0)
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise InputError(f"{self.path.name} holds values that are not finite")
        segmented = self._segmented(context, values)
        if self.voxel is not None:
            spacing, physical = (self.voxel.mm(),) * 3, True
        elif image.spacing is not None:
            spacing, physical = image.spacing, True
        else:
            spacing, physical = (1.0 / values.shape[0],) * 3, False
        voxels = Voxels(segmented, spacing, physical, (self.periodic,) * 3)
        if self.mirror:
            voxels = voxels.mirrored()
        solid = voxels.solid()
        if not solid.any() or solid.all():
            context.warn(f"{self.path.name} is all {'solid' if solid.all() else 'void'}")
        return voxels

    def _segmented(self, context: Context, values: NDArray[Any]) -> NDArray[Any]:
        """Phases or fractions."""
        name = self.path.name
        if self.values == "fractions":
            return self._fractions(values)
        if self.values in ("threshold", "otsu"):
            if self.values == "otsu" and values.min() == values.max():
                raise InputError(f"{name} has one value only, {values.min():g}: there is nothing to separate")
            cut = otsu(values) if self.threshold is None else self.threshold
            context.report(threshold=cut)
            solid: NDArray[np.bool_] = (values < cut) if self.invert else (values >= cut)
            return solid.astype(np.uint8)
        labels = labels_of(values)
        # whole numbers in reals are labels too
        whole = labels is not None and (labels == np.round(labels.astype(np.float64))).all()
        if (
            labels is not None
            and whole
            and labels[0] >= 0
            and labels[-1] < 64
            and (self.values == "phases" or labels[-1] > 1)
        ):
            if self.invert:
                raise ConfigError("`invert` means nothing to an image of phases")
            return values.astype(np.uint8)
        if self.values == "auto" and labels is not None and len(labels) <= 2:
            solid = values == labels[-1] if len(labels) == 2 or labels[0] > 0 else values != values
            return (~solid if self.invert else solid).astype(np.uint8)
        kind = "phases are integers from 0 to 63" if self.values == "phases" else "it is a gray image"
        count = "many" if labels is None else str(len(labels))
        raise InputError(
            f"{name} has {count} different values from {values.min():g} to {values.max():g}: {kind}",
            hint="give `values: threshold` with a `threshold`, `values: otsu`, or `values: fractions`",
        )

    def _fractions(self, values: NDArray[Any]) -> NDArray[np.float32]:
        if values.dtype.kind == "f" or values.dtype == bool:
            shares = values.astype(np.float32)
        else:
            shares = (values / np.float64(np.iinfo(values.dtype).max)).astype(np.float32)
        if not (shares.min() >= 0 and shares.max() <= 1):
            raise InputError(
                f"{self.path.name} has values from {values.min():g} to {values.max():g}; solid fractions lie in 0 to 1"
            )
        return np.float32(1) - shares if self.invert else shares
