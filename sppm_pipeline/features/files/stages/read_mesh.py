"""``read.mesh``: the part to fill, from a mesh file."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, InputError, Length, Palette, Size, Stage, SurfaceMesh, option, options
from sppm_pipeline.nouns.length import UNITS_IN_MM
from sppm_pipeline.nouns.size import Geometry
from sppm_pipeline.services.arrays import F64, I32
from sppm_pipeline.services.formats.input_file import content_of, require_file

MAX_FILE_BYTES = 2 * 2**30
"""Bytes; larger files are refused before they are read."""

MAX_COORDINATE, MIN_SIZE = 1e9, 1e-6
"""Largest coordinate and smallest size of a part, mm; beyond, a unit is wrong or a file is broken."""

SUSPICIOUS_SIZE = 10.0
"""mm; a file without a unit whose part is smaller may be in inches, or in meters."""

MIN_THICKNESS = 1e-9
"""A part is flat if it is thinner than this share of its size, or encloses less than this share of its box."""

MIN_OVERLAP = 1e-4
"""Volume that shells share, as a fraction of all, below which a mesh only touches itself: slivers of a scan do."""

MAX_LISTED_GROUPS = 100
"""Names of groups that the run record lists."""

HEADER_BYTES, PROBED_TRIANGLES = 4096, 4096
"""Bytes at the start of a file that may state the number of triangles, and triangles that give the size of a part."""

TYPICAL_BYTES = {"stl": 260, "obj": 40, "ply": 19, "off": 35, "glb": 18, "3mf": 13}
"""Bytes of a triangle, and of the half vertex that comes with it, where no header states their number."""

TYPICAL_FILL, TYPICAL_COVER = 0.35, 0.8
"""Typical volume of a part as a fraction of its box, and surface as a fraction of the box's; those of a torus knot and
a bunny differ from it by less than a third."""


@dataclass(frozen=True, kw_only=True)
class ReadMesh(Stage):
    """Read an STL, OBJ, PLY, OFF, 3MF or GLB file, turn, scale and place it, and test whether it bounds a volume.

    The unit that a file or its format states is honored, and so is its upward axis: 3MF files name their unit, GLB
    files are in meters with y up; other formats are read if the library trimesh reads them. Then the mesh is
    turned, then scaled, then placed. Names of groups are kept (objects, groups and materials of OBJ, objects of 3MF,
    solids of an ASCII STL), so that `skin_groups` of `fill.implicit` can choose among them. Shells that are wound
    inside out are turned. The volume is that of the union of all shells; a mesh that does not close has none.
    """

    name: ClassVar[str] = "read.mesh"
    libraries: ClassVar[tuple[str, ...]] = ("trimesh",)
    advice: ClassVar[str] = "simplify the mesh"

    path: Path = options.read_path(note=".stl, .obj, .ply, .off, .3mf, .glb, or what trimesh reads besides")
    unit: str | None = options.unit(None, note="what the file states (3MF, GLB), or else mm, if omitted")
    up: str | None = option(
        None,
        help="axis of the file that points up and becomes z; y for GLB, as its specification says, else z if omitted",
        choices=("x", "y", "z"),
    )
    turn: tuple[float, float, float] = options.turn((0.0, 0.0, 0.0))
    scale: float | None = options.scale(None, minimum=1e-9)
    height: Length | None = option(
        None, help="scale the part to this size along z", unit="mm", minimum=1e-3, maximum=1e5
    )
    place: str = option(
        "keep",
        help="where the part goes: as in the file, low corner at the origin, or standing centered on the origin",
        choices=("keep", "corner", "center"),
    )
    accept: str = options.accept(
        "closed",
        note="closed: refuse a mesh with holes or faces wound against each other; any: pass it on with a warning, for "
        "`check.mesh` to say what is wrong, or for `fill.implicit` to determine whether it can still be filled",
        choices=("closed", "any"),
    )

    def check_options(self) -> None:
        if self.scale is not None and self.height is not None:
            raise ConfigError("`scale` and `height` exclude each other")

    def estimate(self, palette: Palette) -> Size:
        """From the header and some triangles of a binary STL, else from the length of the file and `height`."""
        triangles, extent = _probed(self.path)
        factor = (UNITS_IN_MM[self.unit] if self.unit else 1.0) * (self.scale or 1.0)
        if self.height is not None:
            extent = (1.0, 1.0, 1.0) if extent is None else extent
            factor = self.height.mm() / extent[2]
        if extent is None:
            return Size(triangles=triangles)
        x, y, z = (factor * side for side in extent)
        surface = TYPICAL_COVER * 2 * (x * y + y * z + z * x)
        part = Geometry(edge_mm=1.0, box=(x, y, z), volume=TYPICAL_FILL * x * y * z, envelope=surface)
        return Size(triangles=triangles, geometry=part)

    def run(self, context: Context) -> SurfaceMesh:
        """Read the file."""
        from sppm_pipeline.features.files.formats.detect import decode_mesh_file
        from sppm_pipeline.services.mesh.measures import edge_counts, volume
        from sppm_pipeline.services.mesh.orientation import orient
        from sppm_pipeline.services.mesh.rotation import rotated, rotation, upright

        file = decode_mesh_file(content_of(self.path, MAX_FILE_BYTES), self.path.name)
        faces = file.faces.astype(np.int32)
        file = file._replace(faces=np.empty((0, 3), np.int64))  # half of the memory is freed
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
        largest = float((upper - lower).max())
        if largest < SUSPICIOUS_SIZE and (self.unit, file.unit, self.scale, self.height) == (None,) * 4:
            context.warn(
                f"{self.path.name} states no unit, and in mm it is only {_sides(upper - lower)} mm in size; `unit: in` "
                f"would make it {_sides((upper - lower) * UNITS_IN_MM['in'])} mm; `unit: mm` says that it is right"
            )
        counts = edge_counts(faces)
        context.report(
            unit=self.unit or file.unit or "mm",
            mm_per_unit=mm,
            up=up,
            closed=counts.closed,
            boundary_edges=counts.boundary,
        )
        enclosed = math.nan  # the sum over the triangles of an open mesh depends on where it is
        # an open mesh has no inside: only one that is wound consistently is turned, and as a whole
        if counts.bounds_solid:
            wound = orient(vertices, faces)
            if wound.turned == len(faces):
                context.warn("the mesh was wound inside out; its faces have been turned")
            elif wound.turned:
                context.warn(f"{wound.turned} triangles belong to shells that were wound inside out; they were turned")
            faces = wound.faces
        elif counts.consistent and volume(vertices, faces) < 0:
            context.warn("the mesh was wound inside out; its faces have been turned")
            faces = faces[:, ::-1]
        made = SurfaceMesh(vertices, faces, self.path.name, file.groups)
        if not counts.bounds_solid:
            message = (
                f"{self.path.name} does not bound a volume: {counts.boundary} open edges, {counts.non_manifold} edges "
                f"of three or more triangles, {counts.unbalanced} edges where the winding does not match"
            )
            if self.accept == "closed":
                raise InputError(
                    message,
                    hint="repair the mesh; or give `accept: any`, to have `check.mesh` say what is wrong, "
                    "or `fill.implicit` determine whether it can be filled nevertheless",
                )
            context.warn(message)
        else:
            summed = volume(made.vertices, made.faces)
            enclosed = summed if made.outer_surface is None else made.outer_surface.volume
            if abs(summed - enclosed) <= MIN_OVERLAP * enclosed:
                enclosed = summed  # the sum is exact
            if enclosed <= MIN_THICKNESS * float((upper - lower).prod()):
                raise InputError(
                    f"{self.path.name} encloses nothing: its volume is {enclosed:g} mm3",
                    hint="are its faces there twice, back to back?",
                )
            if summed > enclosed:
                context.report(overlap_mm3=summed - enclosed)
        made = made.with_volume(enclosed)
        if file.groups:
            context.report(groups=list(dict.fromkeys(name for name, _, _ in file.groups))[:MAX_LISTED_GROUPS])
        return made


def _probed(path: Path) -> tuple[float, tuple[float, float, float] | None]:
    """Number of triangles and size of the box in a file, as far as they can be known without reading all of it."""
    length, extension = require_file(path, MAX_FILE_BYTES), path.suffix[1:].lower()
    if extension not in TYPICAL_BYTES:
        raise LookupError("how many triangles a file of this kind holds is unknown")
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES)
    count = int.from_bytes(header[80:84], "little") if extension == "stl" else 0
    if count and length == 84 + 50 * count:
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
        # a sample spread over the file gives the box; of its pages only some are read
        records = np.memmap(path, record, "r", 84)[:: max(1, count // PROBED_TRIANGLES)]
        corners = records["corners"].reshape(-1, 3).astype(np.float64)
        with np.errstate(invalid="ignore"):
            x, y, z = (corners.max(0) - corners.min(0)).tolist()
        return float(count), (x, y, z) if math.isfinite(x + y + z) else None
    found = re.search(rb"element face (\d+)" if extension == "ply" else rb"^OFF\s+\d+\s+(\d+)", header)
    return float(found[1]) if found else length / TYPICAL_BYTES[extension], None


def _sides(extent: F64) -> str:
    return " x ".join(f"{size:.4g}" for size in extent)


def _box(vertices: F64, faces: I32, name: str) -> tuple[F64, F64]:
    """Low and high corner of the triangles; InputError if the part is flat, or of a size that no part has."""
    from sppm_pipeline.services.mesh.measures import bounds

    lower, upper = bounds(vertices, faces)
    farthest = float(max(np.abs(lower).max(), np.abs(upper).max()))
    if not farthest <= MAX_COORDINATE:  # so is what is not a number
        raise InputError(
            f"{name} reaches to {farthest:g} mm; at most {MAX_COORDINATE:g} mm make sense",
            hint="check `unit` and `scale`",
        )
    extent = upper - lower
    shown = _sides(extent)
    if not extent.max() >= MIN_SIZE:
        raise InputError(f"{name} is as small as a point: its size is {shown} mm", hint="check `unit` and `scale`")
    if not extent.min() > MIN_THICKNESS * extent.max():
        raise InputError(f"{name} is flat: its size is {shown} mm", hint="a part encloses a volume")
    return lower, upper
