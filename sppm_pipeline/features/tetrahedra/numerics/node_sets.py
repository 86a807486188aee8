"""Nodes and triangles in the faces, on the edges and at the corners of a box, under names that solvers can use."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.tetrahedra.numerics.periodic import on_faces
from sppm_pipeline.features.tetrahedra.numerics.quadratic import EDGES
from sppm_pipeline.services.mesh.faces import BOUNDARY, FACES, face_neighbors

SIDES = ("XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX")

_MID_NODE = {frozenset(ends): 4 + place for place, ends in enumerate(EDGES.tolist())}


def box_node_sets(nodes: NDArray[np.floating], box: NDArray[np.floating]) -> dict[str, NDArray[np.int64]]:
    """Nodes on the boundary of a box: name to ascending numbers of nodes.

    ``XMIN`` ... ``ZMAX``: the faces with their edges and corners. ``XMIN_INNER`` ...: without them. ``YMIN_ZMIN`` ...:
    the twelve edges without their corners. ``XMIN_YMIN_ZMIN`` ...: the eight corners. The last three kinds share no
    node.
    """
    low, high = on_faces(nodes, box)
    side = dict(zip(SIDES, np.stack([low, high], axis=2).reshape(len(nodes), 6).T, strict=True))
    count = low.sum(1) + high.sum(1)
    sets = {name: np.flatnonzero(flags) for name, flags in side.items()}
    sets |= {f"{name}_INNER": np.flatnonzero(flags & (count == 1)) for name, flags in side.items()}
    for size in (2, 3):
        for names in itertools.combinations(SIDES, size):
            if len({name[0] for name in names}) == size:
                members = np.logical_and.reduce([side[name] for name in names]) & (count == size)
                sets["_".join(names)] = np.flatnonzero(members)
    return sets


def boundary_surfaces(
    nodes: NDArray[np.floating], cells: NDArray[np.integer], box: NDArray[np.floating]
) -> dict[str, NDArray[np.int64]]:
    """The triangles of the boundary by name: those in the six faces of a box, and ``SURFACE``, the rest.

    (k, 3), or (k, 6) for quadratic cells: corners counterclockwise for a viewer outside, then nodes on the edges 01,
    12, 20.
    """
    cell, corner = np.nonzero(face_neighbors(cells) == BOUNDARY)
    columns = [list(face) for face in FACES.tolist()]
    if cells.shape[1] == 10:
        columns = [[*f, *(_MID_NODE[frozenset((f[i], f[(i + 1) % 3]))] for i in range(3))] for f in columns]
    triangles = np.asarray(cells, np.int64)[cell[:, None], np.array(columns)[corner]]
    flags = on_faces(nodes, box)
    surfaces, rest = {}, np.ones(len(triangles), np.bool_)
    for place, name in enumerate(SIDES):
        members = flags[place % 2][triangles[:, :3], place // 2].all(axis=1)
        surfaces[name] = triangles[members]
        rest &= ~members
    return {**surfaces, "SURFACE": triangles[rest]}


def box_copies(
    nodes: NDArray[np.floating], standing: NDArray[np.integer], box: NDArray[np.floating]
) -> dict[tuple[str, str], NDArray[np.int64]]:
    """For each high face of a periodic box the pairs of its nodes and their copies in the low face, (p, 2).

    `standing`, (n,), is that of `matched_nodes`; of nodes on edges and corners of the box, pairs straight across are
    taken.
    """
    low, high = on_faces(nodes, box)
    pairs = {}
    for axis in range(3):
        one, other = np.flatnonzero(high[:, axis]), np.flatnonzero(low[:, axis])
        # copies straight across have the same representative and lie on the same of the other faces
        keys = []
        for members in (one, other):
            across = np.delete(high[members], axis, axis=1)
            keys.append(4 * np.asarray(standing)[members] + across @ np.array([1, 2]))
        _, first, second = np.intersect1d(keys[0], keys[1], assume_unique=True, return_indices=True)
        pairs[SIDES[2 * axis + 1], SIDES[2 * axis]] = np.stack([one[first], other[second]], axis=1)
    return pairs
