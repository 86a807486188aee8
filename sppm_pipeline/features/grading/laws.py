"""Laws behind maps: formulas, tables, and data (images, samples, finite elements, distances, curves of stiffness)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.grading.numerics.curve import StiffnessCurve
from sppm_pipeline.method.nouns.maps import (
    BOX_COORDINATES,
    CELL_COORDINATES,
    COORDINATES,
    DISTANCE,
    DataLaw,
    Law,
    Place,
)
from sppm_pipeline.services.arrays import F64, I32, I64, Bools
from sppm_pipeline.services.expression import Expression
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.mesh.winding_number import dipoles, winding_numbers
from sppm_pipeline.services.monotone_cubic import monotone_cubic
from sppm_pipeline.services.nearest import element_tree, locate, nearest_in, surface_distances

NEIGHBORS, POWER = 8, 2
"""Points of a mean by inverse distances, and the power of the distance: Shepard (1968) recommends four to ten points
and the square."""

CORNERS = {
    "tetra": 4, "tetra10": 4, "hexahedron": 8, "hexahedron20": 8, "hexahedron27": 8, "wedge": 6, "wedge15": 6,
    "pyramid": 5, "pyramid13": 5,
}  # fmt: skip
"""Solid elements that are read, and their corner nodes, which come first; others are nodes on edges and faces."""

_SPLITS: Mapping[int, list[list[int]]] = {
    4: [[0, 1, 2, 3]],
    5: [[0, 1, 2, 4], [0, 2, 3, 4]],
    6: [[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]],
    8: [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]],
}
"""Tetrahedra that fill an element, by its number of corners; those of a hexahedron share a diagonal."""

MAX_PAIRS = 200_000_000
"""Pairs of nodes that smoothing sums over; a tenth of a microsecond each."""


def by_inverse_distance(tree: Any, values: F64, points: F64) -> F64:
    """Mean of the nearest samples by inverse squared distances; at a sample its own value."""
    count = min(NEIGHBORS, len(values))
    distance, near = tree.query(points, count)
    distance, near = distance.reshape(len(points), count), near.reshape(len(points), count)
    there = distance[:, 0] == 0
    # relative to the nearest one, so that nothing overflows
    weights = (np.where(there, 1.0, distance[:, 0])[:, None] / np.where(distance > 0, distance, 1.0)) ** POWER
    weights[there] = np.where(distance[there] == 0, 1.0, 0.0)
    means: F64 = (weights * values[near]).sum(axis=1) / weights.sum(axis=1)
    return means


def as_tetrahedra(blocks: list[tuple[str, I64]]) -> I64:
    """Corner nodes (m, 4) of tetrahedra that fill solid elements; each block is a type and its nodes (k, nodes)."""
    parts = []
    for kind, nodes in blocks:
        split = np.array(_SPLITS[CORNERS[kind]])
        parts.append(nodes[:, split].reshape(-1, 4))
    return np.concatenate(parts) if parts else np.zeros((0, 4), np.int64)


def tetrahedra_of(blocks: list[tuple[str, I64]]) -> I64:
    """Number of tetrahedra that `as_tetrahedra` makes of each element, (elements,)."""
    return np.concatenate([np.full(len(nodes), len(_SPLITS[CORNERS[kind]])) for kind, nodes in blocks])


def volumes(corners: F64) -> F64:
    """Volumes (m,) of tetrahedra (m, 4, 3)."""
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    found: F64 = np.abs(np.einsum("ij,ij->i", np.cross(a, b), c)) / 6
    return found


def at_nodes(tetrahedra: I64, volume: F64, values: F64, count: int) -> F64:
    """Values of tetrahedra as means at the nodes, weighted by volume: (count,), NaN at nodes of no element."""
    nodes, weights = tetrahedra.ravel(), np.repeat(volume, 4)
    total = np.bincount(nodes, weights, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        means: F64 = np.bincount(nodes, weights * np.repeat(values, 4), count) / total
    return means


def smoothed(nodes: F64, weights: F64, values: F64, sigma: float) -> F64:
    """Means of nodal values, weighted by a Gaussian of the distance and by the nodes' volumes.

    The Gaussian has the standard deviation `sigma`, and is cut off at three of them; the `weights` are the nodes'
    volumes, a quarter of those of their tetrahedra. `ValueError` if so many nodes lie within reach of each other that
    it would take very long.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(nodes)
    pairs = int(tree.count_neighbors(tree, 3 * sigma))
    if pairs > MAX_PAIRS:
        raise ValueError(f"{pairs:.2g} pairs of nodes lie within 3 x {sigma:g} of each other; up to {MAX_PAIRS:.0e} do")
    # some four million pairs at a time, for memory
    step = max(1, int(len(nodes) * 4e6 / max(pairs, 1)))
    means = np.empty(len(nodes))
    for start in range(0, len(nodes), step):
        own = cKDTree(nodes[start : start + step])
        near = own.sparse_distance_matrix(tree, 3 * sigma, output_type="ndarray")
        # in a fixed order, so that sums do not depend on how the tree was walked
        near = near[np.lexsort((near["j"], near["i"]))]
        share = np.exp(-0.5 * (near["v"] / sigma) ** 2) * weights[near["j"]]
        count = len(own.data)
        total = np.bincount(near["i"], share, count)
        means[start : start + count] = np.bincount(near["i"], share * values[near["j"]], count) / total
    return means


@dataclass(frozen=True, eq=False)
class FormulaLaw(Law):
    """A formula of the coordinates and of earlier maps."""

    text: str
    names: tuple[str, ...]  # maps and coordinates that it may use
    constants: tuple[tuple[str, float], ...]
    box: F64 | None  # low and high corner of the part, (2, 3) mm, of which u, v, w are shares
    surface: Law | None  # the distance from the part

    @cached_property
    def expression(self) -> Expression:
        """The compiled formula."""
        constants = [name for name, _ in self.constants]
        box = () if self.box is None else BOX_COORDINATES
        depth = () if self.surface is None else (DISTANCE,)
        return Expression(self.text, (*COORDINATES, *CELL_COORDINATES, *box, *depth, *constants, *self.names))

    def at(self, place: Place) -> F64:
        constants = dict(self.constants)
        values = {}
        for name in self.expression.used:
            if name in constants:
                values[name] = np.full(len(place.points), constants[name])
            elif name in BOX_COORDINATES and self.box is not None:
                axis = BOX_COORDINATES.index(name)
                low, high = self.box[:, axis]
                values[name] = (place.points[:, axis] - low) / (high - low)
            elif name == DISTANCE and self.surface is not None:
                values[name] = self.surface.at(place)
            else:
                values[name] = place.values(name)
        return self.expression.evaluate(values, len(place.points))

    @property
    def needs(self) -> tuple[str, ...]:
        return tuple(name for name in self.expression.used if name in self.names)

    def blame(self) -> str:
        return f"the map {self.name!r}, the formula {self.text!r},"


@dataclass(frozen=True, eq=False)
class TableLaw(Law):
    """Values at places along a coordinate or over an earlier map."""

    along: str  # "x", "cell_x", or the name of a map
    places: F64  # (k,), ascending; with steps values hold from a place to the next
    values: F64
    kind: str  # "steps", "linear" or "smooth", the last by monotone cubic polynomials

    def at(self, place: Place) -> F64:
        t = place.values(self.along)
        if self.kind == "steps" or len(self.places) == 1:
            return self.values[np.clip(np.searchsorted(self.places, t, side="right") - 1, 0, None)]
        if self.kind == "linear":
            return np.interp(t, self.places, self.values)
        curve = monotone_cubic(self.places, self.values).at
        # the curve does not leave the values but for rounding
        found: F64 = np.clip(curve(np.clip(t, self.places[0], self.places[-1])), *self.bounds)
        return found

    @property
    def needs(self) -> tuple[str, ...]:
        return () if self.along in (*COORDINATES, *CELL_COORDINATES) else (self.along,)

    @property
    def bounds(self) -> tuple[float, float]:
        return float(self.values.min()), float(self.values.max())


@dataclass(frozen=True, eq=False)
class PointsLaw(DataLaw):
    """Samples at points (m, 3) mm: linear in tetrahedra, "nearest", or a mean by inverse distances, "idw"."""

    points: F64
    values: F64
    by: str = "linear"

    @property
    def box(self) -> F64:
        return np.array([self.points.min(axis=0), self.points.max(axis=0)])

    @property
    def bounds(self) -> tuple[float, float]:
        return float(self.values.min()), float(self.values.max())

    @property
    def elements(self) -> I64:
        """Points of each tetrahedron, (k, 4): those of Delaunay."""
        from scipy.spatial import Delaunay

        return np.asarray(Delaunay(self.points).simplices, np.int64)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    @cached_property
    def _mesh(self) -> Tetrahedra:
        return Tetrahedra(self.points, self.elements)

    def at(self, place: Place) -> F64:
        if self.by == "linear":
            values, outside = self._mesh.values(self.values, place.points)
            return self.bounded(values, outside)
        if self.by == "nearest":
            found: F64 = self.values[self._tree.query(place.points)[1]]
        else:
            found = by_inverse_distance(self._tree, self.values, place.points)
        return self.bounded(found, self.beyond(place.points))


@dataclass(frozen=True, eq=False)
class NodesLaw(PointsLaw):
    """Values at the nodes of a finite element mesh, linear in `tetrahedra` (k, 4) that fill its elements."""

    tetrahedra: I64 = field(kw_only=True)

    @property
    def elements(self) -> I64:
        return self.tetrahedra


class Tetrahedra:
    """Tetrahedra that nodal values are interpolated in; nodes (n, 3), tetrahedra (m, 4)."""

    def __init__(self, nodes: F64, tetrahedra: I64) -> None:
        from scipy.spatial import cKDTree

        self._tetrahedra = tetrahedra
        self._corners = np.ascontiguousarray(nodes[tetrahedra])
        self._boxes = element_tree(self._corners)
        self._used = np.unique(tetrahedra)
        self._nearest = cKDTree(nodes[self._used])

    def values(self, values: F64, points: F64) -> tuple[F64, Bools]:
        """Values (n,) at points (n, 3), and which of them lie outside and have the value of the nearest element."""
        # linear in the element that holds a point; beyond all of them, in the nearest one at the node next to the point
        element, weights = locate(self._boxes, self._corners, points)
        outside = element < 0
        if outside.any():
            node = self._used[self._nearest.query(points[outside])[1]]
            found = nearest_in(self._corners, self._tetrahedra, node, points[outside])
            element[outside], weights[outside] = found
            # what rounding puts beyond the surface lies on it
            placed = np.einsum("ij,ijk->ik", weights[outside], self._corners[element[outside]])
            away = np.abs(placed - points[outside]).max(axis=1)
            outside[outside] = away > 1e-9 * np.abs(points).max()
        return np.einsum("ij,ij->i", weights, values[self._tetrahedra[element]]), outside


@dataclass(frozen=True, eq=False)
class DistanceLaw(Law):
    """Distance from a surface, positive inside of it if it is closed; from a line, or from a point."""

    vertices: F64  # (n, 3) mm, of the surface; or a point, or two points of a line
    faces: I32  # (m, 3); empty for a line or point
    closed: bool  # there is an inside

    @cached_property
    def _tree(self) -> Any:
        return box_tree(self.vertices[self.faces])

    @cached_property
    def _poles(self) -> Any:
        return dipoles(self._tree)

    def at(self, place: Place) -> F64:
        if not len(self.faces):
            away = place.points - self.vertices[0]
            if len(self.vertices) == 2:
                along = self.vertices[1] - self.vertices[0]
                along = along / np.linalg.norm(along)
                away = away - np.outer(away @ along, along)
            far: F64 = np.linalg.norm(away, axis=1)
            return far
        distance = surface_distances(self._tree, place.points)
        if not self.closed:
            return distance
        # a point lies on the side of the one before if it is nearer to that than the surface is
        step = np.linalg.norm(np.diff(place.points, axis=0), axis=1)
        asked = np.concatenate([[True], step >= distance[:-1]])[: len(distance)]
        # winding numbers, since a few gaps or overlaps of a mesh must not turn a side inside out
        inside = winding_numbers(self._poles, place.points[asked]) > 0.5
        return np.where(inside[np.cumsum(asked) - 1], distance, -distance)


@dataclass(frozen=True, eq=False)
class StiffnessLaw(Law):
    """The porosity at which a structure has the modulus that an earlier map asks for."""

    wanted: str  # name of the map of moduli
    porosities: F64  # the structure's curve, (m,)
    moduli: F64
    deviation: float  # relative standard deviation of single cells around it

    @property
    def curve(self) -> StiffnessCurve:
        """Modulus over porosity."""
        return StiffnessCurve(self.porosities, self.moduli, self.deviation)

    @property
    def needs(self) -> tuple[str, ...]:
        return (self.wanted,)

    @property
    def bounds(self) -> tuple[float, float]:
        return float(self.porosities[0]), float(self.porosities[-1])

    def at(self, place: Place) -> F64:
        wanted = place.values(self.wanted)
        found = self.curve.porosity(wanted)
        out = np.isnan(found)
        if out.any():
            first = int(np.argmax(out))
            x, y, z = place.points[first]
            raise DesignError(
                f"the map {self.wanted!r} asks for a modulus of {wanted[first]:g} at ({x:g}, {y:g}, {z:g}) mm, and at "
                f"{int(out.sum())} of {len(out)} points for one that the structure does not have: its curve goes from "
                f"{self.moduli[-1]:.4g} at a porosity of {self.porosities[-1]:.3g} to {self.moduli[0]:.4g} at "
                f"{self.porosities[0]:.3g}",
                hint="bound the map by clip(), or change the pores of the structure",
            )
        return found
