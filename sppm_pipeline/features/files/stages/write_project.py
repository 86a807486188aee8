"""``write.project``: parts of one object with settings of their own, for programs that slice for extruded filament."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

import sppm_pipeline
from sppm_pipeline import ConfigError, Context, DesignError, Length, Palette, Size, Stage, SurfaceMesh, option, options
from sppm_pipeline.features.files.formats.print_project import KINDS, LISTED, Body, Listed, listed
from sppm_pipeline.method.families.file_writer import ADVICE, require_triangles, write_pieces
from sppm_pipeline.services.formats.input_file import content_of

PORTS = ("body", "structure", "third", "fourth")

MAX_PROJECT_BYTES = 2**30

OBJECT = "object"
"""The name that settings for all parts begin with."""

ONE_WIDTH = {
    "perimeter_generator": "classic", "gap_fill_enabled": "0", "thin_walls": "0", "thick_bridges": "0",
}  # fmt: skip
"""Settings with which all lines of a kind are as wide as is set."""

LINES = ("external_perimeter", "perimeter", "infill", "solid_infill", "top_infill")

PER_NOZZLE = 1.125
"""Width of a line in diameters of the nozzle, as PrusaSlicer chooses it where nothing is set."""

_SETTING = re.compile(r"(?P<part>.+?)\s*:\s*(?P<key>[a-z][a-z0-9_]*)\s*=\s*(?P<value>\S.*?)\s*")


@dataclass(frozen=True, kw_only=True)
class WriteProject(Stage):
    """Write meshes as the parts of one object in a 3MF project that PrusaSlicer and OrcaSlicer open.

    A part has a name, a kind and settings of its own, such as its number of perimeters. Kinds are those of the two
    programs: a solid `part`; a `modifier`, which gives what lies in it other settings; a `negative` volume; a
    `support_blocker` or `support_enforcer`. Where solid parts overlap, the one at the earlier port is made, so that a
    skin at `body` stays whole where the structure runs into it. Settings have the names of PrusaSlicer; where
    OrcaSlicer has another name for one, both are written, and each program passes over the other's.

    With `nozzle`, lines are 1.125 times as wide as it, and none is narrower: perimeters are lines of one width
    (`perimeter_generator = classic`), gaps between them are not filled by thinner lines, and bridges are no thicker
    than layers. Solid thinner than a line is then left out by the slicing program: `check.sizes` with the same `nozzle`
    says how much there is.

    A project that was saved by PrusaSlicer is kept with `project`: its settings of printer, filament and print, of its
    object, and of parts that have the same names, and its parts that are no solid, where they stand. `settings`
    win over them. What is painted on its surfaces is lost, as these go. Give `read.mesh` the same file, and leave the
    part in its place.
    """

    name: ClassVar[str] = "write.project"
    advice: ClassVar[str] = ADVICE

    path: str = options.write_path("project.3mf", suffixes=(".3mf",))
    names: tuple[str, ...] = option(
        (), help="names of the parts, in the order of the ports; the names of these if omitted"
    )
    kinds: tuple[str, ...] = option(
        ("part",), help="kinds of the parts, in the order of the ports; one holds for all", choices=tuple(KINDS)
    )
    settings: tuple[str, ...] = option(
        (), help=f"'NAME: KEY = VALUE' each: a setting of PrusaSlicer for the part NAME, or for all if it is '{OBJECT}'"
    )
    nozzle: Length | None = option(
        None, help="diameter of the nozzle that extrudes filament; no line is narrower", unit="mm", above=0, maximum=100
    )
    project: Path | None = options.read_path(None, note="a 3MF project of PrusaSlicer whose settings are kept")
    title: str | None = options.title(None, note="the first part's name if omitted")

    def check_options(self) -> None:
        """Settings that can be read, and names to tell parts apart."""
        if len(set(self.names)) < len(self.names) or OBJECT in self.names:
            raise ConfigError(f"`names` are to be different, and none is '{OBJECT}', not {list(self.names)}")
        for text in (*self.names, *self.settings, self.title or ""):
            if not text.isprintable():
                raise ConfigError(f"{text!r} has characters that cannot be printed")
        for text in self.settings:
            if (found := _SETTING.fullmatch(text)) is None:
                raise ConfigError(
                    f"{text!r} in `settings` is none", hint="write for example 'structure: perimeters = 2'"
                )
            if self.names and found["part"] not in (*self.names, OBJECT):
                raise ConfigError(
                    f"{text!r} is a setting of a part that there is not",
                    hint=f"known: {', '.join((OBJECT, *self.names))}",
                )

    def estimate(
        self, palette: Palette, body: Size, structure: Size | None, third: Size | None, fourth: Size | None
    ) -> Size:
        return Size(triangles=sum(size.triangles for size in (body, structure, third, fourth) if size is not None))

    def run(
        self,
        context: Context,
        body: SurfaceMesh,
        structure: SurfaceMesh | None,
        third: SurfaceMesh | None,
        fourth: SurfaceMesh | None,
    ) -> None:
        """Put the parts into one mesh, list them, and write both."""
        from sppm_pipeline.features.files.formats.three_mf import encode, read_project

        given = [(port, mesh) for port, mesh in zip(PORTS, (body, structure, third, fourth), strict=True) if mesh]
        for what, values in (("names", self.names), ("kinds", self.kinds if len(self.kinds) > 1 else ())):
            if values and len(values) != len(given):
                raise ConfigError(f"`{what}` has {len(values)} entries for {len(given)} parts")
        names = self.names or tuple(port for port, _ in given)
        kinds = self.kinds if len(self.kinds) > 1 else self.kinds * len(given)
        if "part" not in kinds:
            raise ConfigError("no part is solid", hint="give one the kind `part`")
        meshes = []
        for _, mesh in given:
            require_triangles(mesh, self.path)
            meshes.append((mesh.vertices, mesh.faces))
        kept, others, beside = Listed(), [], {}
        if self.project is not None:
            taken = read_project(content_of(self.project, MAX_PROJECT_BYTES), self.project.name)
            kept, beside = taken.object, taken.beside
            others = [part for part in kept.bodies if part.kind != "part" and part.name not in names]
            own = taken.mesh[1].astype(np.int32)
            meshes += [(taken.mesh[0], own[part.first : part.last]) for part in others]
        wanted = self._settings(names)
        if self.nozzle is not None:
            width = f"{PER_NOZZLE * self.nozzle.mm():.6g}"
            kept.settings |= ONE_WIDTH | {f"{line}_extrusion_width": width for line in LINES}
        earlier = {part.name: part.settings for part in kept.bodies}
        parts = [Body(name, kind, earlier.get(name, {}), 0, 0) for name, kind in zip(names, kinds, strict=True)]
        # slicing programs make the last one where parts overlap
        order = list(range(len(given)))[::-1] + list(range(len(given), len(meshes)))
        parts, vertices, faces, first, base = [*parts, *others], [], [], 0, 0
        bodies = []
        for part, (points, triangles) in ((parts[i], meshes[i]) for i in order):
            last = first + len(triangles)
            bodies.append(Body(part.name, part.kind, {**part.settings, **wanted.get(part.name, {})}, first, last))
            used, corners = np.unique(triangles, return_inverse=True)
            vertices.append(points[used])
            faces.append((corners.reshape(-1, 3) + base).astype(np.int32))
            first, base = last, base + len(used)
        title = self.title or names[0]
        beside[LISTED] = listed(title, kept.settings | wanted.get(OBJECT, {}), bodies)
        about = {
            "Title": title,
            # OrcaSlicer looks for the name of that program here
            "Application": f"sppm_pipeline {sppm_pipeline.__version__}, a project for PrusaSlicer",
        }
        whole = np.concatenate(vertices), np.concatenate(faces)
        content = encode(*whole, threads=context.threads, name=title, metadata=about, beside=beside)
        size = write_pieces(context, self.path, content)
        context.report(
            bytes=size, triangles=len(whole[1]),
            parts=[{"name": body.name, "kind": body.kind, "triangles": body.last - body.first} for body in bodies],
        )  # fmt: skip

    def _settings(self, names: tuple[str, ...]) -> dict[str, dict[str, str]]:
        """What `settings` say, by part."""
        wanted: dict[str, dict[str, str]] = {}
        for text in self.settings:
            found = _SETTING.fullmatch(text)
            assert found is not None
            if found["part"] not in (*names, OBJECT):
                raise DesignError(
                    f"{text!r} is a setting of a part that there is not", hint=f"known: {', '.join((OBJECT, *names))}"
                )
            wanted.setdefault(found["part"], {})[found["key"]] = found["value"]
        return wanted
