"""Files of a run in a report: its layers, as they are printed, and its pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from struct import error
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np

from sppm_pipeline.engine.config.names import output_parts
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.errors import SppmError
from sppm_pipeline.features.browser.live.page import encode_view
from sppm_pipeline.features.browser.live.structures import OVERVIEW
from sppm_pipeline.method.families.layer_writer import LayerWriter, StoredLayers
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.stage import Stage

MAX_LAYERS = 1500
"""Layers in a report; of more, every k-th is shown."""

MAX_PIXELS = 1024
"""Pixels along the longer side of a layer in a report; larger layers are reduced."""

PICTURE_PIXELS = 1000
"""Pixels along the longer side of a picture in a report."""

MAX_PICTURES = 24
MAX_OPENED = 2**26
"""Maximum number of pixels of a picture that is decoded, which takes 0.25 GB then."""

MAX_DECODED = 3 * 10**9
"""Pixels of layers that are decoded, about 10 s; of large displays, fewer layers are shown."""


class Layers(NamedTuple):
    """The layers of a run, as PNG files one after the other."""

    folder: str
    total: int  # of the run; the report may hold fewer
    numbers: list[int]  # which layers these are
    files: list[bytes]
    size: tuple[int, int]  # width and height in pixels, as printed
    reduced: int  # pixels of a layer along one of the pictures here
    exact: bool  # whether these are the files themselves
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


def stored_layers(
    path: Path, stages: Sequence[Mapping[str, Any]], registry: Registry
) -> tuple[str, StoredLayers] | None:
    """The first layers that a stage of a run has written and can read again, and where; None if there are none."""
    for stage in stages:
        outputs = outputs_of(path, [stage])
        try:
            kind = registry.get(str(stage["stage"])) if outputs else Stage
            if issubclass(kind, LayerWriter):
                name = str(outputs[0]["path"])
                found = kind.stored(path / name, stage["summary"], stage.get("options", {}))
                if found is not None and found.layers > 0:
                    return name, found
        except (SppmError, OSError, ValueError, KeyError, TypeError, BadZipFile):
            continue
    return None


def view_of_layers(stored: StoredLayers) -> bytes:
    """The view file of a part by its layers, for where nothing else is left of it: solid shares of blocks of pixels."""
    from PIL import Image

    lengths = np.multiply((*stored.size, stored.layers), (*stored.pixel_mm, stored.layer_mm))
    counts = np.rint(lengths * (OVERVIEW / lengths.prod()) ** (1 / 3))
    most = *stored.size, min(stored.layers, max(2, MAX_DECODED // stored.pixels))
    nx, ny, nz = np.clip(counts, 1, most).astype(int).tolist()
    void = np.full((nz + 2, ny + 2, nx + 2), 255, np.uint8)  # what ends at the border is seen to end
    for k in range(nz):
        image = stored.image(min(stored.layers - 1, int((k + 0.5) * stored.layers / nz)))
        small = Image.fromarray(np.ascontiguousarray(image)).resize((nx, ny), Image.Resampling.BOX)
        void[k + 1, 1:-1, 1:-1] = 255 - np.asarray(small)[::-1]
    step = lengths / (nx, ny, nz)
    head = {
        "kind": "grid", "title": "layers", "shape": [nx + 2, ny + 2, nz + 2], "cells": None, "edge_mm": None,
        "unit": "mm", "size": (lengths + 2 * step).tolist(), "origin": (np.array(stored.origin_mm) - step).tolist(),
        "level": 0.5, "top": 1.0, "base": 0.0, "level_name": "", "domain": False, "periodic": False, "porosity": None,
        "explore": None, "marks": [],
    }  # fmt: skip
    return encode_view(head, {"field": void})


def layers_of(name: str, stored: StoredLayers, budget: int) -> Layers | None:
    """Layers of at most `budget` bytes, evenly spread; None if they can't be read."""
    reduced = -(-max(stored.size) // MAX_PIXELS)
    exact = stored.png is not None and reduced == 1
    most = MAX_LAYERS if exact else min(MAX_LAYERS // 6, max(2, MAX_DECODED // stored.pixels))
    numbers = list(range(0, stored.layers, -(-stored.layers // most)))
    try:
        if stored.png is not None and reduced == 1:
            sizes = [len(stored.png(n)) for n in numbers]
            # every second, third... until they fit
            step = next((k for k in range(1, len(numbers)) if sum(sizes[::k]) <= budget), len(numbers))
            numbers = numbers[::step]
        read = [_layer(stored, number, reduced) for number in numbers]
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        IndexError,
        SyntaxError,
        BadZipFile,
        error,
    ):  # Pillow and struct raise those
        return None
    # sizes of reduced layers are known only when they are made: every second one goes until the rest fits
    while len(read) > 1 and sum(len(data) for data, _ in read) > budget:
        read, numbers = read[::2], numbers[::2]
    (px, py), (nx, ny) = map(float, stored.pixel_mm), stored.size
    x, y, z = map(float, stored.origin_mm)
    solid = np.array([share * nx * px * ny * py for _, share in read])
    files = [data for data, _ in read]
    return Layers(
        name, stored.layers, numbers, files, stored.size, reduced, exact, (px, py), stored.layer_mm,
        (x, y, z), solid,
    )  # fmt: skip


def _layer(stored: StoredLayers, number: int, reduced: int) -> tuple[bytes, float]:
    """A layer as PNG, and its solid share."""
    from PIL import Image

    image = stored.image(number)
    share = float(image.mean() / 255)
    if stored.png is not None and reduced == 1:
        return stored.png(number), share
    small = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).reduce(reduced).save(small, "PNG", optimize=True)
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
