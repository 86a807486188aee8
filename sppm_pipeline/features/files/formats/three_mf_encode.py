"""3MF files written: a mesh in millimeters, once, and perhaps many components that place it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.files.formats.three_mf_model import CORE
from sppm_pipeline.services.formats.archive import Packed, packed, zipped
from sppm_pipeline.services.formats.decimals import Words, decimal_scale, face_rows, vertex_rows
from sppm_pipeline.services.formats.encoding import as_written, in_blocks

_VERTEX = Words.of(b'<vertex x="', b'" y="', b'" z="', b'"/>\n')
_TRIANGLE = Words.of(b'<triangle v1="', b'" v2="', b'" v3="', b'"/>\n')

_XML = b'<?xml version="1.0" encoding="UTF-8"?>\n'
_TYPES = _XML + (
    b'<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    b'<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    b'<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>\n'
)
_RELATIONS = _XML + (
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
) -> Iterator[bytes | memoryview]:
    """Write a mesh, (n, 3) in millimeters and (m, 3), piece by piece, as the core specification requires.

    Coordinates are rounded to 5e-10 of the power of ten above the largest one. Same mesh, same bytes, however many
    `threads` share the packing. `name` is that of the object; `metadata` are ``Title``, ``Description``,
    ``Application`` and other names that the core specification knows. With `offsets`, (k, 3) in mm, the mesh is written
    once and placed by k components. DesignError if the file would have 4 GiB or more.
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
            + f'<model unit="millimeter" xml:lang="en-US" xmlns="{CORE}">\n{about}<resources>\n'.encode()
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

    parts = (("[Content_Types].xml", small(_TYPES)), ("_rels/.rels", small(_RELATIONS)), ("3D/3dmodel.model", model))
    yield from zipped((path, pieces()) for path, pieces in parts)


def _components(offsets: NDArray[np.floating]) -> bytes:
    """A component for each place; shifts keep more digits than vertices, as copies must touch each other exactly."""
    lines = []
    for x, y, z in np.asarray(offsets, np.float64).tolist():
        lines.append(f'<component objectid="1" transform="1 0 0 0 1 0 0 0 1 {x!r} {y!r} {z!r}"/>\n')
    return "".join(lines).encode()
