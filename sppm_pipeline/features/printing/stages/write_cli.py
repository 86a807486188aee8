"""``write.cli``: contours of the layers as Common Layer Interface, which machines for powder read.

The layout is that of version 2.0 of the format (Brite/EuRam project BE 2578, 1994): a header of lines, then layers and
closed polylines, as lines or as little-endian numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline import SliceStack, option, options
from sppm_pipeline.features.printing.contour_writer import ContourWriter
from sppm_pipeline.method.families.layer_writer import EncodedLayers
from sppm_pipeline.services.arrays import F64

START_LAYER, START_POLYLINE = 127, 130
"""Commands of the binary form with float32 heights and coordinates."""


@dataclass(frozen=True, kw_only=True)
class WriteCli(ContourWriter):
    """Write the contours of the layers as Common Layer Interface (.cli), in millimeters.

    The height of a layer is that of its upper side. Contours are closed polylines: outer ones counterclockwise
    (direction 1), those of holes clockwise (0). Coordinates are those of the part.
    """

    name: ClassVar[str] = "write.cli"

    path: str = options.write_path("part.cli", suffixes=(".cli",))
    binary: bool = option(False, help="numbers of 32 bits instead of text of six decimals")

    def encode_contours(self, rings: Sequence[F64], stack: SliceStack) -> bytes:
        closed = [np.vstack([ring, ring[:1]]) for ring in rings]
        outer = [int(area(ring) > 0) for ring in rings]
        if self.binary:
            return b"".join(
                START_POLYLINE.to_bytes(2, "little")
                + np.array([1, way, len(ring)], "<i4").tobytes()
                + ring.astype("<f4").tobytes()
                for way, ring in zip(outer, closed, strict=True)
            )
        return "".join(
            f"$$POLYLINE/1,{way},{len(ring)},{','.join(f'{value:.6f}' for value in ring.ravel().tolist())}\n"
            for way, ring in zip(outer, closed, strict=True)
        ).encode()

    def store(self, target: Path, stack: SliceStack, layers: EncodedLayers) -> None:
        (nx, ny, nz), low = stack.shape, stack.origin_mm
        high = [o + n * h for o, n, h in zip(low, (nx, ny, nz), (*stack.pixel_mm, stack.layer_mm), strict=True)]
        label = "".join(c if c.isascii() and c.isprintable() and c not in ",$" else "_" for c in target.stem)
        head = [
            "$$HEADERSTART", "$$BINARY" if self.binary else "$$ASCII", "$$UNITS/1.000000", "$$VERSION/200",
            f"$$LABEL/1,{label}", f"$$DIMENSION/{','.join(f'{value:.6f}' for value in (*low, *high))}",
            f"$$LAYERS/{nz:06d}", "$$HEADEREND",
        ]  # fmt: skip
        with target.open("wb") as file:
            # numbers follow the last word of the header at once
            file.write("\n".join(head).encode() + (b"" if self.binary else b"\n$$GEOMETRYSTART\n"))
            for number, data in enumerate(layers, 1):
                z = low[2] + number * stack.layer_mm
                if self.binary:
                    file.write(START_LAYER.to_bytes(2, "little") + np.array(z, "<f4").tobytes())
                else:
                    file.write(f"$$LAYER/{z:.6f}\n".encode())
                file.write(data)
            if not self.binary:
                file.write(b"$$GEOMETRYEND\n")


def area(ring: F64) -> float:
    """Area within a closed polyline (n, 2) whose first point is not repeated; negative if it is clockwise."""
    x, y = ring.T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(np.roll(x, -1), y)) / 2
