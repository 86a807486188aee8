"""Stacks of layers that are computed while they are read."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.data.artifact import Artifact, frozen
from sppm_pipeline.data.size import Geometry, Size

Slab = tuple[int, NDArray[np.uint8]]
"""Index of the first layer, and layers (nz, ny, nx), rows in order of increasing y."""


class Slabs:
    """The slabs of a stack in one pass from the bottom, and what was found out on the way.

    Attributes
    ----------
    findings : dict
        Empty until the last slab was read; then for instance the solid volume and the fraction of islands removed.
    """

    def __init__(self, source: Generator[Slab, None, dict[str, Any]]) -> None:
        self._source = source
        self.findings: dict[str, Any] = {}

    def __iter__(self) -> Iterator[Slab]:
        self.findings = yield from self._source


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
    def read(self, threads: int) -> Generator[Slab, None, dict[str, Any]]:
        """Yield the slabs, and return what was found out on the way; see `slabs`."""

    def slabs(self, threads: int = 1) -> Slabs:
        """The layers, bottom first: 0 (void) to 255 (solid), binary stacks hold nothing between.

        Each array may be changed or reused by the stack when the next one is asked for.
        """
        return Slabs(self.read(threads))

    def to_array(self, threads: int = 1) -> NDArray[np.uint8]:
        """All layers at once, (nz, ny, nx) uint8; for stacks that fit into memory."""
        return np.concatenate([slab.copy() for _, slab in self.slabs(threads)])

    @staticmethod
    def from_array(layers: ArrayLike, *, pixel_mm: float, layer_mm: float | None = None) -> SliceStack:
        """Layers that are there already.

        Parameters
        ----------
        layers : (nz, ny, nx) array_like
            Truth values (True is solid), or integers from 0 (void) to 255 (solid); rows in order of increasing y.
        pixel_mm : float
        layer_mm : float, optional
            `pixel_mm` if omitted.

        Raises
        ------
        ValueError
            If a value is out of range or the array has not three axes.
        """
        values = np.asarray(layers)
        if values.ndim != 3 or not values.size or values.dtype.kind not in "biu":
            raise ValueError(f"layers need three axes of integers, got shape {values.shape} of {values.dtype}")
        if values.dtype.kind == "b":
            values = values * np.uint8(255)
        if not 0 <= values.min() <= values.max() <= 255:
            raise ValueError("layers hold integers from 0 (void) to 255 (solid)")
        return ArraySlices(frozen(values.astype(np.uint8)), float(pixel_mm), float(layer_mm or pixel_mm))

    @property
    def gray(self) -> bool:
        """Whether values between 0 and 255 occur."""
        return False

    def summary(self) -> dict[str, Any]:
        """Size and pitch."""
        nx, ny, nz = self.shape
        return {"pixels": [nx, ny], "layers": nz, "pixel_mm": self.pixel_mm, "layer_mm": self.layer_mm}


@dataclass(frozen=True, eq=False)
class ArraySlices(SliceStack):
    """Layers that are there already, (nz, ny, nx) uint8, with the low corner of the stack at the origin."""

    layers: NDArray[np.uint8]
    pixel: float
    layer: float

    @property
    def pixel_mm(self) -> float:
        return self.pixel

    @property
    def layer_mm(self) -> float:
        return self.layer

    @property
    def shape(self) -> tuple[int, int, int]:
        nz, ny, nx = self.layers.shape
        return nx, ny, nz

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return (0.0, 0.0, 0.0)

    @property
    def gray(self) -> bool:
        return bool(((self.layers > 0) & (self.layers < 255)).any())

    def read(self, threads: int) -> Generator[Slab, None, dict[str, Any]]:
        for start, layer in enumerate(self.layers):
            yield start, layer[None].copy()
        nx, ny, nz = self.shape
        solid = float(self.layers.sum(dtype=np.float64)) / 255
        return {
            "solid_voxels": int(np.count_nonzero(self.layers)),
            "solid_share_of_box": solid / (nx * ny * nz),
            "solid_volume_mm3": solid * self.pixel**2 * self.layer,
        }


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
