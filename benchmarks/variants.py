"""The plate of ``examples/plate_of_variants.py``: what it takes, and whether its layers show twenty numbers.

Usage: ``python -m benchmarks.variants [--write] [RUN]``, with the folder of a finished run if there is one; `--write`
puts the table into docs/howto/printer-files.md and a
layer into docs/pictures/variants.png. The layers are read back from the print file. Parts that touch would be fewer
than twenty components of all layers laid on each other. A number is read where the grooves of its sample are more like
its strokes than like those of any other number, by correlation.
"""

from __future__ import annotations

import functools
import io
import json
import re
import runpy
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy import ndimage

from benchmarks.measure import between_marks
from sppm_pipeline.features.printing.numerics.lettering import HIGH, strokes
from sppm_pipeline.services.arrays import U8, Bools

ROOT = Path(__file__).resolve().parents[1]
PAGE, PICTURE = ROOT / "docs" / "howto" / "printer-files.md", ROOT / "docs" / "pictures" / "variants.png"
MARK = "<!-- benchmarks.variants -->\n"
LETTER_MM, STROKE_MM = 6.0, 0.8


def layers_of(path: Path) -> U8:
    """The images of an SL1 archive, (layers, rows, columns)."""
    with zipfile.ZipFile(path) as archive:
        names = sorted(name for name in archive.namelist() if re.search(r"\d{5}\.png$", name))
        return np.stack([np.asarray(Image.open(io.BytesIO(archive.read(name))).convert("L")) for name in names])


@functools.cache
def drawn(text: str, pixel_mm: float, shape: tuple[int, int]) -> Bools:
    """The grooves of a number in the middle of an image, rows from below."""
    across = [(np.arange(n) - (n - 1) / 2) * pixel_mm * HIGH / LETTER_MM for n in shape]
    y, x = np.meshgrid(*across, indexing="ij")
    near = np.full(shape, np.inf)
    for a, b in strokes(text):
        way = b - a
        share = np.clip(((x - a[0]) * way[0] + (y - a[1]) * way[1]) / max(float(way @ way), 1e-12), 0, 1)
        near = np.minimum(near, np.hypot(x - a[0] - share * way[0], y - a[1] - share * way[1]))
    return near < STROKE_MM / 2 * HIGH / LETTER_MM


def turned(image: U8 | Bools, way: int) -> U8 | Bools:
    """An image in one of the eight ways in which a printer may turn and mirror it."""
    return np.rot90(image, way % 4)[:, :: 1 if way < 4 else -1]


def read_numbers(layers: U8, pixel_mm: float, count: int) -> tuple[int, list[tuple[int, float, float]], int]:
    """Components of all layers together, the number of each with its correlation and that of the next best, and the
    way in which images are turned: that in which numbers are read best."""
    labels, parts = ndimage.label((layers >= 128).any(0))
    below = layers[-4]  # within the grooves
    best: list[tuple[int, float, float]] = []
    best_way = 0
    for way in range(8):
        found = []
        for rows, columns in ndimage.find_objects(labels):
            tile = turned(below[rows, columns][1::3, 1::3] < 128, way)
            scores = [
                float(np.corrcoef(tile.ravel(), drawn(f"{n:02d}", 3 * pixel_mm, tile.shape).ravel())[0, 1])
                for n in range(1, count + 1)
            ]
            order = np.argsort(scores)
            found.append((int(order[-1]) + 1, scores[order[-1]], scores[order[-2]]))
        if not best or sum(score for _, score, _ in found) > sum(score for _, score, _ in best):
            best, best_way = found, way
    return parts, best, best_way


def main() -> None:
    """Make the plate, read it back, and print what was found."""
    given = [word for word in sys.argv[1:] if word != "--write"]
    folder = Path(given[0] if given else tempfile.mkdtemp(prefix="variants-"))
    example: dict[str, Any] = runpy.run_path(str(ROOT / "examples" / "plate_of_variants.py"))
    count = len(example["POROSITIES"]) * len(example["CELLS_MM"])
    if not given:
        example["plate"]().run(folder)
    stages = json.loads((folder / "run.json").read_text("utf-8"))["stages"]
    n = next(stage["summary"] for stage in stages if stage["stage"] == "check.print")
    layers = layers_of(folder / "plate.sl1")
    parts, found, way = read_numbers(layers, 0.05, count)
    read = sorted(number for number, *_ in found)
    lead = min(score - other for _, score, other in found)
    rows = [
        "| samples | apart | numbers read | least correlation, lead over the next best | resin | time | price |",
        "|---|---|---|---|---|---|---|",
        f"| {count} | {parts} | {len(set(read))} | {min(score for _, score, _ in found):.2f}, {lead:.3f} | "
        f"{n['resin_g']:.0f} g, {n['resin_ml']:.0f} ml | {n['print_time_s'] / 3600:.1f} h | {n['price']:.2f} |",
    ]
    table = "\n".join(rows) + "\n"
    print(table, read)
    if "--write" in sys.argv:
        rows_used, columns_used = (np.flatnonzero((layers[-4] >= 128).any(axis)) for axis in (1, 0))
        image = layers[-4][rows_used[0] - 20 : rows_used[-1] + 20, columns_used[0] - 20 : columns_used[-1] + 20]
        picture = Image.fromarray(turned(image, way)[::-1]).reduce(2)
        picture.quantize(8).save(PICTURE, optimize=True)
        between_marks(PAGE, MARK, table)


if __name__ == "__main__":
    main()
