"""``write.vti``: a voxel image as image data that ParaView reads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.voxels import Voxels
from sppm_pipeline.families import VoxelWriter
from sppm_pipeline.stage import option


@dataclass(frozen=True, kw_only=True)
class WriteVti(VoxelWriter):
    """Write a voxel image as VTK image data, one value a voxel: the phase, or the solid fraction."""

    name: ClassVar[str] = "write.vti"

    path: str = option("voxels.vti", help="file to write", output=True)

    def encode(self, voxels: Voxels) -> Iterator[bytes]:
        from sppm_pipeline.formats import vti

        array = "fraction" if voxels.fractions else "phase"
        return vti.encode(voxels.values, voxels.spacing, (0.0, 0.0, 0.0), array)
