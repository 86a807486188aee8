"""Tetrahedral meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline import ConfigError, Viewable, frozen
from sppm_pipeline.nouns import Surface, optional_module
from sppm_pipeline.numerics import F64, I32, I64, U8, Bools
from sppm_tetrahedra.numerics.faces import boundary_triangles, face_neighbors

TOLERANCE = 1e-6
"""Fraction of the shortest edge of the box by which copies may miss each other."""


class FaceMatch(NamedTuple):
    """Agreement of the triangles in opposite faces of a box; each is an array of three, for x, y and z."""

    area: F64  # mean area of the mesh in the low and the high face
    matched: I64  # pairs of triangles that are copies of each other
    # triangles without a copy and with nothing on the other side: there the surface of the solid lies in the face
    free: I64
    # triangles without a copy that overlap some on the other side; the mesh does not repeat there
    mismatched: I64


def on_faces(
    nodes: NDArray[np.floating], box: NDArray[np.floating], tolerance: float = TOLERANCE
) -> tuple[Bools, Bools]:
    """Test which nodes lie in the low and in the high face of the box, (n, 3) bool each, across x, y, z."""
    reach = tolerance * float(np.min(box[1] - box[0]))
    return np.abs(nodes - box[0]) <= reach, np.abs(nodes - box[1]) <= reach


def matched_nodes(nodes: NDArray[np.floating], box: NDArray[np.floating], tolerance: float = TOLERANCE) -> I64:
    """For each node (n,) the one that stands for it and all its copies on faces, edges and corners of a periodic box.

    The representative of a node is its copy on the low faces; of copies none of which lies on low faces only, the one
    with the lowest number. A node without copies, inside the box or on a face whose other side has none there, stands
    for itself. Unknowns of representatives are what is left of a periodic problem; applied twice it changes nothing
    more. Copies may miss each other by `tolerance`, a fraction of the shortest edge of the box (2, 3). ValueError if
    two nodes at the same face are closer to each other than that, so that a copy could be either.
    """
    from scipy.spatial import cKDTree

    points = np.asarray(nodes, np.float64)
    low, high = on_faces(points, box, tolerance)
    standing = np.arange(len(points))
    chosen = np.flatnonzero((low | high).any(1))
    if not len(chosen):
        return standing
    # all copies moved onto the low faces lie in one place; those that lay there come first
    wrapped = np.where(low[chosen] | high[chosen], np.asarray(box[0], np.float64), points[chosen])
    order = np.lexsort((chosen, high[chosen].any(1)))
    chosen, wrapped = chosen[order], wrapped[order]
    reach = tolerance * float(np.min(box[1] - box[0]))
    found = cKDTree(wrapped).query_pairs(2 * reach, output_type="ndarray")
    place = np.arange(len(chosen))
    np.minimum.at(place, found.max(1), found.min(1))
    if (place[found[:, 0]] != place[found[:, 1]]).any():
        raise ValueError("nodes on a face of the box are too close to each other to distinguish their copies")
    same = np.linalg.norm(points[chosen[found[:, 0]]] - points[chosen[found[:, 1]]], axis=1) <= 2 * reach
    if same.any():
        raise ValueError(f"nodes {chosen[found[np.argmax(same)]].tolist()} on a face of the box coincide")
    standing[chosen] = chosen[place]
    return standing


def face_match(
    nodes: NDArray[np.floating], tets: NDArray[np.integer], box: NDArray[np.floating], tolerance: float = TOLERANCE
) -> FaceMatch:
    """Compare the triangles of a mesh, (n, 3) and (m, 4 or more), in opposite faces of its box; see `matched_nodes`."""
    from scipy.spatial import cKDTree

    reach = 2 * tolerance * float(np.min(box[1] - box[0]))
    points = np.asarray(nodes, np.float64)
    triangles = boundary_triangles(tets, face_neighbors(tets))
    low, high = on_faces(points, box, tolerance)
    area, counts = np.zeros(3), np.zeros((3, 3), np.int64)
    for axis in range(3):
        sides = [triangles[flags[triangles, axis].all(1)] for flags in (low, high)]
        plane = np.delete(points, axis, 1)
        area[axis] = sum(np.abs(_doubled_areas(plane[side])).sum() for side in sides) / 4
        partner = np.arange(len(points))
        below, above = (np.unique(side) for side in sides)
        if len(below) and len(above):
            away, nearest = cKDTree(plane[below]).query(plane[above], distance_upper_bound=reach)
            partner[above[away <= reach]] = below[nearest[away <= reach]]
        keys = [np.sort(partner[side], axis=1) for side in sides]
        _, index, times = np.unique(np.concatenate(keys), axis=0, return_inverse=True, return_counts=True)
        alone = times[index.ravel()] == 1
        lone = [sides[0][alone[: len(sides[0])]], sides[1][alone[len(sides[0]) :]]]
        mismatched = sum(int(_covered(plane[one].mean(1), plane[other]).sum()) for one, other in (lone, lone[::-1]))
        counts[:, axis] = (times == 2).sum(), len(lone[0]) + len(lone[1]) - mismatched, mismatched
    return FaceMatch(area, counts[0], counts[1], counts[2])


def _doubled_areas(triangles: F64) -> F64:
    """Twice the areas of plane triangles (k, 3, 2), with sign."""
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def _covered(points: F64, triangles: F64) -> Bools:
    """Test which points in a plane lie inside one of some triangles."""
    covered = np.zeros(len(points), np.bool_)
    for triangle in triangles:
        edges = np.roll(triangle, -1, axis=0) - triangle
        turns = np.stack(
            [e[0] * (points - p)[:, 1] - e[1] * (points - p)[:, 0] for e, p in zip(edges, triangle, strict=True)]
        )
        covered |= (turns > 0).all(0) | (turns < 0).all(0)
    return covered


def loose_parts(
    nodes: NDArray[np.floating], cells: NDArray[np.integer], box: NDArray[np.floating], standing: NDArray[np.integer]
) -> int:
    """Number of the parts of a periodic mesh if all of them are loose; 0 if one runs through the box along some axis.

    A part runs through if it holds a way along edges from a node to a copy of that node in another period. `standing`,
    (n,), is that of `matched_nodes`.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ways = np.concatenate([cells[:, [0, end]] for end in (1, 2, 3)])
    count = len(nodes)
    part = connected_components(coo_array((np.ones(len(ways), np.int8), ways.T), (count, count)), directed=False)[1]
    used = np.zeros(count, bool)
    used[cells] = True
    copies = np.flatnonzero(used & (standing != np.arange(count)) & used[standing])
    shifts = np.rint((nodes[copies] - nodes[standing[copies]]) / (box[1] - box[0])).astype(np.int64)
    # parts as they lie in the box, and by how many periods what belongs together across its faces is apart
    seams: dict[int, list[tuple[int, I64]]] = {int(label): [] for label in np.unique(part[used])}
    for one, other, *shift in np.unique(np.column_stack([part[copies], part[standing[copies]], shifts]), axis=0):
        seams[int(one)].append((int(other), np.array(shift)))
        seams[int(other)].append((int(one), -np.array(shift)))
    place: dict[int, I64] = {}
    found = 0
    for first in seams:
        if first in place:
            continue
        found += 1
        place[first], todo = np.zeros(3, np.int64), [first]
        while todo:
            one = todo.pop()
            for other, shift in seams[one]:
                if other not in place:
                    place[other] = place[one] + shift
                    todo.append(other)
                # the same part is met again some periods away: it runs through
                elif (place[other] != place[one] + shift).any():
                    return 0
    return found


@dataclass(frozen=True, eq=False)
class VolumeMesh(Viewable):
    """A mesh of tetrahedra with positive volume, straight (4 nodes) or quadratic (10 nodes).

    Attributes
    ----------
    nodes : (n, 3) float64, mm
    cells : (m, 4) or (m, 10) int32
        The first four nodes are the corners, the fourth on the side of the first three that their normal by the right
        hand points to; the mid-edge nodes follow in the order 01, 12, 02, 03, 13, 23.
    box : (2, 3) float64, mm, or None
        Low and high corner of the periodic cell that the mesh fills, if it is one.
    matched : bool
        Whether nodes on opposite faces of the box are copies of each other, shifted by its edge, so that the mesh
        repeats without a seam.
    materials : (m,) uint8
        Index of the material of each cell, from 1.
    name : str
        What a person would call it, for messages.
    """

    reported: ClassVar[tuple[str, ...]] = ("nodes", "cells", "order", "volume_mm3", "matched", "porosity")

    nodes: F64
    cells: I32
    box: F64 | None = None
    matched: bool = False
    materials: U8 | None = None
    name: str = "volume mesh"

    def __post_init__(self) -> None:
        cells = np.asarray(self.cells, np.int32)
        object.__setattr__(self, "nodes", frozen(np.asarray(self.nodes, np.float64)))
        object.__setattr__(self, "cells", frozen(cells))
        if self.box is not None:
            object.__setattr__(self, "box", frozen(np.asarray(self.box, np.float64)))
        materials = np.ones(len(cells), np.uint8) if self.materials is None else self.materials
        object.__setattr__(self, "materials", frozen(np.asarray(materials, np.uint8)))

    @classmethod
    def from_arrays(cls, nodes: ArrayLike, cells: ArrayLike, **details: Any) -> VolumeMesh:
        """A mesh of nodes (n, 3), mm, and tetrahedra (m, 4) or (m, 10); `details` are further fields.

        Raises
        ------
        ValueError
            If shapes do not fit or an index is out of range.
        """
        mesh = cls(np.array(nodes, np.float64), np.array(cells, np.int32), **details)
        mesh.check()
        return mesh

    def to_pyvista(self) -> Any:
        """A `pyvista.UnstructuredGrid`; `ResourceError` if pyvista is not installed."""
        straight = self.cells.shape[1] == 4
        kind = 10 if straight else 24  # VTK_TETRA, VTK_QUADRATIC_TETRA
        grid = optional_module("pyvista").UnstructuredGrid({kind: self.cells}, self.nodes)
        grid.cell_data["material"] = self.material_of_cells
        return grid

    def check(self) -> None:
        """Shapes that fit each other, finite nodes, indices in range."""
        if self.nodes.ndim != 2 or self.nodes.shape[1] != 3 or not np.isfinite(self.nodes).all():
            raise ValueError("nodes must be finite points in space")
        if self.cells.ndim != 2 or self.cells.shape[1] not in (4, 10):
            raise ValueError(f"cells need 4 or 10 nodes, got shape {self.cells.shape}")
        if len(self.cells) and int(self.cells.view(np.uint32).max()) >= len(self.nodes):
            raise ValueError("a cell names a node that does not exist")
        if self.box is not None and not (self.box.shape == (2, 3) and (self.box[1] > self.box[0]).all()):
            raise ValueError("the box needs a low and a high corner")
        if self.matched and self.box is None:
            raise ValueError("a mesh without a box has no opposite faces")
        if self.materials is None or self.materials.shape != (len(self.cells),):
            raise ValueError("each cell needs a material")

    @property
    def volume(self) -> float:
        """Sum over the cells, as if their edges were straight, mm^3."""
        a, b, c, d = (self.nodes[self.cells[:, corner]] for corner in range(4))
        return float(np.einsum("ij,ij->", np.cross(b - a, c - a), d - a)) / 6

    @property
    def material_of_cells(self) -> U8:
        """`materials`, which are always there once the mesh is made."""
        assert self.materials is not None
        return self.materials

    def constants(self, name: str, given: float | tuple[float, ...]) -> list[float]:
        """The constant `name` of each material, given once or for each; `ConfigError` if some have none."""
        count = int(self.material_of_cells.max())
        values = list(given) if isinstance(given, tuple) else [given] * count
        if len(values) < count:
            raise ConfigError(f"the mesh has {count} materials, `{name}` gives values for {len(values)}")
        return values

    @property
    def around(self) -> F64:
        """The box, or else the bounding box of the nodes, (2, 3) mm."""
        return self.box if self.box is not None else np.array([self.nodes.min(axis=0), self.nodes.max(axis=0)])

    def live_view(self) -> Surface:
        """The triangles of its boundary."""
        faces = boundary_triangles(self.cells, face_neighbors(self.cells))
        return Surface(self.nodes, faces, f"surface of the {self.name}", "mm")

    def summary(self) -> dict[str, Any]:
        """Nodes, cells, volume, and for a periodic cell its porosity."""
        summary: dict[str, Any] = {
            "nodes": len(self.nodes), "cells": len(self.cells), "order": 1 if self.cells.shape[1] == 4 else 2,
            "volume_mm3": self.volume, "matched": self.matched,
        }  # fmt: skip
        if self.box is not None:
            summary["porosity"] = 1 - self.volume / float(np.prod(self.box[1] - self.box[0]))
        return summary
