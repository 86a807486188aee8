"""``read.cad``: the part to fill, from a STEP or IGES file, with its faces by name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, InputError, Length, Palette, Size, Stage, SurfaceMesh, option, options

MAX_FILE_BYTES = 2**28
"""Of a file that is read into memory, of which Open CASCADE takes some twenty times as much."""

MILLIMETERS = {
    "um": 1e-3, "µm": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3, "in": 25.4,
    "micrometre": 1e-3, "millimetre": 1.0, "centimetre": 10.0, "metre": 1e3, "inch": 25.4, "foot": 304.8, "ft": 304.8,
}  # fmt: skip
"""Units that files state, and those of the option `unit`."""

MAX_LISTED_FACES = 100
"""Faces that the run record lists."""


@dataclass(frozen=True, kw_only=True)
class ReadCad(Stage):
    """Read the solid bodies of a STEP or IGES file as triangles, with the faces of the CAD program by name.

    The triangles keep within `chord` of the faces, and the volume of each body within 0.05 % of the exact one: they are
    made smaller if need be. Edges are shared, so that each body is closed. Loose faces, as IGES has them, are sewn;
    those that enclose nothing (sheets) are left out with a warning, or refused if there is nothing else. Lengths are in
    the unit of the file; one that states none is refused unless `unit` is given.

    Faces are groups of the mesh, numbered as in the file: ``#12 cylinder hole d=5 color=#ff0000 body=plate
    name=seat``. Skins, loads and drains choose among them, all words together: ``holes``, ``cylinder d<6mm``, ``color
    red``, ``#12`` or ``face 12``, ``body plate``, ``name seat``. A hole is a concave cylinder or cone that goes all
    around; a concave fillet is none.
    """

    name: ClassVar[str] = "read.cad"

    path: Path = options.read_path(note=".step, .stp, .iges or .igs")
    chord: Length = option(
        Length(0.02), help="largest distance of the triangles from the faces", unit="mm", minimum=1e-4, maximum=1e3
    )
    angle: float = option(
        20.0, help="largest angle between neighboring triangles of a face", unit="degrees", minimum=1, maximum=60
    )
    bodies: tuple[str, ...] = option((), help="names or numbers, from 1, of the bodies to take; all if omitted")
    max_bodies: int = option(
        100, help="bodies that are taken without being named; an assembly has more of them", minimum=1, maximum=100_000
    )
    unit: str | None = options.unit(None, note="what the file states if omitted")
    turn: tuple[float, float, float] = options.turn((0.0, 0.0, 0.0))
    scale: float = options.scale(1.0, minimum=1e-9)
    place: str = option(
        "keep",
        help="where the part goes: as in the file, low corner at the origin, or standing centered on the origin",
        choices=("keep", "corner", "center"),
    )
    time_limit: float = options.time_limit(600.0)

    def estimate(self, palette: Palette) -> Size:
        raise LookupError("how many triangles a CAD file will have is unknown before it is read")

    def run(self, context: Context) -> SurfaceMesh:
        """Read the file in a child process, and place what is in it."""
        from sppm_pipeline import run_native
        from sppm_pipeline.nouns import ArraySpec
        from sppm_pipeline.numerics import rotated, rotation

        data, iges = _content(self.path)
        result = run_native(
            "sppm_cad.child:tessellated",
            {"data": data},
            {
                "name": self.path.name, "iges": iges, "bodies": list(self.bodies), "most": self.max_bodies,
                "chord": self.chord.mm() / self.scale, "angle": math.radians(self.angle),
            },
            returns={
                "vertices": ArraySpec("float64", (None, 3)), "faces": ArraySpec("int32", (None, 3)),
                "stretches": ArraySpec("int32", (None, 2)),
            },
            distribution="cadquery-ocp-novtk",
            seconds=self.time_limit,
            hint="export the part as another version of STEP, or as STL; `time_limit` gives more time",
            progress=context.progress,
        )  # fmt: skip
        said = result.values
        factor = self.scale * self._unit(context, said["units"])
        vertices = rotated(factor * result.arrays["vertices"], rotation(self.turn))
        if self.place != "keep":
            low, high = vertices.min(0), vertices.max(0)
            middle = (low + high) / 2
            vertices -= low if self.place == "corner" else np.array([*middle[:2], low[2]])
        groups = tuple(
            (_label(n, label, factor), int(first), int(last))
            for n, (label, (first, last)) in enumerate(zip(said["labels"], result.arrays["stretches"], strict=True), 1)
            if last > first
        )
        made = SurfaceMesh(vertices, result.arrays["faces"], self.path.name, groups)
        if not made.bounds_solid:
            raise InputError(
                f"{self.path.name}: the faces of its bodies do not meet", hint="heal the body in the CAD program"
            )
        if said["sheets"]:
            context.warn(
                f"{said['sheets']} parts of {self.path.name} are sheets that enclose nothing; they are left out"
            )
        exact = factor**3 * sum(said["volumes"])
        outer = made.outer_surface
        volume = float(made.summary()["volume_mm3"])
        context.report(
            bodies=len(said["bodies"]), faces=len(groups), holes=sum(label["hole"] for label in said["labels"]),
            unit=self.unit or said["units"][0], exact_volume_mm3=exact, volume_error=volume / exact - 1,
            groups=[name for name, _, _ in groups[:MAX_LISTED_FACES]],
        )  # fmt: skip
        return made if outer is None else made.with_volume(outer.volume)

    def _unit(self, context: Context, stated: list[str]) -> float:
        """What lengths are multiplied by that Open CASCADE has read as those of the file, in mm."""
        if not stated:
            if self.unit is None:
                raise InputError(f"{self.path.name} states no unit of length", hint="give `unit: mm` or `unit: in`")
            return MILLIMETERS[self.unit]  # they were taken for millimeters
        if self.unit is None:
            return 1.0
        if (known := MILLIMETERS.get(stated[0])) is None or len(stated) > 1:
            raise InputError(
                f"{self.path.name} states its units as {', '.join(stated)}; `unit` can't replace them",
                hint="leave out `unit`, and give `scale` if the size is wrong",
            )
        if known != MILLIMETERS[self.unit]:
            context.warn(f"{self.path.name} states its unit as {stated[0]}; `unit: {self.unit}` is taken instead")
        return MILLIMETERS[self.unit] / known


def _content(path: Path) -> tuple[NDArray[np.uint8], bool]:
    """Bytes of the file, and whether it is IGES; `InputError` if it is something else by name or content."""
    extension = path.suffix.lower()
    if extension not in (".step", ".stp", ".iges", ".igs"):
        raise InputError(f"{path.name} is no STEP or IGES file by its extension", hint="meshes are read by `read.mesh`")
    try:
        if not path.is_file() or path.stat().st_size > MAX_FILE_BYTES:
            raise InputError(f"{path} is no file of at most {MAX_FILE_BYTES} bytes", hint="export one part alone")
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    head = data[: 2**16].tobytes()
    iges = extension in (".iges", ".igs")
    if not len(data):
        raise InputError(f"{path.name} is empty")
    # IGES: letter and number of the section in columns 73 to 80
    if (b"ISO-10303-21" not in head) if not iges else head[72:73] not in (b"S", b"C", b"B"):
        raise InputError(f"{path.name} is no {'IGES' if iges else 'STEP'} file by its content", hint="export it again")
    return data, iges


def _label(number: int, label: dict[str, Any], factor: float) -> str:
    """What is known of a face in words, which conditions and skins choose by."""
    words = [f"#{number} {label['kind']}"]
    if label["hole"]:
        words.append("hole")
    if label["diameter"] is not None:
        words.append(f"d={factor * label['diameter']:.6g}")
    return " ".join(words + [f"{key}={label[key]}" for key in ("color", "body", "name") if label[key]])
