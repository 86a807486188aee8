"""Layers of several parts on one plate: places for their outlines, and the layers of all read side by side."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.nouns.printer import Printer
from sppm_pipeline.method.slicing.slice_stack import Slab, SliceStack
from sppm_pipeline.nouns.artifact import frozen

TAG_MM = (3.0, 0.5, 0.5)
"""Height of the letters of a tag, thickness of its base, and how far the letters rise above it: choices."""


class Placed(NamedTuple):
    """A copy of a part: which of the stacks it is, and the pixel of its low corner."""

    part: int
    x: int
    y: int


def packed(
    sizes: Sequence[tuple[int, int]], gap: tuple[int, int], room: tuple[int, int] | None
) -> tuple[list[tuple[int, int]], tuple[int, int]] | None:
    """Low corners of rectangles in rows, the deepest first, and the extent of all; None if they do not fit.

    A shelf packing, about as wide as deep. `sizes` are extents along x and y, at least 1; `gap` the free pixels between
    neighbors; `room` the extent not to be exceeded, if there is a bound.
    """
    widest = max(x for x, _ in sizes)
    everything = sum(x + gap[0] for x, _ in sizes)
    most = everything if room is None else min(everything, room[0])
    balanced = math.ceil(math.sqrt(sum((x + gap[0]) * (y + gap[1]) for x, y in sizes)))
    start = min(max(widest, balanced), most)
    # widths from that of a square up to all there is; the first that fits is taken
    for width in dict.fromkeys([start + (most - start) * k // 16 for k in range(17)]):
        if widest > width:
            continue
        corners, x, y, depth, right = {}, 0, 0, 0, 0
        for i in sorted(range(len(sizes)), key=lambda i: (-sizes[i][1], i)):
            if x + sizes[i][0] > width:
                x, y, depth = 0, y + depth + gap[1], 0
            corners[i] = (x, y)
            x, depth, right = x + sizes[i][0] + gap[0], max(depth, sizes[i][1]), max(right, x + sizes[i][0])
        if room is None or y + depth <= room[1]:
            return [corners[i] for i in range(len(sizes))], (right, y + depth)
    return None


def tag(words: str, pixel_mm: tuple[float, float]) -> NDArray[np.uint8]:
    """Letters on a base: (2, ny, nx) of 255 where solid, base and letters, rows in order of increasing y."""
    from PIL import Image, ImageDraw

    from sppm_pipeline.services.pictures.sheets import font

    letters = font(64)
    left, top, right, bottom = (int(v) for v in letters.getbbox(words))
    image = Image.new("L", (right - left + 32, bottom - top + 32))
    ImageDraw.Draw(image).text((16 - left, 16 - top), words, fill=255, font=letters)
    mm = TAG_MM[0] / (bottom - top)
    size = tuple(max(1, round(n * mm / p)) for n, p in zip(image.size, pixel_mm, strict=True))
    raised = np.asarray(image.resize((size[0], size[1])))[::-1] >= 128
    return frozen(np.stack([np.ones_like(raised), raised]).astype(np.uint8) * 255)


@dataclass(frozen=True, eq=False, kw_only=True)
class PlateSlices(SliceStack):
    """Several stacks of one pitch side by side."""

    parts: tuple[SliceStack, ...]  # each is read once, however many copies there are
    places: tuple[Placed, ...]  # of copies of them, which do not overlap
    extent: tuple[int, int]  # pixels of the plate along x and y
    tags: tuple[tuple[NDArray[np.uint8], int, int], ...] = ()  # tags and the pixels x, y of their low corners

    @property
    def pixel_mm(self) -> tuple[float, float]:
        return self.parts[0].pixel_mm

    @property
    def layer_mm(self) -> float:
        return self.parts[0].layer_mm

    @property
    def printer(self) -> Printer | None:
        return self.parts[0].printer

    @property
    def gray(self) -> bool:
        return any(part.gray for part in self.parts)

    @property
    def tag_layers(self) -> tuple[int, int]:
        """Layers of the base of a tag, and of base and letters."""
        base = math.ceil(TAG_MM[1] / self.layer_mm - 1e-6)
        return base, base + math.ceil(TAG_MM[2] / self.layer_mm - 1e-6)

    @property
    def shape(self) -> tuple[int, int, int]:
        highest = max(part.shape[2] for part in self.parts)
        return *self.extent, max(highest, self.tag_layers[1]) if self.tags else highest

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return (0.0, 0.0, 0.0)

    def read(self, threads: int) -> Generator[Slab, None, dict[str, Any]]:
        sources = [part.slabs(threads) for part in self.parts]
        layers = [_layers(iter(source)) for source in sources]
        (nx, ny, nz), ends = self.shape, self.tag_layers
        tags = 0
        for k in range(nz):
            plate = np.zeros((1, ny, nx), np.uint8)
            current = [next(layer, None) for layer in layers]
            for part, x, y in self.places:
                if (image := current[part]) is not None:
                    plate[0, y : y + image.shape[0], x : x + image.shape[1]] = image
            for which, x, y in self.tags:
                if k < ends[1]:
                    image = which[int(k >= ends[0])]
                    plate[0, y : y + image.shape[0], x : x + image.shape[1]] = image
                    tags += int(np.count_nonzero(image))
            yield k, plate
        for layer in layers:
            next(layer, None)  # to the end of the pass, where findings are complete
        (hx, hy), copies = self.pixel_mm, np.bincount([p.part for p in self.places], minlength=len(self.parts))
        voxel = hx * hy * self.layer_mm
        found = [source.findings["solid_volume_mm3"] for source in sources]
        solid = float(np.dot(copies, found)) + tags * voxel
        return {
            "solid_share_of_box": solid / (nx * ny * nz * voxel), "solid_volume_mm3": solid,
            "part_volumes_mm3": found,
        }  # fmt: skip


def _layers(slabs: Iterator[Slab]) -> Iterator[NDArray[np.uint8]]:
    for _, slab in slabs:
        yield from slab
