"""``read.mesh``: the part to fill, from a mesh file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.estimate import Estimate, Given
from sppm_pipeline.data.length import UNITS_IN_MM, Length
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.formats.input_file import content_of
from sppm_pipeline.stage import Context, Stage, option

LARGEST_FILE = 2 * 2**30
"""Bytes; larger files are refused before they are read."""

FARTHEST, SMALLEST = 1e9, 1e-6
"""Largest coordinate and smallest size of a part, mm; beyond, a unit is wrong or a file is broken."""

FLAT = 1e-9
"""A part is flat if it is thinner than this share of its size, or encloses less than this share of its box."""

PROBED_FILE = 2**26
"""Bytes of the largest file that is read to foretell a run."""


@dataclass(frozen=True, kw_only=True)
class ReadMesh(Stage):
    """Read an STL, OBJ, PLY, OFF, 3MF or GLB file, turn, scale and place it, and judge whether it encloses a volume.

    The unit that a file or its format states is honoured, and so is its upward axis: 3MF files name their unit, GLB
    files are in metres with y up. Then the mesh is turned, then scaled, then placed.
    """

    name: ClassVar[str] = "read.mesh"

    path: Path = option(help="file to read: .stl, .obj, .ply, .off, .3mf or .glb")
    unit: str | None = option(
        None,
        help="unit of the coordinates in the file; what the file states (3MF, GLB), or else mm, if omitted",
        choices=tuple(UNITS_IN_MM),
    )
    up: str | None = option(
        None,
        help="axis of the file that points up and becomes z; y for GLB, as its specification says, else z if omitted",
        choices=("x", "y", "z"),
    )
    turn: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), help="angles about x, then y, then z", unit="degrees", minimum=-360, maximum=360
    )
    scale: float | None = option(None, help="factor of all lengths", minimum=1e-9, maximum=1e9)
    height: Length | None = option(
        None, help="scale the part to this size along z", unit="mm", minimum=1e-3, maximum=1e5
    )
    place: str = option(
        "keep",
        help="where the part goes: as in the file, low corner at the origin, or standing centered on the origin",
        choices=("keep", "corner", "center"),
    )
    accept: str = option(
        "closed",
        help="closed: refuse a mesh with holes or faces wound against each other; any: pass it on with a warning, "
        "for `check.mesh` to say what is wrong, or for `fill.implicit` to judge whether it can be filled all the same",
        choices=("closed", "any"),
    )

    def check_options(self) -> None:
        if self.scale is not None and self.height is not None:
            raise ConfigError("`scale` and `height` exclude each other")

    def estimate(self, given: Given) -> Estimate:
        """From the file itself, which is read: nothing else tells the size of the part."""
        from sppm_pipeline.formats.detect import decode_mesh_file
        from sppm_pipeline.numerics.meshcheck.measures import surface_area, volume
        from sppm_pipeline.numerics.surface.rotation import rotated, rotation, upright

        if self.path.stat().st_size > PROBED_FILE:
            return Estimate(memory=4 * self.path.stat().st_size, seconds=self.path.stat().st_size * 2e-8)
        file = decode_mesh_file(content_of(self.path, PROBED_FILE), self.path.name)
        faces, mm = file.faces, UNITS_IN_MM[self.unit] if self.unit is not None else file.mm
        vertices = rotated(file.vertices * mm, rotation(self.turn) @ upright(self.up or file.up))
        lower, upper = _box(vertices, faces, self.path.name)
        extent = upper - lower
        factor = float(self.height.mm() / extent[2]) if self.height is not None else self.scale or 1.0
        return Estimate(
            makes={
                "triangles": len(faces),
                "size_mm": tuple(float(v) for v in extent * factor),
                "volume_mm3": abs(volume(vertices, faces)) * factor**3,
                "area_mm2": surface_area(vertices, faces) * factor**2,
            },
            keeps=24 * len(vertices) + 12 * len(faces),
            memory=200 * len(faces),
            seconds=4e-7 * len(faces),
            advice="simplify the mesh",
        )

    def run(self, context: Context) -> SurfaceMesh:
        """Read the file."""
        from sppm_pipeline.formats.detect import decode_mesh_file
        from sppm_pipeline.numerics.meshcheck.measures import edge_counts, volume
        from sppm_pipeline.numerics.surface.rotation import rotated, rotation, upright

        file = decode_mesh_file(content_of(self.path, LARGEST_FILE), self.path.name)
        faces = file.faces
        mm = UNITS_IN_MM[self.unit] if self.unit is not None else file.mm
        if file.unit is not None and mm != file.mm:
            context.warn(f"{self.path.name} states its unit as {file.unit}; `unit: {self.unit}` is taken instead")
        up = self.up or file.up
        with np.errstate(over="ignore", invalid="ignore"):
            vertices = rotated(file.vertices * mm, rotation(self.turn) @ upright(up))
        lower, upper = _box(vertices, faces, self.path.name)
        factor = float(self.height.mm() / (upper - lower)[2]) if self.height is not None else self.scale or 1.0
        with np.errstate(over="ignore", invalid="ignore"):
            offset = {
                "keep": np.zeros(3),
                "corner": -lower * factor,
                "center": -np.array([(lower[0] + upper[0]) / 2, (lower[1] + upper[1]) / 2, lower[2]]) * factor,
            }[self.place]
            vertices = vertices * factor + offset
        lower, upper = _box(vertices, faces, self.path.name)
        counts, enclosed = edge_counts(faces), volume(vertices, faces)
        context.report(
            unit=self.unit or file.unit or "mm",
            mm_per_unit=mm,
            up=up,
            closed=counts.closed,
            boundary_edges=counts.boundary,
        )
        if counts.consistent and enclosed < 0:
            context.warn("the mesh was wound inside out; its faces have been turned")
            faces = faces[:, ::-1]
        if not counts.bounds_solid:
            message = (
                f"{self.path.name} does not bound a volume: {counts.boundary} open edges, {counts.non_manifold} edges "
                f"of three or more triangles, {counts.unbalanced} edges where the winding does not match"
            )
            if self.accept == "closed":
                raise InputError(
                    message,
                    hint="repair the mesh; or give `accept: any`, to have `check.mesh` say what is wrong, "
                    "or `fill.implicit` judge whether it can be filled all the same",
                )
            context.warn(message)
        elif abs(enclosed) <= FLAT * float((upper - lower).prod()):
            raise InputError(
                f"{self.path.name} encloses nothing: its volume is {enclosed:g} mm3",
                hint="are its faces there twice, back to back?",
            )
        return SurfaceMesh(vertices, faces.astype(np.int32), name=self.path.name)


def _box(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Low and high corner of the triangles.

    Raises
    ------
    InputError
        If the part is flat, or of a size that no part has.
    """
    from sppm_pipeline.numerics.meshcheck.measures import bounds

    lower, upper = bounds(vertices, faces)
    farthest = float(max(np.abs(lower).max(), np.abs(upper).max()))
    if not farthest <= FARTHEST:  # so is what is not a number
        raise InputError(
            f"{name} reaches to {farthest:g} mm; at most {FARTHEST:g} mm make sense", hint="check `unit` and `scale`"
        )
    extent = upper - lower
    shown = " x ".join(f"{size:g}" for size in extent)
    if not extent.max() >= SMALLEST:
        raise InputError(f"{name} is as small as a point: its size is {shown} mm", hint="check `unit` and `scale`")
    if not extent.min() > FLAT * extent.max():
        raise InputError(f"{name} is flat: its size is {shown} mm", hint="a part encloses a volume")
    return lower, upper
