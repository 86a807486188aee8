"""3MF, the format of 3D printing programs: meshes as XML in a ZIP archive, with a unit, components and items to build.

Read are the core specification and the parts of the production extension that say where an object lies. What is placed
where is determined here, the tables of the meshes in `three_mf_model`.
"""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.features.files.formats.print_project import LISTED, Body, Listed, read_listed, require_ranges
from sppm_pipeline.features.files.formats.three_mf_model import (
    CORE,
    UNITS_IN_MM,
    Model,
    Object,
    Use,
    XmlReader,
    read_model,
)
from sppm_pipeline.services.formats.archive import Archive, Packed, packed, zipped
from sppm_pipeline.services.formats.decimals import Words, decimal_scale, face_rows, vertex_rows
from sppm_pipeline.services.formats.encoding import as_written, in_blocks
from sppm_pipeline.services.formats.mesh_arrays import (
    DecodedMesh,
    GroupLog,
    Groups,
    Matrix,
    after,
    place,
    require_content,
    require_faces,
    require_few,
)

_VERTEX = Words.of(b'<vertex x="', b'" y="', b'" z="', b'"/>\n')
_TRIANGLE = Words.of(b'<triangle v1="', b'" v2="', b'" v3="', b'"/>\n')

_XML = b'<?xml version="1.0" encoding="UTF-8"?>\n'
_TYPES = _XML + (
    b'<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    b'<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    b'<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
)
_OTHER_TYPE = '<Default Extension="{}" ContentType="text/plain"/>'
_PACKAGE_RELATIONS = _XML + (
    b'<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    b'<Relationship Id="model" Target="/3D/3dmodel.model" '
    b'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>\n'
)


def encode(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    *,
    threads: int = 1,
    name: str = "mesh",
    metadata: Mapping[str, str] | None = None,
    offsets: NDArray[np.floating] | None = None,
    beside: Mapping[str, bytes] | None = None,
) -> Iterator[bytes | memoryview]:
    """Write a mesh, (n, 3) in millimeters and (m, 3), piece by piece, as the core specification requires.

    Coordinates are rounded to 5e-10 of the power of ten above the largest one. Same mesh, same bytes, however many
    `threads` share the packing. `name` is that of the object; `metadata` are ``Title``, ``Description``,
    ``Application`` and other names that the core specification knows. With `offsets`, (k, 3) in mm, the mesh is written
    once and placed by k components. `beside` are texts that are stored with the model, by their paths in the archive:
    those of a project of PrusaSlicer make the file one. DesignError if the file would have 4 GiB or more.
    """
    mesh = as_written(vertices, faces)
    scale = decimal_scale(mesh.largest)

    def vertex_block(rows: slice) -> Packed:
        return packed(vertex_rows(mesh.points[rows], scale, _VERTEX))

    def face_block(rows: slice) -> Packed:
        return packed(face_rows(mesh.faces[rows], 0, _TRIANGLE))

    def model() -> Iterator[Packed]:
        about = "".join(
            f"<metadata name={quoteattr(key)}>{escape(value)}</metadata>\n" for key, value in (metadata or {}).items()
        )
        yield packed(
            _XML
            + f'<model unit="millimeter" xml:lang="en-US" xmlns="{CORE}"{_PROJECT if beside else ""}>\n'.encode()
            + f"{_VERSION if beside else ''}{about}<resources>\n".encode()
            + f'<object id="1" type="model" name={quoteattr(name)}><mesh>\n<vertices>\n'.encode()
        )
        yield from in_blocks(len(mesh.points), vertex_block, threads)
        yield packed(b"</vertices>\n<triangles>\n")
        yield from in_blocks(len(mesh.faces), face_block, threads)
        yield packed(b"</triangles>\n</mesh></object>\n")
        if offsets is not None:
            yield packed(b'<object id="2" type="model"><components>\n')
            yield packed(_components(offsets))
            yield packed(b"</components></object>\n")
        item = 1 if offsets is None else 2
        yield packed(f'</resources>\n<build><item objectid="{item}"/></build>\n</model>\n'.encode())

    # entries are made one after the other, so that only one is in memory
    def small(content: bytes) -> Callable[[], Iterator[Packed]]:
        return lambda: iter([packed(content)])

    beside = dict(sorted((beside or {}).items()))
    others = sorted({posixpath.splitext(path)[1][1:] for path in beside})
    types = _TYPES + "".join(map(_OTHER_TYPE.format, others)).encode() + b"</Types>\n"
    parts = (
        ("[Content_Types].xml", small(types)),
        ("_rels/.rels", small(_PACKAGE_RELATIONS)),
        (_USUAL_MODEL, model),
        *((path, small(text)) for path, text in beside.items()),
    )
    yield from zipped((path, pieces()) for path, pieces in parts)


def _components(offsets: NDArray[np.floating]) -> bytes:
    """A component for each place; shifts keep more digits than vertices, as copies must touch each other exactly."""
    lines = []
    for x, y, z in np.asarray(offsets, np.float64).tolist():
        lines.append(f'<component objectid="1" transform="1 0 0 0 1 0 0 0 1 {x!r} {y!r} {z!r}"/>\n')
    return "".join(lines).encode()


_PROJECT = ' xmlns:slic3rpe="http://schemas.slic3r.org/3mf/2017/06"'
_VERSION = '<metadata name="slic3rpe:Version3mf">1</metadata>\n'
_RELATIONS = "_rels/.rels"
_USUAL_MODEL = "3D/3dmodel.model"
_RELATIONSHIP = "http://schemas.openxmlformats.org/package/2006/relationships Relationship"
_MODEL_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_SMALL_PART = 2**20
_MAX_PARTS = 4096
_LISTED_BYTES = 2**24
_OF_PROJECT = (
    "Metadata/Slic3r_PE.config", "Metadata/Slic3r_PE_layer_heights_profile.txt",
    "Metadata/Prusa_Slicer_layer_config_ranges.xml", "Metadata/Prusa_Slicer_custom_gcode_per_print_z.xml",
)  # fmt: skip
# settings for all of a project, and by height; what is painted on triangles is lost with them
_DEEPEST = 256  # components inside components
_SOLID = {"model", "surface"}  # objects of other types are supports and modifiers, not the part


def decode(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read what a file says is to be built, in its own unit; see `decode_with_unit`."""
    return decode_with_unit(data, name)[0]


def decode_with_unit(data: bytes | memoryview | bytearray, name: str) -> tuple[DecodedMesh, str, float, Groups]:
    """Read what a file says is to be built: all items, with their components and transformations, as one mesh.

    Objects that are supports are left out, and of a project of PrusaSlicer parts that only change settings or supports.
    Returned are the mesh ((n, 3), (m, 3)), its unit (``millimeter``,
    ``inch``...), that unit in millimeters, and the triangles of each copy of an object, or part of a project, that has
    a name. See `detect.decode_mesh` for what all readers take and raise.
    """
    require_content(data, name)
    return _built(_Package(Archive(data, name), name, solid=True), name)


class Project(NamedTuple):
    """A project of PrusaSlicer with one object: mesh and parts, in mm where it stands on the bed, and its settings."""

    mesh: DecodedMesh
    object: Listed
    beside: dict[str, bytes]  # printer, print and filament settings, by their paths in the archive


def read_project(data: bytes, name: str) -> Project:
    """Read a project; InputError if it does not have one object with a mesh and a list of parts, or is broken."""
    archive = Archive(data, name)
    package = _Package(archive, name, solid=False)
    mesh, _, mm, _ = _built(package, name)
    objects = list(package.listed.values())
    if len(objects) != 1 or len(package.meshes) != 1 or package.placed != 1:
        raise InputError(
            f"{name}: a project is taken over that has one object, once; this file lists {len(objects)} objects and "
            f"places {package.placed}",
            hint="save a project of one part in PrusaSlicer",
        )
    beside = {part: archive.read(part, _SMALL_PART) for part in _OF_PROJECT if part in archive}
    return Project((mesh[0] * mm, mesh[1]), objects[0], beside)


def _built(package: _Package, name: str) -> tuple[DecodedMesh, str, float, Groups]:
    root = package.root
    model = package.model(root)
    if not model.items:
        raise InputError(
            f"{name}: {root}: nothing is to be built; the file has {len(model.objects)} objects, but no item",
            hint="put the objects on the plate and save the file again",
        )
    copies: list[tuple[int, Matrix]] = []
    package.read_listed(root)
    package.count(root, model.items)
    for use in model.items:
        package.collect(root, use, copies)
    package.placed = len(copies)
    mesh = place(name, package.meshes, copies)
    require_faces(name, mesh[1])
    return mesh, model.unit, UNITS_IN_MM[model.unit], package.groups(copies)


class _Relations(XmlReader):
    target: str | None = None

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        if tag == _RELATIONSHIP and attributes.get("Type") == _MODEL_TYPE and self.target is None:
            self.target = attributes.get("Target")


class _Package:
    """The model parts of a file, each read once."""

    def __init__(self, archive: Archive, name: str, solid: bool) -> None:
        self._archive = archive
        self._name = name
        self._solid = solid  # parts of a project that are none are left out
        self.listed: dict[int, Listed] = {}
        self.placed, self._root = 0, ""
        self._models: dict[str, Model] = {}
        self._sizes: dict[tuple[str, int], tuple[int, int, int] | None] = {}
        self._numbers: dict[tuple[str, int], int] = {}
        self.meshes: list[DecodedMesh] = []
        self._groups: list[list[Body]] = []

    @property
    def root(self) -> str:
        """The part that holds the build."""
        if _RELATIONS in self._archive:
            relations = _Relations(self._name, _RELATIONS)
            relations.feed([self._archive.read(_RELATIONS, _SMALL_PART)])
            if relations.target is not None:
                return _normal(relations.target)
        if _USUAL_MODEL not in self._archive:
            raise InputError(
                f"{self._name}: this ZIP archive names no 3D model in {_RELATIONS}", hint="is it a 3MF at all?"
            )
        return _USUAL_MODEL

    def model(self, part: str) -> Model:
        """A model part."""
        if part not in self._models:
            if len(self._models) >= _MAX_PARTS:
                raise InputError(f"{self._name}: it is spread over more than {_MAX_PARTS} parts")
            model = read_model(self._archive.chunks(part), self._name, part)
            # `place` joins meshes by numbers alone, so that all parts must have one unit
            first = next(iter(self._models.values()), model)
            if model.unit != first.unit:
                raise InputError(f"{self._name}: {part}: its unit is {model.unit}, that of the file {first.unit}")
            self._models[part] = model
        return self._models[part]

    def read_listed(self, root: str) -> None:
        """Read which parts the objects of a project have, if it is one."""
        self._root = root
        if LISTED in self._archive:
            known = self.model(root).objects
            found = read_listed(self._archive.read(LISTED, _LISTED_BYTES), self._name)
            # an object of components has its parts elsewhere
            self.listed = {number: entry for number, entry in found.items() if number in known and entry.bodies}

    def count(self, part: str, uses: list[Use], depth: int = 0) -> tuple[int, int, int]:
        """Copies of objects, their vertices and triangles; what there are too many of is refused here."""
        copies = vertices = triangles = 0
        for use in uses:
            own, entry = self._object(part, use)
            key = (own, use.identifier)
            if key not in self._sizes:
                if depth > _DEEPEST:
                    raise InputError(f"{self._name}: components are nested more than {_DEEPEST} deep")
                # each object is counted once, however often it is used: nested components could stand for more than
                # fits anywhere
                self._sizes[key] = None  # being counted
                size = self.count(own, entry.components, depth + 1)
                own_size = (len(entry.mesh[0]), len(entry.mesh[1])) if entry.mesh is not None else (0, 0)
                size = (size[0] + 1, size[1] + own_size[0], size[2] + own_size[1])
                self._sizes[key] = size
            known = self._sizes[key]
            if known is None:
                raise InputError(f"{self._name}: {own}: object {use.identifier} is a component of itself")
            copies, vertices, triangles = (
                total + more for total, more in zip((copies, vertices, triangles), known, strict=True)
            )
        if depth == 0:
            require_few(self._name, copies, vertices, triangles)
        return copies, vertices, triangles

    def collect(self, part: str, use: Use, copies: list[tuple[int, Matrix]], outer: Matrix | None = None) -> None:
        """The copies of meshes that an object stands for, in the order of the file; `count` has bounded them."""
        own, entry = self._object(part, use)
        if entry.kind not in _SOLID:
            return
        # transformations of components apply inside those of the items that use them
        matrix = use.matrix if outer is None else after(outer, use.matrix)
        if entry.mesh is not None:
            key = (own, use.identifier)
            if key not in self._numbers:
                self._numbers[key] = len(self.meshes)
                mesh, groups = entry.mesh, [Body(entry.name, "part", {}, 0, len(entry.mesh[1]))]
                if own == self._root and use.identifier in self.listed and len(mesh[1]):
                    groups = self.listed[use.identifier].bodies
                    require_ranges(groups, len(mesh[1]), self._name)
                    mesh, groups = self._solid_parts(mesh, groups) if self._solid else (mesh, groups)
                self.meshes.append(mesh)
                self._groups.append(groups)
            copies.append((self._numbers[key], matrix))
        for component in entry.components:
            self.collect(own, component, copies, matrix)

    def groups(self, copies: list[tuple[int, Matrix]]) -> Groups:
        """The triangles of each copy of an object that has a name."""
        named, triangle = GroupLog(), 0
        for which, _ in copies:
            for body in self._groups[which]:
                named.begin("object", [body.name.encode()] if body.name else [], triangle + body.first)
            triangle += len(self.meshes[which][1])
        return named.groups(triangle)

    def _solid_parts(self, mesh: DecodedMesh, bodies: list[Body]) -> tuple[DecodedMesh, list[Body]]:
        """The mesh without parts that are no solid, and where in it the others are."""
        taken = next((body.name for body in bodies if body.kind == "negative"), None)
        if taken is not None:
            raise InputError(
                f"{self._name}: the part {taken!r} is a negative volume, which is to be cut out of the others",
                hint="cut it out in the slicing program or by `fill.combine`, or remove it there",
            )
        kept, first, faces = [], 0, [mesh[1][:0]]
        for body in bodies:
            if body.kind == "part":
                faces.append(mesh[1][body.first : body.last])
                kept.append(Body(body.name, body.kind, body.settings, first, first + len(faces[-1])))
                first += len(faces[-1])
        used, corners = np.unique(np.concatenate(faces), return_inverse=True)
        return (mesh[0][used], corners.reshape(-1, 3).astype(np.int64)), kept

    def _object(self, part: str, use: Use) -> tuple[str, Object]:
        own = part if use.part is None else _normal(use.part)
        entry = self.model(own).objects.get(use.identifier)
        if entry is None:
            raise InputError(f"{self._name}: {own}: there is no object {use.identifier}")
        return own, entry


def _normal(part: str) -> str:
    return posixpath.normpath("/" + part[:1000]).lstrip("/")
