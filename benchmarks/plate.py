"""A full resin plate of porous solid, 3840 x 2400 pixels: memory must not grow with the number of layers.

Usage: python -m benchmarks.plate [LAYERS ...]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from benchmarks.measure import pipeline_command, run, table

CONFIG = """
sppm: 1
name: plate
recipes:
  cell:
    - {{stage: sample.mirrored_faces, total: 68, share: 0.5}}
    - {{stage: sample.dart_throwing, total: 68}}
    - {{stage: connect.mbdst, mode: greedy}}
    - {{stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.03}}
pipeline:
  - {{stage: tileset.wang_3color, recipe: cell, porosity: 0.7}}
  - {{stage: read.primitive, shape: box, size: [192 mm, 120 mm, {height} mm]}}
  - {{stage: tile.wang_3color, cell: 5 mm}}
  - {{stage: fill.implicit, islands: {islands}}}
  - {{stage: slice.field, pixel: 0.05 mm}}
  - {{stage: write.png, path: slices, sheet: 0}}
"""
ADDRESS_SPACE = int(1.5 * 2**30)


def main() -> None:
    rows = []
    for layers in [int(v) for v in sys.argv[1:]] or [200, 400]:
        for islands in ("keep", "remove"):
            with tempfile.TemporaryDirectory() as scratch:
                config = Path(scratch) / "plate.yaml"
                config.write_text(CONFIG.format(height=layers * 0.05, islands=islands))
                command = pipeline_command(config, scratch + "/run")
                command += ["--threads", "1"]  # so that processor time is that of the work, not of waiting
                result = run(command, limit_bytes=ADDRESS_SPACE)
            voxels = layers * 3840 * 2400
            rows.append([layers, islands, voxels / 1e9, *result, result.cpu / voxels * 1e9])
    table(
        "3840 x 2400 plate within 1.5 GiB of address space",
        ["layers", "islands", "Gvoxel", "wall s", "CPU s", "peak MB", "CPU ns/voxel"],
        rows,
    )


if __name__ == "__main__":
    main()
