"""Printer files against PNG layers in one run: processor time of encoding, and memory over the number of layers.

Usage: python -m benchmarks.printer_files [LAYERS ...]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from benchmarks.measure import pipeline_command, repeat_in_process, run, table

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
  - {{stage: read.primitive, shape: box, size: [130 mm, 74 mm, {height} mm]}}
  - {{stage: tile.wang_3color, cell: 5 mm}}
  - {{stage: fill.implicit, islands: keep}}
  - {{stage: slice.field, printer: elegoo_mars_4_dlp, layer: 0.05 mm}}
  - {{stage: {writer}, sheet: 0}}
"""


def encoders() -> None:
    """One layer of 3840 x 2400 pixels, smoothed noise of porosity 0.6, by each encoder."""
    import numpy as np
    from scipy.ndimage import gaussian_filter

    from sppm_pipeline.features.printing.stages import write_goo as goo
    from sppm_pipeline.services.formats import png

    noise = gaussian_filter(np.random.default_rng(1).standard_normal((2400, 3840)), 12.0, mode="wrap")
    layer = np.where(noise > np.quantile(noise, 0.6), np.uint8(255), np.uint8(0))
    rows = []
    for name, encode in (
        ("PNG", lambda: png.encode_layer(layer)),
        ("GOO", lambda: goo.encode_layer(layer, 0, 0, *layer.shape)),
        ("GOO on 11520 x 5120", lambda: goo.encode_layer(layer, 1000, 3000, 5120, 11520)),
        ("PNG of 8 bits", lambda: png.encode_layer(layer, bits=8)),
    ):
        seconds = repeat_in_process(encode)[1]
        rows.append([name, seconds * 1e3, seconds * 1e3 / (rows[0][1] if rows else seconds * 1e3), len(encode())])
    table("one layer of 3840 x 2400 pixels", ["encoder", "CPU ms", "over PNG", "bytes"], rows)


def files() -> None:
    """A full plate of a Mars 4 DLP: memory and time must not grow faster than the layers."""
    rows = []
    for layers in [int(v) for v in sys.argv[1:]] or [100, 200]:
        for writer in ("write.png", "write.goo"):
            with tempfile.TemporaryDirectory() as scratch:
                config = Path(scratch) / "plate.yaml"
                config.write_text(CONFIG.format(height=layers * 0.05, writer=writer))
                command = pipeline_command(config, scratch + "/run")
                rows.append([layers, writer, *run([*command, "--threads", "1"])])
    table("2560 x 1440 plate", ["layers", "writer", "wall s", "CPU s", "peak MB"], rows)


if __name__ == "__main__":
    encoders()
    files()
