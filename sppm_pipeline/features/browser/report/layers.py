"""Files of a run in a report: its layers, as they are printed, and its pictures."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.engine.config.names import output_parts
from sppm_pipeline.errors import SppmError
from sppm_pipeline.services.arrays import F64

MAX_LAYERS = 1500
"""Layers in a report; of more, every k-th is shown."""

MAX_PIXELS = 1024
"""Pixels along the longer side of a layer in a report; larger layers are reduced."""

PICTURE_PIXELS = 1000
"""Pixels along the longer side of a picture in a report."""

MAX_PICTURES = 24
MAX_OPENED = 2**26
"""Maximum number of pixels of a picture that is decoded, which takes 0.25 GB then."""


class Layers(NamedTuple):
    """The layers of a run, as PNG files one after the other."""

    folder: str
    total: int  # of the run; the report may hold fewer
    numbers: list[int]  # which layers these are
    files: list[bytes]
    size: tuple[int, int]  # width and height in pixels, as printed
    reduced: int  # pixels of a layer along one of the pictures here; 1 if these are the files themselves
    pixel_mm: tuple[float, float]
    layer_mm: float
    origin_mm: tuple[float, float, float]
    solid_mm2: F64  # (n,), solid area of each of these layers

    def head(self) -> dict[str, Any]:
        """Description of the bytes for the script of the page."""
        ends = np.cumsum([0, *(len(data) for data in self.files)]).tolist()
        return {
            "count": self.total, "numbers": self.numbers, "ends": ends, "size": list(self.size),
            "reduced": self.reduced, "pixel_mm": list(self.pixel_mm), "layer_mm": self.layer_mm,
            "origin_mm": list(self.origin_mm),
        }  # fmt: skip


def layers_of(path: Path, outputs: Sequence[Mapping[str, Any]], budget: int) -> Layers | None:
    """Layers that a run has written as a folder of PNG files, of at most `budget` bytes; None if none can be read."""
    for output in outputs:
        folder = path / str(output.get("path"))
        if "files" not in output or not (folder / "manifest.json").is_file():
            continue
        try:
            manifest = json.loads((folder / "manifest.json").read_bytes())
            return _read(folder, str(output["path"]), manifest, budget)
        except (OSError, ValueError, KeyError, TypeError, SyntaxError):  # Pillow raises the last for broken files
            continue
    return None


def _read(folder: Path, name: str, manifest: Mapping[str, Any], budget: int) -> Layers | None:
    count, first = int(manifest["layers"]), str(manifest["first_file"])
    digits, suffix = len(Path(first).stem), Path(first).suffix
    if suffix != ".png" or count < 1:
        return None
    size = int(manifest["width_px"]), int(manifest["height_px"])
    reduced = -(-max(size) // MAX_PIXELS)
    step = -(-count // (MAX_LAYERS if reduced == 1 else MAX_LAYERS // 6))
    while True:
        numbers = list(range(0, count, step))
        paths = [folder / f"{number:0{digits}d}{suffix}" for number in numbers]
        if reduced > 1 or len(paths) == 1 or sum(p.stat().st_size for p in paths) <= budget:
            break
        step += 1
    read = [_layer(p, reduced) for p in paths]
    # sizes of reduced layers are known only when they are made: every second one goes until the rest fits
    while len(read) > 1 and sum(len(data) for data, _ in read) > budget:
        read, numbers = read[::2], numbers[::2]
    px, py = (float(v) for v in manifest["pixel_mm"])
    x, y, z = (float(v) for v in manifest["origin_mm"])
    area = size[0] * px * size[1] * py
    solid = np.array([share * area for _, share in read])
    files = [data for data, _ in read]
    return Layers(name, count, numbers, files, size, reduced, (px, py), float(manifest["layer_mm"]), (x, y, z), solid)


def _layer(path: Path, reduced: int) -> tuple[bytes, float]:
    """A layer as PNG, and its solid share."""
    from PIL import Image

    data = path.read_bytes()
    with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
        if image.width * image.height > MAX_OPENED:
            # known before it is decoded: a small file may hold billions of pixels
            raise ValueError("too large a layer")
        gray = image.convert("L")
    share = float(np.asarray(gray).mean() / 255)
    if reduced == 1:
        return data, share
    small = io.BytesIO()
    gray.reduce(reduced).save(small, "PNG", optimize=True)
    return small.getvalue(), share


class Picture(NamedTuple):
    """A picture for a page: name of the file, address of its data, pixels, and whether it is the file itself."""

    name: str
    source: str
    width: int
    height: int
    whole: bool


def pictures_of(
    path: Path, outputs: Sequence[Mapping[str, Any]], budget: int, pixels: int = PICTURE_PIXELS
) -> list[Picture]:
    """The pictures and charts that a run has written, in their order; small files as they are, others reduced."""
    found: list[Picture] = []
    for output in outputs:
        name = str(output.get("path"))
        file, suffix = path / name, Path(name).suffix.lower()
        if suffix not in (".png", ".svg") or "files" in output or len(found) >= MAX_PICTURES:
            continue
        try:
            made = _picture(name, file.read_bytes(), suffix, budget // 3, pixels)
        except (OSError, ValueError, SyntaxError):
            continue
        if made is not None and len(made.source) * 3 // 4 <= budget:
            budget -= len(made.source) * 3 // 4
            found.append(made)
    return found


def _picture(name: str, data: bytes, suffix: str, most: int, pixels: int) -> Picture | None:
    from PIL import Image

    # SVG files are shown by <img>, in which no browser runs scripts or fetches anything
    if suffix == ".svg":
        return Picture(name, data_uri("image/svg+xml", data), 560, 400, True) if len(data) <= most else None
    with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
        if image.width * image.height > MAX_OPENED:
            return None
        width, height = image.size
        if len(data) <= most // 2:
            return Picture(name, data_uri("image/png", data), width, height, True)
        seen = Image.new("RGBA", image.size, "white")  # what shows through a transparent picture
        seen.alpha_composite(image.convert("RGBA"))
        small = seen.convert("RGB")
    small.thumbnail((pixels, pixels))
    packed = io.BytesIO()
    small.save(packed, "JPEG", quality=86)
    return Picture(name, data_uri("image/jpeg", packed.getvalue()), *small.size, False)


def data_uri(kind: str, data: bytes) -> str:
    """Data as an address that holds them."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def outputs_of(path: Path, stages: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The outputs of the stages of a record that lie in its run directory, whatever the record says."""
    home = path.resolve()
    found = []
    for stage in stages:
        for output in stage.get("outputs", ()):
            try:
                place = path.joinpath(*output_parts(output["path"])).resolve()
            except (SppmError, OSError, ValueError, TypeError, KeyError):
                continue
            # a record may name any file of this machine, and a report is mailed
            if place.is_relative_to(home):
                found.append(output)
    return found
