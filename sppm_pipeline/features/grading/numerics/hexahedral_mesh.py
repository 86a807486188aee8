"""Meshes of hexahedra of any shape: checks, boundary, refinement.

Proof by Bernstein coefficients, not samples, that a trilinear hexahedron is nowhere inside out.

The determinant of the derivative is a polynomial of degree two along each axis. It lies between the least and the
largest of its 27 Bernstein coefficients, of which those at the corners are its values there (Johnen, Remacle and
Geuzaine 2013). Where the least one is not above a bound and no corner is below it, the hexahedron is halved, upon
which coefficients come nearer to the values, by a factor of four each time that all axes are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.features.grading.numerics.hexahedral_places import points_in
from sppm_pipeline.services.arrays import F64, I32, I64, Bools

_BETWEEN = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])  # from the values at two ends to those at 0, 1/2 and 1
_COEFFICIENTS = np.array([[1.0, 0.0, 0.0], [-0.5, 2.0, -0.5], [0.0, 0.0, 1.0]])  # from these to those of Bernstein
_HALVES = (
    np.array([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.25, 0.5, 0.25]]),
    np.array([[0.25, 0.5, 0.25], [0.0, 0.5, 0.5], [0.0, 0.0, 1.0]]),
)

_LEVELS = 30
"""Halvings at most, ten along each axis or more along one. What is undecided then is within some millionths of its
range of the bound, and counts as below.
"""

_MAX_PARTS = 512
"""Parts of a hexahedron that may be undecided at the same time; more are where it is flat along a face."""

_AT_ONCE, _HALVED_AT_ONCE = 4096, 64


def determinant_coefficients(corners: F64) -> F64:
    """Bernstein coefficients of the determinant of hexahedra (m, 2, 2, 2, 3), (m, 3, 3, 3) by x, y, z."""
    w = _BETWEEN
    along_x = np.einsum("jb,kc,mbcv->mjkv", w, w, corners[:, 1] - corners[:, 0])[:, None]
    along_y = np.einsum("ia,kc,macv->mikv", w, w, corners[:, :, 1] - corners[:, :, 0])[:, :, None]
    along_z = np.einsum("ia,jb,mabv->mijv", w, w, corners[:, :, :, 1] - corners[:, :, :, 0])[:, :, :, None]
    # 27 values determine a polynomial of degree two along each axis
    values = (along_x * np.cross(along_y, along_z)).sum(axis=-1)
    c = _COEFFICIENTS
    return np.asarray(np.einsum("ia,jb,kc,mabc->mijk", c, c, c, values, optimize=True))


def largest_determinants(corners: F64) -> F64:
    """Upper bounds of the determinant of the derivative in hexahedra (m, 2, 2, 2, 3), (m,)."""
    parts = [
        determinant_coefficients(corners[first : first + _AT_ONCE]).max(axis=(1, 2, 3))
        for first in range(0, len(corners), _AT_ONCE)
    ]
    return np.concatenate([np.zeros(0), *parts])


def above_throughout(corners: F64, bounds: F64) -> Bools:
    """Which hexahedra (m, 2, 2, 2, 3) have a determinant of the derivative above their bound (m,) everywhere; not also
    where it is so close to the bound that a few hundred parts do not decide.
    """
    above = np.ones(len(corners), bool)
    for first in range(0, len(corners), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        excess = determinant_coefficients(corners[some]) - bounds[some, None, None, None]
        undecided = np.flatnonzero((excess <= 0).any(axis=(1, 2, 3)))
        for begin in range(0, len(undecided), _HALVED_AT_ONCE):
            chosen = undecided[begin : begin + _HALVED_AT_ONCE]
            above[first + chosen] = _positive(excess[chosen])
    return above


def _positive(coefficients: F64) -> Bools:
    """Test whether polynomials (m, 3, 3, 3) are positive throughout, by halving."""
    positive, owner = np.ones(len(coefficients), bool), np.arange(len(coefficients))
    for level in range(_LEVELS + 1):
        positive[owner[(coefficients[:, ::2, ::2, ::2] <= 0).any(axis=(1, 2, 3))]] = False
        unsure = (coefficients <= 0).any(axis=(1, 2, 3)) & positive[owner]
        positive &= np.bincount(owner[unsure], minlength=len(positive)) <= _MAX_PARTS
        unsure &= positive[owner]
        coefficients, owner = coefficients[unsure], owner[unsure]
        if level == _LEVELS or not len(owner):
            break
        # coefficients differ from values by the second differences: halved is the axis of the largest one
        bent = [np.abs(np.diff(coefficients, 2, axis)).max(axis=(1, 2, 3)) for axis in (1, 2, 3)]
        longest = np.argmax(bent, axis=0)
        halves, owners = [], []
        for axis in range(3):
            own = np.flatnonzero(longest == axis)
            along = np.moveaxis(coefficients[own], 1 + axis, 3)
            halves += [np.moveaxis(along @ half.T, 3, 1 + axis) for half in _HALVES]
            owners += [owner[own]] * 2
        coefficients, owner = np.concatenate(halves), np.concatenate(owners)
    positive[owner] = False
    return positive


PLACES = np.array([0, 4, 3, 7, 1, 5, 2, 6])
"""Node in VTK's order, which meshio gives, at each place of a hexahedron: x, y, z low or high, z fastest."""

_ORDERS = {
    "": [0, 1, 2, 3, 4, 5, 6, 7],
    "with the upper four nodes first": [4, 5, 6, 7, 0, 1, 2, 3],
    "row by row, as voxels are": [0, 1, 3, 2, 4, 5, 7, 6],
    "row by row from above": [4, 5, 7, 6, 0, 1, 3, 2],
}
"""Orders in which programs number nodes, by what they are called, and the nodes in VTK's order."""

_FACES = np.array([[0, 4, 7, 3], [1, 2, 6, 5], [0, 1, 5, 4], [3, 7, 6, 2], [0, 3, 2, 1], [4, 5, 6, 7]])
"""Nodes of the low and high faces of each axis in VTK's order, their normals out of the hexahedron."""

SAME = 1e-6
"""Nodes nearer to each other than this share of the shortest edge are one: files often list them once an element."""

_FLAT = 1e-9
"""A determinant of the derivative counts as positive above so much of the cube of a hexahedron's length."""

_ON_FACE = 1e-3
"""A node so near to a face, in its size, that is no corner of it hangs."""


class HexahedralMesh(NamedTuple):
    """Hexahedra that meet node by node."""

    corners: F64  # (m, 2, 2, 2, 3), nodes by x, y, z of each hexahedron, which are right-handed
    hexahedra: I64  # (m, 8), their nodes in VTK's order; nodes at the same place are one
    listed: I64  # (m, 8), the same nodes as the file numbers them, which may list one several times
    boundary: I64  # (f, 4), nodes of the faces at which the mesh ends, normals outwards
    nodes: F64  # (n, 3)
    turned: str  # order of the nodes in the file, if it is not the expected one


def checked_mesh(points: F64, hexahedra: I64) -> HexahedralMesh:
    """A mesh of `points` (n, 3) and hexahedra (m, 8), if they fill a body face to face.

    Nodes are in VTK's order, or one of some others that programs use, all in the same. `ValueError` if a hexahedron is
    flat or inside out anywhere or listed twice, three meet at a face, or nodes hang.
    """
    listed = hexahedra
    hexahedra, nodes = _joined(points, hexahedra)
    turned, order = _order_of(nodes, hexahedra)
    hexahedra = hexahedra[:, order]
    corners = corners_of(nodes, hexahedra)
    _check_inside(corners, nodes, hexahedra)
    _check_listed_once(hexahedra)
    boundary = _boundary(hexahedra)
    _check_hanging(nodes, boundary)
    return HexahedralMesh(corners, hexahedra, listed[:, order], boundary, nodes, turned)


def corners_of(nodes: F64, hexahedra: I64) -> F64:
    """Nodes by x, y, z of hexahedra (m, 8) in VTK's order, (m, 2, 2, 2, 3)."""
    return nodes[hexahedra[:, PLACES]].reshape(-1, 2, 2, 2, 3)


def _joined(points: F64, hexahedra: I64) -> tuple[I64, F64]:
    """The mesh with nodes at the same place made one, and without others than those of hexahedra."""
    from scipy.spatial import cKDTree

    used, numbered = np.unique(hexahedra, return_inverse=True)
    nodes, hexahedra = points[used], numbered.reshape(-1, 8)
    ends = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]])
    lengths = np.linalg.norm(np.diff(nodes[hexahedra[:, ends]], axis=2)[:, :, 0], axis=2)
    # edges without length are a matter of the orders below
    shortest = float(lengths[lengths > 0].min(initial=np.inf))
    if not np.isfinite(shortest):
        raise ValueError("all nodes of the hexahedra lie in one place")
    pairs = cKDTree(nodes).query_pairs(SAME * shortest, output_type="ndarray")
    if not len(pairs):
        return hexahedra, nodes
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(nodes)
    _, label = connected_components(coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n)), directed=False)
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    return number[hexahedra], nodes[first]


def _order_of(nodes: F64, hexahedra: I64) -> tuple[str, list[int]]:
    """The order of nodes in which all hexahedra are right-handed; an error that names one if there is none."""
    worst = 0
    for turned, order in _ORDERS.items():
        corners = corners_of(nodes, hexahedra[:, order])
        # coefficients at the corners are the values there
        at_corners = determinant_coefficients(corners)[:, ::2, ::2, ::2]
        wrong = (at_corners <= _flat(corners)[:, None, None, None]).any(axis=(1, 2, 3))
        if not wrong.any():
            return turned, order
        if not turned:
            worst, count = int(np.argmax(wrong)), int(wrong.sum())
    raise ValueError(
        f"hexahedron {worst} is inside out or flat at a corner, as {count} of {len(hexahedra)} are; its nodes are "
        f"{nodes[hexahedra[worst]].round(6).tolist()}"
    )


def _flat(corners: F64) -> F64:
    """The determinant at or below which hexahedra (m, 2, 2, 2, 3) are flat, (m,)."""
    length = (corners.max(axis=(1, 2, 3)) - corners.min(axis=(1, 2, 3))).max(axis=1)
    return np.asarray(_FLAT * length**3)


def _check_inside(corners: F64, nodes: F64, hexahedra: I64) -> None:
    """No hexahedron is turned inside out within, which may be though it is not at its corners."""
    wrong = ~above_throughout(corners, _flat(corners))
    if wrong.any():
        worst = int(np.argmax(wrong))
        raise ValueError(
            f"hexahedron {worst} is inside out or flat somewhere within, though not at a corner, as {wrong.sum()} of "
            f"{len(corners)} are; its nodes are {nodes[hexahedra[worst]].round(6).tolist()}"
        )


def _check_listed_once(hexahedra: I64) -> None:
    own = np.sort(hexahedra, axis=1)
    _, first, which = np.unique(own, axis=0, return_index=True, return_inverse=True)
    if len(first) < len(own):
        second = int(np.flatnonzero(first[which.reshape(-1)] != np.arange(len(own)))[0])
        raise ValueError(f"hexahedra {int(first[which.reshape(-1)[second]])} and {second} have the same nodes")


def _boundary(hexahedra: I64) -> I64:
    """Faces with a hexahedron on one side only."""
    faces = hexahedra[:, _FACES].reshape(-1, 4)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    if (count > 2).any():
        face = int(first[np.argmax(count > 2)])
        raise ValueError(f"{int(count.max())} hexahedra share a face of hexahedron {face // 6}")
    return np.asarray(faces[np.sort(first[count == 1])])


def _check_hanging(nodes: F64, boundary: I64) -> None:
    """No node of the boundary lies on a face of it without being a corner."""
    from scipy.spatial import cKDTree

    quads = nodes[boundary]
    center = quads.mean(axis=1)
    radius = np.linalg.norm(quads - center[:, None], axis=2).max(axis=1)
    used = np.unique(boundary)
    found = cKDTree(nodes[used]).query_ball_point(center, radius * (1 + _ON_FACE))
    face = np.repeat(np.arange(len(boundary)), [len(f) for f in found])
    node = used[np.concatenate([np.asarray(f, np.int64) for f in found])] if len(face) else face
    other = (boundary[face] != node[:, None]).all(axis=1)
    face, node = face[other], node[other]
    a, b, c, d = (quads[face, k] for k in range(4))
    p, u, v = nodes[node], np.full(len(face), 0.5), np.full(len(face), 0.5)
    for _ in range(8):  # the nearest place of the bilinear face, by Gauss-Newton steps
        along = (1 - v)[:, None] * (b - a) + v[:, None] * (c - d)
        across = (1 - u)[:, None] * (d - a) + u[:, None] * (c - b)
        at = _bilinear(a, b, c, d, u, v)
        uu, uv, vv = (along**2).sum(1), (along * across).sum(1), (across**2).sum(1)
        ru, rv = (along * (p - at)).sum(1), (across * (p - at)).sum(1)
        det = np.maximum(uu * vv - uv**2, 1e-30)
        u = np.clip(u + (vv * ru - uv * rv) / det, 0, 1)
        v = np.clip(v + (uu * rv - uv * ru) / det, 0, 1)
    away = np.linalg.norm(p - _bilinear(a, b, c, d, u, v), axis=1)
    hangs = away < _ON_FACE * radius[face]
    if hangs.any():
        first = int(np.argmax(hangs))
        where = quads[face[first]].round(6).tolist()
        raise ValueError(
            f"the node at {p[first].round(6).tolist()} hangs: it lies on the face {where} of another hexahedron and is "
            "no corner of it"
        )


def _bilinear(a: F64, b: F64, c: F64, d: F64, u: F64, v: F64) -> F64:
    u, v = u[..., None], v[..., None]
    return np.asarray((1 - u) * (1 - v) * a + u * (1 - v) * b + u * v * c + (1 - u) * v * d)


def split(corners: F64, parts: tuple[int, int, int]) -> F64:
    """Hexahedra cut along each axis, exactly: (m, 2, 2, 2, 3) to (m parts, 2, 2, 2, 3), parts in a row, z fastest."""
    m = len(corners)
    axes = [np.arange(n + 1) / n for n in parts]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    count = places[..., 0].size
    points, _ = points_in(corners, np.repeat(np.arange(m), count), np.tile(places.reshape(-1, 3), (m, 1)))
    nodes = points.reshape(m, *places.shape)
    made = np.empty((m, *parts, 2, 2, 2, 3))
    nx, ny, nz = parts
    for i, j, k in np.ndindex(2, 2, 2):
        made[:, :, :, :, i, j, k] = nodes[:, i : i + nx, j : j + ny, k : k + nz]
    return made.reshape(-1, 2, 2, 2, 3)


def boundary_triangles(mesh: HexahedralMesh, parts: int) -> tuple[F64, I32]:
    """Triangles of the boundary, vertices (n, 3) and faces (2 parts^2 f, 3), normals outwards; each face is cut into
    `parts` x `parts` squares so that its twist is followed.
    """
    quads = mesh.nodes[mesh.boundary]
    step = np.arange(parts + 1) / parts
    u, v = np.meshgrid(step, step, indexing="ij")
    corner = [quads[:, None, None, k] for k in range(4)]
    points = _bilinear(corner[0], corner[1], corner[2], corner[3], u, v).reshape(-1, 3)
    index = np.arange(len(points)).reshape(len(quads), parts + 1, parts + 1)
    a, b = index[:, :-1, :-1], index[:, 1:, :-1]
    c, d = index[:, 1:, 1:], index[:, :-1, 1:]
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], -2).reshape(-1, 3)
    # points on an edge are those of both faces: rounded alike, as both ends are the same
    from scipy.spatial import cKDTree

    edge = float(np.linalg.norm(quads[:, 1] - quads[:, 0], axis=1).min())
    pairs = cKDTree(points).query_pairs(SAME * edge / parts, output_type="ndarray")
    first = np.arange(len(points))
    np.minimum.at(first, pairs[:, 1], pairs[:, 0])
    used, numbered = np.unique(first[triangles], return_inverse=True)
    return points[used], numbered.reshape(-1, 3).astype(np.int32)


class OuterHexahedra(NamedTuple):
    """Hexahedra that continue others beyond the boundary of a mesh."""

    corners: F64  # (f, 2, 2, 2, 3)
    cell: I32  # (f,), the hexahedron that each continues
    low: F64  # (f, 3), place of its low corner in that hexahedron
    size: F64  # (f, 3), its size there


def outer_hexahedra(corners: F64, far: float) -> OuterHexahedra:
    """Continue hexahedra (m, 2, 2, 2, 3) that meet node by node, by a share `far` of their length."""
    size = np.abs(corners).max()
    # places of nodes are equal to the last bit, or up to rounding where hexahedra were cut into parts
    places = np.round(corners / max(size, 1e-300) * 2.0**36).astype(np.int64).reshape(-1, 3)
    _, number = np.unique(places, axis=0, return_inverse=True)
    nodes = number.reshape(-1, 2, 2, 2)
    made = []
    for axis in range(3):
        for side in range(2):
            face = np.sort(nodes.take(side, axis + 1).reshape(-1, 4), axis=1)
            m = len(face)
            made.append(np.column_stack([face, np.arange(m), np.full(m, axis), np.full(m, side)]))
    faces = np.concatenate(made)
    _, first, count = np.unique(faces[:, :4], axis=0, return_index=True, return_counts=True)
    ends = faces[np.sort(first[count == 1])]
    cell, axis, side = ends[:, 4], ends[:, 5], ends[:, 6]
    low, extent, rows = np.zeros((len(ends), 3)), np.ones((len(ends), 3)), np.arange(len(ends))
    low[rows, axis] = np.where(side == 1, 1.0, -far)
    extent[rows, axis] = far
    outer = np.empty((len(ends), 2, 2, 2, 3))
    for corner in np.ndindex(2, 2, 2):
        outer[(slice(None), *corner)] = points_in(corners, cell, low + extent * np.array(corner))[0]
    return OuterHexahedra(outer, cell.astype(np.int32), low, extent)
