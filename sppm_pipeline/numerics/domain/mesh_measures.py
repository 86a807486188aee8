"""What a triangle mesh measures, and whether it encloses a solid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.numerics.compiled import kernel

__all__ = [
    "MeshTopology",
    "as_mesh",
    "bounding_box",
    "face_areas",
    "mesh_topology",
    "signed_volume",
    "surface_area",
]


class MeshTopology(NamedTuple):
    """How the triangles of a mesh hang together; vertices are the same if they have the same index.

    Attributes
    ----------
    boundary_edges : int
        Edges of one triangle only.
    branching_edges : int
        Edges of three or more triangles.
    misoriented_edges : int
        Edges of two triangles that run through them in the same direction.
    degenerate_faces : int
        Triangles that name a vertex twice. They count in nothing else.
    components : int
        Pieces that hang together by common vertices.
    euler : int
        Vertices - edges + faces, of the vertices in use.
    watertight : bool
        Each edge belongs to two triangles; there is at least one triangle and none is degenerate.
    consistent : bool
        Watertight, and each edge is run through once in either direction. The signed volume has a meaning then.
    """

    boundary_edges: int
    branching_edges: int
    misoriented_edges: int
    degenerate_faces: int
    components: int
    euler: int
    watertight: bool
    consistent: bool

    @property
    def genus(self) -> int | None:
        """Handles of all components together, or None for a mesh that is not consistent."""
        return (2 * self.components - self.euler) // 2 if self.consistent else None


def as_mesh(vertices: ArrayLike, faces: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A mesh in the types that the kernels are compiled for.

    Parameters
    ----------
    vertices : (n, 3) floats
    faces : (m, 3) integers
        Indices of vertices.

    Returns
    -------
    vertices : (n, 3) float64, C-contiguous
    faces : (m, 3) int32, C-contiguous

    Raises
    ------
    InputError
        If a coordinate is not finite or an index names no vertex.
    ValueError
        If the shapes are wrong.
    """
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    raw = np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3 or raw.ndim != 2 or raw.shape[1] != 3 or raw.dtype.kind not in "iu":
        raise ValueError(f"a mesh is (n, 3) floats and (m, 3) integers, not {points.shape} and {raw.shape} {raw.dtype}")
    if not np.isfinite(points).all():
        bad = int(np.count_nonzero(~np.isfinite(points).all(axis=1)))
        raise InputError(f"{bad} of {len(points)} vertices have a coordinate that is not finite")
    if raw.size and (int(raw.min()) < 0 or int(raw.max()) >= len(points)):
        raise InputError(f"faces name vertices {raw.min()} to {raw.max()}, the mesh has {len(points)}")
    return points, np.ascontiguousarray(raw, dtype=np.int32)


def _corners(
    vertices: NDArray[np.float64], faces: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    return vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]


def signed_volume(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> float:
    """Enclosed volume, positive if the triangles are wound outwards (divergence theorem).

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) integers

    Returns
    -------
    float
        In cubed units of the vertices; without a meaning for a mesh that is not closed.
    """
    if len(faces) == 0:
        return 0.0
    # measured from the middle of the mesh, so that a part far from the origin loses no digits
    a, b, c = _corners(vertices - vertices.mean(axis=0), faces)
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def face_areas(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    """Area of each triangle, (m,)."""
    a, b, c = _corners(vertices, faces)
    normal = np.cross(b - a, c - a)
    areas: NDArray[np.float64] = np.sqrt(np.einsum("ij,ij->i", normal, normal)) / 2.0
    return areas


def surface_area(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> float:
    """Total area of the triangles, in squared units of the vertices."""
    return float(face_areas(vertices, faces).sum())


def bounding_box(
    vertices: NDArray[np.float64], faces: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest corner of the triangles, (3,) each; vertices that no triangle uses don't count.

    Raises
    ------
    InputError
        If there is no triangle.
    """
    if len(faces) == 0:
        raise InputError("the mesh has no triangles")
    used = vertices[np.unique(faces)]
    return used.min(axis=0), used.max(axis=0)


def mesh_topology(n_vertices: int, faces: NDArray[np.integer]) -> MeshTopology:
    """See how the triangles hang together.

    Parameters
    ----------
    n_vertices : int
    faces : (m, 3) integers
        Indices below n_vertices.

    Returns
    -------
    MeshTopology
    """
    whole = np.ascontiguousarray(faces, dtype=np.int32)
    degenerate = (whole[:, 0] == whole[:, 1]) | (whole[:, 1] == whole[:, 2]) | (whole[:, 2] == whole[:, 0])
    proper = whole[~degenerate]
    start = proper.ravel().astype(np.int64)
    end = np.roll(proper, -1, axis=1).ravel().astype(np.int64)
    # one number for an undirected edge, its direction in the lowest bit: one sort brings the uses of an edge together
    edges = np.minimum(start, end) * n_vertices + np.maximum(start, end)
    keys = np.sort(edges * 2 + (start > end))
    first = np.flatnonzero(np.diff(keys >> 1, prepend=-1))
    uses = np.diff(first, append=keys.size)
    backwards = np.add.reduceat(keys & 1, first) if first.size else np.zeros(0, dtype=np.int64)
    boundary = int(np.count_nonzero(uses == 1))
    branching = int(np.count_nonzero(uses > 2))
    misoriented = int(np.count_nonzero((uses == 2) & (backwards != 1)))
    components, used = _count_pieces(n_vertices, proper)
    watertight = boundary == 0 and branching == 0 and len(proper) == len(whole) > 0
    return MeshTopology(
        boundary_edges=boundary,
        branching_edges=branching,
        misoriented_edges=misoriented,
        degenerate_faces=len(whole) - len(proper),
        components=components,
        euler=used - first.size + len(proper),
        watertight=watertight,
        consistent=watertight and misoriented == 0,
    )


@kernel
def _count_pieces(n_vertices: int, faces: NDArray[np.int32]) -> tuple[int, int]:
    """Number of pieces that hang together by common vertices, and of vertices in use."""
    parent = np.full(n_vertices, -1, np.int32)  # -1: not in use
    pieces = 0
    used = 0
    for f in range(faces.shape[0]):
        for corner in range(3):
            v = faces[f, corner]
            if parent[v] < 0:
                parent[v] = v
                pieces += 1
                used += 1
        for corner in range(1, 3):
            a = faces[f, 0]
            b = faces[f, corner]
            while parent[a] != a:
                parent[a] = parent[parent[a]]
                a = parent[a]
            while parent[b] != b:
                parent[b] = parent[parent[b]]
                b = parent[b]
            if a != b:
                parent[max(a, b)] = min(a, b)
                pieces -= 1
    return pieces, used
