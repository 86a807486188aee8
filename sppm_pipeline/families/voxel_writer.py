"""Base class of stages that write a voxel image: one method names the encoder."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass

from sppm_pipeline.data.estimate import Estimate, Facts, Given
from sppm_pipeline.data.voxels import Voxels
from sppm_pipeline.stage import Context, Stage


@dataclass(frozen=True, kw_only=True)
class VoxelWriter(Stage):
    """Base of writers of voxel images: implement `encode` and declare the option `path`."""

    path: str

    def estimate(self, given: Given) -> Estimate:
        facts = given["voxels"]
        values = float(math.prod(facts["shape"])) * facts["bytes"]
        size = self.foreseen_bytes(facts, values)
        return Estimate(disk=size, memory=2 * values, seconds=0.01 + 4e-9 * values, advice="lower `resolution`")

    def foreseen_bytes(self, facts: Facts, values: float) -> float:
        """Bytes of the file for so many bytes of values."""
        return values + 300

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
