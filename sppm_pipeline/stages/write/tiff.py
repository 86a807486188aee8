"""``write.tiff``: a voxel image as a picture of many pages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.voxels import Voxels
from sppm_pipeline.families import VoxelWriter
from sppm_pipeline.stage import option


@dataclass(frozen=True, kw_only=True)
class WriteTiff(VoxelWriter):
    """Write a voxel image as a TIFF file of one page a layer, the lowest first, rows from the largest y down.

    An image of one phase has the values 0 and 255, one of several phases their numbers, fractions are 32-bit reals."""

    name: ClassVar[str] = "write.tiff"

    path: str = option("voxels.tiff", help="file to write", output=True)

    def encode(self, voxels: Voxels) -> Iterator[bytes]:
        from sppm_pipeline.formats.image_stack import encode_tiff

        yield encode_tiff(voxels.values if voxels.fractions or voxels.values.max() > 1 else voxels.solid())
