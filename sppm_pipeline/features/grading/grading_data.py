"""Laws of maps that are data: an image, samples at points, values of a finite element mesh, distances."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.grading.grading import Law, Place
from sppm_pipeline.features.grading.numerics.curve import StiffnessCurve
from sppm_pipeline.nouns.artifact import frozen


@dataclass(frozen=True, eq=False)
class DataLaw(Law):
    """Base of laws that are data.

    Attributes
    ----------
    outside : str
        "nearest" goes on with the nearest value where there are no data; with "refuse" there is no value.
    """

    outside: str

    @property
    def box(self) -> NDArray[np.float64]:
        """Low and high corner of the data, (2, 3) mm."""
        raise NotImplementedError

    def beyond(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points (n, 3) lie outside of the box of the data, up to rounding."""
        low, high = self.box
        slack = 1e-9 * np.abs(self.box).max()
        found: NDArray[np.bool_] = ((points < low - slack) | (points > high + slack)).any(axis=1)
        return found

    def bounded(self, values: NDArray[np.float64], outside: NDArray[np.bool_]) -> NDArray[np.float64]:
        """`values`, without those outside if these are refused."""
        return np.where(outside, np.nan, values) if self.outside == "refuse" else values


@dataclass(frozen=True, eq=False)
class ImageLaw(DataLaw):
    """An image, linear between the middles of voxels.

    Attributes
    ----------
    values : (nx, ny, nz)
        Any type of numbers.
    origin, spacing : tuple of 3 floats
        Low corner of the first voxel, and edges of a voxel, mm.
    factor : float
        What the numbers are multiplied by.
    """

    values: NDArray[Any]
    origin: tuple[float, float, float]
    spacing: tuple[float, float, float]
    factor: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen(self.values))

    @property
    def box(self) -> NDArray[np.float64]:
        low = np.array(self.origin)
        return np.array([low, low + np.array(self.spacing) * self.values.shape])

    @property
    def bounds(self) -> tuple[float, float]:
        return self.factor * float(self.values.min()), self.factor * float(self.values.max())

    def at(self, place: Place) -> NDArray[np.float64]:
        from scipy.ndimage import map_coordinates

        index = (place.points - self.origin) / self.spacing - 0.5
        index = np.clip(index, 0, np.array(self.values.shape) - 1)
        found = map_coordinates(self.values, index.T, np.float64, order=1, mode="nearest", prefilter=False)
        return self.bounded(self.factor * found, self.beyond(place.points))


@dataclass(frozen=True, eq=False)
class PointsLaw(DataLaw):
    """Samples at points: linear in the tetrahedra of Delaunay, of the nearest one, or by inverse distances.

    Attributes
    ----------
    points : (m, 3) float64, mm
    values : (m,) float64
    by : str
        "linear", "nearest" or "idw".
    """

    points: NDArray[np.float64]
    values: NDArray[np.float64]
    by: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points))
        object.__setattr__(self, "values", frozen(self.values))

    @property
    def box(self) -> NDArray[np.float64]:
        return np.array([self.points.min(axis=0), self.points.max(axis=0)])

    @property
    def bounds(self) -> tuple[float, float]:
        return float(self.values.min()), float(self.values.max())

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    @cached_property
    def _mesh(self) -> Tetrahedra:
        from scipy.spatial import Delaunay

        return Tetrahedra(self.points, Delaunay(self.points).simplices.astype(np.int64))

    def at(self, place: Place) -> NDArray[np.float64]:
        from sppm_pipeline.features.grading.numerics.samples import by_inverse_distance

        if self.by == "linear":
            values, outside = self._mesh.values(self.values, place.points)
            return self.bounded(values, outside)
        if self.by == "nearest":
            found: NDArray[np.float64] = self.values[self._tree.query(place.points)[1]]
        else:
            found = by_inverse_distance(self._tree, self.values, place.points)
        return self.bounded(found, self.beyond(place.points))


class Tetrahedra:
    """Tetrahedra that nodal values are interpolated in; nodes (n, 3), tetrahedra (m, 4)."""

    def __init__(self, nodes: NDArray[np.float64], tetrahedra: NDArray[np.int64]) -> None:
        from scipy.spatial import cKDTree

        from sppm_pipeline.services.nearest import element_tree

        self._tetrahedra = tetrahedra
        self._corners = np.ascontiguousarray(nodes[tetrahedra])
        self._boxes = element_tree(self._corners)
        self._used = np.unique(tetrahedra)
        self._nearest = cKDTree(nodes[self._used])

    def values(
        self, values: NDArray[np.float64], points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Values (n,) at points (n, 3), and which of them lie outside and have the value of the nearest element."""
        from sppm_pipeline.services.nearest import locate, nearest_in

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
class NodesLaw(DataLaw):
    """Values at the nodes of a finite element mesh, linear in tetrahedra that fill its elements.

    Attributes
    ----------
    nodes : (n, 3) float64, mm
    tetrahedra : (m, 4) int64
    values : (n,) float64
    """

    nodes: NDArray[np.float64]
    tetrahedra: NDArray[np.int64]
    values: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name in ("nodes", "tetrahedra", "values"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def box(self) -> NDArray[np.float64]:
        return np.array([self.nodes.min(axis=0), self.nodes.max(axis=0)])

    @property
    def bounds(self) -> tuple[float, float]:
        return float(self.values.min()), float(self.values.max())

    @cached_property
    def _mesh(self) -> Tetrahedra:
        return Tetrahedra(self.nodes, self.tetrahedra)

    def at(self, place: Place) -> NDArray[np.float64]:
        values, outside = self._mesh.values(self.values, place.points)
        return self.bounded(values, outside)


@dataclass(frozen=True, eq=False)
class DistanceLaw(Law):
    """Distance from a surface, positive inside of it if it is closed; from a line, or from a point.

    Attributes
    ----------
    vertices : (n, 3) float64, mm
        Those of the surface; or a point, or two points of a line.
    faces : (m, 3) int32
        Empty for a line or point.
    closed : bool
        Whether there is an inside.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    closed: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(self.vertices))
        object.__setattr__(self, "faces", frozen(self.faces))

    @cached_property
    def _tree(self) -> Any:
        from sppm_pipeline.services.mesh.box_tree import box_tree

        return box_tree(self.vertices[self.faces])

    @cached_property
    def _poles(self) -> Any:
        from sppm_pipeline.services.mesh.winding_number import dipoles

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
        from sppm_pipeline.services.mesh.winding_number import winding_numbers
        from sppm_pipeline.services.nearest import surface_distances

        distance = surface_distances(self._tree, place.points)
        if not self.closed:
            return distance
        # a point lies on the side of the one before if it is nearer to that than the surface is
        step = np.linalg.norm(np.diff(place.points, axis=0), axis=1)
        asked = np.concatenate([[True], step >= distance[:-1]])[: len(distance)]
        inside = winding_numbers(self._poles, place.points[asked]) > 0.5
        return np.where(inside[np.cumsum(asked) - 1], distance, -distance)


@dataclass(frozen=True, eq=False)
class StiffnessLaw(Law):
    """The porosity at which a structure has the modulus that an earlier map asks for.

    Attributes
    ----------
    wanted : str
        Name of the map of moduli.
    porosities, moduli : (m,) float64
        The structure's curve.
    deviation : float
        Relative standard deviation of single cells around it.
    """

    wanted: str
    porosities: NDArray[np.float64]
    moduli: NDArray[np.float64]
    deviation: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "porosities", frozen(self.porosities))
        object.__setattr__(self, "moduli", frozen(self.moduli))

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
