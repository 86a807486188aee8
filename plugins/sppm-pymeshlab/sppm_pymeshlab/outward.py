"""Which way is out: pieces of a surface whose neighbors already agree are turned as a whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import mesh_components as components
from sppm_pipeline.numerics import mesh_edges as edge_counts
from sppm_pipeline.numerics import mesh_volume as volume
from sppm_pymeshlab.winding import winding_numbers


def turned_outward(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], *, as_whole: bool, threads: int = 1
) -> NDArray[np.int32]:
    """Faces (m, 3) turned so that their normals point out of the solid.

    `as_whole` turns all pieces or none: right if the winding of the input agreed with itself, as then a piece that is
    wound the other way is a cavity. Otherwise each piece is turned by itself, and is a cavity if it lies inside an odd
    number of others.
    """
    if as_whole:
        return faces if volume(vertices, faces) >= 0 else np.ascontiguousarray(faces[:, ::-1])
    count, parts = components(faces)
    order = np.argsort(parts, kind="stable")
    pieces = np.split(order, np.cumsum(np.bincount(parts, minlength=count))[:-1])
    low = np.array([vertices[faces[piece]].min((0, 1)) for piece in pieces])
    high = np.array([vertices[faces[piece]].max((0, 1)) for piece in pieces])
    depth = np.zeros(count, int)
    for k, piece in enumerate(pieces):
        inner = np.flatnonzero((low >= low[k]).all(1) & (high <= high[k]).all(1) & (np.arange(count) != k))
        if len(inner) and edge_counts(faces[piece]).bounds_solid:
            probes = np.array([vertices[faces[pieces[i][0]]].mean(0) for i in inner])
            depth[inner] += np.abs(winding_numbers(probes, (vertices, faces[piece]), threads=threads)) > 0.5
    turned = faces.copy()
    for piece, around in zip(pieces, depth, strict=True):
        # an open piece has no volume; about its own middle it has one whose sign is that of its hollow side
        outward = volume(vertices[faces[piece]].reshape(-1, 3), np.arange(3 * len(piece)).reshape(-1, 3)) >= 0
        if outward != (around % 2 == 0):
            turned[piece] = faces[piece][:, ::-1]
    return turned
