"""``write.npy``: a voxel image as an array that NumPy reads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.voxels import Voxels
from sppm_pipeline.families import VoxelWriter
from sppm_pipeline.stage import option


@dataclass(frozen=True, kw_only=True)
class WriteNpy(VoxelWriter):
    """Write a voxel image as .npy: uint8 phases, 0 for void, or float32 solid fractions, indexed x, y, z."""

    name: ClassVar[str] = "write.npy"

    path: str = option("voxels.npy", help="file to write", output=True)

    def encode(self, voxels: Voxels) -> Iterator[bytes]:
        from sppm_pipeline.formats import npy

        return npy.encode(voxels.values)
