"""Base of stages that write one printer's file."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.families import options
from sppm_pipeline.method.families.layer_writer import EncodedLayers, LayerWriter, StoredLayers
from sppm_pipeline.method.nouns.printer import Job, Printer, Resin, cards
from sppm_pipeline.method.slicing.slice_stack import SliceStack
from sppm_pipeline.services.arrays import U8
from sppm_pipeline.stage import Context, Headline, option

PREVIEW_SAMPLES = 128
"""Samples along the longest side of the part for its picture in the file, a heuristic: each covers some
pixels of a thumbnail, and twice as many take eight times the time."""


class Place(NamedTuple):
    """Place of a block of pixels in the picture that a printer exposes."""

    top: int
    left: int
    height: int
    width: int

    def filled(self, block: U8) -> U8:
        """The whole picture, black around the block."""
        picture = np.zeros((self.height, self.width), np.uint8)
        picture[self.top : self.top + block.shape[0], self.left : self.left + block.shape[1]] = block
        return picture


def placed(image: U8, printer: Printer) -> tuple[U8, Place]:
    """A layer (ny, nx), as `LayerWriter.encode` takes it, in the middle of the display, turned as it is exposed."""
    (width, height), (rows, columns) = printer.pixels, image.shape
    left, top = (width - columns) // 2, height - rows - (height - rows) // 2
    if printer.portrait:  # turned by 90 degrees: the largest x comes first, then the largest y
        image, width, height, top, left = image.T[::-1], height, width, width - columns - left, top
    rows, columns = image.shape
    if printer.mirror_x:
        image, left = image[:, ::-1], width - columns - left
    if printer.mirror_y:
        image, top = image[::-1], height - rows - top
    return image, Place(top, left, height, width)


def unplaced(picture: U8, place: Place, shape: tuple[int, ...], printer: Printer) -> U8:
    """The layer of which `placed` made the block of this shape."""
    image = picture[place.top : place.top + shape[0], place.left : place.left + shape[1]]
    image = image[:: -1 if printer.mirror_y else 1, :: -1 if printer.mirror_x else 1]
    return image[::-1].T if printer.portrait else image


class Preview:
    """A coarse image of the part, taken from its layers as they pass, and pictures of it."""

    def __init__(self, stack: SliceStack) -> None:
        sides = np.multiply(stack.shape, (*stack.pixel_mm, stack.layer_mm))
        nx, ny, nz = np.clip(np.rint(sides * PREVIEW_SAMPLES / sides.max()), 1, stack.shape).astype(int).tolist()
        self._shape = nx, ny, nz
        self._spacing = float(sides[0] / nx), float(sides[1] / ny), float(sides[2] / nz)
        self._at = {int((k + 0.5) * stack.shape[2] / nz): k for k in range(nz)}
        self._share = np.zeros((nz, ny, nx), np.float32)

    @property
    def wanted(self) -> Collection[int]:
        """The layers that it looks at."""
        return self._at.keys()

    def add(self, number: int, image: U8) -> None:
        """Take in a layer, as `LayerWriter.encode` takes it."""
        from PIL import Image

        if (k := self._at.get(number)) is not None:
            nx, ny, _ = self._shape
            small = Image.fromarray(image).resize((nx, ny), Image.Resampling.BOX)
            self._share[k] = np.asarray(small, np.float32)[::-1] / 255

    def picture(self, width: int, height: int) -> U8:
        """The part seen from the front and above, (height, width, 3); the background alone if nothing is solid."""
        from sppm_pipeline.services.mesh.closing import capped_marching_cubes
        from sppm_pipeline.services.pictures.mesh_view import render_mesh

        if not (self._share >= 0.5).any():
            return np.full((height, width, 3), 255, np.uint8)
        field = np.pad(np.float32(0.5) - self._share, 1, constant_values=0.5)
        vertices, faces = capped_marching_cubes(field, spacing=self._spacing)
        return render_mesh(vertices, faces, size=(width, height))


def thumbnail(layers: EncodedLayers, width: int, height: int) -> U8:
    """A picture of the part whose layers a `PrinterWriter` has all taken, (height, width, 3)."""
    assert isinstance(layers.observer, Preview)
    return layers.observer.picture(width, height)


@dataclass(frozen=True, kw_only=True)
class PrinterWriter(LayerWriter):
    """Base of writers of printer files: implement `encode_placed` for a layer and `pack` for the file.

    The layers must have been cut for a printer (`slice.field` with `printer`). The part stands in the middle of the
    plate. No file of this program was tried on a machine; see `verified_on_hardware` in the list of printers.
    """

    format: ClassVar[str]
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("layers"), Headline("resin_ml", "resin", "ml"), Headline("print_time_s", "print time", "s"),
        Headline("bytes"),
    )  # fmt: skip

    resin: str = option("generic_gray", help="resin; `sppm printers --resins` lists them")
    cards: Path | None = options.cards(None)
    exposure: float | None = option(
        None, help="exposure of a layer; that of the resin's card if omitted", unit="s", above=0, maximum=600
    )
    bottom_exposure: float | None = option(
        None, help="exposure of a bottom layer; that of the resin's card if omitted", unit="s", above=0, maximum=600
    )
    bottom_layers: int | None = option(
        None, help="number of bottom layers; that of the resin's card if omitted", minimum=0, maximum=200
    )
    gray_from: int = option(
        1,
        help="lowest gray that cures the resin; the grays 1 to 255 of the layers are spread from here to 255",
        minimum=1,
        maximum=255,
    )

    @property
    def rated_as(self) -> str:
        return "write.png"

    def check_options(self) -> None:
        self.chosen_resin()

    def chosen_resin(self) -> Resin:
        """The card of the resin, with what the options say otherwise."""
        card = cards(self.cards).resin(self.resin)
        bottom, other = card.exposure_s
        exposures = (self.bottom_exposure or bottom, self.exposure or other)
        layers = card.bottom_layers if self.bottom_layers is None else self.bottom_layers
        return replace(card, exposure_s=exposures, bottom_layers=layers)

    def run(self, context: Context, stack: SliceStack) -> None:
        """Refuse layers that are not of a printer of this format, and write the file."""
        printer = stack.printer
        if printer is None:
            raise ConfigError(
                f"{self.name} writes the file of one printer, and the layers were cut for none",
                hint="give the slicing stage a `printer`; `sppm printers` lists them",
            )
        if printer.format != self.format:
            raise ConfigError(
                f"{self.name} writes no files for {printer.name}", hint=f"say `stage: write.{printer.format}`"
            )
        printer.require_pixel(stack.pixel_mm)
        printer.require_layer(stack.layer_mm)
        stack.require_room()
        if printer.convert_to:
            context.warn(f"{printer.name} reads {printer.convert_to} files: convert {self.path} by UVtools")
        super().run(context, stack)

    def encode(self, image: U8, stack: SliceStack) -> bytes:
        printer = self._printer(stack)
        if stack.gray and self.gray_from > 1:
            image = spread_grays(self.gray_from)[image]
        return self.encode_placed(*placed(image, printer), printer)

    def observer(self, stack: SliceStack) -> Preview:
        return Preview(stack)

    def facts(self, stack: SliceStack, findings: dict[str, Any]) -> dict[str, Any]:
        job = self.job(stack, findings)
        facts = {
            "printer": job.printer.name, "resin": job.resin.name, "resin_measured": job.resin.measured,
            "resin_ml": job.milliliters, "resin_g": job.grams, "print_time_s": job.seconds,
            "verified_on_hardware": job.printer.verified_on_hardware, "pixels": list(stack.shape[:2]),
            "pixel_mm": list(stack.pixel_mm), "layer_mm": stack.layer_mm, "origin_mm": list(stack.origin_mm),
        }  # fmt: skip
        return facts if job.price is None else {**facts, "resin_price": job.price}

    def job(self, stack: SliceStack, findings: dict[str, Any]) -> Job:
        """All about the print; `findings` are those of the layers once all were taken."""
        return Job(
            name=Path(self.path).stem, printer=self._printer(stack), resin=self.chosen_resin(), layers=stack.shape[2],
            layer_mm=stack.layer_mm, gray=stack.gray, volume_mm3=float(findings.get("solid_volume_mm3", 0.0)),
        )  # fmt: skip

    @staticmethod
    def _printer(stack: SliceStack) -> Printer:
        assert stack.printer is not None  # `run` has refused others
        return stack.printer

    @classmethod
    def stored(cls, target: Path, summary: Mapping[str, Any], options: Mapping[str, Any]) -> StoredLayers:
        own = options.get("cards")
        printer = cards(None if own is None else Path(str(own))).printer(str(summary["printer"]))
        nx, ny = (int(n) for n in summary["pixels"])
        block, place = placed(np.broadcast_to(np.uint8(0), (ny, nx)), printer)
        if min(place) < 0:
            raise ValueError("the layers do not fit on the display")
        pictures = cls.pictures(target, printer, (place.height, place.width))
        return StoredLayers(
            int(summary["layers"]), (nx, ny), summary["pixel_mm"], float(summary["layer_mm"]), summary["origin_mm"],
            lambda k: unplaced(pictures(k), place, block.shape, printer), place.height * place.width,
        )  # fmt: skip

    @classmethod
    @abstractmethod
    def pictures(cls, target: Path, printer: Printer, shape: tuple[int, int]) -> Callable[[int], U8]:
        """A function that reads the picture (height, width) of layer k from a file that `store` has written."""

    @abstractmethod
    def encode_placed(self, block: U8, place: Place, printer: Printer) -> bytes:
        """One layer as bytes; called by several threads at once.

        Parameters
        ----------
        block : (h, w) uint8
            The pixels of the part, turned and mirrored as the printer exposes them.
        place : Place
            Where they stand in the picture, which is black around them.
        printer : Printer
        """


def spread_grays(lowest: int) -> U8:
    """Table of 256 grays: 0 stays, 1 to 255 are spread evenly from `lowest` to 255."""
    table = np.rint(lowest + (np.arange(256) - 1) * (255 - lowest) / 254)
    table[0] = 0
    return table.astype(np.uint8)
