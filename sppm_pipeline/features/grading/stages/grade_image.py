"""``grade.image``: a parameter given by an image of voxels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, Length, SurfaceMesh, option, options
from sppm_pipeline.features.grading.grader import DataGrader
from sppm_pipeline.method.nouns.maps import ImageLaw
from sppm_pipeline.nouns.length import UNITS_IN_MM


@dataclass(frozen=True, kw_only=True)
class GradeImage(DataGrader):
    """Let a parameter follow an image of voxels, such as a scan: .npy, .nrrd, TIFF, a folder of pictures, or .vti.

    Between the middles of voxels values are interpolated linearly. A map of raw values, for instance gray ones, becomes
    a parameter by `grade.table` or `grade.formula`.
    """

    name: ClassVar[str] = "grade.image"
    libraries: ClassVar[tuple[str, ...]] = ("imagecodecs", "pynrrd", "tifffile")

    path: Path = options.read_path(note="an image, or a folder of pictures")
    array: str | None = option(None, help="name of the array; needed if the file holds several")
    axes: str = option("xyz", help="what the axes of a .npy array are, in order", choices=("xyz", "zyx"))
    unit: str = options.unit("mm", note="of the size of a voxel and the place that the file states")
    voxel: Length | None = options.voxel(None, note="what the file says if omitted")
    origin: tuple[Length, Length, Length] | None = option(
        None,
        help="low corner of the image; what the file says if omitted, or else 0, 0, 0",
        unit="mm", minimum=-1e6, maximum=1e6,
    )  # fmt: skip
    fit: bool = option(False, help="stretch the image over the box of the part")

    def check_options(self) -> None:
        super().check_options()
        if self.fit and (self.voxel is not None or self.origin is not None):
            raise ConfigError("`fit` says where the image lies; leave out `voxel` and `origin`")

    def data(self, context: Context, part: SurfaceMesh | None) -> ImageLaw:
        """Read the image and put it into its place."""
        from sppm_pipeline.services.formats.voxel_files import read_image

        image = read_image(self.path, self.array)
        values = image.values if self.axes == "xyz" or self.path.suffix != ".npy" else image.values.transpose(2, 1, 0)
        if values.dtype == bool:
            values = values.view(np.uint8)
        if values.dtype.kind == "f":
            good = self.finite(values, f"voxels of {self.path.name}")
            if not good.all():
                from scipy.ndimage import distance_transform_edt

                # the value of the nearest voxel that has one
                nearest = distance_transform_edt(~good, return_distances=False, return_indices=True)
                values = values[tuple(nearest)]
        mm = UNITS_IN_MM[self.unit]
        if self.fit:
            if part is None:
                raise ConfigError("`fit` needs a part", hint="read a mesh before this stage")
            origin, edges = part.lower, (part.upper - part.lower) / values.shape
            if not (edges > 0).all():
                raise ConfigError("`fit` needs a part that is not flat")
        else:
            if self.voxel is not None:
                edges = np.full(3, self.voxel.mm())
            elif image.spacing is not None:
                edges = mm * np.array(image.spacing)
            else:
                raise ConfigError(
                    f"{self.path.name} does not say how large its voxels are",
                    hint="give `voxel: 0.1 mm`, or `fit: true` to stretch the image over the box of the part",
                )
            if self.origin is not None:
                origin = np.array([length.mm() for length in self.origin])
            else:
                origin = mm * np.array(image.origin or (0.0, 0.0, 0.0))
        x, y, z = origin.tolist()
        sx, sy, sz = edges.tolist()
        return ImageLaw(
            self.of, self.unit_of_values, self.outside, values, (x, y, z), (sx, sy, sz), self.factor
        )  # fmt: skip
