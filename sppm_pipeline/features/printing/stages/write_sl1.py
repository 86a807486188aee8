"""``write.sl1``: the file of Prusa's SL1 and SL1S, which UVtools converts for many other printers.

SL1 archives (Prusa SL1 and SL1S, and what UVtools converts): two INI files, PNG layers, two thumbnails.

The layout is that of PrusaSlicer 2.5 and of the printer's firmware: every PNG whose name starts with ``jobDir`` is a
layer; layers are gray of 8 bits; `numSlow + numFast` is their number, and the firmware counts itself which are slow.
UVtools needs both INI files. The size of the display and how pictures are mirrored and turned stand in the second one,
from which PrusaSlicer imports a file again.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline import SliceStack, options
from sppm_pipeline.features.printing.printer_writer import Place, PrinterWriter, thumbnail
from sppm_pipeline.method.families.layer_writer import EncodedLayers, gray_of
from sppm_pipeline.method.nouns.printer import Printer
from sppm_pipeline.nouns.artifact import png_of
from sppm_pipeline.services.arrays import U8

EPOCH = (1980, 1, 1, 0, 0, 0)
"""Date of every entry, the first that a ZIP archive can hold, so that equal layers are equal bytes."""

TIMESTAMP = "1980-01-01 at 00:00:00 UTC"
"""The same for ``fileCreationTimestamp``."""

THUMBNAILS = ((400, 400), (800, 480))
"""Width and height of the thumbnails that the printer shows."""

MAX_FADED = 200
"""Layers over which the firmware fades from the first exposure to the others at most."""


def write_archive(target: Path, entries: Iterable[tuple[str, bytes]]) -> None:
    """A ZIP archive of stored entries, as they come; its bytes depend on names and contents alone."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:
        for name, data in entries:
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.create_system, entry.external_attr = 3, 0o644 << 16  # the same on every system
            archive.writestr(entry, data)


def read_archive(target: Path, shape: tuple[int, int]) -> Callable[[int], U8]:
    """A function that reads the k-th of the numbered pictures of this shape in an archive."""
    with zipfile.ZipFile(target) as archive:
        names = [name for name in archive.namelist() if name.endswith(".png") and "/" not in name]
    names.sort(key=lambda name: (len(name), name))

    def picture(k: int) -> U8:
        with zipfile.ZipFile(target) as archive:
            if archive.getinfo(names[k]).file_size > shape[0] * shape[1] + 2**20:
                raise ValueError("the picture of a layer is larger than its pixels")
            return gray_of(archive.read(names[k]), shape[0] * shape[1])

    return picture


def ini(values: Mapping[str, object]) -> bytes:
    """``key = value`` lines in the order of the keys; truth values are 1 and 0."""
    return "".join(
        f"{key} = {int(value) if isinstance(value, bool) else value}\n" for key, value in sorted(values.items())
    ).encode()


def job_name(stem: str) -> str:
    """``jobDir`` for a file: its stem, unless the names of thumbnails started with it."""
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in stem)
    return f"part_{name}" if "thumbnail/".startswith(name.lower()) else name


def config(
    *, job: str, model: str, resin: str, exposure_s: tuple[float, float], faded: int, layers: int, layer_mm: float,
    seconds: float, milliliters: float,
) -> bytes:  # fmt: skip
    """``config.ini``, by which the printer prints; `exposure_s` is of the first layers and of the others."""
    first, other = exposure_s
    return ini({
        "action": "print", "expTime": _number(other), "expTimeFirst": _number(first), "expUserProfile": 0,
        "fileCreationTimestamp": TIMESTAMP, "hollow": 0, "jobDir": job, "layerHeight": _number(layer_mm),
        "materialName": resin, "numFade": min(faded, MAX_FADED), "numFast": layers, "numSlow": 0,
        "printProfile": "sppm_pipeline", "printTime": f"{seconds:.6f}", "printerModel": model,
        "printerProfile": model, "printerVariant": "default", "prusaSlicerVersion": "sppm_pipeline",
        "usedMaterial": f"{milliliters:.6f}",
    })  # fmt: skip


def profile(
    *, model: str, pixels: tuple[int, int], display_mm: tuple[float, float], height_mm: float, mirror: tuple[bool,
    bool], portrait: bool, exposure_s: tuple[float, float], faded: int, layer_mm: float, density: float,
) -> bytes:  # fmt: skip
    """``prusaslicer.ini``, from which other programs know the display."""
    return ini({
        "display_pixels_x": pixels[0], "display_pixels_y": pixels[1], "display_width": _number(display_mm[0]),
        "display_height": _number(display_mm[1]), "display_mirror_x": mirror[0], "display_mirror_y": mirror[1],
        "display_orientation": "portrait" if portrait else "landscape", "max_print_height": _number(height_mm),
        "layer_height": _number(layer_mm), "initial_layer_height": _number(layer_mm), "faded_layers": faded,
        "exposure_time": _number(exposure_s[1]), "initial_exposure_time": _number(exposure_s[0]),
        "printer_technology": "SLA", "printer_model": model, "printer_settings_id": model, "printer_variant": "default",
        "material_density": _number(density), "gamma_correction": 1,
    })  # fmt: skip


def _number(value: float) -> str:
    return f"{value:.9g}"


@dataclass(frozen=True, kw_only=True)
class WriteSl1(PrinterWriter):
    """Write the layers as an SL1 archive: gray PNG pictures of the whole display, thumbnails, settings.

    The first three layers get the bottom exposure, and the printer fades from it to the other over as many layers as
    the resin has bottom layers. Times and dates in the file are fixed, so that equal layers are equal files.
    """

    name: ClassVar[str] = "write.sl1"
    format: ClassVar[str] = "sl1"

    path: str = options.write_path("part.sl1", suffixes=(".sl1", ".sl1s"))

    def encode_placed(self, block: U8, place: Place, printer: Printer) -> bytes:
        from sppm_pipeline.services.formats.png import encode_layer

        return encode_layer(place.filled(block), bits=8)

    @classmethod
    def pictures(cls, target: Path, printer: Printer, shape: tuple[int, int]) -> Callable[[int], U8]:
        return read_archive(target, shape)

    def store(self, target: Path, stack: SliceStack, layers: EncodedLayers) -> None:
        def entries() -> Iterator[tuple[str, bytes]]:
            name = job_name(Path(self.path).stem)
            digits = max(5, len(str(stack.shape[2] - 1)))
            for number, data in enumerate(layers):
                yield f"{name}{number:0{digits}d}.png", data
            job, printer = self.job(stack, layers.findings), self._printer(stack)
            model, exposure, faded, layer = printer.model, job.resin.exposure_s, job.resin.bottom_layers, job.layer_mm
            yield "config.ini", config(
                job=name, model=model, resin=job.resin.name, exposure_s=exposure, faded=faded, layers=job.layers,
                layer_mm=layer, seconds=job.seconds, milliliters=job.milliliters,
            )  # fmt: skip
            yield "prusaslicer.ini", profile(
                model=model, pixels=printer.pixels, display_mm=printer.display_mm, height_mm=printer.height_mm,
                mirror=(printer.mirror_x, printer.mirror_y), portrait=printer.portrait, exposure_s=exposure,
                faded=faded, layer_mm=layer, density=job.resin.density_g_ml,
            )  # fmt: skip
            for width, height in THUMBNAILS:
                picture = thumbnail(layers, width, height)
                # with an opaque alpha channel, as the printer's own slicer writes it
                opaque = np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])
                yield f"thumbnail/thumbnail{width}x{height}.png", png_of(opaque)

        write_archive(target, entries())
