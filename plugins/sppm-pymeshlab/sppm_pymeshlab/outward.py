"""Which way is out: pieces of a surface whose neighbours already agree are turned as a whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.surface.measures import components, volume
from sppm_pymeshlab.winding import winding_numbers

__all__ = ["turned_outward"]


def turned_outward(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], *, as_whole: bool, threads: int = 1
) -> NDArray[np.int32]:
    """Faces turned so that their normals point out of the solid.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32
    as_whole : bool
        Turn all pieces or none: right if the winding of the input agreed with itself, as then a piece that is wound
        the other way is a cavity. Otherwise each piece is turned by itself, and is a cavity if it lies inside an odd
        number of others.
    threads : int

    Returns
    -------
    (m, 3) int32
    """
    if as_whole:
        return faces if volume(vertices, faces) >= 0 else np.ascontiguousarray(faces[:, ::-1])
    count, parts = components(faces)
    order = np.argsort(parts, kind="stable")
    pieces = np.split(order, np.cumsum(np.bincount(parts, minlength=count))[:-1])
    boxes = np.array([[vertices[faces[piece]].min((0, 1)), vertices[faces[piece]].max((0, 1))] for piece in pieces])
    low, high = boxes[:, 0], boxes[:, 1]
    enclosing = np.ones((count, count), np.bool_) & ~np.eye(count, dtype=np.bool_)
    for axis in range(3):
        enclosing &= (low[:, None, axis] >= low[:, axis]) & (high[:, None, axis] <= high[:, axis])
    depth = np.zeros(count, int)
    inner = np.flatnonzero(enclosing.any(1))
    if len(inner):
        probes = np.array([vertices[faces[pieces[k][0]]].mean(0) for k in inner])
        windings = winding_numbers(probes, (vertices, faces), threads=threads, parts=parts)
        depth[inner] = (enclosing[inner] & (np.abs(windings) > 0.5)).sum(1)
    turned = faces.copy()
    for piece, around in zip(pieces, depth, strict=True):
        # an open piece has no volume; about its own middle it has one that tells on which side it is hollow
        outward = volume(vertices[faces[piece]].reshape(-1, 3), np.arange(3 * len(piece)).reshape(-1, 3)) >= 0
        if outward != (around % 2 == 0):
            turned[piece] = faces[piece][:, ::-1]
    return turned
