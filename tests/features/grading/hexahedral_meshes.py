"""Small meshes of hexahedra made by formulas: a star around an edge, a disc with a square core, corners and holes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Cells = NDArray[np.int64]


def extruded(points: Points, quads: Cells, layers: int, height: float) -> tuple[Points, Cells]:
    """A flat mesh of quadrilaterals, counterclockwise, drawn up along z: points (n, 3) and hexahedra (m, 8)."""
    n = len(points)
    levels = [np.column_stack([points, np.full(n, height * k / layers)]) for k in range(layers + 1)]
    return np.concatenate(levels), np.concatenate(
        [np.column_stack([quads + k * n, quads + (k + 1) * n]) for k in range(layers)]
    )


def star(around: int, edge: float, layers: int = 2) -> tuple[Points, Cells]:
    """So many rhombs around a common edge, drawn up."""
    parts = []
    for k in range(around):
        a, c = (np.array([np.cos(t), np.sin(t)]) * edge for t in 2 * np.pi * np.array([k, k + 1]) / around)
        parts.append(_grid(np.array([np.zeros(2), a, a + c, c]), 1))
    return extruded(*_together(parts), layers, edge * layers)


def o_grid(
    radius: float, core: float, around: int, rings: int, layers: int, height: float, hollow: bool = False
) -> tuple[Points, Cells]:
    """A cylinder: 4 x `around` sectors around a square of half the edge `core`, which may be left out."""
    t = np.linspace(-1, 1, around + 1)
    square = core * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    parts = [] if hollow else [_grid(square, around)]
    for side in range(4):
        c, s = np.cos(side * np.pi / 2), np.sin(side * np.pi / 2)
        inner = np.stack([np.full_like(t, core), core * t], 1)
        outer = radius * np.stack([np.cos(t * np.pi / 4), np.sin(t * np.pi / 4)], 1)
        share = np.arange(rings + 1)[:, None, None] / rings
        points = ((1 - share) * inner + share * outer).reshape(-1, 2) @ np.array([[c, s], [-s, c]])
        parts.append((points, _quads(rings, around)))
    return extruded(*_together(parts), layers, height)


def squares(places: list[tuple[int, int]], edge: float, layers: int = 2) -> tuple[Points, Cells]:
    """Squares at places of a grid, drawn up: an L, or a ring around a hole."""
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return extruded(*_together([_grid(edge * (corner + np.array(p)), 1) for p in places]), layers, edge * layers)


def _quads(nx: int, ny: int) -> Cells:
    index = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
    return np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1).reshape(-1, 4)


def _grid(corners: Points, n: int) -> tuple[Points, Cells]:
    """A quadrilateral (4, 2) cut into n x n."""
    u, v = (x[..., None] for x in np.meshgrid(np.arange(n + 1) / n, np.arange(n + 1) / n, indexing="ij"))
    a, b, c, d = corners
    return ((1 - u) * (1 - v) * a + u * (1 - v) * b + u * v * c + (1 - u) * v * d).reshape(-1, 2), _quads(n, n)


def _together(parts: list[tuple[Points, Cells]]) -> tuple[Points, Cells]:
    """One mesh of several, nodes at the same place made one."""
    first = np.cumsum([0, *(len(points) for points, _ in parts)])
    points = np.concatenate([own for own, _ in parts])
    quads = np.concatenate([cells + begin for (_, cells), begin in zip(parts, first[:-1], strict=True)])
    # rounded, as nodes of two parts differ in their last digits; + 0.0 makes -0 and 0 one
    _, kept, number = np.unique((points + 0.0).round(9) + 0.0, axis=0, return_index=True, return_inverse=True)
    return points[kept], number.reshape(-1)[quads]
