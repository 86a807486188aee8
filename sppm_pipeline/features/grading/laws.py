"""Laws behind maps: formulas, tables, and data (images, samples, finite elements, distances, curves of stiffness)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.grading.numerics.curve import StiffnessCurve
from sppm_pipeline.features.grading.numerics.samples import by_inverse_distance
from sppm_pipeline.method.nouns.maps import (
    BOX_COORDINATES,
    CELL_COORDINATES,
    COORDINATES,
    DISTANCE,
    DataLaw,
    Law,
    Place,
)
from sppm_pipeline.services.expression import Expression
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.mesh.winding_number import dipoles, winding_numbers
from sppm_pipeline.services.monotone_cubic import monotone_cubic
from sppm_pipeline.services.nearest import element_tree, locate, nearest_in, surface_distances


@dataclass(frozen=True, eq=False)
class FormulaLaw(Law):
    """A formula of the coordinates and of earlier maps."""

    text: str
    names: tuple[str, ...]  # maps and coordinates that it may use
    constants: tuple[tuple[str, float], ...]
    box: NDArray[np.float64] | None  # low and high corner of the part, (2, 3) mm, of which u, v, w are shares
    surface: Law | None  # the distance from the part

    @cached_property
    def expression(self) -> Expression:
        """The compiled formula."""
        constants = [name for name, _ in self.constants]
        box = () if self.box is None else BOX_COORDINATES
        depth = () if self.surface is None else (DISTANCE,)
        return Expression(self.text, (*COORDINATES, *CELL_COORDINATES, *box, *depth, *constants, *self.names))

    def at(self, place: Place) -> NDArray[np.float64]:
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
    places: NDArray[np.float64]  # (k,), ascending; with steps values hold from a place to the next
    values: NDArray[np.float64]
    kind: str  # "steps", "linear" or "smooth", the last by monotone cubic polynomials

    def at(self, place: Place) -> NDArray[np.float64]:
        t = place.values(self.along)
        if self.kind == "steps" or len(self.places) == 1:
            return self.values[np.clip(np.searchsorted(self.places, t, side="right") - 1, 0, None)]
        if self.kind == "linear":
            return np.interp(t, self.places, self.values)
        curve = monotone_cubic(self.places, self.values).at
        # the curve does not leave the values but for rounding
        found: NDArray[np.float64] = np.clip(curve(np.clip(t, self.places[0], self.places[-1])), *self.bounds)
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

    points: NDArray[np.float64]
    values: NDArray[np.float64]
    by: str = "linear"

    @property
    def box(self) -> NDArray[np.float64]:
        return np.array([self.points.min(axis=0), self.points.max(axis=0)])

    @property
    def bounds(self) -> tuple[float, float]:
        return float(self.values.min()), float(self.values.max())

    @property
    def elements(self) -> NDArray[np.int64]:
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

    def at(self, place: Place) -> NDArray[np.float64]:
        if self.by == "linear":
            values, outside = self._mesh.values(self.values, place.points)
            return self.bounded(values, outside)
        if self.by == "nearest":
            found: NDArray[np.float64] = self.values[self._tree.query(place.points)[1]]
        else:
            found = by_inverse_distance(self._tree, self.values, place.points)
        return self.bounded(found, self.beyond(place.points))


@dataclass(frozen=True, eq=False)
class NodesLaw(PointsLaw):
    """Values at the nodes of a finite element mesh, linear in `tetrahedra` (k, 4) that fill its elements."""

    tetrahedra: NDArray[np.int64] = field(kw_only=True)

    @property
    def elements(self) -> NDArray[np.int64]:
        return self.tetrahedra


class Tetrahedra:
    """Tetrahedra that nodal values are interpolated in; nodes (n, 3), tetrahedra (m, 4)."""

    def __init__(self, nodes: NDArray[np.float64], tetrahedra: NDArray[np.int64]) -> None:
        from scipy.spatial import cKDTree

        self._tetrahedra = tetrahedra
        self._corners = np.ascontiguousarray(nodes[tetrahedra])
        self._boxes = element_tree(self._corners)
        self._used = np.unique(tetrahedra)
        self._nearest = cKDTree(nodes[self._used])

    def values(
        self, values: NDArray[np.float64], points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
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

    vertices: NDArray[np.float64]  # (n, 3) mm, of the surface; or a point, or two points of a line
    faces: NDArray[np.int32]  # (m, 3); empty for a line or point
    closed: bool  # there is an inside

    @cached_property
    def _tree(self) -> Any:
        return box_tree(self.vertices[self.faces])

    @cached_property
    def _poles(self) -> Any:
        return dipoles(self._tree)

    def at(self, place: Place) -> NDArray[np.float64]:
        if not len(self.faces):
            away = place.points - self.vertices[0]
            if len(self.vertices) == 2:
                along = self.vertices[1] - self.vertices[0]
                along = along / np.linalg.norm(along)
                away = away - np.outer(away @ along, along)
            far: NDArray[np.float64] = np.linalg.norm(away, axis=1)
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
    porosities: NDArray[np.float64]  # the structure's curve, (m,)
    moduli: NDArray[np.float64]
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

    def at(self, place: Place) -> NDArray[np.float64]:
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
