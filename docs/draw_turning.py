"""Draw the picture that turns on top of README.md: the part of `configs/quickstart.yaml` with a border, from all sides.

Usage: ``python docs/draw_turning.py`` writes docs/pictures/turning.png, an animated PNG.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from PIL import Image

import sppm_pipeline as sppm

ROOT = Path(__file__).resolve().parents[1]
FRAMES, SIZE, COLORS, PAUSE_MS = 54, (480, 320), 32, 110
"""A full turn in six seconds; more frames or colors exceed 2 MB, which the front page should stay below."""


def main() -> None:
    """Draw each frame by rays, then join them with the colors of the first."""
    border = {"fill.implicit.border": "round", "fill.implicit.thinnest": "0.3 mm"}
    part = sppm.run(str(ROOT / "configs" / "quickstart.yaml"), set=border, until="fill.implicit")["fill.implicit"]
    with tempfile.TemporaryDirectory() as folder:
        frames = []
        for number in range(FRAMES):
            name = f"{number:02d}.png"
            sppm.write.picture(
                part, path=name, azimuth=-180 + 360 * number / FRAMES, elevation=28.0, resolution=32,
                image_size=SIZE, annotate=False, output=folder,
            )  # fmt: skip
            frames.append(Image.open(Path(folder, name)).convert("RGB"))
    palette = frames[0].quantize(COLORS)
    first, *others = [frame.quantize(COLORS, palette=palette, dither=Image.Dither.NONE) for frame in frames]
    path = ROOT / "docs" / "pictures" / "turning.png"
    first.save(path, "PNG", save_all=True, append_images=others, duration=PAUSE_MS, loop=0, optimize=True)
    print(f"{path.name}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
