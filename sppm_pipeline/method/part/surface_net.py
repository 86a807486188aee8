"""A net of struts along the surface of a part, whose meshes are the pores of the surface.

Points are spread over the surface with a least distance from each other (Poisson disks). Two of them are neighbors if
they are the nearest two of some place of the surface, so that neighbors lie side by side along it (the witnesses of de
Silva and Carlsson 2004, "Topological estimation using witness complexes"), and are joined if no third point is nearer
to both (Toussaint 1980, "The relative neighbourhood graph of a finite planar set"). A strut follows the surface, inside
of it by its radius.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import F64, I64, Bools

PER_SPACING = 12
"""Places of the surface along the spacing of its points. A heuristic: with twice as many, one neighbor in a hundred is
found that is missed with these."""

PIECES = 6
"""Straight pieces of a strut. On a ball of the radius of its length they are off the surface by 1/280 of the length."""

SAME_SIDE = -0.5
"""Least cosine of the angle between normals of places that belong together; the other side of a thin wall has -1."""

MAX_PLACES = 4_000_000
"""Places of the surface: some hundred MB, about 10 s."""


class SurfaceNet(NamedTuple):
    """Points (n, 3) of the surface, mm, the pairs (m, 2) that are joined, and capsules (k, 7) along them."""

    points: F64
    edges: I64
    capsules: F64


def surface_net(triangles: F64, spacing: float, radius: float, rng: np.random.Generator) -> SurfaceNet:
    """The net on triangles (m, 3, 3), wound outwards, mm.

    Parameters
    ----------
    triangles : (m, 3, 3) float64
    spacing : float
        Least distance of its points, mm.
    radius : float
        Of the struts, mm.
    rng : numpy.random.Generator

    Raises
    ------
    DesignError
        If the surface needs too many points, or has room for less than two.
    """
    from scipy.spatial import cKDTree

    places, normals = _places(triangles, spacing, rng)
    tree = cKDTree(places)
    chosen = _spread(tree, normals, spacing)
    points, upright = places[chosen], normals[chosen]
    nodes = cKDTree(points)
    # the two nearest points of each place, on its side of a wall
    near = nodes.query(places, k=list(range(1, min(6, len(points)) + 1)))[1]
    beside = np.einsum("ni,nki->nk", normals, upright[near]) > SAME_SIDE
    order = np.argsort(~beside, axis=1, kind="stable")[:, :2]
    pairs = np.take_along_axis(near, order, 1)[beside.sum(1) >= 2]
    edges = np.unique(np.sort(pairs, axis=1), axis=0)
    if not len(edges):
        raise DesignError(
            f"the surface of the part has no room for points {spacing:g} mm apart", hint="give a smaller spacing"
        )
    edges = edges[_relative(nodes, upright, edges)]
    share = np.linspace(0, 1, PIECES + 1)[:, None]
    ends = points[edges][:, :, None]
    lines = ((1 - share) * ends[:, 0] + share * ends[:, 1]).reshape(-1, 3)
    for depth, several in ((0.0, 1), *[(radius, 4)] * 4):
        # onto the plane of the nearest place, then below the planes of all that are nearer than the radius
        nearest = tree.query(lines, k=list(range(1, min(several, len(places)) + 1)))[1]
        above = np.einsum("nki,nki->nk", lines[:, None] - places[nearest], normals[nearest]) + depth
        worst = above.argmax(1)[:, None]
        move = np.take_along_axis(above, worst, 1)
        lines -= (np.maximum(move, 0) if depth else move) * normals[np.take_along_axis(nearest, worst, 1)[:, 0]]
    lines = lines.reshape(-1, PIECES + 1, 3)
    both = np.concatenate([lines[:, :-1], lines[:, 1:]], axis=2).reshape(-1, 6)
    return SurfaceNet(points, edges, np.column_stack([both, np.full(len(both), radius)]))


def _relative(nodes: Any, upright: F64, edges: I64) -> Bools:
    """Edges between relative neighbors, to which no third point is nearer than they are to each other; and the shortest
    others of points that would have less than two."""
    points = nodes.data
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    around = nodes.query(points, k=list(range(1, min(16, len(points)) + 1)))[1]
    kept = np.ones(len(edges), np.bool_)
    for a, b in (edges.T, edges.T[::-1]):
        third = around[a]
        near = [np.linalg.norm(points[third] - points[end][:, None], axis=2) for end in (a, b)]
        closer = np.maximum(*near) < (1 - 1e-9) * length[:, None]
        closer &= np.einsum("ni,nki->nk", upright[a], upright[third]) > SAME_SIDE
        kept &= ~closer.any(1)
    degree = np.bincount(edges[kept].ravel(), minlength=len(points))
    for number in np.argsort(length, kind="stable"):
        if not kept[number] and degree[edges[number]].min() < 2:
            kept[number] = True
            degree[edges[number]] += 1
    return kept


def _places(triangles: F64, spacing: float, rng: np.random.Generator) -> tuple[F64, F64]:
    """Places (n, 3) all over the surface, in random order, and the normals there."""
    a, b, c = (triangles[:, corner] for corner in range(3))
    normals = np.cross(b - a, c - a)
    doubled = np.linalg.norm(normals, axis=1)
    area = doubled.sum() / 2
    count = math.ceil(area * (PER_SPACING / spacing) ** 2)
    if count > MAX_PLACES:
        least = PER_SPACING * math.sqrt(area / MAX_PLACES)
        raise DesignError(
            f"a net with points every {spacing:g} mm on {area:.4g} mm2 of surface has too many of them",
            hint=f"give a spacing of {least:.2g} mm or more",
        )
    # one in each of so many equal shares of the area
    wanted = (np.arange(count) + rng.random(count)) / count
    which = np.searchsorted(np.cumsum(doubled) / doubled.sum(), wanted).clip(max=len(triangles) - 1)
    which = which[doubled[which] > 0]
    which = rng.permutation(which)
    u, v = np.sqrt(rng.random(len(which)))[:, None], rng.random(len(which))[:, None]
    return (1 - u) * a[which] + u * (1 - v) * b[which] + u * v * c[which], normals[which] / doubled[which][:, None]


def _spread(tree: Any, normals: F64, spacing: float) -> I64:
    """Numbers of places that are at least a distance apart, each the first in order that is free."""
    free = np.ones(len(normals), np.bool_)
    chosen = []
    for place, normal in enumerate(normals):
        if free[place]:
            chosen.append(place)
            near = np.asarray(tree.query_ball_point(tree.data[place], spacing))
            free[near[normals[near] @ normal > SAME_SIDE]] = False
    return np.array(chosen, np.int64)
