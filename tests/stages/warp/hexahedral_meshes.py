"""Small meshes of hexahedra, made by formulas."""

from __future__ import annotations

import numpy as np


def extruded(points, quads, layers, height):
    """A flat mesh of quadrilaterals drawn up along z: points (n, 3) and hexahedra (m, 8)."""
    n = len(points)
    levels = [np.column_stack([points, np.full(n, height * k / layers)]) for k in range(layers + 1)]
    hexes = [np.column_stack([quads + k * n, quads + (k + 1) * n]) for k in range(layers)]
    return np.concatenate(levels), np.concatenate(hexes)


def merged(points, quads):
    """The mesh with nodes of equal places made one."""
    _, first, number = np.unique(points.round(9), axis=0, return_index=True, return_inverse=True)
    return points[first], number.reshape(-1)[quads]


def grid_of(corners, nx, ny):
    """A quadrilateral (4, 2) cut into nx x ny: points and quadrilaterals."""
    u, v = np.meshgrid(np.arange(nx + 1) / nx, np.arange(ny + 1) / ny, indexing="ij")
    a, b, c, d = corners
    points = (
        ((1 - u) * (1 - v))[..., None] * a + (u * (1 - v))[..., None] * b + (u * v)[..., None] * c
        + ((1 - u) * v)[..., None] * d
    ).reshape(-1, 2)  # fmt: skip
    index = np.arange(len(points)).reshape(nx + 1, ny + 1)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1).reshape(-1, 4)
    return points, quads


def together(parts):
    points, quads, count = [], [], 0
    for own, cells in parts:
        points.append(own)
        quads.append(cells + count)
        count += len(own)
    return merged(np.concatenate(points), np.concatenate(quads))


def star(around, edge, layers=2, parts=1):
    """`around` rhombs around a common edge, each cut into parts x parts."""
    rhombs = []
    for k in range(around):
        a, c = (np.array([np.cos(t), np.sin(t)]) * edge for t in 2 * np.pi * np.array([k, k + 1]) / around)
        rhombs.append(grid_of(np.array([[0, 0], a, a + c, c]), parts, parts))
    return extruded(*together(rhombs), layers, edge * layers)


def o_grid(radius, core, around, rings, layers, height):
    """A disc as a square in the middle with 4 x `around` sectors around it, drawn up to a cylinder."""
    t = np.linspace(-1, 1, around + 1)
    inner, cells = grid_of(core * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float), around, around)
    parts = [(inner, cells)]
    for side in range(4):
        turn = np.array([[np.cos(side * np.pi / 2), -np.sin(side * np.pi / 2)],
                         [np.sin(side * np.pi / 2), np.cos(side * np.pi / 2)]])  # fmt: skip
        square = np.stack([np.full_like(t, core), core * t], 1)
        circle = radius * np.stack([np.cos(t * np.pi / 4), np.sin(t * np.pi / 4)], 1)
        share = np.arange(rings + 1)[:, None, None] / rings
        points = ((1 - share) * square + share * circle).reshape(-1, 2) @ turn.T
        index = np.arange(len(points)).reshape(rings + 1, around + 1)
        quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1).reshape(-1, 4)
        parts.append((points, quads))
    return extruded(*together(parts), layers, height)


def l_shape(edge, hole=False):
    """Three squares of 2 x 2 elements around a corner, or eight elements around a hole, two layers."""
    if hole:
        squares = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
        parts = 1
    else:
        squares, parts = [(0, 0), (1, 0), (0, 1)], 2
    size = edge * parts
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    made = together([grid_of(size * (corner + np.array(s)), parts, parts) for s in squares])
    return extruded(*made, 2, 2 * edge)
