"""Base class of stages that write a voxel image: one method names the encoder."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.data.voxels import Voxels
from sppm_pipeline.stage import Context, Stage


@dataclass(frozen=True, kw_only=True)
class VoxelWriter(Stage):
    """Base of writers of voxel images: implement `encode` and declare the option `path`."""

    path: str

    def estimate(self, palette: Palette, voxels: Size) -> Size:
        return Size(voxels=voxels.voxels, resident=voxels.resident, outline=voxels.outline, layers=voxels.layers)

    @abstractmethod
    def encode(self, voxels: Voxels) -> Iterable[bytes]:
        """The content of the file, piece by piece."""

    def run(self, context: Context, voxels: Voxels) -> None:
        """Write the file piece by piece."""
        size = 0
        with context.output(self.path).open("wb") as file:
            for chunk in self.encode(voxels):
                size += file.write(chunk)
        context.report(bytes=size, voxels=voxels.values.size)
