"""``write.3mf_slices``: layers as the slice stack of a 3MF file."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import LayerWriter, SliceStack, option

SPACE = uuid.UUID("6f1f6d0a-6a51-5c3c-9a5e-0b9a5f9d8e11")
"""Names of parts become identifiers within this one."""


@dataclass(frozen=True, kw_only=True)
class WriteSlices(LayerWriter):
    """Write the layers as a 3MF file with a slice stack: for each layer, the outlines of its pixels.

    The mesh in the file is the box of the part only. Gray pixels are solid from 128.
    """

    name: ClassVar[str] = "write.3mf_slices"

    path: str = option("part.3mf", help="file or folder to write", output=True, suffixes=(".3mf",))

    def encode(self, image: NDArray[np.uint8], stack: SliceStack) -> bytes:
        from sppm_pipeline.numerics import outlines

        rings = outlines(image[::-1] >= 128)
        sizes = np.array([len(rings), *(len(ring) for ring in rings)], np.int32)
        return b"".join([sizes.tobytes(), *(ring.tobytes() for ring in rings)])

    def store(self, target: Path, stack: SliceStack, layers: Any) -> None:
        import lib3mf

        model = lib3mf.get_wrapper().CreateModel()
        model.SetUnit(lib3mf.ModelUnit.MilliMeter)
        low = stack.origin_mm
        slices = model.AddSliceStack(low[2])
        pixel = np.array(stack.pixel_mm)
        for number, data in enumerate(layers, 1):
            _add(lib3mf, slices.AddSlice(low[2] + number * stack.layer_mm), data, np.array(low[:2]), pixel)
        mesh = model.AddMeshObject()
        size = (*(pixel * stack.shape[:2]).tolist(), stack.shape[2] * stack.layer_mm)
        mesh.SetGeometry(*_box(lib3mf, low, size))
        mesh.SetName(target.stem)
        mesh.AssignSliceStack(slices)
        mesh.SetSlicesMeshResolution(lib3mf.SlicesMeshResolution.Lowres)
        item = model.AddBuildItem(mesh, lib3mf.get_wrapper().GetIdentityTransform())
        for what, owner, setter in (
            ("mesh", mesh, "SetUUID"),
            ("item", item, "SetUUID"),
            ("build", model, "SetBuildUUID"),
        ):
            getattr(owner, setter)(str(uuid.uuid5(SPACE, f"{target.name} {what}")))
        target.write_bytes(_bytes(model))


def _add(lib3mf: Any, layer: Any, data: bytes, low: NDArray[np.float64], pixel: NDArray[np.float64]) -> None:
    """Put the outlines that `encode` has packed into a slice."""
    numbers = np.frombuffer(data, np.int32)
    sizes = numbers[1 : 1 + numbers[0]].tolist()
    corners = low + numbers[1 + numbers[0] :].reshape(-1, 2) * pixel
    if not sizes:
        return
    layer.SetVertices([lib3mf.Position2D((x, y)) for x, y in corners.tolist()])
    start = 0
    for size in sizes:
        layer.AddPolygon([*range(start, start + size), start])
        start += size


def _box(lib3mf: Any, low: tuple[float, float, float], size: tuple[float, ...]) -> tuple[list[Any], list[Any]]:
    """Vertices and triangles of a box, wound outwards."""
    corners = [[low[a] + size[a] * (k >> a & 1) for a in range(3)] for k in range(8)]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return [lib3mf.Position(tuple(c)) for c in corners], [lib3mf.Triangle(t) for t in triangles]


def _bytes(model: Any) -> bytes:
    return bytes(model.QueryWriter("3mf").WriteToBuffer())
