"""Draw the pictures of `docs/pictures/hero-*.png`: parts from primitives in one material each.

Usage: ``python docs/draw_heroes.py [--size 2400]`` writes them, 1200 pixels wide if no size is given, and prints the
seconds of processor time of each picture.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

from PIL import Image

import sppm_pipeline as sppm

ROOT = Path(__file__).resolve().parents[1]
CELL = [
    {"stage": "sample.dart_throwing", "total": 72, "share": 0.55},
    {"stage": "connect.mbdst", "degree": [3, 5], "mode": "greedy"},
    {"stage": "field.gaussian", "pore_radius": 0.11, "tunnel_radius": 0.03},
]
HEROES: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    "cage": (
        {"shape": "cylinder", "size": ["22 mm", "22 mm", "12 mm"]}, {"skin": "0.9 mm"},
        {"material": "titanium", "section": 0.5, "section_along": "corner", "cut": "plain", "azimuth": -52.0},
    ),
    "knot": (
        {"shape": "torus_knot", "size": ["30 mm", "30 mm", "15 mm"]}, {}, {"material": "resin", "elevation": 30.0},
    ),
    "ball": (
        {"shape": "ball", "size": ["24 mm", "24 mm", "24 mm"]}, {},
        {"material": "bone", "section": 0.5, "section_along": "corner", "azimuth": -48.0, "background": "dark"},
    ),
}  # fmt: skip
"""Name -> options of the primitive, of the filling, and of the picture."""


def main() -> None:
    """Fill each primitive with scattered pores, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=1200, help="width in pixels")
    width = parser.parse_args().size
    for name, (shape, filling, view) in HEROES.items():
        body = sppm.read.primitive(**shape)
        cells = sppm.tile.scattered(body, recipe=CELL, cell="4 mm", porosity=0.7, seed=7)
        part = sppm.fill.implicit(cells, body, **filling)
        began = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            sppm.write.picture(
                part, path="hero.png", image_size=(width, width * 3 // 4), resolution=48, shadow=True, annotate=False,
                output=folder, **view,
            )  # fmt: skip
            picture = Image.open(Path(folder, "hero.png")).convert("RGB")
        path = ROOT / "docs" / "pictures" / f"hero-{name}.png"
        picture.quantize(192, dither=Image.Dither.FLOYDSTEINBERG).save(path, "PNG", optimize=True)
        print(f"{path.name}: {time.process_time() - began:.1f} CPU-s, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
