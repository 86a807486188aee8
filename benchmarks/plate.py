"""A full resin plate of porous solid, 3840 x 2400 pixels: memory must not grow with the number of layers.

python -m benchmarks.plate [LAYERS ...]
python -m benchmarks.plate wide [LAYERS]     # 15 000 x 6153 pixels of an Elegoo Jupiter 2, as the printer's file
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from benchmarks.measure import Run, pipeline_command, run, table

CONFIG = """
sppm: 1
name: plate
audit: warn  # a plate of a few layers has another porosity than its tiles
recipes:
  cell:
    - {{stage: sample.mirrored_faces, total: 68, share: 0.5}}
    - {{stage: sample.dart_throwing, total: 68}}
    - {{stage: connect.mbdst, mode: greedy}}
    - {{stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.03}}
pipeline:
  - {{stage: tileset.wang_3color, recipe: cell, porosity: 0.7}}
  - {{stage: read.primitive, shape: box, size: [{plate}, {height} mm]}}
  - {{stage: tile.wang_3color, cell: 5 mm}}
  - {{stage: fill.implicit, islands: {islands}}}
  - {{stage: slice.field, {pixel}}}
  - {{stage: {writer}, sheet: 0}}
"""
PLATE = {"plate": "192 mm, 120 mm", "pixel": "pixel: 0.05 mm", "writer": "write.png, path: slices"}
WIDE = {
    "plate": "300 mm, 160 mm", "pixel": "printer: elegoo_jupiter_2, layer: 0.05 mm",
    "writer": "write.goo, path: plate.goo",
}  # fmt: skip
ADDRESS_SPACE = int(1.5 * 2**30)


def measured(layers: int, islands: str, plate: dict[str, str], limit: int | None) -> Run:
    """One whole process, on one thread, so that processor time is that of the work, not of waiting."""
    with tempfile.TemporaryDirectory() as scratch:
        config = Path(scratch) / "plate.yaml"
        config.write_text(CONFIG.format(height=layers * 0.05, islands=islands, **plate))
        command = [*pipeline_command(config, scratch + "/run"), "--threads", "1"]
        return run(command, limit_bytes=limit)


def main(arguments: list[str]) -> None:
    head = ["layers", "islands", "Gvoxel", "wall s", "CPU s", "peak MB", "CPU ns/voxel"]
    wide = arguments[:1] == ["wide"]
    plate, pixels = (WIDE, 15000 * 6153) if wide else (PLATE, 3840 * 2400)
    rows = []
    for layers in [int(v) for v in arguments[wide:]] or ([32] if wide else [200, 400]):
        for islands in ("keep", "remove"):
            result = measured(layers, islands, plate, None if wide else ADDRESS_SPACE)
            voxels = layers * pixels
            rows.append([layers, islands, voxels / 1e9, *result, result.cpu / voxels * 1e9])
    table("15 000 x 6153 plate" if wide else "3840 x 2400 plate within 1.5 GiB of address space", head, rows)


if __name__ == "__main__":
    main(sys.argv[1:])
