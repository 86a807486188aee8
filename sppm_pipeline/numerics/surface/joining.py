"""Pieces of a mesh put together while they arrive, so that never more than the mesh and one piece is in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from sppm_pipeline.numerics.surface.marching_cubes import Mesh


def joined_mesh(pieces: Iterable[Mesh], expected: Callable[[], tuple[int, int]] = lambda: (0, 0)) -> Mesh:
    """The mesh whose vertices and faces come in pieces; the faces name vertices by their number in the whole mesh.

    A list of pieces, concatenated at the end, would need the memory of two meshes.

    Parameters
    ----------
    pieces : iterable of (vertices, faces)
        (n, 3) float64 and (m, 3) int32 each.
    expected : function
        About how many vertices and faces there will be; asked when the first piece is there. Memory that is reserved
        at once is mapped in large pages and so filled in less time; what is too little grows, what is too much is
        given back untouched.

    Returns
    -------
    vertices : (n, 3) float64
    faces : (m, 3) int32
        Both own their memory.
    """
    vertices, faces = np.empty((0, 3)), np.empty((0, 3), np.int32)
    n, m = 0, 0
    for more_vertices, more_faces in pieces:
        if n == m == 0:
            room = expected()
            vertices, faces = np.empty((room[0], 3)), np.empty((room[1], 3), np.int32)
        n, m = n + len(more_vertices), m + len(more_faces)
        # nobody else holds a reference yet, whatever a debugger or a profiler counts
        if n > len(vertices):
            vertices.resize((n, 3), refcheck=False)
        if m > len(faces):
            faces.resize((m, 3), refcheck=False)
        vertices[n - len(more_vertices) : n], faces[m - len(more_faces) : m] = more_vertices, more_faces
    vertices.resize((n, 3), refcheck=False)
    faces.resize((m, 3), refcheck=False)
    return vertices, faces
