"""Gmsh's format MSH 4.1, as text: tetrahedra, the triangles of the faces of a box, physical groups, periodic copies.

Version 4.1 is what Gmsh itself writes and what meshio and converters to FEniCS read; the older 2.2 has no place for
copies of nodes that all readers agree on.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from sppm_tetrahedra.formats.volume_arrays import as_written, integer_rows, number_rows

_TETRAHEDRA = {4: 4, 10: 11}
_TRIANGLES = {3: 2, 6: 9}
_ORDER = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
"""Gmsh exchanges the nodes on the last two edges of a quadratic tetrahedron."""


def encode(
    nodes: NDArray[np.floating],
    cells: NDArray[np.integer],
    materials: NDArray[np.integer],
    surfaces: Mapping[str, NDArray[np.integer]],
    copies: Mapping[tuple[str, str], NDArray[np.integer]] | None = None,
) -> Iterator[bytes]:
    """A file, piece by piece; numbers in the file are one more than those in the arrays.

    Quadratic cells (m, 10) have mid-edge nodes in the order 01, 12, 02, 03, 13, 23; they are rearranged. Each material
    (m,) becomes a volume and a physical group ``material1``, ...; each name of triangles (k, 3) or (k, 6) a surface and
    a physical group, unless empty. `copies` maps a surface and its original to pairs (p, 2) of a node and that which it
    is a copy of.
    """
    points, corners, materials = as_written(nodes, cells, materials)
    if corners.shape[1] == 10:
        corners = corners[:, _ORDER]
    faces = {name: np.asarray(triangles) for name, triangles in surfaces.items() if len(triangles)}
    volumes = [int(material) for material in np.unique(materials)]
    yield b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
    groups = [f'2 {tag} "{name}"\n' for tag, name in enumerate(faces, 1)]
    groups += [f'3 {material} "material{material}"\n' for material in volumes]
    yield f"$PhysicalNames\n{len(groups)}\n{''.join(groups)}$EndPhysicalNames\n".encode()

    def extent(members: NDArray[np.integer]) -> str:
        used = points[np.unique(members)]
        return " ".join(repr(float(v)) for v in (*used.min(axis=0), *used.max(axis=0)))

    around = f"{len(faces)}{''.join(f' {tag}' for tag in range(1, len(faces) + 1))}"
    yield f"$Entities\n0 0 {len(faces)} {len(volumes)}\n".encode()
    for tag, triangles in enumerate(faces.values(), 1):
        yield f"{tag} {extent(triangles)} 1 {tag} 0\n".encode()
    for material in volumes:
        yield f"{material} {extent(corners[materials == material])} 1 {material} {around}\n".encode()
    yield b"$EndEntities\n"
    yield f"$Nodes\n1 {len(points)} 1 {len(points)}\n3 {volumes[0] if volumes else 1} 0 {len(points)}\n".encode()
    yield from integer_rows(np.arange(1, len(points) + 1)[:, None], " ")
    yield from number_rows(points, " ")
    total = len(corners) + sum(len(triangles) for triangles in faces.values())
    yield f"$EndNodes\n$Elements\n{len(faces) + len(volumes)} {total} 1 {total}\n".encode()
    done = 0
    blocks = [(2, tag, _TRIANGLES[t.shape[1]], t) for tag, t in enumerate(faces.values(), 1)]
    blocks += [(3, m, _TETRAHEDRA[corners.shape[1]], corners[materials == m]) for m in volumes]
    for dimension, tag, kind, elements in blocks:
        yield f"{dimension} {tag} {kind} {len(elements)}\n".encode()
        numbers = np.arange(done + 1, done + len(elements) + 1)[:, None]
        yield from integer_rows(np.concatenate([numbers, elements + 1], axis=1), " ")
        done += len(elements)
    yield b"$EndElements\n"
    tags = {name: tag for tag, name in enumerate(faces, 1)}
    links = [(key, pairs) for key, pairs in (copies or {}).items() if key[0] in tags and key[1] in tags and len(pairs)]
    if not links:
        return
    yield f"$Periodic\n{len(links)}\n".encode()
    for (name, original), pairs in links:
        shift = points[pairs[0, 0]] - points[pairs[0, 1]]
        rows = [[float(i == j) for j in range(3)] + [float(shift[i])] for i in range(3)] + [[0.0, 0.0, 0.0, 1.0]]
        yield f"2 {tags[name]} {tags[original]}\n16 {' '.join(repr(v) for row in rows for v in row)}\n".encode()
        yield f"{len(pairs)}\n".encode()
        yield from integer_rows(np.asarray(pairs) + 1, " ")
    yield b"$EndPeriodic\n"
