"""``write.png``: one picture a layer, as DLP and LCD printers expose them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from sppm_pipeline import ConfigError, Context, LayerWriter, SliceStack, option, options
from sppm_pipeline.services.arrays import U8, U64


@dataclass(frozen=True, kw_only=True)
class WritePng(LayerWriter):
    """Write a folder of PNG files, white (255) where solid and black (0) elsewhere, with a manifest beside them.

    File ``00000.png`` is the lowest layer. The first row of a picture is the side of largest y, as one looks down on
    the build plate; the first column is the side of smallest x.
    """

    name: ClassVar[str] = "write.png"
    version: ClassVar[int] = 2
    suffix: ClassVar[str] = ".png"

    path: str = options.write_path("slices", suffixes=("/",))
    bits: int | None = option(
        None, help="bits of a pixel: 1 for black and white, 8 for gray; what the layers need if omitted", minimum=1,
        maximum=8,
    )  # fmt: skip

    def check_options(self) -> None:
        if self.bits not in (None, 1, 8):
            raise ConfigError(f"`bits` is {self.bits}; PNG layers have 1 or 8")

    def run(self, context: Context, stack: SliceStack) -> None:
        """Write all layers, unless they have gray values that one bit cannot hold."""
        if stack.gray and self.bits == 1:
            raise ConfigError(
                "one bit cannot hold the gray of these layers", hint="leave out `bits`, or slice with `gray: 1`"
            )
        super().run(context, stack)

    def encode(self, image: U8, stack: SliceStack) -> bytes:
        from sppm_pipeline.services.formats.png import encode_layer

        return encode_layer(image, bits=self._bits(stack), pixel_mm=stack.pixel_mm)

    def takes_bits(self, stack: SliceStack) -> bool:
        return self._bits(stack) == 1

    def encode_bits(self, rows: U64, stack: SliceStack) -> bytes:
        from sppm_pipeline.services.formats.png import encode_rows

        return encode_rows(rows, stack.shape[0], pixel_mm=stack.pixel_mm)

    def encoding(self, stack: SliceStack) -> dict[str, Any]:
        return {"bits": self._bits(stack)}

    def _bits(self, stack: SliceStack) -> int:
        return self.bits or (8 if stack.gray else 1)
