"""Moduli as functions of direction, and their extremes."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import F64, I32
from sppm_pipeline.services.elastic.voigt import compliance, null_space


def young_along(stiffness: F64, directions: F64) -> F64:
    """Young's modulus along each direction, E(n) = 1 / (n n : S : n n).

    Parameters
    ----------
    stiffness : (6, 6)
        Voigt.
    directions : (n, 3)
        Unit vectors.

    Returns
    -------
    (n,) float64
        0 along a direction without stiffness.
    """
    x, y, z = np.asarray(directions, np.float64).T
    # the stress of a unit pull in Voigt's notation
    stress = np.stack([x * x, y * y, z * z, y * z, x * z, x * y], axis=1)
    values, vectors = null_space(stiffness)
    weighted = stress * np.array([1, 1, 1, *(np.sqrt(2.0),) * 3])
    carried = ((weighted @ vectors[:, values == 0]) ** 2).sum(axis=1) < 1e-6
    flexible = np.einsum("ni,ij,nj->n", stress, compliance(stiffness), stress)
    moduli: F64 = np.divide(1.0, flexible, out=np.zeros(len(stress)), where=carried & (flexible > 0))
    return moduli


def sphere_mesh(rounds: int) -> tuple[F64, I32]:
    """A sphere of triangles from an icosahedron halved `rounds` times: unit vertices and faces that look outward."""
    golden = (1 + np.sqrt(5)) / 2
    corners = np.array(
        [[s, t * golden, 0] for s in (-1, 1) for t in (-1, 1)]
        + [[0, s, t * golden] for s in (-1, 1) for t in (-1, 1)]
        + [[t * golden, 0, s] for s in (-1, 1) for t in (-1, 1)]
    )
    vertices = corners / np.linalg.norm(corners[0])
    # each triangle of three corners that are neighbors (edge 2 in these units) is a face
    near = np.abs(np.linalg.norm(corners[:, None] - corners[None], axis=2) - 2) < 1e-9
    found = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    faces = np.array([f if np.linalg.det(vertices[list(f)]) > 0 else (f[0], f[2], f[1]) for f in found], np.int32)
    for _ in range(rounds):
        vertices, faces = _halved(vertices, faces)
    return vertices, faces


def _halved(vertices: F64, faces: I32) -> tuple[F64, I32]:
    """Each triangle becomes four; new vertices lie on the sphere."""
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, at = np.unique(sides, axis=0, return_inverse=True)
    middle = vertices[edges].sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1)[:, None]
    ab, bc, ca = (at.reshape(3, -1) + len(vertices)).astype(np.int32)
    a, b, c = faces.T
    parts = [np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
    return np.concatenate([vertices, middle]), np.concatenate(parts)


def extremes(stiffness: F64) -> dict[str, tuple[float, F64]]:
    """Smallest and largest Young's modulus and where they point.

    Found on a fine sphere and refined by shrinking steps, so that the direction is right to 1e-4 and the value to 1e-7.

    Returns
    -------
    dict
        ``min`` and ``max``: value and unit direction (3,), its largest component positive.
    """
    vertices, _ = sphere_mesh(4)
    values = young_along(stiffness, vertices)
    found = {}
    for name, sign in (("min", 1.0), ("max", -1.0)):
        best = vertices[int(np.argmin(sign * values))]
        # pattern search: the best of eight directions around; the step halves where none is better
        step = 0.05
        while step > 1e-5:
            first = np.cross(best, np.eye(3)[int(np.argmin(np.abs(best)))])
            first /= np.linalg.norm(first)
            second = np.cross(best, first)
            angles = np.arange(8) * np.pi / 4
            around = best + step * (np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second)
            around = np.vstack([best, around / np.linalg.norm(around, axis=1)[:, None]])
            chosen = int(np.argmin(sign * young_along(stiffness, around)))
            best = around[chosen]
            step = step if chosen else step / 2
        best = best * np.sign(best[int(np.argmax(np.abs(best)))])
        found[name] = (float(young_along(stiffness, best[None])[0]), best)
    return found
