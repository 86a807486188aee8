"""``write.nanodlp``: a ZIP archive of numbered pictures, which NanoDLP imports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from sppm_pipeline import SliceStack, options
from sppm_pipeline.features.printing.printer_writer import Place, PrinterWriter
from sppm_pipeline.method.families.layer_writer import EncodedLayers
from sppm_pipeline.method.nouns.printer import Printer
from sppm_pipeline.services.arrays import U8


@dataclass(frozen=True, kw_only=True)
class WriteNanodlp(PrinterWriter):
    """Write the layers as a ZIP archive of PNG pictures of the whole display, ``1.png`` the lowest.

    Exposures, lifts and the layer height are those of the profile that one chooses in NanoDLP when the archive is
    imported; resin, time and price here only go into the run record. Displays whose pixels are a third of a color pixel
    get pictures in color, as their cards say.
    """

    name: ClassVar[str] = "write.nanodlp"
    format: ClassVar[str] = "nanodlp"

    path: str = options.write_path("part.zip", suffixes=(".zip",))

    def encode_placed(self, block: U8, place: Place, printer: Printer) -> bytes:
        from sppm_pipeline.services.formats.png import encode_layer

        return encode_layer(place.filled(block), bits=8, subpixels=printer.subpixels)

    @classmethod
    def pictures(cls, target: Path, printer: Printer, shape: tuple[int, int]) -> Callable[[int], U8]:
        from sppm_pipeline.features.printing.stages.write_sl1 import read_archive

        return read_archive(target, shape)

    def store(self, target: Path, stack: SliceStack, layers: EncodedLayers) -> None:
        from sppm_pipeline.features.printing.stages.write_sl1 import write_archive

        write_archive(target, ((f"{number}.png", data) for number, data in enumerate(layers, 1)))
