"""``write.png``: one picture a layer, as DLP and LCD printers expose them."""

from __future__ import annotations

import json
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.estimate import Estimate, Given
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.fields.slice_stack import SliceStack
from sppm_pipeline.stage import Context, Stage, option


@dataclass(frozen=True, kw_only=True)
class WritePng(Stage):
    """Write a folder of PNG files, white (255) where solid and black (0) elsewhere, with a manifest beside them.

    File ``00000.png`` is the lowest layer. The first row of a picture is the side of largest y, as one looks down on
    the build plate; the first column is the side of smallest x.
    """

    name: ClassVar[str] = "write.png"

    path: str = option("slices", help="folder to write", output=True)
    bits: int | None = option(
        None,
        help="bits of a pixel: 1 for black and white, 8 for gray; what the layers need if omitted",
        minimum=1,
        maximum=8,
    )
    sheet: int = option(
        6, help="layers shown together in an overview picture beside the folder; 0 for none", minimum=0, maximum=100
    )

    def check_options(self) -> None:
        if self.bits not in (None, 1, 8):
            raise ConfigError(f"`bits` is {self.bits}; PNG layers have 1 or 8")

    def estimate(self, given: Given) -> Estimate:
        from sppm_pipeline.numerics.forecast import costs

        stack = given["stack"]
        field, gray = stack["field"], stack["gray"]
        nx, ny, layers = stack["shape"]
        voxels, inside = nx * ny * layers * gray**2, stack["inside"] * gray**2
        patches = costs.patch_bytes(field.get("pieces", 1), field["reach"], stack["along"] * gray)
        kept = voxels / 8 if stack["two_passes"] and voxels <= 2**30 else 0
        passes = 2 if stack["two_passes"] and not kept else 1
        patched = stack["commensurate"] and field.get("cells", 1) > 4 * field.get("pieces", 1) and patches < 96 * 2**20
        slab = min(voxels, max(costs.SLAB_VOXELS, nx * ny * gray**2))
        black_and_white = costs.layer_bytes(stack["inside"], field["surface"], stack["along"])
        size = black_and_white * (6 if gray > 1 else 1) + costs.LAYER_BYTES * layers
        seconds = costs.field_seconds(inside, field["kernels"], patched=patched) * passes
        return Estimate(
            disk=size + 600 + (10e3 * self.sheet if self.sheet else 0),
            memory=kept + 8 * slab + (patches if patched else 0) + 5 * nx * ny * (self.sheet + 4),
            seconds=seconds + 4e-9 * voxels + 2e-4 * layers,
            voxels=voxels * passes,
            layers=layers,
            advice="slice with a larger `pixel` or `layer`",
        )

    def run(self, context: Context, stack: SliceStack) -> None:
        """Write layer after layer; encoding runs beside the evaluation of the next slab."""
        bits = self.bits or (8 if stack.gray else 1)
        if stack.gray and bits == 1:
            raise ConfigError(
                "one bit cannot hold the gray of these layers", hint="leave out `bits`, or slice with `gray: 1`"
            )
        folder = context.output(self.path)
        folder.mkdir(parents=True)
        nx, ny, nz = stack.shape
        digits = max(5, len(str(nz - 1)))
        shown = set(np.linspace(0, nz - 1, self.sheet + 2).round().astype(int)[1:-1].tolist()) if self.sheet else set()
        overview: list[NDArray[np.uint8]] = []
        total = 0
        waiting: deque[Future[int]] = deque()
        slabs = stack.slabs(context.threads)
        with ThreadPoolExecutor(max(1, context.threads)) as pool:
            for start, slab in slabs:
                for k, image in enumerate(slab, start):
                    upright = np.ascontiguousarray(image[::-1])
                    if k in shown:
                        overview.append(upright)
                    waiting.append(pool.submit(_write, folder / f"{k:0{digits}d}.png", upright, bits, stack.pixel_mm))
                    while len(waiting) > 4 * max(1, context.threads):
                        total += waiting.popleft().result()
                context.progress(min(start + len(slab), nz), nz, "layers")
            total += sum(job.result() for job in waiting)
        findings = slabs.findings
        manifest = {
            "format": 1,
            "layers": nz,
            "width_px": nx,
            "height_px": ny,
            "pixel_mm": stack.pixel_mm,
            "layer_mm": stack.layer_mm,
            "origin_mm": list(stack.origin_mm),
            "bits": bits,
            "first_file": f"{0:0{digits}d}.png",
            "solid_value": 255,
            "section": "mid-height of the layer",
            "row_0": "+y",
            "column_0": "-x",
            **findings,
        }
        (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
        context.report(bytes=total, layers=nz, **findings)
        if overview:
            from PIL import Image

            from sppm_pipeline.render.plates import layer_sheet

            Image.fromarray(layer_sheet(overview)).save(context.output(self.path.rstrip("/") + "-overview.png"))


def _write(path: Path, image: NDArray[np.uint8], bits: int, pixel_mm: float) -> int:
    from sppm_pipeline.formats.png import encode_layer

    data = encode_layer(image, bits=bits, pixel_mm=(pixel_mm, pixel_mm))
    path.write_bytes(data)
    return len(data)
