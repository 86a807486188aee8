"""Primitive bodies as watertight triangle meshes, wound outwards, vertices on the surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I32

Mesh = tuple[F64, I32]
Point = tuple[float, float, float]


def box_mesh(center: Point, size: Point) -> Mesh:
    """An axis-aligned box: 8 vertices, 12 triangles."""
    corners = np.array([(x, y, z) for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    quads = np.array([(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)])
    return corners * np.asarray(size) + np.asarray(center), _split(quads)


def _split(quads: NDArray[np.integer]) -> I32:
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)


def _wrap(rows: int, columns: int) -> I32:
    """Triangles of a closed grid of rows x columns vertices, both directions periodic."""
    i, j = (v.ravel() for v in np.indices((rows, columns)))
    right, up = (j + 1) % columns, (i + 1) % rows
    return _split(np.stack([i * columns + j, i * columns + right, up * columns + right, up * columns + j], axis=1))


def ball_mesh(center: Point, radius: float, subdivisions: int = 3) -> Mesh:
    """A ball: an icosahedron whose triangles are split in four `subdivisions` times; 20 * 4^s triangles."""
    # the corners of an icosahedron lie on three golden rectangles
    golden = (1 + 5**0.5) / 2
    points = np.array(
        [
            [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)],
            [(0, -1, golden), (0, 1, golden), (0, -1, -golden), (0, 1, -golden)],
            [(golden, 0, -1), (golden, 0, 1), (-golden, 0, -1), (-golden, 0, 1)],
        ]
    ).reshape(-1, 3)
    faces = np.array(
        [
            [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11)],
            [(1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8)],
            [(3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9)],
            [(4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)],
        ]
    ).reshape(-1, 3)
    for _ in range(subdivisions):
        ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
        # both triangles of an edge share its middle, so the mesh stays closed
        edges, middle = np.unique(ends, axis=0, return_inverse=True)
        ab, bc, ca = (len(points) + middle.reshape(-1, 3)).T
        a, b, c = faces.T
        points = np.concatenate([points, points[edges].mean(axis=1)])
        faces = np.concatenate([np.stack(f, axis=1) for f in [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]])
    # all vertices lie on the sphere, so the volume is a little below that of the ball
    points = points * (radius / np.linalg.norm(points, axis=1, keepdims=True)) + np.asarray(center)
    return points, faces.astype(np.int32)


def cylinder_mesh(center: Point, radius: float, height: float, segments: int = 64) -> Mesh:
    """An upright prism with `segments` sides, inscribed in a cylinder along z; `center` is its middle."""
    angle = np.arange(segments) * (2 * np.pi / segments)
    circle = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    rings = [np.column_stack([circle, np.full(segments, z)]) for z in (-height / 2, height / 2)]
    vertices = np.concatenate([*rings, [(0, 0, -height / 2), (0, 0, height / 2)]]) + np.asarray(center)
    i = np.arange(segments)
    j = (i + 1) % segments
    side = _split(np.stack([i, j, j + segments, i + segments], axis=1))
    floor = np.stack([j, i, np.full(segments, 2 * segments)], axis=1)
    ceiling = np.stack([i + segments, j + segments, np.full(segments, 2 * segments + 1)], axis=1)
    return vertices, np.concatenate([side, floor, ceiling]).astype(np.int32)


def torus_mesh(center: Point, radius: float, tube: float, segments: int = 96, sides: int = 48) -> Mesh:
    """A torus around the z axis, `segments` along the ring and `sides` around the tube.

    The radius goes from the center to the middle of the tube; a tube not smaller than it would make a mesh that meets
    itself.
    """
    around = (np.arange(segments) * (2 * np.pi / segments))[:, None]
    across = (np.arange(sides) * (2 * np.pi / sides))[None, :]
    r = radius + tube * np.cos(across)
    height = np.broadcast_to(tube * np.sin(across), (segments, sides))
    points = np.stack([r * np.cos(around), r * np.sin(around), height], axis=2)
    # reversed, so that normals point out of the tube
    return points.reshape(-1, 3) + np.asarray(center), _wrap(segments, sides)[:, ::-1].copy()


def torus_knot_mesh(
    center: Point,
    turns: tuple[int, int] = (2, 3),
    radius: float = 1.0,
    swing: float = 0.4,
    tube: float = 0.2,
    segments: int = 512,
    sides: int = 32,
) -> Mesh:
    """A tube around a torus knot, with `segments` vertices along the curve and `sides` around the tube.

    The curve goes `turns[0]` times around the z axis and `turns[1]` times around the ring of a torus, which has the
    radius `radius`, in a tube of `swing`; the turns have no common divisor.
    """
    t = np.arange(segments) * (2 * np.pi / segments)
    r = radius + swing * np.cos(turns[1] * t)
    curve = np.stack([r * np.cos(turns[0] * t), r * np.sin(turns[0] * t), swing * np.sin(turns[1] * t)], axis=1)
    # central differences on a closed curve
    tangent = np.roll(curve, -1, axis=0) - np.roll(curve, 1, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # the normal of the torus turns with the curve and comes back to itself, so the last ring fits the first
    ring = np.stack([np.cos(turns[0] * t), np.sin(turns[0] * t), np.zeros(segments)], axis=1) * radius
    outwards = curve - ring
    outwards -= (outwards * tangent).sum(axis=1, keepdims=True) * tangent
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    sidewards = np.cross(tangent, outwards)
    angle = np.arange(sides) * (2 * np.pi / sides)
    rim = np.cos(angle)[None, :, None] * outwards[:, None] + np.sin(angle)[None, :, None] * sidewards[:, None]
    points = curve[:, None] + tube * rim
    return points.reshape(-1, 3) + np.asarray(center), _wrap(segments, sides)
