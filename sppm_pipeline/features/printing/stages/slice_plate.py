"""``slice.plate``: several parts, or several copies of one, on one build plate."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sppm_pipeline import ConfigError, Context, DesignError, Length, Palette, Size, SliceStack, Stage, option
from sppm_pipeline.method.nouns.printer import Printer
from sppm_pipeline.method.slicing.slice_stack import Slab
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.services.arrays import U8

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


def tag(words: str, pixel_mm: tuple[float, float]) -> U8:
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
    tags: tuple[tuple[U8, int, int], ...] = ()  # tags and the pixels x, y of their low corners

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


def _layers(slabs: Iterator[Slab]) -> Iterator[U8]:
    for _, slab in slabs:
        yield from slab


@dataclass(frozen=True, kw_only=True)
class SlicePlate(Stage):
    """Place sliced parts side by side, in rows, the deepest first, so that one file prints them all.

    `from: {parts: [a, b]}` names them. They must have been sliced with the same pixels and layers. Each is computed
    once, however many copies there are. Without a printer the plate is as large as it needs to be.
    """

    name: ClassVar[str] = "slice.plate"
    advice: ClassVar[str] = "place fewer copies"

    quantity: tuple[int, ...] = option(
        (1,), help="copies of each part, in the order of the ports; one number holds for all", minimum=1, maximum=1000
    )
    separation: Length = option(Length(2.0), help="free space between parts", unit="mm", minimum=0, maximum=1000)
    labels: bool = option(
        False, help="print a tag with a number below each part, which the run record explains by its place"
    )

    def check_options(self) -> None:
        if not self.quantity:
            raise ConfigError("`quantity` is empty", hint="one number holds for all parts")

    def estimate(self, palette: Palette, parts: tuple[Size, ...]) -> Size:
        pixels = sum(size.pixels * n for size, n in zip(parts, self._copies(len(parts)), strict=True))
        return replace(parts[0], pixels=1.5 * pixels, layers=max(size.layers for size in parts))

    def _copies(self, parts: int) -> tuple[int, ...]:
        if len(self.quantity) not in (1, parts):
            raise ConfigError(
                f"`quantity` has {len(self.quantity)} numbers for {parts} part{'s' * (parts > 1)}",
                hint="give one for all, or one for each",
            )
        return self.quantity if len(self.quantity) == parts else self.quantity * parts

    def run(self, context: Context, parts: tuple[SliceStack, ...]) -> SliceStack:
        """Find places for all copies; no layer is computed yet."""
        part = parts[0]
        for other in parts[1:]:
            if (other.pixel_mm, other.layer_mm, other.printer) != (part.pixel_mm, part.layer_mm, part.printer):
                raise DesignError(
                    f"parts on one plate need the same pixels, layers and printer: {_pitch(part)} and {_pitch(other)}",
                    hint="slice all with the same `printer` (or `pixel`) and `layer`",
                )
        numbers = [i for i, count in enumerate(self._copies(len(parts))) for _ in range(count)]
        pixel, printer = part.pixel_mm, part.printer
        gap = tuple(-int(-self.separation.mm() // length) for length in pixel)
        tags = [tag(str(k), pixel) if self.labels else None for k in range(1, len(numbers) + 1)]
        sizes, feet = [], []
        for i, label in zip(numbers, tags, strict=True):
            (nx, ny, _), (ty, tx) = parts[i].shape, (0, 0) if label is None else label.shape[1:]
            feet.append(0 if label is None else ty + gap[1])
            sizes.append((max(nx, tx), ny + feet[-1]))
        found = packed(sizes, (gap[0], gap[1]), None if printer is None else printer.pixels)
        if found is None:
            assert printer is not None
            x, y = printer.display_mm
            raise DesignError(
                f"{len(numbers)} parts {self.separation.mm():g} mm apart do not fit the plate of {printer.name}, "
                f"{x:g} x {y:g} mm",
                hint="lower `quantity`, make `separation` smaller, or take a larger printer (`sppm printers`)",
            )
        corners, extent = found
        context.report(
            parts=len(numbers),
            plate_mm=[n * h for n, h in zip(extent, pixel, strict=True)],
            places=[
                {"label": k, "part": i + 1, "x_mm": x * pixel[0], "y_mm": (y + foot) * pixel[1]}
                for k, (i, (x, y), foot) in enumerate(zip(numbers, corners, feet, strict=True), 1)
            ],
        )
        return PlateSlices(
            parts=parts,
            places=tuple(Placed(i, x, y + foot) for i, (x, y), foot in zip(numbers, corners, feet, strict=True)),
            extent=extent,
            tags=tuple((t, x, y) for t, (x, y) in zip(tags, corners, strict=True) if t is not None),
        )


def _pitch(stack: SliceStack) -> str:
    x, y = stack.pixel_mm
    return f"{x:g} x {y:g} mm, layers of {stack.layer_mm:g} mm, {stack.printer.name if stack.printer else 'no printer'}"
