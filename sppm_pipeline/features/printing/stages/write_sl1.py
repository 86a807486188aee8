"""``write.sl1``: the file of Prusa's SL1 and SL1S, which UVtools converts for many other printers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import SliceStack, options
from sppm_pipeline.features.printing.printer_writer import Place, PrinterWriter, thumbnail
from sppm_pipeline.method.families.layer_writer import EncodedLayers
from sppm_pipeline.method.nouns.printer import Printer
from sppm_pipeline.nouns.artifact import png_of


@dataclass(frozen=True, kw_only=True)
class WriteSl1(PrinterWriter):
    """Write the layers as an SL1 archive: gray PNG pictures of the whole display, thumbnails, settings.

    The first three layers get the bottom exposure, and the printer fades from it to the other over as many layers as
    the resin has bottom layers. Times and dates in the file are fixed, so that equal layers are equal files.
    """

    name: ClassVar[str] = "write.sl1"
    format: ClassVar[str] = "sl1"

    path: str = options.write_path("part.sl1", suffixes=(".sl1", ".sl1s"))

    def encode_placed(self, block: NDArray[np.uint8], place: Place, printer: Printer) -> bytes:
        from sppm_pipeline.services.formats.png import encode_layer

        return encode_layer(place.filled(block), bits=8)

    def store(self, target: Path, stack: SliceStack, layers: EncodedLayers) -> None:
        from sppm_pipeline.features.printing.formats import sl1

        def entries() -> Iterator[tuple[str, bytes]]:
            name = sl1.job_name(Path(self.path).stem)
            digits = max(5, len(str(stack.shape[2] - 1)))
            for number, data in enumerate(layers):
                yield f"{name}{number:0{digits}d}.png", data
            job, printer = self.job(stack, layers.findings), self._printer(stack)
            model, exposure, faded, layer = printer.model, job.resin.exposure_s, job.resin.bottom_layers, job.layer_mm
            yield "config.ini", sl1.config(
                job=name, model=model, resin=job.resin.name, exposure_s=exposure, faded=faded, layers=job.layers,
                layer_mm=layer, seconds=job.seconds, milliliters=job.milliliters,
            )  # fmt: skip
            yield "prusaslicer.ini", sl1.profile(
                model=model, pixels=printer.pixels, display_mm=printer.display_mm, height_mm=printer.height_mm,
                mirror=(printer.mirror_x, printer.mirror_y), portrait=printer.portrait, exposure_s=exposure,
                faded=faded, layer_mm=layer, density=job.resin.density_g_ml,
            )  # fmt: skip
            for width, height in sl1.THUMBNAILS:
                yield f"thumbnail/thumbnail{width}x{height}.png", _rgba(thumbnail(layers, width, height))

        sl1.write_archive(target, entries())


def _rgba(picture: NDArray[np.uint8]) -> bytes:
    """A picture (h, w, 3) as a PNG file with an opaque alpha channel, as the printer's own slicer writes it."""
    return png_of(np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)]))
