"""Pores and tunnels as balls and rods within the frame of their cell: triangles with colors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph

MAX_SHOWN = 20_000
"""Pores and tunnels of a picture; more would hide each other, and take minutes."""

BALL, ROD, FRAME = 0.024, 0.007, 0.005
"""Radii in cell sizes of a pore, a tunnel and an edge of the frame."""

INTERIOR, FACES = (0, 114, 178), ((213, 94, 0), (0, 158, 115), (204, 121, 167))
TUNNEL, CONNECTOR, EDGE, INNER = (86, 180, 233), (150, 150, 150), (40, 120, 80), (30, 90, 150)

_SIDES = 8


class Shape(NamedTuple):
    """Triangles with a color each."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colors: NDArray[np.uint8]


def graph_shape(what: PoreSet | TunnelGraph) -> Shape:
    """The pores of one cell and their tunnels, in cell sizes.

    Of a tile set the first interior and the first color of each axis are shown. Pores of the interior are blue; those
    of faces across x, y and z orange, green and pink, on both sides of the cell. Tunnels are light blue, those between
    the interior and a face gray. The outer frame is the cell; the inner one, of cells with face pores, is the smallest
    box that holds the pores of the interior.

    Raises
    ------
    DesignError
        If there are more than `MAX_SHOWN` pores and tunnels, or the pores are those of blocks without faces.
    """
    pores = what if isinstance(what, PoreSet) else what.pores
    if pores.blocks is not None:
        raise DesignError("pores of blocks without faces have no cell to be drawn in", hint="draw the field they make")
    shown = [0, *(pores.face_piece(axis, 0) for axis in range(3) if pores.colors[axis])]
    kept, axis_of, place = np.isin(pores.piece, shown), pores.axis_of_piece()[pores.piece], pores.centers
    edges, shift = np.zeros((0, 2), np.int64), np.zeros((0, 3))
    if isinstance(what, TunnelGraph):
        there = kept[what.edges].all(1)
        edges, shift = what.edges[there].astype(np.int64), what.shift[there].astype(np.float64)
    if kept.sum() + len(edges) > MAX_SHOWN:
        raise DesignError(
            f"a picture shows up to {MAX_SHOWN} pores and tunnels, there are {kept.sum()} and {len(edges)}",
            hint="draw the field that is made of them",
        )
    shapes = [_rods(*_box_edges(np.zeros(3), np.ones(3)), FRAME, EDGE)]
    inside = kept & (axis_of < 0)
    if pores.has_faces and inside.sum() > 1:
        shapes.append(_rods(*_box_edges(place[inside].min(0), place[inside].max(0)), FRAME, INNER))
    shapes.append(_balls(place[inside], BALL, INTERIOR))
    for axis in range(3):
        # a pore is seen at every place of the cell that is the same by periodicity
        images = np.concatenate([place[kept & (axis_of == axis)] + np.array(s) for s in np.ndindex(2, 2, 2)])
        shapes.append(_balls(images[(images <= 1).all(1)], BALL, FACES[axis]))
    starts, ends = place[edges[:, 0]], place[edges[:, 1]] + shift
    across = pores.piece[edges[:, 0]] != pores.piece[edges[:, 1]]
    for chosen, color in ((~across, TUNNEL), (across, CONNECTOR)):
        # a tunnel that leaves the cell comes in again on the other side; one of a face is seen on both sides
        moves = [np.array(s) - 1.0 for s in np.ndindex(3, 3, 3)]
        parts = [_clipped(starts[chosen] + move, ends[chosen] + move) for move in moves]
        first, last = (np.concatenate([part[end] for part in parts]) for end in (0, 1))
        shapes.append(_rods(first, last, ROD, color))
    return _together(shapes)


def _together(shapes: list[Shape]) -> Shape:
    firsts = np.cumsum([0, *(len(shape.vertices) for shape in shapes)])
    return Shape(
        np.concatenate([shape.vertices for shape in shapes]),
        np.concatenate([shape.faces + first for shape, first in zip(shapes, firsts, strict=False)]),
        np.concatenate([shape.colors for shape in shapes]),
    )


def _many(points: NDArray[np.float64], faces: NDArray[np.int64], color: tuple[int, int, int]) -> Shape:
    """Copies of one body with vertices `points` (copies, n, 3)."""
    copies, n = points.shape[:2]
    triangles = (faces[None] + n * np.arange(copies)[:, None, None]).reshape(-1, 3)
    return Shape(points.reshape(-1, 3), triangles, np.full((len(triangles), 3), color, np.uint8))


def _balls(centers: NDArray[np.float64], radius: float, color: tuple[int, int, int]) -> Shape:
    from sppm_pipeline.services.elastic.directional import sphere_mesh

    sphere, faces = sphere_mesh(2)
    return _many(centers[:, None, :] + radius * sphere, np.asarray(faces, np.int64), color)


def _rods(starts: NDArray[np.float64], ends: NDArray[np.float64], radius: float, color: tuple[int, int, int]) -> Shape:
    """Open prisms around segments."""
    along = ends - starts
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    helper = np.eye(3)[np.abs(along).argmin(1)]
    u = np.cross(along, helper)
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-12)
    v = np.cross(along, u)
    angle = np.arange(_SIDES) * 2 * np.pi / _SIDES
    ring = radius * (np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * v[:, None])
    points = np.concatenate([starts[:, None] + ring, ends[:, None] + ring], axis=1)
    here = np.arange(_SIDES)
    there = (here + 1) % _SIDES
    faces = np.concatenate(
        [np.stack([here, there, there + _SIDES], 1), np.stack([here, there + _SIDES, here + _SIDES], 1)]
    )
    return _many(points, faces, color)


def _clipped(starts: NDArray[np.float64], ends: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The parts of segments in the unit cube (Liang and Barsky 1984), those of some length."""
    along = ends - starts
    with np.errstate(divide="ignore", invalid="ignore"):
        enter, leave = -starts / along, (1 - starts) / along
    flat = along == 0
    outside = (flat & ((starts < 0) | (starts > 1))).any(1)
    enter, leave = np.minimum(enter, leave), np.maximum(enter, leave)
    first = np.where(flat, 0.0, enter).max(1).clip(0.0)
    last = np.where(flat, 1.0, leave).min(1).clip(max=1.0)
    there = ((last - first) * np.linalg.norm(along, axis=1) > 1e-9) & ~outside
    first, last = (t[there, None] for t in (first, last))
    return starts[there] + first * along[there], starts[there] + last * along[there]


def _box_edges(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Starts and ends of the 12 edges of a box."""
    corners = np.array(list(np.ndindex(2, 2, 2)))
    pairs = [(a, b) for a in range(8) for b in range(a) if np.abs(corners[a] - corners[b]).sum() == 1]
    places = low + corners * (high - low)
    return places[[a for a, _ in pairs]], places[[b for _, b in pairs]]
