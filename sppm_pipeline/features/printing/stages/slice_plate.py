"""``slice.plate``: several parts, or several copies of one, on one build plate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from sppm_pipeline import ConfigError, Context, DesignError, Length, Palette, Size, SliceStack, Stage, option
from sppm_pipeline.features.printing.plate_slices import Placed, PlateSlices, packed, tag


@dataclass(frozen=True, kw_only=True)
class SlicePlate(Stage):
    """Place sliced parts side by side, in rows, the deepest first, so that one file prints them all.

    The parts must have been sliced with the same pixels and layers. Each is computed once, however many copies there
    are. Without a printer the plate is as large as it needs to be.
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

    def estimate(
        self, palette: Palette, part: Size, second: Size | None, third: Size | None, fourth: Size | None
    ) -> Size:
        sizes = [size for size in (part, second, third, fourth) if size is not None]
        copies = self._copies(len(sizes))
        pixels = sum(size.pixels * n for size, n in zip(sizes, copies, strict=True))
        return replace(part, pixels=1.5 * pixels, layers=max(size.layers for size in sizes))

    def _copies(self, parts: int) -> tuple[int, ...]:
        if len(self.quantity) not in (1, parts):
            raise ConfigError(
                f"`quantity` has {len(self.quantity)} numbers for {parts} part{'s' * (parts > 1)}",
                hint="give one for all, or one for each",
            )
        return self.quantity if len(self.quantity) == parts else self.quantity * parts

    def run(
        self,
        context: Context,
        part: SliceStack,
        second: SliceStack | None,
        third: SliceStack | None,
        fourth: SliceStack | None,
    ) -> SliceStack:
        """Find places for all copies; no layer is computed yet."""
        parts = [stack for stack in (part, second, third, fourth) if stack is not None]
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
            parts=tuple(parts),
            places=tuple(Placed(i, x, y + foot) for i, (x, y), foot in zip(numbers, corners, feet, strict=True)),
            extent=extent,
            tags=tuple((t, x, y) for t, (x, y) in zip(tags, corners, strict=True) if t is not None),
        )


def _pitch(stack: SliceStack) -> str:
    x, y = stack.pixel_mm
    return f"{x:g} x {y:g} mm, layers of {stack.layer_mm:g} mm, {stack.printer.name if stack.printer else 'no printer'}"
