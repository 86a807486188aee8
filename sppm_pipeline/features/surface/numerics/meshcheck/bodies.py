"""The bodies that a closed mesh bounds: outer shells, each with the cavities directly inside of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I32, I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_cubes import Mesh
from sppm_pipeline.services.mesh.measures import components


class Shells(NamedTuple):
    """The connected parts of a closed mesh."""

    labels: I32  # (m,), shell of each triangle
    volumes: F64  # (n,), inside each shell; negative for a cavity, whose triangles look inwards

    @property
    def bodies(self) -> int:
        """Number of shells with solid inside."""
        return int(np.count_nonzero(self.volumes > 0))

    @property
    def cavities(self) -> int:
        """Number of closed voids."""
        return len(self.volumes) - self.bodies


def find_shells(vertices: F64, faces: I32) -> Shells:
    """The shells of a closed mesh, (n, 3) and (m, 3)."""
    count, labels = components(faces)
    # volumes are taken about the middle: far from the origin tetrahedra from there would cancel to
    # rounding
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2 if len(vertices) else np.zeros(3)
    return Shells(labels, _volumes(vertices, np.ascontiguousarray(faces, np.int32), labels, middle, count))


def largest_body(vertices: F64, faces: I32, shells: Shells) -> Mesh:
    """The body with the largest outer shell, with its own cavities and without whatever floats in them.

    The mesh, (n, 3) and (m, 3), is closed, wound outwards and free of intersections; `shells` are those of
    `find_shells`.
    """
    if shells.bodies == 0:
        return np.empty((0, 3)), np.empty((0, 3), np.int32)
    largest = int(np.argmax(shells.volumes))
    kept = np.zeros(len(shells.volumes), np.bool_)
    kept[largest] = True
    order = np.argsort(shells.labels, kind="stable")
    starts = np.searchsorted(shells.labels[order], np.arange(len(shells.volumes) + 1))
    for cavity in np.flatnonzero(shells.volumes <= 0):
        at = vertices[faces[order[starts[cavity]], 0]]
        # the smallest body around a cavity is the one that it belongs to
        larger = np.flatnonzero(shells.volumes > -shells.volumes[cavity])
        for body in larger[np.argsort(shells.volumes[larger], kind="stable")]:
            if _winding(vertices, faces, order[starts[body] : starts[body + 1]], at) > 0.5:
                kept[cavity] = body == largest
                break
    return used_vertices(vertices, faces[kept[shells.labels]])


def used_vertices(vertices: F64, faces: I32) -> Mesh:
    """The mesh without vertices that belong to no triangle; the order of the others stays."""
    used = np.zeros(len(vertices), np.bool_)
    used[faces] = True
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return vertices[used], number[faces]


@jit
def _volumes(vertices: F64, faces: I32, labels: I32, middle: F64, count: int) -> F64:
    volumes = np.zeros(count)
    p = np.empty((3, 3))
    for i in range(faces.shape[0]):
        for c in range(3):
            for a in range(3):
                p[c, a] = vertices[faces[i, c], a] - middle[a]
        volumes[labels[i]] += (
            p[0, 0] * (p[1, 1] * p[2, 2] - p[1, 2] * p[2, 1])
            + p[0, 1] * (p[1, 2] * p[2, 0] - p[1, 0] * p[2, 2])
            + p[0, 2] * (p[1, 0] * p[2, 1] - p[1, 1] * p[2, 0])
        ) / 6.0
    return volumes


@jit
def _winding(vertices: F64, faces: I32, which: I64, at: F64) -> float:
    """Winding number of triangles around a point, the sum of their solid angles (van Oosterom and Strackee, 1983)."""
    total = 0.0
    p, r = np.empty((3, 3)), np.empty(3)
    for i in which:
        for c in range(3):
            for a in range(3):
                p[c, a] = vertices[faces[i, c], a] - at[a]
            r[c] = np.sqrt(p[c, 0] ** 2 + p[c, 1] ** 2 + p[c, 2] ** 2)
        triple = (
            p[0, 0] * (p[1, 1] * p[2, 2] - p[1, 2] * p[2, 1])
            + p[0, 1] * (p[1, 2] * p[2, 0] - p[1, 0] * p[2, 2])
            + p[0, 2] * (p[1, 0] * p[2, 1] - p[1, 1] * p[2, 0])
        )
        d01 = p[0, 0] * p[1, 0] + p[0, 1] * p[1, 1] + p[0, 2] * p[1, 2]
        d12 = p[1, 0] * p[2, 0] + p[1, 1] * p[2, 1] + p[1, 2] * p[2, 2]
        d20 = p[2, 0] * p[0, 0] + p[2, 1] * p[0, 1] + p[2, 2] * p[0, 2]
        total += np.arctan2(triple, r[0] * r[1] * r[2] + d01 * r[2] + d12 * r[0] + d20 * r[1])
    return total / (2.0 * np.pi)
