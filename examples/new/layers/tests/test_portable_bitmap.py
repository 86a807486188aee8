"""The writer keeps the contract of writers, and its own promises."""

from __future__ import annotations

import json

import numpy as np
from my_plugin.portable_bitmap import WriteBitmaps
from PIL import Image

import sppm_pipeline as sppm
from sppm_pipeline.testing.contracts import WriterContract
from sppm_pipeline.testing.plain_context import PlainContext

BALL = sppm.read.primitive(shape="ball", size=["3 mm", "3 mm", "3 mm"])
STACK = sppm.slice.mesh(BALL, pixel="0.25 mm")


class TestWriteBitmaps(WriterContract):
    def stages(self):
        return [WriteBitmaps(), WriteBitmaps(path="a/b", sheet=0)]

    def inputs(self):
        return {"stack": STACK}


def test_another_program_reads_what_is_written():
    context = PlainContext()
    WriteBitmaps().run(context, STACK)
    folder = context.directory / "layers"
    about = json.loads((folder / "manifest.json").read_text())
    files = sorted(folder.glob("*.pbm"))
    assert len(files) == about["layers"] == STACK.shape[2]
    pixels = [~np.asarray(Image.open(file)) for file in files]  # 1 is black there
    assert {image.shape for image in pixels} == {(about["height_px"], about["width_px"])}
    volume = sum(map(np.count_nonzero, pixels)) * np.prod(about["pixel_mm"]) * about["layer_mm"]
    assert np.isclose(volume, 4 / 3 * np.pi * 1.5**3, rtol=0.03)
