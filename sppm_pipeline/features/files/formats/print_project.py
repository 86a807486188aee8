"""What PrusaSlicer keeps in a 3MF project beside the core specification: parts of an object, and settings.

A part is a range of the triangles of an object, listed in a file beside the model; without that list, solid parts and
the bodies that only change settings look alike. OrcaSlicer reads such projects too, with names of settings of its own;
both programs pass over names that they do not know.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import quoteattr

from sppm_pipeline.errors import InputError
from sppm_pipeline.features.files.formats.three_mf_model import XmlReader

LISTED = "Metadata/Slic3r_PE_model.config"
"""The part of the archive that lists the parts."""

KINDS = {
    "part": "ModelPart", "modifier": "ParameterModifier", "negative": "NegativeVolume",
    "support_blocker": "SupportBlocker", "support_enforcer": "SupportEnforcer",
}  # fmt: skip
"""Kinds of parts, and their names in the file."""

OF_ORCA = {
    "perimeters": "wall_loops", "fill_density": "sparse_infill_density", "fill_pattern": "sparse_infill_pattern",
    "top_solid_layers": "top_shell_layers", "bottom_solid_layers": "bottom_shell_layers",
    "perimeter_generator": "wall_generator", "thin_walls": "detect_thin_wall", "support_material": "enable_support",
    "external_perimeter_extrusion_width": "outer_wall_line_width",
    "perimeter_extrusion_width": "inner_wall_line_width", "infill_extrusion_width": "sparse_infill_line_width",
    "solid_infill_extrusion_width": "internal_solid_infill_line_width",
    "top_infill_extrusion_width": "top_surface_line_width",
}  # fmt: skip
"""Settings that OrcaSlicer calls otherwise; values mean the same."""

# of the mesh that was loaded, not of the one that takes its place
_OF_MESH = ("matrix", "source_", "mesh_", "name", "volume_type")


@dataclass(frozen=True)
class Body:
    """A part of an object: triangles first <= i < last, what they are, and settings for them."""

    name: str
    kind: str
    settings: Mapping[str, str]
    first: int
    last: int


@dataclass
class Listed:
    """An object of a project: settings for all of it, and its parts."""

    settings: dict[str, str] = field(default_factory=dict)
    bodies: list[Body] = field(default_factory=list)


def read_listed(data: bytes, name: str) -> dict[int, Listed]:
    """Objects of a project by their number in the model; InputError if the list is broken."""
    reader = _Reader(name, LISTED)
    reader.feed([data])
    return reader.objects


class _Reader(XmlReader):
    def __init__(self, name: str, part: str) -> None:
        super().__init__(name, part)
        self.objects: dict[int, Listed] = {}
        self._object = Listed()
        self._range = (0, 0)
        self._settings: dict[str, str] = {}

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        if tag == "object":
            self._object = self.objects.setdefault(self.number(attributes, "id"), Listed())
        elif tag == "volume":
            self._range = self.number(attributes, "firstid"), self.number(attributes, "lastid") + 1
            self._settings = {}
        elif tag == "metadata" and self.path:
            kept = self._settings if self.path[-1] == "volume" else self._object.settings
            kept[attributes.get("key", "")] = attributes.get("value", "")

    def end(self, tag: str) -> None:
        if tag != "volume":
            return
        word = self._settings.get("volume_type", "ModelPart")
        kind = next((kind for kind, written in KINDS.items() if written == word), None)
        if kind is None or self._settings.get("modifier") == "1":  # as versions before 2.0 wrote it
            kind = "modifier"
        name = self._settings.get("name", "")
        settings = {key: value for key, value in self._settings.items() if key and not key.startswith(_OF_MESH)}
        self._object.bodies.append(Body(name, kind, settings, *self._range))


def require_ranges(bodies: Sequence[Body], triangles: int, name: str) -> None:
    """Raise InputError for parts whose triangles the mesh does not have."""
    for body in bodies:
        if not body.first < body.last <= triangles:
            raise InputError(
                f"{name}: {LISTED}: the part {body.name!r} has the triangles {body.first} to {body.last - 1} of "
                f"{triangles}",
                hint="save the project again",
            )


def listed(name: str, settings: Mapping[str, str], bodies: Sequence[Body]) -> bytes:
    """The list of one object, number 1 in the model, with all settings under the names of both programs."""
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<config>", ' <object id="1" instances_count="1">']
    about = {key: value for key, value in settings.items() if not key.startswith(_OF_MESH)}
    lines += _lines("object", {"name": name} | _of_both(about))
    for body in bodies:
        lines.append(f'  <volume firstid="{body.first}" lastid="{body.last - 1}">')
        lines += _lines("volume", {"name": body.name, "volume_type": KINDS[body.kind]} | _of_both(body.settings))
        lines.append("  </volume>")
    return "\n".join([*lines, " </object>", "</config>", ""]).encode()


def _of_both(settings: Mapping[str, str]) -> dict[str, str]:
    orca = {OF_ORCA[key]: value for key, value in settings.items() if key in OF_ORCA}
    return {**settings, **{key: value for key, value in orca.items() if key not in settings}}


def _lines(kind: str, values: Mapping[str, str]) -> list[str]:
    return [
        f'   <metadata type="{kind}" key={quoteattr(key)} value={quoteattr(value)}/>' for key, value in values.items()
    ]
