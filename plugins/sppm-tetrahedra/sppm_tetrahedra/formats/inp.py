"""The input format of Abaqus and CalculiX: nodes, tetrahedra C3D4 or C3D10, sets, constraints, and a job."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import F64
from sppm_tetrahedra.formats.volume_arrays import as_written, integer_rows, number_rows

_TYPES = {4: "C3D4", 10: "C3D10"}
_A_LINE = 16
"""Numbers that a line of a set may hold."""


def encode(
    nodes: NDArray[np.floating],
    cells: NDArray[np.integer],
    materials: NDArray[np.integer],
    node_sets: Mapping[str, NDArray[np.integer]],
    standing: NDArray[np.integer] | None = None,
    comments: Sequence[str] = (),
) -> Iterator[bytes]:
    """An input file with the mesh, piece by piece; numbers in the file are one more than those in the arrays.

    Quadratic cells (m, 10) have mid-edge nodes in the order 01, 12, 02, 03, 13, 23, which is that of C3D10. Each
    material (m,) becomes an element set ``MATERIAL1``, ...; all elements together are ``SOLID``. Node sets are written
    in the order of the mapping, empty ones left out; comments are lines at the top.

    `standing` (n,) is for each node its representative in a periodic cell. The displacements of every other node are
    then tied to it: ``u(node) - u(representative) = sum over x, y, z of (copies apart) * u(REFX, REFY, REFZ)``, where
    the three reference nodes, each in a set of that name, are added behind the last node. Component i of the node of
    axis j is the displacement gradient du_i/dx_j times the edge of the cell along j.
    """
    points, corners, materials = as_written(nodes, cells, materials)
    n, per_cell = len(points), corners.shape[1]
    yield "".join(f"** {line}\n" for line in comments).encode()
    yield b"*NODE, NSET=NODES\n"
    yield from number_rows(points, ", ", first=1)
    if standing is not None:  # in the same block, as some readers keep one block only
        yield from number_rows(np.repeat(points.mean(axis=0)[None], 3, axis=0), ", ", first=n + 1)
    numbers = np.arange(1, len(corners) + 1)[:, None]
    for material in np.unique(materials):
        of_it = materials == material
        yield f"*ELEMENT, TYPE={_TYPES[per_cell]}, ELSET=MATERIAL{material}\n".encode()
        yield from integer_rows(np.concatenate([numbers[of_it], corners[of_it] + 1], axis=1), ", ")
    yield b"*ELSET, ELSET=SOLID\n" + "".join(f"MATERIAL{material}\n" for material in np.unique(materials)).encode()
    for name, members in node_sets.items():
        if len(members):
            yield f"*NSET, NSET={name}\n".encode()
            yield from _list(np.asarray(members) + 1)
    if standing is not None:
        yield from _constraints(points, np.asarray(standing), n)


def _list(numbers: NDArray[np.integer]) -> Iterator[bytes]:
    whole = len(numbers) // _A_LINE * _A_LINE
    yield from integer_rows(numbers[:whole].reshape(-1, _A_LINE), ", ")
    yield from integer_rows(numbers[whole:].reshape(1, -1), ", ")


def _constraints(points: F64, standing: NDArray[np.integer], n: int) -> Iterator[bytes]:
    tied = np.flatnonzero(standing != np.arange(n))
    apart = points[tied] - points[standing[tied]]
    edge = np.abs(apart).max(axis=0, initial=0)
    if not (edge > 0).all():
        raise ValueError("a periodic mesh has copies along x, y and z")
    steps = np.rint(apart / edge).astype(np.int64)
    yield b"** reference nodes: their displacements are the gradient of the mean displacement, times the cell's edge\n"
    for axis, name in enumerate("XYZ"):
        yield f"*NSET, NSET=REF{name}\n{n + 1 + axis}\n".encode()
    lines = ["*EQUATION"]
    for node, other, step in zip((tied + 1).tolist(), (standing[tied] + 1).tolist(), steps.tolist(), strict=True):
        moved = [(n + 1 + axis, -by) for axis, by in enumerate(step) if by]
        for i in (1, 2, 3):
            terms = [f"{node}, {i}, 1.", f"{other}, {i}, -1.", *(f"{ref}, {i}, {by}." for ref, by in moved)]
            lines.append(str(len(terms)))
            lines.extend(", ".join(terms[k : k + 4]) for k in range(0, len(terms), 4))
    yield ("\n".join(lines) + "\n").encode()


_LOADS = ((0, 0), (1, 1), (2, 2), (2, 1), (2, 0), (1, 0))
"""Reference node and component that carry the mean stresses xx, yy, zz, yz, xz, xy; the other three are held."""


def stiffness_job(
    moduli: Mapping[int, tuple[float, float]], standing: NDArray[np.integer], box: F64
) -> Iterator[bytes]:
    """Materials and six static steps behind a mesh whose copies are tied: a mean stress of one in each of them.

    The stresses are forces on the reference nodes, whose displacements over the edges of the cell are then the mean
    strains. Prescribed displacements would not do: CalculiX leaves the forces of equations out of reaction forces.
    Materials map to (Young's modulus, Poisson's ratio); the box (2, 3) is the low and high corner of the cell.
    """
    edges = [float(edge) for edge in box[1] - box[0]]
    lines = []
    for material, (young, poisson) in moduli.items():
        lines += [f"*MATERIAL, NAME=PHASE{material}", "*ELASTIC", f"{young!r}, {poisson!r}"]
        lines.append(f"*SOLID SECTION, ELSET=MATERIAL{material}, MATERIAL=PHASE{material}")
    held = int(np.flatnonzero(standing == np.arange(len(standing)))[0]) + 1
    lines += ["*NSET, NSET=REF", *(str(len(standing) + 1 + axis) for axis in range(3))]
    lines += ["** no rigid motion: one node, and the rotations of the mean gradient"]
    lines += ["*BOUNDARY", f"{held}, 1, 3", "REFX, 2, 3", "REFY, 3, 3"]
    for name, (axis, component) in zip(("XX", "YY", "ZZ", "YZ", "XZ", "XY"), _LOADS, strict=True):
        force = edges[0] * edges[1] * edges[2] / edges[axis]
        lines += [f"** a mean stress {name} of one", "*STEP", "*STATIC", "*CLOAD, OP=NEW"]
        lines += [f"REF{'XYZ'[axis]}, {component + 1}, {force!r}", "*NODE PRINT, NSET=REF", "U"]
        lines += ["*EL PRINT, ELSET=SOLID, TOTALS=ONLY", "ELSE", "*END STEP"]
    yield ("\n".join(lines) + "\n").encode()
