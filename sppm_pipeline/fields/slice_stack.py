"""Stacks of layers that are computed while they are read."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.artifact import Artifact
from sppm_pipeline.data.size import Geometry, Size


class SliceStack(Artifact, ABC):
    """Layers of a part, delivered slab by slab from the bottom, never all in memory.

    Layer k is the section at mid-height, ``origin z + (k + 1/2) * layer_mm``; pixel (i, j) is the square around
    ``origin + (i + 1/2, j + 1/2) * pixel_mm``.

    Attributes
    ----------
    pixel_mm : float
        Pixel pitch.
    layer_mm : float
        Layer height.
    shape : tuple of 3 ints
        Pixels along x and y, number of layers.
    origin_mm : tuple of 3 floats
        World position of the low corner of the stack.
    """

    @property
    @abstractmethod
    def pixel_mm(self) -> float: ...

    @property
    @abstractmethod
    def layer_mm(self) -> float: ...

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int, int]: ...

    @property
    @abstractmethod
    def origin_mm(self) -> tuple[float, float, float]: ...

    @abstractmethod
    def slabs(self, threads: int = 1) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """Yield (index of the first layer, layers (nz, ny, nx) uint8), bottom first, rows in order of increasing y.

        Values are 0 (void) to 255 (solid); binary stacks hold nothing between. Each array may be changed or reused by
        the stack when the next one is asked for.
        """

    @property
    def gray(self) -> bool:
        """Whether values between 0 and 255 occur."""
        return False

    def findings(self) -> dict[str, Any]:
        """What became known while the layers were read, for instance porosity and islands removed."""
        return {}

    def summary(self) -> dict[str, Any]:
        """Size and pitch."""
        nx, ny, nz = self.shape
        return {"pixels": [nx, ny], "layers": nz, "pixel_mm": self.pixel_mm, "layer_mm": self.layer_mm}


def stack_size(body: Geometry, pixel: float, layer: float, gray: int, *, passes: int = 1) -> Size:
    """The size of a stack of a body sliced at a pixel and layer pitch (mm), and of the work of evaluating it.

    Finding islands takes a pass of its own; the layers are kept for the second one, a bit a pixel, if they are few.
    """
    edge = body.scale
    nx, ny, nz = (max(1, round(side * edge / p)) for side, p in zip(body.box, (pixel, pixel, layer), strict=True))
    samples = float(nx) * ny * nz * gray**2
    kept = samples if passes > 1 and samples <= 2**30 else 0.0
    passes = 1 if kept else passes
    along = edge / pixel * gray
    even = abs(edge / pixel - round(edge / pixel)) < 1e-6 and layer == pixel
    inside = body.volume * (edge * gray / pixel) ** 2 * edge / layer
    slab = min(samples, max(2.0**22, nx * ny * gray**2))
    return Size(
        samples=passes * samples, sums=passes * body.sums(inside, along, commensurate=even), resident=slab + kept / 64,
        pixels=nx * ny, layers=nz, outline=body.outline(pixel / edge, layer / edge) * (6 if gray > 1 else 1),
        geometry=body,
    )  # fmt: skip
