"""``write.goo``: the file of Elegoo's printers and some others, straight from the runs of the layers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import SliceStack, options
from sppm_pipeline.features.printing.printer_writer import Job, Place, PrinterWriter, thumbnail
from sppm_pipeline.method.families.layer_writer import EncodedLayers
from sppm_pipeline.method.nouns.printer import Printer


@dataclass(frozen=True, kw_only=True)
class WriteGoo(PrinterWriter):
    """Write the layers as a GOO file: run lengths of the whole display, two pictures, exposures, lifts and rests.

    The date in the file is fixed, so that equal layers are equal files.
    """

    name: ClassVar[str] = "write.goo"
    format: ClassVar[str] = "goo"

    path: str = options.write_path("part.goo", suffixes=(".goo",))

    def encode_placed(self, block: NDArray[np.uint8], place: Place, printer: Printer) -> bytes:
        from sppm_pipeline.features.printing.formats.goo import encode_layer

        return encode_layer(block, *place)

    def store(self, target: Path, stack: SliceStack, layers: EncodedLayers) -> None:
        from sppm_pipeline.features.printing.formats import goo

        job, printer, motion = self.job(stack, {}), self._printer(stack), self._printer(stack).motion
        with target.open("wb") as file:
            file.write(bytes(goo.HEADER_BYTES))
            for number, data in enumerate(layers):
                k = int(number >= job.resin.bottom_layers)
                file.write(
                    goo.layer_record(
                        pause_mm=printer.height_mm,
                        top_mm=(number + 1) * job.layer_mm,
                        exposure=job.exposure_s(number),
                        waits=(motion.wait_after_cure_s[k], motion.wait_after_lift_s[k], motion.wait_before_cure_s[k]),
                        lift=(motion.lift_mm[k], motion.lift_mm_min[k]),
                        retract=(motion.lift_mm[k], motion.retract_mm_min[k]),
                        length=len(data),
                        little_endian=printer.little_endian,
                    )
                )
                file.write(data + goo.DELIMITER)
            file.write(goo.FOOTER)
            file.seek(0)
            pictures = {
                "small": goo.picture(thumbnail(layers, *goo.SMALL)), "big": goo.picture(thumbnail(layers, *goo.BIG))
            }  # fmt: skip
            file.write(goo.header(_settings(self.job(stack, layers.findings)) | pictures, printer.little_endian))


def _settings(job: Job) -> dict[str, object]:
    """The entries of the header that follow from printer, resin and part."""
    from sppm_pipeline.features.printing.formats.goo import text

    printer, motion = job.printer, job.printer.motion
    (width, height), (wide, high) = printer.picture
    found: dict[str, object] = {
        "printer_name": text(printer.model, 32), "profile": text(job.resin.name, 32),
        "antialiasing": 8 if job.gray else 1, "layers": job.layers, "width": width,
        "height": height, "mirror_x": printer.mirror_x, "mirror_y": printer.mirror_y,
        "display_x": wide, "display_y": high, "height_mm": printer.height_mm,
        "layer_mm": job.layer_mm, "bottom_layers": job.resin.bottom_layers, "seconds": round(job.seconds),
        "volume_mm3": job.volume_mm3, "grams": job.grams, "price": job.price or 0.0,
    }  # fmt: skip
    for k, which in enumerate(("bottom_", "")):
        found |= {
            f"{which}exposure": job.resin.exposure_s[k], f"{which}wait_after_cure": motion.wait_after_cure_s[k],
            f"{which}wait_after_lift": motion.wait_after_lift_s[k],
            f"{which}wait_before_cure": motion.wait_before_cure_s[k], f"{which}lift_mm": motion.lift_mm[k],
            f"{which}lift_mm_min": motion.lift_mm_min[k], f"{which}retract_mm": motion.lift_mm[k],
            f"{which}retract_mm_min": motion.retract_mm_min[k],
        }  # fmt: skip
    return found
