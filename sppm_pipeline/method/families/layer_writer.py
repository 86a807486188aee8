"""Base class of stages that write printing layers: one method encodes a layer, one more stores them in a container."""

from __future__ import annotations

import io
import json
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from sppm_pipeline.method.connectivity.removal import removal_warning
from sppm_pipeline.method.families.slab_writer import DividedLayers, divides, encoded_bits, image_of
from sppm_pipeline.method.slicing.sampled_slices import SampledSlices
from sppm_pipeline.method.slicing.slice_stack import Slabs, SliceStack
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.size import Size
from sppm_pipeline.services.arrays import U8, U64
from sppm_pipeline.services.threads import ordered_map
from sppm_pipeline.stage import Context, Headline, Stage, option


class LayerObserver(Protocol):
    """Observer of the layers as they pass, such as a thumbnail.

    One that has an attribute `wanted`, a collection of numbers, may be shown these layers only; where workers make the
    layers, others need not travel then.
    """

    def add(self, number: int, image: U8) -> None:
        """Take in a layer, as `LayerWriter.encode` takes it; called once for each, the lowest first, in one thread."""


class EncodedLayers:
    """Encoded layers in one pass from the lowest, and what is known when the last of them was taken.

    Attributes
    ----------
    taken : int
        Number of layers taken so far.
    bytes : int
        Their size.
    findings : dict
        Empty until the last layer was taken; then what the stack determined on the way, such as the solid volume.
    observer : LayerObserver or None
        What `LayerWriter.observer` made; it has seen all layers when the last of them was taken.
    """

    def __init__(
        self, layers: Iterator[bytes], slabs: Slabs | DividedLayers, observer: LayerObserver | None = None
    ) -> None:
        self._layers, self._slabs, self.observer = layers, slabs, observer
        self.taken = self.bytes = 0

    def __iter__(self) -> Iterator[bytes]:
        for data in self._layers:
            self.taken += 1
            self.bytes += len(data)
            yield data

    @property
    def findings(self) -> dict[str, Any]:
        return self._slabs.findings


class StoredLayers(NamedTuple):
    """Layers that a writer has stored, for reports: `image` reads layer k as `LayerWriter.encode` took it."""

    layers: int
    size: tuple[int, int]  # width and height in pixels
    pixel_mm: tuple[float, float]
    layer_mm: float
    origin_mm: tuple[float, float, float]
    image: Callable[[int], U8]
    pixels: int  # that are decoded for a layer
    png: Callable[[int], bytes] | None = None  # the file of layer k, if each has one of its own


def gray_of(data: bytes, pixels: int) -> U8:
    """A PNG file of so many pixels, as gray values, or those of three pixels in a row as colors; else `ValueError`."""
    from PIL import Image

    with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
        colors = 3 if image.mode == "RGB" else 1
        # known before it is decoded: a small file may hold billions of pixels
        if image.width * image.height * colors != pixels:
            raise ValueError(f"a layer has {image.width} x {image.height} pixels")
        return np.asarray(image if colors == 3 else image.convert("L")).reshape(image.height, -1)


@dataclass(frozen=True, kw_only=True)
class LayerWriter(Stage):
    """Base of writers of layers: implement `encode`, and `store` for a container instead of a folder of files.

    Layers are evaluated slab by slab and encoded by threads beside the evaluation of the next slab; only a few of them
    are in memory at once. `encode` runs in several threads at once, `store` in one. In a run with workers (``-j``) they
    evaluate and encode the layers, slab by slab; `encode` must not depend on more than the options and its arguments.
    What must be refused before the first layer is computed is checked in `check_options`, or in `run` before it calls
    this one.

    A container in a few lines::

        @dataclass(frozen=True, kw_only=True)
        class WriteZip(LayerWriter):
            '''Write layers as PNG files in a ZIP archive.'''

            name: ClassVar[str] = "write.zip"
            path: str = option("layers.zip", help="file to write", output=True, suffixes=(".zip",))

            def encode(self, image, stack):
                return png_of(image)

            def store(self, target, stack, layers):
                with zipfile.ZipFile(target, "w") as archive:
                    for number, data in enumerate(layers):
                        archive.writestr(f"{number}.png", data)
    """

    maps: ClassVar[bool] = True
    advice: ClassVar[str] = "slice with a larger `pixel` or `layer`"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("layers"), Headline("solid_volume_mm3", "solid volume", "mm^3"), Headline("porosity"),
        Headline("infill_porosity", "porosity of the infill"), Headline("removed_share", "share of solid removed"),
        Headline("bytes"),
    )  # fmt: skip
    suffix: ClassVar[str] = ""  # ends the names of the files that `store` makes in its folder

    path: str
    sheet: int = option(
        6, help="layers shown together in an overview picture beside the output; 0 for none", minimum=0, maximum=100
    )

    def estimate(self, palette: Palette, stack: Size) -> Size:
        return replace(stack, triangles=0.0, pixels=stack.pixels * self.sheet)

    @abstractmethod
    def encode(self, image: U8, stack: SliceStack) -> bytes:
        """One layer as bytes; called by several threads at once.

        Parameters
        ----------
        image : (ny, nx) uint8, C-contiguous
            255 where solid, 0 elsewhere, values between only if ``stack.gray``. The first row is the side of largest
            y, as one looks down on the build plate; the first column is the side of smallest x.
        stack : SliceStack
            Pixel pitch along x and y, layer height, size and position of the part.
        """

    def takes_bits(self, stack: SliceStack) -> bool:
        """True if layers of black and white are passed to `encode_bits` where they are there as bits."""
        return False

    def encode_bits(self, rows: U64, stack: SliceStack) -> bytes:
        """`encode` for a layer of bits: the same bytes, from an eighth of the memory; see `takes_bits`.

        Parameters
        ----------
        rows : (ny, words) uint64, C-contiguous
            Set where solid; pixel x is bit ``x % 64`` of word ``x // 64``. The first row is the side of largest y.
        stack : SliceStack
        """
        raise NotImplementedError(f"{self.name} takes bits and has no `encode_bits`")

    def store(self, target: Path, stack: SliceStack, layers: EncodedLayers) -> None:
        """Write all layers: by default a folder with a file for each and ``manifest.json``.

        Parameters
        ----------
        target : Path
            The file or folder to make.
        stack : SliceStack
            The stack that is written.
        layers : EncodedLayers
            An iterable of the results of `encode`, the lowest layer first; all of them have to be taken. Its `findings`
            are complete then.
        """
        target.mkdir(parents=True)
        digits = max(5, len(str(stack.shape[2] - 1)))
        for number, data in enumerate(layers):
            (target / f"{number:0{digits}d}{self.suffix}").write_bytes(data)
        nx, ny, nz = stack.shape
        manifest = {
            "format": 2, "layers": nz, "width_px": nx, "height_px": ny, "pixel_mm": list(stack.pixel_mm),
            "layer_mm": stack.layer_mm, "origin_mm": list(stack.origin_mm), **self.encoding(stack),
            "first_file": f"{0:0{digits}d}{self.suffix}", "solid_value": 255, "section": "mid-height of the layer",
            "row_0": "+y", "column_0": "-x", **layers.findings,
        }  # fmt: skip
        (target / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")

    @classmethod
    def stored(cls, target: Path, summary: Mapping[str, Any], options: Mapping[str, Any]) -> StoredLayers | None:
        """Layers that a run has stored in `target`, by its record; None if reports can't show them.

        The default reads a folder of PNG files with ``manifest.json``. What is not as it was written raises OSError,
        ValueError, KeyError or TypeError.
        """
        manifest = json.loads((target / "manifest.json").read_bytes())
        count, first = int(manifest["layers"]), PurePosixPath(str(manifest["first_file"]))
        if first.suffix != ".png" or count < 1:
            return None
        size = int(manifest["width_px"]), int(manifest["height_px"])

        def png(k: int) -> bytes:
            return (target / f"{k:0{len(first.stem)}d}.png").read_bytes()

        return StoredLayers(
            count, size, manifest["pixel_mm"], float(manifest["layer_mm"]), manifest["origin_mm"],
            lambda k: gray_of(png(k), size[0] * size[1]), size[0] * size[1], png,
        )  # fmt: skip

    def encoding(self, stack: SliceStack) -> dict[str, Any]:
        """Entries of ``manifest.json`` that describe how `encode` writes a pixel."""
        return {}

    def observer(self, stack: SliceStack) -> LayerObserver | None:
        """Observer of the layers as they pass, for `store` to use; nothing by default."""
        return None

    def facts(self, stack: SliceStack, findings: dict[str, Any]) -> dict[str, Any]:
        """Numbers for the run record beside the findings of the layers; none by default."""
        return {}

    def run(self, context: Context, stack: SliceStack) -> None:
        """Evaluate, encode and store layer after layer."""
        nz, threads = stack.shape[2], context.threads
        shown = set(np.linspace(0, nz - 1, self.sheet + 2).round().astype(int)[1:-1].tolist()) if self.sheet else set()
        overview: list[U8] = []
        observer = self.observer(stack)

        def show(number: int, image: U8) -> None:
            if observer is not None:
                observer.add(number, image)
            if number in shown:
                overview.append(image)

        def flipped(bits: bool) -> Iterator[Any]:
            for start, slab in slabs:
                for number, layer in enumerate(slab, start):
                    # row 0 of a layer that is written is the side of largest y; the stack may reuse its slab
                    rows = layer[::-1].copy()
                    if not bits or number in seen:
                        show(number, image_of(rows, stack) if bits else rows)
                    yield rows
                context.progress(min(start + len(slab), nz), nz, "layers")

        seen = shown.union(() if observer is None else getattr(observer, "wanted", range(nz)))
        encoded: Iterator[bytes]
        source: Slabs | DividedLayers
        if divides(context, stack, self):
            assert isinstance(stack, SampledSlices)
            source = DividedLayers(context, stack, self, seen, show)
            encoded = iter(source)
        elif isinstance(stack, SampledSlices) and not stack.gray:
            source = slabs = stack.bit_slabs(threads)
            encoded = ordered_map(
                lambda rows: encoded_bits(self, rows, stack), flipped(True), threads, ahead=4 * threads
            )
        else:
            source = slabs = stack.slabs(threads)
            encoded = ordered_map(lambda image: self.encode(image, stack), flipped(False), threads, ahead=4 * threads)
        layers = EncodedLayers(encoded, source, observer)
        target = context.output(self.path)
        self.store(target, stack, layers)
        # a `store` that stops early would leave a truncated part without notice
        if layers.taken != nz:
            raise RuntimeError(f"`store` of {self.name} has taken {layers.taken} of {nz} layers")
        found = layers.findings
        context.report(bytes=layers.bytes, layers=nz, **found, **self.facts(stack, found))
        porosity = (found["porosity_with_islands"], found["porosity"]) if "porosity" in found else None
        if warning := removal_warning(found.get("removed_share", 0.0), porosity):
            context.warn(warning)
        if overview:
            from PIL import Image

            from sppm_pipeline.services.pictures.sheets import layer_sheet

            stem = self.path.rstrip("/") if target.is_dir() else str(PurePosixPath(self.path).with_suffix(""))
            heights = [stack.origin_mm[2] + (number + 0.5) * stack.layer_mm for number in sorted(shown)]
            labels = [f"layer {k}, z = {z:.4g} mm" for k, z in zip(sorted(shown), heights, strict=True)]
            sheet = layer_sheet(overview, labels, pixel=stack.pixel_mm)
            Image.fromarray(sheet).save(context.output(f"{stem}-overview.png"))
